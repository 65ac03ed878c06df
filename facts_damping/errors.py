"""The few errors of this package; each message names what was given and what is allowed."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from facts_damping.escaping import escaped, shortened

if TYPE_CHECKING:
    from collections.abc import Iterable

VERBOSE = "FACTS_DAMPING_VERBOSE"  # variable by which `--verbose` reaches all processes of a command
OLD_NAMES = {"beds": "base_runs", "v_max": "setpoint_max", "smoothness": "roughness"}  # of keys and figures
SHORT = range(3, 6)  # letters of a word


class FactsDampingError(Exception):
    """Base class of every error that this package raises on purpose.

    `details`: what `--verbose` shows beside it, such as the traceback of the user's code in a node.
    """

    details = ""


class InputError(FactsDampingError):
    """Bad input of the user's: a file, a field, an option. The command line exits with 2."""


class RunError(FactsDampingError):
    """A run that could not be carried out. The command line exits with 1."""


class DegradedError(FactsDampingError):
    """A run that ended, but was degraded, attacked or incompletely recorded. The command line exits with 3."""


class RecordingError(FactsDampingError):
    """A recording that cannot be read or written."""


def one_line(error: object) -> str:
    """What an error says, in one line that can be seen and is not longer than a screen."""
    return shortened(escaped(" ".join(str(error).split())))


def traced(error: BaseException) -> str:
    """Where an error is from, if that is asked for: the traceback of its first cause, else its details; lines."""
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
    """What a mistyped name may have been, as a part of a message; nothing where none is close."""
    if name in OLD_NAMES:
        return f" (called {OLD_NAMES[name]} now)"
    from difflib import get_close_matches  # noqa: PLC0415 (asked for by errors alone)

    by_small = {one.lower(): one for one in allowed}
    likeness = 0.65 if name.isalpha() and len(name) in SHORT else 0.8  # of short words a letter is a third
    found = get_close_matches(name.lower(), by_small, 3, likeness)
    found.sort(key=lambda one: sorted(one) != sorted(name.lower()))  # letters that changed places come first
    return f" (did you mean {by_small[found[0]]}?)" if found else ""


def check_known(where: str, name: str, allowed: Iterable[str]) -> None:
    """Raise `InputError` where a name is not among those that there are."""
    names = list(allowed)
    if name not in names:
        raise InputError(f"{where}: '{name}' given{meant(name, names)}; allowed: {', '.join(names) or 'none'}")
