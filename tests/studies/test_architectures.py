"""Architectures, interaction of devices, identified Jacobians: the pages are what the commands give, and must hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from facts_damping.simulation.build import build_plant
from facts_damping.small_signal.residues import residues
from facts_damping.studies import architectures, interaction, jacobians
from facts_damping.studies.true_jacobian import Respondent, figures, follow
from tests.studies.pages import assert_same_lines

DOCS = Path(__file__).parents[2] / "docs"
BOTH = "devices=[sssc, statcom]"


def quiet(_done: int, _of: int) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return architectures.study([], [], 2, quiet)


def test_every_controller_runs_in_every_architecture_on_every_scenario(rows: list[dict[str, Any]]) -> None:
    assert len(rows) == 3 * 4 * (2 + 2 * 11)
    assert len({(r["scenario"], r["architecture"], r["name"], r["scheme"]) for r in rows}) == len(rows)


def test_the_page_of_architectures_is_what_the_command_gives(rows: list[dict[str, Any]]) -> None:
    made = [
        *architectures.head("architectures.png"),
        *architectures.architecture_tables(rows),
        "### Relative gains",
        "",
    ]
    made += interaction.relative_gain_table(interaction.interactions())
    written = (DOCS / "architectures.md").read_text(encoding="utf-8").splitlines()
    assert_same_lines(written, made[:-1])  # the last line is empty
    assert (DOCS / "architectures.png").is_file()


def test_lead_lags_side_by_side_are_the_centralised_one(rows: list[dict[str, Any]]) -> None:
    """Appendix B's two lead-lags take one signal: centralised or not, they are the same."""
    for scenario in ("small", "large", "multiple"):
        own = {r["architecture"]: r for r in rows if (r["name"], r["scenario"]) == ("LLC", scenario)}
        assert own["centralised"]["indices"] == own["decentralised"]["indices"]
        assert own["centralised"]["indices"] != own["single SSSC"]["indices"]


def test_relative_gains_do_not_depend_on_units_and_add_up_to_one() -> None:
    for one in interaction.interactions():
        np.testing.assert_allclose(one.relative.sum(axis=0), 1, rtol=1e-9)
        np.testing.assert_allclose(one.relative.sum(axis=1), 1, rtol=1e-9)
        g = one.gain
        expected = 1 / (1 - g[0, 1] * g[1, 0] / (g[0, 0] * g[1, 1]))  # Bristol's, of two by two
        assert one.relative[0, 0] == pytest.approx(expected, rel=1e-9)


# Jacobians


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


def test_the_table_of_jacobians_is_what_the_command_gives() -> None:
    """The thesis's three; all others with `facts-damping jacobian`."""
    asked = ["ANFTSC", "ANFLeWC", "HBsWC"]
    made = jacobians.jacobian_tables(jacobians.study(asked, 10, [], 2, quiet))
    page = (DOCS / "jacobians" / "jacobians.md").read_text(encoding="utf-8").splitlines()
    written = [line for line in page if not line.startswith("| ANF") or line.split("|")[1].strip() in asked]
    at = written.index(made[0])
    assert_same_lines(written[at:], made[:-1], rel=0.1)
    assert len(list((DOCS / "jacobians").glob("*.png"))) >= 3


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "page.md"
    short = ["--set", "duration=3", "--jobs", "1"]
    assert main(["architectures", "LLC", *short, "--out", str(out), "--json", str(tmp_path / "a.json")]) == 0
    assert out.read_text().startswith("# Architectures")
    assert out.with_suffix(".png").is_file()
    assert len(json.loads((tmp_path / "a.json").read_text())) == 12
    assert main(["jacobian", "ANFTSC", *short, "--horizon", "4", "--out", str(tmp_path / "j")]) == 0
    assert sorted(path.name for path in (tmp_path / "j").iterdir()) == ["ANFTSC.png", "jacobians.md"]
    assert "sign at 4, %" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["architectures", "PID"], "'PID' given; allowed: LLC"),
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
