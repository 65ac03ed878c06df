"""Escapes text from outside, so that it shows as written and cannot control the terminal."""

from __future__ import annotations

SCREEN = 1200  # characters of the longest error message


def escaped(text: str) -> str:
    r"""Text in which unprintable characters, such as `\x1b` or the bidirectional control `\u202e`, are escaped.

    Line breaks and tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() or letter in "\n\t" else _escape(letter) for letter in text)


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def shortened(text: str, maximum: int = SCREEN) -> str:
    """Text of at most `maximum` characters: long text keeps its beginning and its end, which states what is allowed."""
    if len(text) <= maximum:
        return text
    end = maximum // 3
    return f"{text[: maximum - end - 5]} ... {text[len(text) - end :]}"
