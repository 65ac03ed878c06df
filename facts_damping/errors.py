"""Errors of this package; each message states what was given and what is allowed."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from facts_damping.escaping import escaped, shortened

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

VERBOSE = "FACTS_DAMPING_VERBOSE"  # environment variable that passes `--verbose` to all processes of a command
OLD_NAMES = {  # old keys, figures and messages
    "VoltageSetpoint": "DeviceSetpoint",
    "VoltageSetpoints": "DeviceSetpoints",
    "beds": "base_runs",
    "v_max": "setpoint_max",
    "smoothness": "roughness",
    "share": "fraction",
    "P_shares": "P_fractions",
    "Q_shares": "Q_fractions",
    "station": "pmu",
    "stations": "pmus",
}
SHORT = range(3, 6)  # lengths of words that count as short


class FactsDampingError(Exception):
    """Base class of all errors that this package raises on purpose.

    `details`: shown with `--verbose`, such as the traceback of the user's code in a node.
    """

    details = ""


class InputError(FactsDampingError):
    """Bad user input: a file, a field, an option. The command line exits with 2."""


class ProblemsError(InputError):
    """All that is wrong with a user's input: `lines` has the first problems, one each, and how many more there are."""

    def __init__(self, problems: Sequence[str], most: int = 20) -> None:
        self.lines = [*problems[:most], *([f"and {len(problems) - most} more"] if len(problems) > most else [])]
        super().__init__("\n".join(self.lines))


class RunError(FactsDampingError):
    """A run that could not be carried out. The command line exits with 1."""


class DegradedError(FactsDampingError):
    """A run that ended, but was degraded, attacked or incompletely recorded. The command line exits with 3."""


class RecordingError(FactsDampingError):
    """A recording that cannot be read or written."""


def one_line(error: object) -> str:
    """Message of an error in one printable line of limited length."""
    return shortened(escaped(" ".join(str(error).split())))


def traced(error: BaseException) -> str:
    """With `--verbose`: the traceback of the error's first cause, else its details; otherwise empty."""
    if VERBOSE not in os.environ:
        return ""
    if error.__cause__ is None:
        return f"{error.details}\n" if isinstance(error, FactsDampingError) and error.details else ""
    from traceback import format_exception  # noqa: PLC0415 (asked for by few)

    first = error
    while first.__cause__ is not None:
        first = first.__cause__
    return "".join(format_exception(type(first), first, first.__traceback__, chain=False))


def meant(name: str, allowed: Iterable[str]) -> str:
    """Suggestion for a mistyped name, as part of a message; empty if no name is similar."""
    if name in OLD_NAMES:
        return f" (called {OLD_NAMES[name]} now)"
    from difflib import get_close_matches  # noqa: PLC0415 (asked for by errors alone)

    by_small = {word.lower(): word for word in allowed}
    likeness = 0.65 if name.isalpha() and len(name) in SHORT else 0.8  # in a short word one letter is a third
    matches = get_close_matches(name.lower(), by_small, 3, likeness)
    matches.sort(key=lambda word: sorted(word) != sorted(name.lower()))  # prefer names with swapped letters
    return f" (did you mean {by_small[matches[0]]}?)" if matches else ""


def check_known(where: str, name: str, allowed: Iterable[str]) -> None:
    """Raise `InputError` if a name is not among the allowed ones."""
    names = list(allowed)
    if name not in names:
        raise InputError(f"{where}: '{name}' given{meant(name, names)}; allowed: {', '.join(names) or 'none'}")
