"""The comparison of all controllers: what it runs, and what it must show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.analysis.indices import INDICES
from facts_damping.case.tuned import tuned
from facts_damping.cli.main import main
from facts_damping.control.table import CONTROLLERS, kind_name
from facts_damping.errors import InputError
from facts_damping.output.terminal import Progress
from facts_damping.parameters.files import shipped
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.batch import make
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

# Scenarios that stay in synchronism without control.
CALM = [("two_area", "small"), ("smib", "nominal"), ("smib", "light")]
# Rows that are not damped, or do not beat no control (docs/reproduction.md): findings.
# In `multiple` 9 s are left after the last event: often too few to tell a chatter that dies from one that does not.
NOT_DAMPED = {
    ("two_area", "small", "ANFBsC", "indirect"): "growing",
    ("two_area", "small", "ANFFsC", "direct"): "limit cycle",
    ("two_area", "small", "ANFLeWC", "indirect"): "limit cycle",
    ("two_area", "small", "ANFGuMoC", "direct"): "undecided",
    ("two_area", "large", "ANFTrMeC", "indirect"): "growing",
    ("two_area", "large", "ANFLeWC", "indirect"): "undecided",
    ("two_area", "multiple", "ANFTrMeC", "indirect"): "undecided",
    ("two_area", "multiple", "ANFGuMoC", "direct"): "undecided",
    ("two_area", "multiple", "ANFBsC", "indirect"): "undecided",
    ("two_area", "multiple", "HBsWC", "direct"): "undecided",
    ("two_area", "multiple", "HBsWC", "indirect"): "undecided",
}
NOT_BETTER: set[tuple[str, str, str, str]] = set()


Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def plans() -> list[sweep.SweepPlan]:
    return [sweep.plan("comparison", [f"system={system}"]) for system in ("two_area", "smib")]


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory, plans: list[sweep.SweepPlan]) -> Rows:
    """Of networks every third in each scenario, each in some; all findings; all others in all scenarios."""
    compared = []
    for plan in plans:
        case = plan.base.set["system"]
        findings = {(scenario, f"{name} {scheme}") for system, scenario, name, scheme in NOT_DAMPED if system == case}
        scenarios = list(dict.fromkeys(point.columns["scenario"] for point in plan.points))
        kinds = list(dict.fromkeys(point.columns["kind"] for point in plan.points))

        def chosen(columns: dict[str, Any]) -> bool:
            scenario, kind = columns["scenario"], columns["kind"]
            return (
                " " not in kind
                or (scenario, kind) in findings  # noqa: B023 (called here)
                or (scenarios.index(scenario) + kinds.index(kind)) % 3 == 0  # noqa: B023
            )

        few = plan._replace(points=[point for point in plan.points if chosen(point.columns)])
        compared += [
            row.cells for row in sweep.rows(sweep.run(few, tmp_path_factory.mktemp(case), 1, None, Progress("compare")))
        ]
    return compared


def place(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return row["system"], row["scenario"], kind_name(row["controller"]), row["scheme"]


def test_comparison_has_all_controllers_and_schemes_on_all_scenarios(plans: list[sweep.SweepPlan]) -> None:
    networks = [name for name, row in CONTROLLERS.items() if row.network is not None]
    assert len(networks) == 11
    points = [point.columns for plan in plans for point in plan.points]
    wanted = {f"{name} {scheme}" for name in networks for scheme in ("direct", "indirect")}
    wanted |= {"none", "LLC", "LLC-tuned", "LQG", "Hinf"}
    scenarios = [{point.columns["scenario"] for point in plan.points} for plan in plans]
    assert [len(names) for names in scenarios] == [3, 4]
    assert len(points) == 7 * len(wanted)
    for plan, names in zip(plans, scenarios, strict=True):
        for scenario in names:
            assert {p.columns["kind"] for p in plan.points if p.columns["scenario"] == scenario} == wanted


def test_none_leaves_its_limits(rows: Rows) -> None:
    for row in rows:
        assert row["max_injected_voltage_pu"] <= 0.1 * (1 + 1e-9), place(row)


def test_adaptive_controllers_damp_all_scenarios_except_for_the_findings(rows: Rows) -> None:
    assert {place(row): row["verdict"] for row in rows if row["scheme"] and not row["damped"]} == NOT_DAMPED


def test_lqg_damps_every_scenario_and_has_less_of_the_squares_than_lead_lags(rows: Rows) -> None:
    for scenario in {place(row)[:2] for row in rows}:
        by_controller = {place(row)[2]: row for row in rows if place(row)[:2] == scenario}
        assert by_controller["LQG"]["damped"]
        assert by_controller["LQG"]["ISE"] < by_controller["LLC"]["ISE"]


def test_adaptive_controllers_beat_no_control_except_for_the_findings(rows: Rows) -> None:
    worse = set()
    for system, scenario in CALM:
        scenario_rows = [row for row in rows if (row["system"], row["scenario"]) == (system, scenario)]
        (none,) = [row for row in scenario_rows if row["controller"] == "none"]
        assert none["stable"]
        worse |= {
            place(row)
            for row in scenario_rows
            if row["scheme"] and not (row["stable"] and all(row[k] < none[k] for k in INDICES))
        }
    assert worse == NOT_BETTER


def test_in_another_profile_all_are_what_was_chosen_there() -> None:
    plan = sweep.plan("comparison", ["profile=deployment"], ["kind=none,LLC*,ANFTSC*"])
    cases = {tuple(point.columns.values()): make(plan.base, point.changes) for point in plan.points}
    assert len(cases) == 3 * 5  # none, LLC, LLC-tuned, ANFTSC in both schemes
    for case in cases.values():
        assert case.run.profile == "deployment"
        assert [c.signals for c in case.controllers] in ([], [["frequency"]])
    known = tuned("two_area", ["frequency"], ["sssc"], profile="deployment")
    for label, key in (("LLC-tuned", ("LLC-tuned", None)), ("ANFTSC direct", ("ANFTSC", "direct"))):
        parameters = cases["small", label].controllers[0].parameters
        assert parameters.items() >= known[key].parameters.items()
        assert cases["small", label].controllers[0].name == known[key].name


def test_comparison_gives_controllers_the_signals_that_they_can_take() -> None:
    plan = sweep.plan("comparison", ["controllers.0.signals=[speed, power]"], ["scenario=small"])
    by_kind = {point.columns["kind"]: make(plan.base, point.changes).controllers for point in plan.points}
    assert [c.signals for c in by_kind["LLC"]] == [["speed"]]
    assert [c.signals for c in by_kind["HBsWC indirect"]] == [["speed", "power"]]
    other = sweep.plan("comparison", ["controllers.0.signals=[angle]"], ["scenario=small"])
    assert "LLC-tuned" in by_kind
    assert "LLC-tuned" not in [point.columns["kind"] for point in other.points]


@pytest.mark.parametrize(
    ("axes", "sets", "only", "said"),
    [
        ("{every: scenario}", ["system=nowhere"], [], "'nowhere' given; allowed: "),
        ("{every: scenario}, {field: system, values: [smib]}", [], [], "'system' beside an axis over every scenario"),
        ("{every: controller, field: seed}", [], [], "`every` have fields of their own"),
        ("{every: device}", [], [], "'device' given"),
        ("{every: scenario}", [], ["kind=LLC"], "--only kind=LLC: 'kind' given; allowed: scenario"),
        ("{every: scenario}", [], ["scenario=huge"], "'huge' given; allowed: large, multiple, small"),
    ],
)
def test_bad_axes_are_one_line(tmp_path: Path, axes: str, sets: list[str], only: list[str], said: str) -> None:
    study = tmp_path / "own.yaml"
    study.write_text(f"sweep: [{axes}]\n")
    with pytest.raises(InputError) as caught:
        sweep.plan(str(study), sets, only)
    assert said in str(caught.value)


@pytest.mark.parametrize("name", [name for name in shipped("studies") if name.startswith("ensemble_")])
def test_ensemble_takes_the_deployment_profile(name: str) -> None:
    plan = sweep.plan(name, ["profile=deployment"])
    case = make(plan.base, plan.points[0].changes)
    assert case.measurement.filter == "p_class"
    assert case.model is not None
    assert case.model.loads != case.system.loads  # the draws are of the plant alone


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Some of its points; their rows are those of the whole."""
    asked = ["sweep", "comparison", "--set", "system=smib", "--only", "kind=none,LLC*", "--set", "duration=1"]
    assert main([*asked, "--jobs", "1", "--out", str(tmp_path / "a")]) == 0
    assert "### smib, heavy" in capsys.readouterr().out
    assert (tmp_path / "a" / "tables.md").read_text(encoding="utf-8").count("| LLC-tuned |") == 4
    assert_one_line(2, [*asked[:-2], "--out", str(tmp_path / "a")], "another study", capsys)
