"""Design and comparison on grids with inverters: places at their inputs, signals, drawn cases."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import make_case
from facts_damping.errors import InputError
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.build import build
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linear_model
from facts_damping_studies.design import design, places, scenario_generation
from facts_damping_studies.score.cases import own_grid
from facts_damping_studies.score.cases.sets import set_of
from tests.plant.running import changed, shipped
from tests.two_plants import path

if TYPE_CHECKING:
    from collections.abc import Callable

SOLAR, BATTERY = path("solar"), path("battery")
INPUT = ("inverter_input",)


def quiet(_name: str, _what: str) -> Callable[[int, int], None]:
    return lambda _done, _of: None


def test_places_are_the_inputs_that_an_inverter_s_controls_use() -> None:
    """Those of a plant with voltage control, without those that have a device; of a battery its own."""
    new = [p for p in places.places(shipped(SOLAR), INPUT) if not p.own]
    assert [p.at for p in new] == ["SOLAR.Qplant", "SOLAR.Vplant", "SOLAR.Paux", "SOLAR.Qaux"]
    assert new[0].label == "inverter_input at SOLAR.Qplant"
    assert new[0].names == {"SOLAR", "SOLAR.Qplant"}
    present = [p for p in places.places(shipped(SOLAR), INPUT) if p.own]
    assert [(p.at, p.device.name) for p in present] == [("SOLAR.Pplant", "pod_p"), ("SOLAR.Vaux", "pod_v")]
    assert places.setpoints(shipped(BATTERY), "BATTERY") == ["Paux", "Qaux", "Vaux"]
    off = [{**c.model_dump(), "enabled": c.model != "REPCA1"} for c in shipped(SOLAR).inverter_controls]
    assert places.setpoints(changed(shipped(SOLAR), inverter_controls=off), "SOLAR") == ["Paux", "Qaux", "Vaux"]


def test_parallel_devices_stand_where_no_unit_is() -> None:
    assert not [p for p in places.places(shipped(SOLAR), ("statcom",)) if not p.own]


def test_signals_are_frequencies_where_an_inverter_forms_the_grid() -> None:
    system, task = shipped(BATTERY), design.Task(BATTERY, [], 0.1, 0.1)
    assert task.channel(system) == places.FREQUENCY
    assert task.channel(shipped(SOLAR)) == places.SPEED
    modes, _ = design.listed_modes(task, system)
    wide = places.with_signals(system, modes, task.channel(system))
    new = {name: s.weights for name, s in wide.signals.items() if s.channel == places.FREQUENCY}
    assert new == {"f_G2_G1": {"G2": 1.0, "G1": -1.0}}
    bare = system.model_copy(update={"pmus": [pmu for pmu in system.pmus if pmu.name != "BATTERY"]})
    assert {pmu.machine for pmu in places.with_signals(bare, modes, places.FREQUENCY).pmus} >= {"BATTERY"}
    assert places.merged(system).pmus == system.pmus


def test_ranking_by_residue_is_how_eigenvalues_move() -> None:
    """With a small gain from signal to setpoint; beside a battery the fastest speed may be its own."""
    system, task = shipped(BATTERY), design.Task(BATTERY, [], 0.1, 0.1)
    modes, target = design.listed_modes(task, system)
    narrow = places.only(places.with_signals(system, modes, places.FREQUENCY), ["f_G2_G1"], system)
    chosen = next(p for p in places.places(narrow, INPUT) if p.at == "BATTERY.Vaux")
    seen = places.tried(places.Trial(narrow, chosen, modes))
    placed = place(places.with_place(narrow, chosen))
    built = build(placed, [chosen.device.name], [])
    model = linear_model(built, placed.signals, [s.name for s in placed.pmus])

    def moved(gain: float) -> complex:
        values = np.linalg.eigvals(model.A + gain * np.outer(model.B[:, 0], model.C[0]) / (1.0 - gain * model.D[0, 0]))
        return complex(values[np.argmin(abs(values - modes[target].eigenvalue))])

    slope = (moved(1e-2) - moved(-1e-2)) / 2e-2
    assert abs(slope - seen.residue[target, 0]) < 1e-3 * abs(slope)


def test_unknown_input_is_refused_with_those_that_are_there() -> None:
    task = design.Task(SOLAR, [], 0.1, 0.1, place="SOLAR.Vbus", kinds=INPUT)
    with pytest.raises(InputError, match=r"--place: 'SOLAR\.Vbus' given .*; allowed: .*SOLAR\.Paux"):
        design.ranked(task, 1, quiet)


def test_scenarios_are_there_though_each_bus_has_a_unit() -> None:
    ranking = design.ranked(design.Task(SOLAR, [], 0.1, 0.1, kinds=INPUT), 1, quiet)
    run: dict[str, Any] = {"system": ranking.bare.model_dump(by_alias=True), "devices": []}
    chosen = ranking.tried[ranking.chosen.tried].place
    drawn = scenario_generation.training_cases(run, ranking.tried, chosen, 0, lambda *_: None)
    assert set(drawn) == {"fault", "line_out"}


def small_plant() -> Any:
    """The solar system with a second, small plant on which no device acts."""
    system = shipped(SOLAR)
    second = {**system.inverters[0].model_dump(), "name": "SMALL", "rating": 60.0, "P": 40.0, "Q": 10.0}
    controls = [c.model_dump() for c in system.inverter_controls]
    more = [{**row, "inverter": "SMALL"} for row in controls]
    inverters = [system.inverters[0].model_dump(), second]
    return changed(system, inverters=inverters, inverter_controls=[*controls, *more])


def test_drawn_cases_vary_inverters_and_trip_small_ones() -> None:
    """Of at most 15 % of the generation, without a device; their cases can be run."""
    system = small_plant()
    run: dict[str, Any] = {
        "system": system.model_dump(by_alias=True),
        "scenario": [],
        "devices": ["pod_p"],
        "controllers": [],
        "duration": 2.0,
    }
    fields = {"run": run, "lines": ["line_1", "line_2"], "seed": "3", "kinds": {"fault": 15, "step": 30}}
    case_set = set_of(
        "small", {"version": "1", "devices": ["pod_p"], "signals": [next(iter(system.signals))], **fields}, ""
    )
    cases = [case.set for case in case_set.cases]
    powers = np.array([[case[f"system.inverters.{i}.P"] for i in range(2)] for case in cases])
    assert (np.ptp(powers / [200.0, 40.0], axis=0) > 0.04).all()
    events = [event for case in cases for event in case["scenario"]]
    trips = [event for event in events if event["kind"] == "generator_trip"]
    assert {event["machine"] for event in trips} == {"SMALL"}
    assert {event["machine"] for event in events if event["kind"] == "mechanical_power_step"} == {"G1", "G2"}
    case = make_case({**run, "scenario": trips[:1]}, "test")
    assert loop.run(case).in_synchronism.all()


def test_compared_cases_have_faults_near_inverters() -> None:
    wscc = shipped("wscc_9")
    solar = {**shipped(SOLAR).inverters[0].model_dump(), "bus": "B3"}
    system = changed(wscc, inverters=[solar])
    lines = [line.name for line in wscc.lines]
    assert own_grid._near_inverters(system, lines) == ["line_6_9", "line_8_9"]  # behind the transformer T3
    assert own_grid._near_inverters(wscc, lines) == []
