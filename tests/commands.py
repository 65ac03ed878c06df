"""What the tests of commands share: their changes of a run, and that what is refused is told in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import pytest


def changes(sets: Iterable[str]) -> list[str]:
    """As a command line has them."""
    return [part for text in sets for part in ("--set", text)]


def assert_one_line(status: int, command: Sequence[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The command ends with the status, says nothing but one line, and that has these words."""
    assert main(list(command)) == status
    out, errors = capsys.readouterr()
    assert out == ""
    assert said in errors
    assert errors.count("\n") == 1
