"""Identified Jacobians beside true ones: what `jacobian` computes, and what its table and pictures say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from facts_damping.simulation.build import build_plant
from facts_damping.small_signal.residues import residues
from facts_damping.studies import jacobians
from facts_damping.studies.true_jacobian import Respondent, figures, follow

if TYPE_CHECKING:
    from pathlib import Path

BOTH = "devices=[sssc, statcom]"


@pytest.mark.parametrize("frames", [1, 10])
def test_the_true_jacobian_at_the_start_is_the_linear_plants(frames: int) -> None:
    """The nonlinear plant, moved and followed, against the matrix exponential; behind washouts."""
    names, devices = ["speed", "power", "voltage", "angle"], ["sssc", "statcom"]
    own = [BOTH, f"controllers.0.devices={devices}", f"controllers.0.signals={names}", "duration=1"]
    case = load_case(None, [*own, "controllers.0.name=ANFTSC", "controllers.0.scheme=direct", "scenario=[]"])
    plant = residues(build_plant(case), case.system, devices, 60)
    assert plant is not None
    found, expected = Respondent(case, loop.run(case)).jacobian(3, frames), plant.response(names, devices, frames)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.002 * np.abs(expected).max(axis=1).min())


def test_figures_of_an_identifier_that_knows_are_those_of_one_that_knows() -> None:
    case = jacobians.scene("small", "ANFTSC", ["controllers.0.parameters.identifier_eta=0", "duration=2"])
    found = follow(case, loop.run(case), 10)
    known = figures(found._replace(estimate=found.true))
    assert np.all(known["error"] == 0)
    assert np.all(known["right_sign"] == 1)
    wrong = figures(found._replace(estimate=-found.true))
    assert np.all(wrong["right_sign"] == 0)
    assert np.all(wrong["error"] > 1.5)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--set", "duration=3", "--jobs", "1"]
    assert main(["jacobian", "ANFTSC", *short, "--horizon", "4", "--out", str(tmp_path / "j")]) == 0
    assert sorted(path.name for path in (tmp_path / "j").iterdir()) == ["ANFTSC.png", "jacobians.md"]
    assert "sign at 4, %" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["jacobian", "LLC"], "'LLC' given, which has no identifier; allowed: ANFTSC"),
        (["jacobian", "--horizon", "0"], "0 given; allowed: 1 to 60"),
        (["tune", "two_area", "--devices", "svc"], "'svc' given; allowed: sssc, statcom"),
        (["tune", "two_area", "--signals", "power"], "none fits; the residue from sssc to power"),
        (["tune", "two_area", "--signals", "speed,speed"], "'speed' given twice"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    errors = capsys.readouterr().err
    assert said in errors
    assert errors.count("\n") == 1
