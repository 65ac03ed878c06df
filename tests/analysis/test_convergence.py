"""Figures that depend on the integration step are told from those that do not."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facts_damping.analysis import convergence
from facts_damping.analysis.summary import Summary, summarise
from facts_damping.analysis.summary_table import table
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from pathlib import Path

CHATTERS = ["scenario=multiple", "controllers.0.name=ANFTrMeC", "controllers.0.scheme=indirect"]


@given(value=st.floats(1e-9, 1e6), change=st.floats(1e-12, 2.0))
def test_figure_is_printed_with_its_converged_digits_only(value: float, change: float) -> None:
    """The last digit is worth twice the change at least, but where there is only one."""
    text = convergence.text(value, change)
    assert text.startswith("~") == (change > 0.01)
    digits = len(text.strip("~").partition("e")[0].replace(".", "").lstrip("0"))
    if digits > 1:
        mantissa = float(f"{value:.{3}e}".partition("e")[0])
        unit = 10.0 ** (1 - digits) / mantissa  # of the last digit, relative
        assert unit > 0.2 * change
    assert float(text.strip("~")) == pytest.approx(value, rel=0.5)


@pytest.mark.parametrize(
    ("value", "change", "text"),
    [
        (0.26789, 0.0, "0.2679"),
        (0.26789, 1e-5, "0.2679"),
        (0.26789, 1e-3, "0.27"),
        (0.26789, 0.009, "0.3"),
        (0.26789, 0.3, "~0.3"),
        (0.26789, float("inf"), "~0.3"),
    ],
)
def test_digits_by_hand(value: float, change: float, text: str) -> None:
    assert convergence.text(value, change) == text


def checked(sets: list[str]) -> Summary:
    case = load_case(None, sets)
    summary, finer = (summarise(loop.run(run_case)) for run_case in (case, loop.with_half_step(case)))
    return convergence.compare(summary, finer)


def test_lead_lag_converges_and_a_network_that_chatters_does_not() -> None:
    smooth, rough = checked(["scenario=multiple"]), checked([*CHATTERS, "duration=40"])
    assert smooth.converged
    assert smooth.step_change is not None
    assert max(smooth.step_change.values()) < 1e-3
    assert not any("converged" in line for line in smooth.warnings)
    assert not rough.converged
    assert rough.step_change is not None
    assert rough.step_change["ITAE"] > 0.05
    assert "not converged: at half the integration step" in rough.warnings[-1]
    lines = {line.split("  ")[0]: line.split() for line in table([("a", smooth), ("b", rough)]).splitlines()}
    assert lines["converged"][1:] == ["yes", "no"]
    assert lines["ITAE"][2].startswith("~")
    assert not lines["ITAE"][1].startswith("~")


def test_by_command(tmp_path: Path) -> None:
    asked = ["simulate", "--set", "duration=2", "--check-step", "--json", str(tmp_path / "a.json")]
    assert main(asked) == 0
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["converged"] is True
    assert set(document["step_change"]) >= {"ITAE", "IAE", "ITSE", "ISE", "roughness"}
    assert main([word for word in asked if word != "--check-step"]) == 0
    assert "converged" not in json.loads((tmp_path / "a.json").read_text())


def test_in_a_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["sweep", "comparison", "--only", "kind=LLC*,ANFTrMeC*", "--set", "duration=6", "--check-step"]
    assert main([*asked, "--jobs", "1", "--out", str(tmp_path), "--json", str(tmp_path / "a.json")]) == 0
    rows = json.loads((tmp_path / "a.json").read_text())["rows"]
    assert all(row["converged"] for row in rows if row["controller"] == "LLC")
    open_ = [row for row in rows if row["converged"] is False and row["stable"]]
    assert open_
    output = capsys.readouterr().out
    assert f"{len(open_)} not converged" in output.splitlines()[0]
    assert f"~{open_[0]['ITAE']:.1g}" in output
