"""What is wrong with a case: all of it at once, a line each with file and line, so that a user mends it in one go."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


class CaseError(InputError):
    """All problems of a case; each of its `lines` is a message of its own."""

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(lines)
        super().__init__("\n".join(self.lines))


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
        """Raise `CaseError` if there is a problem."""
        if self.lines:
            raise CaseError(self.lines)


def problems_of(error: InputError) -> tuple[str, ...]:
    """The problems of an error, one if it is of one alone."""
    return error.lines if isinstance(error, CaseError) else (str(error),)
