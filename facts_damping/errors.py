"""The few errors of this package; each message names what was given and what is allowed."""

from __future__ import annotations


class FactsDampingError(Exception):
    """Base class of every error that this package raises on purpose."""


class InputError(FactsDampingError):
    """Bad input of the user's: a file, a field, an option. The command line exits with 2."""


class RunError(FactsDampingError):
    """A run that could not be carried out. The command line exits with 1."""


class RecordingError(FactsDampingError):
    """A recording that cannot be read or written."""
