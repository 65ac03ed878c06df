"""WECC-240 in the comparison: our runs of it, and what is said where ANDES is not there."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.cli.main import main
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping_bench import study, wecc, wecc_ours
from facts_damping_bench.figures import Rung, difference
from facts_damping_bench.grid import RATE, grid, swings
from facts_damping_bench.programs import WECC, missing

if TYPE_CHECKING:
    from pathlib import Path


def test_case_has_the_counts_that_its_text_states_and_its_steps_meet_instants() -> None:
    system = check(System, wecc_ours.prepare(grid(), None), "")  # type: ignore[arg-type]
    tables = system.buses, system.machines, system.exciters, system.governors, system.inverters
    assert re.findall(r"\d+", wecc.SHOWN.text)[1:] == [str(len(table)) for table in tables]
    for row in WECC.values():
        assert all(1.0 / RATE / step == pytest.approx(round(1.0 / RATE / step)) for step in row.steps)


def test_our_coarsest_step_is_within_the_error_at_which_times_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wecc_ours, "DURATION", 3.0)
    prepared = wecc_ours.prepare(grid(), None)  # type: ignore[arg-type]
    courses = [swings(wecc_ours.run(prepared, grid(), step), 3.0) for step in (WECC["facts_damping"].steps[0], 0.0025)]
    assert courses[0].shape[0] == 102  # without the unit that is lost
    assert difference(*courses) < 1e-3
    assert np.abs(courses[1]).max() > 1e-4  # p.u.


@pytest.mark.skipif(not missing(("andes",)), reason="ANDES is here: it would run for an hour")
def test_without_andes_its_row_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ladder = (Rung(0.02, 1e-5, 1.0, 1.0),)
    monkeypatch.setattr(study, "_measure", lambda field, *_: study.note(field, "facts_damping", rungs=ladder))
    assert main(["bench", "--wecc", "--json", str(tmp_path / "bench.json")]) == 0
    andes = json.loads((tmp_path / "bench.json").read_text())["programs"][1]
    assert "ANDES: not installed (pip install andes)" in capsys.readouterr().out
    assert (andes["name"], andes["failed"]) == ("andes", "not installed (pip install andes)")
