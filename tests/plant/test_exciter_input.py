"""The exciter input: what it adds is what a stabiliser would, at exciters of all kinds; service, limits, bad data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.parameters.plant.machines import StaticExciter
from facts_damping.plant.model import copy
from facts_damping.small_signal.linearisation import linearise
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes
from tests.plant.smoke import damps, follows_linear_model

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

# Systems with exciters of every kind: static ones, DC ones, tables of blocks.
SYSTEMS = ["two_area", "kundur_12_6_thyristor_pss", "kundur_12_6_dc", "nets_nyps"]


def row(machine: str = "G2", **fields: Any) -> dict[str, Any]:
    return {"name": "input", "kind": "exciter_input", "machine": machine, **fields}


def with_input(name: str = "two_area", *more: dict[str, Any], **fields: Any) -> System:
    """A shipped system with an input at the exciter of G2."""
    system = shipped(name)
    devices = [d.model_dump(by_alias=True) for d in system.devices]
    return changed(system, devices=[*devices, row(**fields), *more])


def with_reference(built: Built, machine: int, u: float) -> Built:
    """The same plant with a voltage reference that is higher by u."""
    plant_ = copy_of(built)
    plant_.plant.exciters["Vref"][machine] += u
    plant_.plant.controls["Vref"][machine] += u
    return plant_


def copy_of(built: Built) -> Built:
    """A plant whose exciters can be changed."""
    copied = built.plant._replace(exciters=built.plant.exciters.copy(), controls=built.plant.controls.copy())
    return built._replace(plant=copied)


@pytest.mark.parametrize("name", SYSTEMS)
def test_its_setpoint_acts_as_an_offset_of_the_voltage_reference(name: str) -> None:
    """Slopes of all states with the setpoint are those with a reference that is higher by as much."""
    built = plant(with_input(name), installed=["input"])
    at = [m.name for m in shipped(name).machines].index("G2")
    assert np.abs(slopes(built)).max() < 1e-8
    for u in (0.03, -0.05):
        state = copy(built.state)._replace(reference=np.array([u]))
        derivatives = slopes(built._replace(state=state))
        expected = slopes(with_reference(built, at, u))
        np.testing.assert_allclose(derivatives, expected, rtol=1e-12, atol=1e-9)
    trace = follow(built, frame_times(0.5), [(0.0, 0.02)])
    assert np.ptp(trace.machines["field_voltage"][:, at]) > 1e-3
    assert trace.sound.all()


def test_static_exciter_gives_its_gain_times_the_setpoint() -> None:
    """At once, d(Efd) = KA u / (1 + KA KF / TF), as the transducer and the feedback have not moved."""
    built = plant(with_input(), installed=["input"])
    (e,) = (e for e in shipped("two_area").exciters if isinstance(e, StaticExciter) and e.machine == "G2")
    gain = e.KA / (1.0 + e.KA * e.KF / e.TF)
    assert e.TB == 0.0
    state = copy(built.state)._replace(reference=np.array([1e-3]))
    before, after = (
        follow(built._replace(state=s), [0.0]).machines["field_voltage"][0, 1] for s in (built.state, state)
    )
    assert after - before == pytest.approx(gain * 1e-3, rel=1e-9)


def test_two_inputs_at_a_machine_add_up_beside_its_stabiliser() -> None:
    system = with_input("kundur_12_6_thyristor_pss", {**row(), "name": "second", "response_time": 0.02})
    both, single = plant(system, installed=["input", "second"]), plant(system, installed=["input"])
    np.testing.assert_allclose(
        linearise(both)[1][: len(single.state.x), 0], linearise(single)[1][:, 0], rtol=0, atol=1e-7
    )
    lag = both.state_names.index("second.reference")
    A, B = linearise(both)
    np.testing.assert_allclose(A[:-1, lag], B[:-1, 0], rtol=1e-6, atol=1e-6)
    assert (both.plant.devices["port"] == -1).all()


def test_exciter_input_leaves_the_power_flow_unchanged_and_draws_nothing() -> None:
    built = plant(with_input(), installed=["input"])
    np.testing.assert_array_equal(built.flow.voltage, plant("two_area").flow.voltage)
    trace = follow(built, frame_times(1.0), [(0.0, 0.5), (0.5, float("nan"))])
    device = trace.devices[:, 0]
    for name in ("current", "active_power", "reactive_power", "blocked"):
        assert (device[name] == 0).all()
    assert trace.reference.max() == 0.1  # its limit
    assert np.isnan(device["injected_voltage"]).all()


def test_exciter_input_works_in_a_plant_without_any_port() -> None:
    """wscc_9: loads that are impedances, machines without saliency of the stator."""
    built = plant(with_input("wscc_9"), installed=["input"])
    assert follow(built, frame_times(1.0), [(0.0, 0.05)]).sound.all()


def test_exciter_input_follows_its_linear_model() -> None:
    follows_linear_model(plant(with_input(response_time=0.02), installed=["input"]), u=1e-4)


def test_lead_lag_that_commands_it_damps_the_interarea_swing() -> None:
    damps(row("G2"), damping=0.05)


@pytest.mark.parametrize(("machine", "said"), [("G9", "'G9' given"), ("G2", "'G2' given, which has no exciter")])
def test_machine_without_exciter_is_refused(machine: str, said: str) -> None:
    system = shipped("two_area")
    left = [e.model_dump() for e in system.exciters if e.machine != "G2"]
    others = [s.model_dump() for s in system.stabilisers if s.machine != "G2"]
    devices = [d.model_dump(by_alias=True) for d in system.devices]
    with pytest.raises(ValueError, match=said):
        changed(system, exciters=left, stabilisers=others, devices=[*devices, row(machine)])
