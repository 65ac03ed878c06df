"""Building blocks of the command line: the parser, types of values, shared options."""

from __future__ import annotations

import argparse
import math
import os
import re
from typing import TYPE_CHECKING, Any, NoReturn

from facts_damping.errors import InputError, meant

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Arguments = argparse.ArgumentParser | argparse._MutuallyExclusiveGroup  # noqa: SLF001

_CHOICE = re.compile(r"invalid choice: '(.*)' \(choose from (.*)\)")


EXAMPLES = "examples:"


class _Formatter(argparse.HelpFormatter):
    """Keeps the line breaks of examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith(EXAMPLES) else super()._fill_text(text, width, indent)


def examples_text(examples: Sequence[str]) -> str:
    """Examples as the end of a command's help."""
    return "\n".join([EXAMPLES, *(f"  facts-damping {example}" for example in examples)])


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, with a suggestion for typos."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(formatter_class=_Formatter, **settings)

    def error(self, message: str) -> NoReturn:
        """Raise `InputError` with the message."""
        raise InputError(_CHOICE.sub(_known, message))

    def options(self) -> list[str]:
        """Option strings of the command."""
        return [text for action in self._actions for text in action.option_strings]


def _known(match: re.Match[str]) -> str:
    """A wrong choice in the style of the other errors."""
    names = [name.strip("' ") for name in match[2].split(",")]
    return f"'{match[1]}' given{meant(match[1], names)}; allowed: {', '.join(names)}"


def refuse(unknown: Sequence[str], options: Sequence[str]) -> NoReturn:
    """Raise `InputError` for arguments that the command does not have."""
    close = meant(unknown[0].partition("=")[0], options) if unknown[0].startswith("-") else ""
    if re.match(r"[a-z_]+[.\w]*=", unknown[0]):
        close = f" (did you mean --set {unknown[0]}?)"
    raise InputError(f"{' '.join(unknown)}: given{close}; allowed: what --help lists")


def add_argument(command: Arguments, name: str, content: str | dict[str, Any]) -> None:
    """Add an argument of the table commands.yaml: `name` with its METAVAR, and its help or settings."""
    flag, _, metavar = name.partition(" ")
    settings: dict[str, Any] = {"help": content} if isinstance(content, str) else dict(content)
    folder = settings.pop("names_of", None)
    if metavar:
        settings["metavar"] = metavar
    elif "choices" not in settings:
        settings["action"] = "store_true"
    for key in settings.keys() & TYPES:
        settings["type"] = TYPES[key](*settings.pop(key))
    action = command.add_argument(flag, **settings)
    if folder is not None:
        action.completer = lambda **_: _names(folder)  # type: ignore[attr-defined]


def _names(folder: str) -> list[str]:
    """Names for shell completion."""
    from facts_damping.parameters.files import shipped

    return list(shipped(folder))


def common(
    parser: argparse.ArgumentParser, *, sets: bool = True, of: str = "run", out: bool = True, json: bool = True
) -> None:
    """Add options to change fields (`of`: what they belong to), for the results' folder, and for JSON."""
    if sets:
        text = f"change a field of the {of}; repeatable"
        parser.add_argument("--set", action="append", default=[], metavar="KEY.PATH=VALUE", help=text)
    if out:
        parser.add_argument("--out", metavar="DIR", help="folder for results")
    if json:
        parser.add_argument("--json", metavar="FILE", help="write the results as JSON; - for standard output")
    else:
        parser.set_defaults(json=None)


def jobs(command: argparse.ArgumentParser) -> None:
    """Add an option for the number of parallel runs."""
    text = "number of parallel runs; default: all cores"
    command.add_argument("--jobs", type=whole(1, 10**6), default=os.cpu_count() or 1, metavar="N", help=text)


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of an option: a whole number within bounds."""

    def number(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text} given; allowed: {low} to {high}")
        return int(text)

    return number


def pair(text: str) -> tuple[float, float]:
    """Two numbers separated by a comma."""
    try:
        first, second = map(float, text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} given; allowed: two numbers with a comma between") from error
    return first, second


def between(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Type of an option: a number within bounds."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} given; allowed: {low:g} to {high:g}{unit}")
        return value

    return number


TYPES: dict[str, Callable[..., Callable[[str], Any]]] = {"whole": whole, "between": between, "pair": lambda: pair}
GROUPS: dict[str, Callable[..., None]] = {"common": common, "jobs": jobs}
