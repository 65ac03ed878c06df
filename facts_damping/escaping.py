"""The door for text: what comes from outside is shown as it is written, and steers no terminal."""

from __future__ import annotations

SCREEN = 1200  # characters: an error longer than this is not read


def escaped(text: str) -> str:
    r"""Text on lines, of characters that can be seen: others, and those that turn others' order, as `\x1b`, `\u202e`.

    Lines end, and tabulators stay.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in "\n\t" else _escape(one) for one in text)


def _escape(one: str) -> str:
    return one.encode("unicode_escape").decode("ascii")


def shortened(text: str, most: int = SCREEN) -> str:
    """Text of at most so many characters: of a longer one the beginning and the end, which says what is allowed."""
    if len(text) <= most:
        return text
    end = most // 3
    return f"{text[: most - end - 5]} ... {text[len(text) - end :]}"
