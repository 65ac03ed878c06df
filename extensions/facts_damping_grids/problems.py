"""What is wrong with a case: all of it at once, a line each with file and line, so that a user mends it in one go."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from facts_damping.errors import InputError, ProblemsError

if TYPE_CHECKING:
    from collections.abc import Iterator


class Problems:
    """Problems in the order in which they are met; `check` raises them together."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, *lines: str) -> None:
        """Add messages, each with its file and line."""
        self.lines += lines

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Add an `InputError` of the block instead of raising it: the next record is read."""
        try:
            yield
        except InputError as error:
            self.add(*problems_of(error))

    def check(self) -> None:
        """Raise `ProblemsError` with all problems if there are any."""
        if self.lines:
            raise ProblemsError(self.lines, most=len(self.lines))


def problems_of(error: InputError) -> list[str]:
    """The problems of an error, one if it is of one alone."""
    return error.lines if isinstance(error, ProblemsError) else [str(error)]
