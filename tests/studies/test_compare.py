"""The comparison of the controllers: what it runs, and what it must show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.analysis.indices import INDICES
from facts_damping.case.controllers import tuned
from facts_damping.cli.main import main
from facts_damping.control.table import CONTROLLERS
from facts_damping.parameters.files import shipped
from facts_damping.studies import compare, sweep
from facts_damping.studies.batch import make
from facts_damping.terminal import Progress

if TYPE_CHECKING:
    from pathlib import Path

# Scenarios that stay in synchronism without control.
CALM = [("two_area", "small"), ("smib", "nominal"), ("smib", "light")]
# Rows that are not damped (docs/measures.md), or do not beat no control (docs/controllers.md): findings.
# In `multiple` 9 s are left after the last event: often too few to tell a chatter that dies from one that does not.
NOT_DAMPED = {
    ("two_area", "small", "ANFBsC", "indirect"): "growing",
    ("two_area", "small", "ANFFsC", "direct"): "limit cycle",
    ("two_area", "small", "ANFLeWC", "indirect"): "limit cycle",
    ("two_area", "small", "ANFGuMoC", "direct"): "undecided",
    ("two_area", "large", "ANFLeWC", "indirect"): "undecided",
    ("two_area", "multiple", "ANFTrMeC", "indirect"): "limit cycle",
    ("two_area", "multiple", "ANFTrMoC", "indirect"): "undecided",
    ("two_area", "multiple", "ANFGuMoC", "direct"): "undecided",
    ("two_area", "multiple", "ANFBsC", "indirect"): "undecided",
    ("two_area", "multiple", "HBsWC", "direct"): "undecided",
    ("two_area", "multiple", "HBsWC", "indirect"): "undecided",
}
NOT_BETTER: set[tuple[str, str, str, str]] = set()


Rows = list[dict[str, Any]]


def compared(folder: Path, systems: list[str], names: list[str], sets: list[str]) -> Rows:
    plan = compare.plan(systems, names, sets)
    return sweep.rows(sweep.run(plan, folder, 2, None, Progress("compare")))


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    return compared(tmp_path_factory.mktemp("rows"), [], [], [])


def place(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return row["system"], row["scenario"], row["controller"], row["scheme"]


def test_all_controllers_are_there_in_both_schemes_on_all_scenarios(rows: Rows) -> None:
    networks = [name for name, row in CONTROLLERS.items() if row.network is not None]
    assert len(networks) == 11
    scenarios = {(row["system"], row["scenario"]) for row in rows}
    assert len(scenarios) == 7
    wanted: set[tuple[str, str | None]] = {(name, scheme) for name in networks for scheme in ("direct", "indirect")}
    wanted |= {("none", None), ("LLC", None), ("LLC-tuned", None), ("LQG", None), ("Hinf", None)}
    for one in scenarios:
        assert {(r["controller"], r["scheme"]) for r in rows if (r["system"], r["scenario"]) == one} == wanted


def test_none_leaves_its_limits(rows: Rows) -> None:
    for row in rows:
        assert row["max_injected_voltage_pu"] <= 0.1 * (1 + 1e-9), place(row)


def test_every_adaptive_controller_damps_every_scenario_but_the_findings(rows: Rows) -> None:
    assert {place(row): row["verdict"] for row in rows if row["scheme"] and not row["damped"]} == NOT_DAMPED


def test_the_lqg_damps_every_scenario_and_has_less_of_the_squares_than_lead_lags(rows: Rows) -> None:
    for system, scenario in {(row["system"], row["scenario"]) for row in rows}:
        own = {r["controller"]: r for r in rows if (r["system"], r["scenario"]) == (system, scenario)}
        assert own["LQG"]["damped"]
        assert own["LQG"]["ISE"] < own["LLC"]["ISE"]


def test_every_adaptive_controller_beats_no_control_but_the_findings(rows: Rows) -> None:
    worse = set()
    for system, scenario in CALM:
        own = [row for row in rows if (row["system"], row["scenario"]) == (system, scenario)]
        (none,) = [row for row in own if row["controller"] == "none"]
        assert none["stable"]
        worse |= {
            place(row)
            for row in own
            if row["scheme"] and not (row["stable"] and all(row[k] < none[k] for k in INDICES))
        }
    assert worse == NOT_BETTER


def test_in_another_profile_all_are_what_was_chosen_there() -> None:
    plan = compare.plan(["two_area"], ["LLC-tuned", "ANFTSC"], ["profile=deployment"])
    found = {point.columns["run"]: make(plan.base, point.changes) for point in plan.points}
    assert len(found) == 3 * 5  # none, LLC, LLC-tuned, ANFTSC in both schemes
    for case in found.values():
        assert case.run.profile == "deployment"
        assert [c.signals for c in case.controllers] in ([], [["frequency"]])
    known = tuned("two_area", ["frequency"], ["sssc"], profile="deployment")
    for label, key in (("LLC-tuned", ("LLC-tuned", None)), ("ANFTSC direct", ("ANFTSC", "direct"))):
        own = found[f"two_area small {label}"].controllers[0].parameters
        assert {name: own[name] for name in known[key]} == known[key]


@pytest.mark.parametrize("name", [name for name in shipped("studies") if name.startswith("ensemble_")])
def test_every_ensemble_may_have_another_profile(name: str) -> None:
    plan = sweep.plan(name, ["profile=deployment"])
    case = make(plan.base, plan.points[0].changes)
    assert case.measurement.filter == "p_class"
    assert case.model is not None
    assert case.model.loads != case.system.loads  # the draws are of the plant alone


def test_changes_of_controllers_are_for_networks_only(tmp_path: Path) -> None:
    changed = compared(tmp_path / "a", ["smib"], ["ANFTSC"], ["controllers.0.parameters.eta=0.0", "duration=3"])
    plain = compared(tmp_path / "b", ["smib"], ["ANFTSC"], ["duration=3"])
    assert len(changed) == len(plain) == 4 * 4
    same = {(one["controller"], one["scheme"]) for one, other in zip(changed, plain, strict=True) if one == other}
    assert same == {("none", None), ("LLC", None)}


def test_the_command_leaves_a_study_that_can_be_swept_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its rows are those of `sweep` on the file that it leaves."""
    asked = ["compare", "smib", "--controllers", "LLC-tuned", "--set", "duration=1", "--jobs", "1"]
    assert main([*asked, "--out", str(tmp_path / "a"), "--json", str(tmp_path / "a.json")]) == 0
    assert "### smib, heavy" in capsys.readouterr().out
    assert (tmp_path / "a" / "tables.md").read_text(encoding="utf-8").count("| LLC-tuned |") == 4
    again = ["sweep", str(tmp_path / "a" / "study.yaml"), "--set", "duration=1", "--out", str(tmp_path / "b")]
    assert main([*again, "--json", str(tmp_path / "b.json")]) == 0
    assert (tmp_path / "a.json").read_text() == (tmp_path / "b.json").read_text()
    assert main(asked) == 0
    assert not (tmp_path / "results").exists()
