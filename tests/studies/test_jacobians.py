"""Identified Jacobians beside true ones: what a study of them computes and draws."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_plant
from facts_damping.small_signal.residues import residues
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.true_jacobian import Respondent, compared, follow
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

BOTH = "devices=[sssc, statcom]"


@pytest.mark.parametrize("frames", [1, 10])
def test_true_jacobian_at_the_start_is_the_linear_plants(frames: int) -> None:
    """The nonlinear plant, moved and followed, against the matrix exponential; behind washouts."""
    names, devices = ["speed", "power", "voltage", "angle"], ["sssc", "statcom"]
    sets = [BOTH, f"controllers.0.devices={devices}", f"controllers.0.signals={names}", "duration=1"]
    case = load_case(None, [*sets, "controllers.0.name=ANFTSC", "controllers.0.scheme=direct", "scenario=[]"])
    plant = residues(build_plant(case), case.system, devices, 60)
    assert plant is not None
    jacobian, expected = Respondent(case, loop.run(case)).jacobian(3, frames), plant.response(names, devices, frames)
    np.testing.assert_allclose(jacobian, expected, rtol=0.02, atol=0.002 * np.abs(expected).max(axis=1).min())


def test_figures_of_an_identifier_that_knows_are_those_of_one_that_knows() -> None:
    sets = ["scenario=small", "controllers.0.name=ANFTSC", "controllers.0.parameters.identifier_eta=0", "duration=2"]
    case = load_case("two_area_centralised", [*sets, "link=ideal"])
    followed = follow(case, loop.run(case), 10)
    known = compared(followed._replace(estimate=followed.true))
    assert np.all(known["error"] == 0)
    assert np.all(known["right_sign"] == 1)
    wrong = compared(followed._replace(estimate=-followed.true))
    assert np.all(wrong["right_sign"] == 0)
    assert np.all(wrong["error"] > 1.5)


def test_study_has_a_row_and_a_picture_of_each_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["sweep", "jacobians", "--only", "scenario=small", "--only", "network=ANFTSC", "--set", "duration=3"]
    assert main([*asked, "--jobs", "1", "--out", str(tmp_path), "--json", str(tmp_path / "told.json")]) == 0
    assert (tmp_path / "jacobian_small_ANFTSC.png").is_file()
    (row,) = json.loads((tmp_path / "told.json").read_text())["rows"]
    case = load_case(
        "two_area_centralised", ["scenario=small", "controllers.0.name=ANFTSC", "link=ideal", "duration=3"]
    )
    known = compared(follow(case, loop.run(case), 10))
    for i, signal in enumerate(("speed", "power")):
        for d, device in enumerate(("sssc", "statcom")):
            for figure, value in known.items():
                assert row[f"{figure}.{signal}/{device}"] == value[i, d]
    assert "right_sign.speed/sssc" in capsys.readouterr().out


def test_jacobian_without_an_identifier_is_refused_before_any_run(tmp_path: Path) -> None:
    study = tmp_path / "own.yaml"
    study.write_text("run: two_area_small\nsweep: [{field: seed, values: [1]}]\njacobian: 10\n")
    with pytest.raises(InputError, match="jacobian: LLC given, which has no identifier"):
        sweep.plan(str(study), [])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tune", "two_area", "--devices", "svc"], "'svc' given; allowed: sssc, statcom"),
        (["tune", "two_area", "--signals", "power"], "no sign fits; the residue from sssc to power"),
        (["tune", "two_area", "--signals", "speed,speed"], "'speed' given twice"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(2, arguments, said, capsys)
