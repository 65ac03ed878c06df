import json
from pathlib import Path

import pytest

from facts_damping.analysis.indices import THESIS_INDICES
from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.control.table import kind_name
from facts_damping.output.terminal import Progress
from facts_damping.parameters.stages import Noise
from facts_damping.simulation import loop
from facts_damping_reproduction import explanations
from facts_damping_reproduction.agreement import ComparedRun, name
from facts_damping_reproduction.printed import LLC, SCENARIOS, TABLES, ControllerId, cells
from facts_damping_reproduction.results import FOUND
from facts_damping_reproduction.runs import BASELINES, carry_out, changes, ensemble, figures, nominal, reached, whos
from facts_damping_studies.sweeps import axes, sweep
from facts_damping_studies.sweeps.batch import Base, make

Made = dict[ComparedRun, dict[str, float] | None]


def test_run_of_the_tables_is_that_of_the_comparison_and_of_the_shipped_run(tmp_path: Path) -> None:
    asked = [LLC, ControllerId("MISO", "HBsWC", "direct"), ControllerId("MIMO", "ANFTSC", "indirect")]
    rows = carry_out(nominal("two_area", asked, duration=4), "some", tmp_path, 1)
    by_run = figures(rows, asked)
    plan = sweep.plan("comparison", ["duration=4"], ["kind=LLC,HBsWC*"])
    compared = [row.cells for row in sweep.rows(sweep.run(plan, tmp_path / "compare", 1, None, Progress("compare")))]
    for scenario in SCENARIOS["two_area"].values():
        for who in asked[:2]:
            place = (scenario, who.controller, who.scheme)
            (row,) = [r for r in compared if (r["scenario"], kind_name(r["controller"]), r["scheme"]) == place]
            ours = by_run[ComparedRun("two_area", scenario, who)]
            assert ours == {name: row[name] for name in (*THESIS_INDICES, "roughness")}
        both = ["controllers.0.name=ANFTSC", f"scenario={scenario}", "link=ideal", "duration=4"]
        summary = summarise(loop.run(load_case("two_area_centralised", both)))
        expected = {**(summary.indices or {}), "roughness": summary.roughness}
        assert by_run[ComparedRun("two_area", scenario, asked[2])] == expected


def test_baselines_are_beside_every_table() -> None:
    for table, table_of_thesis in TABLES.items():
        beside = whos(cells([table]), table_of_thesis.system)
        assert beside[: len(BASELINES)] == list(BASELINES)
        assert {cell.who for cell in cells([table])} <= set(beside)
        assert len(beside) == len(set(beside))
        assert (ControllerId("MIMO", "LQG", None) in beside) == (table in ("6.1", "6.2"))


@pytest.mark.parametrize("system", SCENARIOS)
def test_every_controller_runs_in_every_ensemble(system: str) -> None:
    asked = [*whos(cells(), system), *FOUND[system]]
    for scenario in SCENARIOS[system].values():
        study = ensemble(system, scenario, asked, draws=2, link="pdci_100ms")
        points = axes.points(study)
        assert [point.columns["who"] for point in points[: len(asked)]] == [name(who) for who in asked]
        assert len(points) == 2 * len(asked)
        base = Base({"system": system, "scenario": scenario}, "here", {**study.set}, modes=False)
        for point in (points[0], points[-1]):
            case = make(base, point.changes)
            last = case.link.up[-1]
            assert isinstance(last, Noise)
            assert last.std == point.columns["noise_std_pu"]


@pytest.mark.parametrize("variant", explanations.TABLE, ids=lambda variant: variant.name)
def test_variants_of_explanations_can_be_run_and_differ_from_the_tables(variant: explanations.Variant) -> None:
    for system in variant.systems:
        asked = [who for who in whos(cells(("4.1", "4.2", "5.1", "5.3")), system) if who == LLC or who.scheme]
        base = Base({"system": system, "scenario": SCENARIOS[system]["I"]}, "here", {}, modes=False)
        different = set()
        for who in asked:
            more = variant.more(system, who) if variant.more else {}
            plain, other = make(base, changes(who)), make(base, {**changes(who), **variant.fields, **more})
            if {**plain.document(), "asked": None} != {**other.document(), "asked": None}:
                different.add(who)
        assert bool(different) == (variant.name != explanations.BASE)
        assert LLC not in different or variant.fields
        if variant.name == "interpolated control points":
            assert {who.controller for who in different} == set(explanations.INTERPOLATED)


def test_set_up_of_the_tables_agrees_with_itself() -> None:
    system, tables = "smib", cells(("4.1",))
    asked = [who for who in whos(tables, system) if who == LLC or who.scheme]
    figures_made: Made = {
        ComparedRun(system, scenario, who): dict.fromkeys(("ITAE", "IAE", "ITSE", "ISE", "roughness"), 1.0 + i * 7 % 12)
        for scenario in SCENARIOS[system].values()
        for i, who in enumerate(asked)
    }
    (row,) = explanations.told("x", tables, figures_made, figures_made)
    assert row.rho_own == pytest.approx(1.0)
    assert row.unstable == 0
    lost: Made = {
        run: None if run.who.controller == "HBsWC" else figures_of_run for run, figures_of_run in figures_made.items()
    }
    (row,) = explanations.told("x", tables, lost, figures_made)
    assert row.unstable == len(SCENARIOS[system])
    assert row.rho_own is not None
    assert row.rho_own < 1.0


def test_way_to_the_bound() -> None:
    place = ("smib", "light")
    figures_made: Made = {
        ComparedRun(*place, who): {"ITAE": value} for who, value in zip(BASELINES, (9.0, 5.0, 2.0, 1.0), strict=True)
    }
    figures_made[ComparedRun(*place, ControllerId("MISO", "HBsWC", "direct"))] = None
    assert [reached(figures_made, ComparedRun(*place, who), "ITAE") for who in BASELINES] == [-100.0, 0.0, 75.0, 100.0]
    assert reached(figures_made, ComparedRun(*place, ControllerId("MISO", "HBsWC", "direct")), "ITAE") is None


@pytest.mark.parametrize("who", [who for group in FOUND.values() for who in group], ids=name)
def test_controller_found_by_the_search_is_a_shipped_run(who: ControllerId) -> None:
    case = load_case(who.controller, ["duration=1"])
    assert json.loads(json.dumps(changes(who)["devices"])) == case.run.devices
    assert [c.name for c in case.controllers] == [c["name"] for c in changes(who)["controllers"]]
