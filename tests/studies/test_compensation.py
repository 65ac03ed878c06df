"""The study of delay compensation: the tables in the docs are what the command gives, and what they must show."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from facts_damping.cli import main
from facts_damping.studies.compensation import CLOSE, study, text
from tests.studies.pages import assert_same_lines

PAGE = Path(__file__).parents[2] / "docs" / "compensation.md"
LONGEST = 1.0  # s


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    """Those of the lead-lag with the thesis's constants: a quarter of the page."""
    return study(["LLC"], LONGEST, [], 2, lambda _done, _of: None)


def test_the_page_has_what_the_command_gives(rows: list[dict[str, Any]]) -> None:
    made = [line for line in text(rows, LONGEST) if line.startswith("| LLC |")]
    written = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| LLC |  |")]
    assert len(made) == 9
    assert_same_lines(written, made)


@pytest.mark.parametrize("compensation", ["lead", "phasor"])
def test_compensation_more_than_doubles_the_margin(rows: list[dict[str, Any]], compensation: str) -> None:
    def margins(of: str) -> list[float]:
        return [row["damped"]["margin_s"] or LONGEST for row in rows if row["compensation"] == of]

    assert len(margins("none")) == 3
    for plain, own in zip(margins("none"), margins(compensation), strict=True):
        assert own >= 2.0 * plain + CLOSE


def test_the_command_tells_and_writes_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "c.json"
    assert main(["compensation", "LLC", "--max-delay", "0.02", "--jobs", "2", "--json", str(out)]) == 0
    rows = json.loads(out.read_text(encoding="utf-8"))
    assert [row["compensation"] for row in rows] == ["none", "lead", "phasor"] * 3
    assert all(row["damped"] == {"margin_s": None, "share": 1.0} for row in rows)
    assert "| LLC |  | lead | > 20 | 100 | > 20 | 100 |" in capsys.readouterr().out


def test_what_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compensation", "PID"]) == 2
    assert "CONTROLLER: 'PID' given; allowed: LLC" in capsys.readouterr().err
