"""The inverter input: what it adds moves P, Q or V of its inverter, in small and in large; a lead-lag by it damps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import make_case
from facts_damping.errors import InputError, ProblemsError
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from facts_damping_studies.design import design
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes
from tests.plant.smoke import follows_linear_model
from tests.two_plants import path

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.parameters.plant.system import System

RATING = 3.0  # p.u. of the system base
P, Q, V = (list(CHANNELS).index(name) for name in ("active_power", "reactive_power", "voltage_magnitude"))


def with_input(name: str, signal: str, **fields: Any) -> System:
    """A system whose one device acts on a signal of its inverter."""
    system = shipped(path(name))
    row = {"name": "pod", "kind": "inverter_input", "inverter": system.inverters[0].name, "input": signal}
    return changed(system, devices=[{**row, **fields}])


# What an input of 0.05 p.u. moves at the terminals: until when, s, and between which values, p.u. of the rating.
MOVES = {
    ("solar", "Paux"): (P, 0.1, 0.9 * 0.05, 0.05),  # behind two lags of 20 ms
    ("solar", "Pplant"): (P, 0.2, 0.6 * 0.05, 0.05),  # behind one of 0.1 s, too
    ("solar", "Vaux"): (Q, 0.3, 0.1, 0.3),
    ("battery", "Paux"): (P, 0.1, 0.01, 0.05),  # turns its angle
    ("battery", "Vaux"): (Q, 0.3, 0.1, 0.2),
}


@pytest.mark.parametrize(("name", "signal"), MOVES)
def test_setpoint_moves_what_it_is_added_to(name: str, signal: str) -> None:
    channel, seconds, least, most = MOVES[name, signal]
    built = plant(with_input(name, signal), installed=["pod"])
    assert np.abs(slopes(built)).max() < 1e-7
    np.testing.assert_array_equal(built.flow.voltage, plant(shipped(path(name)), installed=[]).flow.voltage)
    trace = follow(built, frame_times(seconds), [(0.0, 0.05)])
    assert trace.sound.all()
    at = [pmu.machine for pmu in shipped(path(name)).pmus].index(shipped(path(name)).inverters[0].name)
    moved = (trace.frames[-1, at, channel] - trace.frames[0, at, channel]) / RATING
    assert least < moved < most
    np.testing.assert_allclose(trace.devices["active_power"][:, 0], trace.frames[:, at, P], rtol=1e-9)
    np.testing.assert_allclose(trace.devices["reactive_power"][:, 0], trace.frames[:, at, Q], rtol=1e-9)


@pytest.mark.parametrize(("name", "signal"), [("solar", "Pplant"), ("solar", "Vaux"), ("battery", "Paux")])
def test_inverter_input_follows_its_linear_model(name: str, signal: str) -> None:
    follows_linear_model(plant(with_input(name, signal, response_time=0.02), installed=["pod"]), u=1e-4)


def quiet(_name: str, _what: str) -> Callable[[int, int], None]:
    return lambda _done, _of: None


@pytest.mark.parametrize(("name", "place"), [("solar", "SOLAR.Vaux"), ("battery", "BATTERY.Paux")])
def test_lead_lag_that_commands_it_damps(name: str, place: str) -> None:
    """To the damping ratio that was designed, as the run after a fault has it."""
    task = design.Task(path(name), [], 0.08, 0.05, place=place, kinds=("inverter_input",))
    designed = design.design(task, 1, quiet)
    assert designed.tuned.reached
    scenario = [{"time": 1.0, "kind": "fault", "bus": "B1", "duration": 0.05}]
    run = {**designed.run, "system": designed.content, "scenario": scenario, "duration": 12.0}
    controlled: Any = summarise(loop.run(make_case(run, "test")))
    free: Any = summarise(loop.run(make_case({**run, "controllers": []}, "test")))
    assert controlled.stable
    assert controlled.indices["ITAE"] < 0.5 * free.indices["ITAE"]
    assert controlled.modes[0].damping_ratio == pytest.approx(0.08, abs=0.01)


def test_inverter_that_has_tripped_gives_nothing() -> None:
    trip = {"time": 0.1, "kind": "generator_trip", "machine": "SOLAR"}
    trace = follow(plant(shipped(path("solar")), trip, installed=["pod_p"]), frame_times(0.5), [(0.0, 0.05)])
    assert trace.sound.all()
    after = trace.t >= 0.1
    assert (trace.frames[~after, 2, P] > 1.9).all()
    assert np.abs(trace.frames[after, 2][:, [P, Q]]).max() < 1e-9
    assert np.abs(trace.devices["active_power"][after]).max() < 1e-9


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        (
            {"devices.0.input": "Vplant", "inverter_controls.1.RefFlag": 0},
            "devices: pod_p.input: Vplant given, .* SOLAR do not use; allowed: Pplant, Qplant, Paux, Qaux, Vaux",
        ),
        (
            {"inverter_controls.0.enabled": False},
            "REGCA1 of SOLAR: no Ipcmd, Iqcmd given; allowed: with one of .*REECB1",
        ),
    ],
)
def test_controls_that_do_not_fit_are_refused(fields: dict[str, Any], said: str) -> None:
    content = shipped(path("solar")).model_dump(by_alias=True)
    for place, value in fields.items():
        table, row, name = place.split(".")
        content[table][int(row)][name] = value
    with pytest.raises(InputError, match=said):
        plant(changed(shipped(path("solar")), **content), installed=["pod_p"])


def test_all_limits_that_exclude_the_start_are_told_a_line_each() -> None:
    content = shipped(path("solar")).model_dump(by_alias=True)
    content["inverters"][0]["P"] = 330.0
    content["inverter_controls"][0]["Qmax"] = 0.1
    with pytest.raises(ProblemsError) as caught:
        plant(changed(shipped(path("solar")), **content), installed=[])
    lines = caught.value.lines
    assert len(lines) == 3
    power = "Pord is 1.1 p.u. at the start; allowed by its limits: 0 to 1 (Pmax)"
    assert f"inverter_controls: SOLAR: REECB1: {power}" in lines
    assert any("REPCA1: P_regulated is 1.1 p.u." in line for line in lines)
    assert any(line.endswith("allowed by its limits: -0.4 to 0.1 (Qmax)") for line in lines)
