from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import simpson

from facts_damping.plant.grid.network import series_devices
from facts_damping.small_signal.linearisation import linearise
from tests.plant.channels import ACTIVE, ANGLE, REACTIVE, VOLTAGE
from tests.plant.running import Trace, changed, events, follow, frame_times, moved, plant, shipped, ssscs, with_device

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.devices.base import Series
    from facts_damping.parameters.plant.grid import Line, Transformer
    from facts_damping.parameters.plant.system import System

LOAD_STEP = {"time": 0.1, "kind": "load_step", "load": "load_2", "change": -0.1}
some = settings(deadline=None, max_examples=8)


def branches(system: System) -> list[Line | Transformer | Series]:
    return [*system.lines, *system.transformers, *series_devices(system)]


def everywhere(system: System) -> System:
    """A PMU at each end of each branch, beside those at the machines."""
    pmus: list[dict[str, Any]] = [{"name": m.name, "machine": m.name} for m in system.machines]
    for branch in branches(system):
        for side, bus in (("from", branch.from_bus), ("to", branch.to_bus)):
            pmus.append({"name": f"{branch.name}.{side}", "bus": bus, "branches": [branch.name]})
    return changed(system, pmus=pmus, signals={}, measures={})


def disturbed(system: System) -> Trace:
    """A load step, setpoints, and a DC link that starts out of balance."""
    built = plant(system, LOAD_STEP)
    return follow(built, frame_times(2), [(0.05, 0.06), (0.5, -0.08)], x=moved(built, {"sssc.vdc": 0.9}))


def test_power_balances_at_every_bus_and_in_all() -> None:
    """What machines give is what loads draw, lines lose and the SSSC takes: losses r |I|^2 from the voltages."""
    system = everywhere(shipped("two_area"))
    trace = disturbed(system)
    pmu = {s.name: trace.frames[:, i] for i, s in enumerate(system.pmus)}
    power = {name: rows[:, ACTIVE] + 1j * rows[:, REACTIVE] for name, rows in pmu.items()}
    phasor = {name: rows[:, VOLTAGE] * np.exp(1j * rows[:, ANGLE]) for name, rows in pmu.items()}
    assert trace.machines["electrical_power"].std(axis=0).min() > 1e-3
    left = {bus.name: np.zeros(len(trace.t), complex) for bus in system.buses}
    at = {s.bus or "": phasor[s.name] for s in system.pmus}
    for m in system.machines:
        left[m.bus] += power[m.name]
    for branch in branches(system):
        left[branch.from_bus or ""] -= power[f"{branch.name}.from"]
        left[branch.to_bus or ""] -= power[f"{branch.name}.to"]
    drawn = np.zeros(len(trace.t))
    for load in system.loads:
        factor = np.where((trace.t >= 0.1) & (load.name == "load_2"), 0.9, 1.0)
        used = factor * complex(load.P, load.Q) / 100 * np.abs(at[load.bus]) ** 2
        left[load.bus] -= used
        drawn += used.real
    for shunt in system.shunts:
        left[shunt.bus] += 1j * shunt.Q / 100 * np.abs(at[shunt.bus]) ** 2
    assert max(np.abs(rest).max() for rest in left.values()) < 1e-10
    losses = np.zeros(len(trace.t))
    for line in system.lines:
        z, y = complex(line.r, line.x) * line.length, 1j * line.b * line.length
        gl = np.sqrt(z * y)
        flow = (at[line.from_bus] - at[line.to_bus]) / (z * np.sinh(gl) / gl)
        shunt_loss = np.tanh(gl / 2) / (gl / 2) * y / 2
        losses += (z * np.sinh(gl) / gl).real * np.abs(flow) ** 2
        losses += shunt_loss.real * (np.abs(at[line.from_bus]) ** 2 + np.abs(at[line.to_bus]) ** 2)
    iron = sum(9 / 500 * np.abs(at[t.from_bus]) ** 2 for t in system.transformers)
    device = trace.devices[:, 0]
    taken_power = device["active_voltage"] * device["current"] + ssscs(system)[0].rs * device["current"] ** 2
    assert np.abs(taken_power).max() > 0.05
    generated = sum(power[m.name].real for m in system.machines)
    np.testing.assert_allclose(generated, drawn + losses + iron + taken_power, rtol=0, atol=1e-9)


@pytest.mark.parametrize("g", [0.0, 0.05])
@pytest.mark.parametrize("vdc", [0.9, 1.1])
def test_power_drawn_by_the_sssc_charges_its_capacitor_or_is_lost(vdc: float, g: float) -> None:
    """The network's power less rs |I|^2, integrated, is the change of tau vdc^2 / 2 and what g takes."""
    system = everywhere(with_device("sssc", g=g))
    built = plant(system)
    trace = follow(built, frame_times(0.2, 4000), [(0.0, 0.05)], x=moved(built, {"sssc.vdc": vdc}))
    names = [s.name for s in system.pmus]
    west, east = (trace.frames[:, names.index(f"sssc.{side}"), ACTIVE] for side in ("from", "to"))
    device, d = trace.devices[:, 0], ssscs(system)[0]
    inward = west + east - d.rs * device["current"] ** 2
    np.testing.assert_allclose(inward, device["active_voltage"] * device["current"], rtol=0, atol=1e-11)
    stored = 0.5 * d.tau * device["dc_voltage"] ** 2
    assert np.ptp(stored) > 3e-4
    lost = simpson(g * device["dc_voltage"] ** 2, x=trace.t)
    assert simpson(inward, x=trace.t) == pytest.approx(stored[-1] - stored[0] + lost, abs=1e-7)


def test_centre_of_inertia_moves_by_the_net_power_alone() -> None:
    """Sum of 2 H S domega/dt is the sum of Pm - Pe: integrated over a disturbed run, and zero where they balance."""
    system = shipped("two_area")
    built = plant(system, {**LOAD_STEP, "time": 0.0})
    trace = follow(built, frame_times(3, 480))
    ratio = built.plant.machines["ratio"]
    inertia = 2 * built.plant.machines["H"] * ratio
    driven = built.plant.mechanical_power[0] @ ratio
    excess = driven - trace.machines["electrical_power"].sum(axis=1)
    centre = trace.speeds @ inertia / inertia.sum()
    np.testing.assert_allclose(centre[-1], simpson(excess, x=trace.t) / inertia.sum(), rtol=1e-6)
    assert centre[-1] > 1e-3
    undisturbed = follow(plant(system), frame_times(3), [(0.5, 0.05)])
    assert np.ptp(undisturbed.speeds, axis=0).min() > 1e-5
    balance = (driven - undisturbed.machines["electrical_power"].sum(axis=1)) / inertia.sum()
    centre = undisturbed.speeds @ inertia / inertia.sum()
    np.testing.assert_allclose(np.gradient(centre, undisturbed.t)[33:-1], balance[33:-1], rtol=0, atol=5e-6)
    assert np.abs(centre[:30]).max() < 1e-12
    assert np.abs(balance[:30]).max() < 1e-12


@pytest.fixture(scope="module")
def usual() -> tuple[NDArray[np.complex128], dict[str, NDArray[np.float64]]]:
    """Eigenvalues and speeds by machine of the shipped order."""
    system = shipped("two_area")
    return np.linalg.eigvals(linearise(plant(system))[0]).astype(complex), swing(system)


def swing(system: System) -> dict[str, NDArray[np.float64]]:
    fault = {"time": 0.1, "kind": "fault", "line": "line_4", "location": 0.99, "duration": 0.1}
    trace = follow(plant(system, fault), frame_times(1.5), [(0.3, 0.05)])
    return {m.name: trace.speeds[:, g] for g, m in enumerate(system.machines)}


TABLES = ("buses", "lines", "transformers", "loads", "shunts", "machines", "exciters", "pmus")


@some
@given(data=st.data())
def test_order_of_rows_is_of_no_account(usual: Any, data: st.DataObject) -> None:
    system = shipped("two_area")
    rows = system.model_dump(by_alias=True)
    shuffled = changed(system, **{name: data.draw(st.permutations(rows[name]), name) for name in TABLES})
    values, speeds = usual
    eigenvalues_found = np.linalg.eigvals(linearise(plant(shuffled))[0])
    away = [v for v in values if abs(v) > 1e-3]  # the pair at zero moves by the root of the round-off
    assert max(np.abs(eigenvalues_found - v).min() for v in away) < 1e-6
    for name, rotor in swing(shuffled).items():
        np.testing.assert_allclose(rotor, speeds[name], rtol=0, atol=1e-9)


@some
@given(degrees=st.floats(-360, 360))
def test_common_angle_is_of_no_account(usual: Any, degrees: float) -> None:
    """The slack's angle turns all others along, and changes no speed."""
    system = shipped("two_area")
    machines = [{**m.model_dump(), "angle": degrees if m.slack else 0.0} for m in system.machines]
    turned = changed(system, machines=machines)
    for name, rotor in swing(turned).items():
        np.testing.assert_allclose(rotor, usual[1][name], rtol=0, atol=1e-9)
    moved = plant(turned).flow.voltage / plant(system).flow.voltage
    np.testing.assert_allclose(moved, np.exp(1j * np.deg2rad(degrees)), rtol=0, atol=1e-9)


def tie(trace: Trace) -> NDArray[np.float64]:
    """Power from west to east, p.u."""
    return trace.frames[:, [s.name for s in shipped("two_area").pmus].index("TIE"), ACTIVE]


def test_capacitive_setpoint_raises_the_transfer() -> None:
    """At once, before the rotors move; and injected voltage follows the reference."""
    for value in (0.02, -0.02):
        trace = follow(plant("two_area"), frame_times(0.3, 240), [(0.0125, value)])
        assert tie(trace)[0] == pytest.approx(4.04, abs=0.01)
        rise = tie(trace)[8] - tie(trace)[0]  # 20 ms after, 16 ms after the ramp's end
        assert rise / value == pytest.approx(5, abs=1.5)
        reached = trace.devices[-1, 0]
        assert reached["setpoint"] == reached["reference"] == value
        assert reached["injected_voltage"] == pytest.approx(value, rel=0.02)


def test_capacitive_setpoint_slows_area_1_and_speeds_area_2() -> None:
    trace = follow(plant("two_area"), frame_times(0.2), [(0.0, 0.05)])
    assert trace.speeds[-1, :2].max() < -1e-5
    assert trace.speeds[-1, 2:].min() > 1e-5


@pytest.mark.parametrize(
    ("event", "sign"),
    [
        ({"kind": "load_step", "load": "load_2", "change": -0.1}, 1),
        ({"kind": "load_step", "load": "load_1", "change": 0.1}, -1),
        ({"kind": "generator_trip", "machine": "G3"}, -1),
        ({"kind": "mechanical_power_step", "machine": "G1", "change": 0.1}, 1),
        ({"kind": "mechanical_power_step", "machine": "G4", "change": -0.1}, -1),
    ],
)
def test_sign_of_the_speed_after_an_event(event: dict[str, Any], sign: int) -> None:
    built = plant("two_area", {"time": 0.1, **event})
    trace = follow(built, frame_times(2))
    inertia = built.plant.machines["H"] * built.plant.online[-1]
    assert sign * (trace.speeds[-1] @ inertia) / inertia.sum() > 1e-3


def test_line_out_lowers_the_tie_power() -> None:
    """At once: one of two circuits of a half of the tie is gone."""
    trace = follow(plant("two_area", {"time": 0.1, "kind": "line_out", "line": "line_2"}), frame_times(0.2))
    assert tie(trace)[-1] < tie(trace)[0] - 0.3
    assert trace.speeds[-1, :2].min() > 0 > trace.speeds[-1, 2:].max()


def test_converter_voltage_is_in_quadrature_while_the_dc_voltage_is_right() -> None:
    """No active voltage: the line's power goes through, but for rs |I|^2."""
    trace = follow(plant("two_area", LOAD_STEP), frame_times(2), [(0.2, 0.08), (0.9, -0.1)])
    device = trace.devices[:, 0]
    assert np.ptp(device["injected_voltage"]) > 0.15
    assert np.abs(device["active_voltage"]).max() < 1e-9
    assert np.abs(device["dc_voltage"] - 1).max() < 1e-9


@some
@given(
    changes=st.lists(
        st.tuples(st.floats(0.05, 1.5), st.sampled_from(["load_1", "load_2"]), st.floats(-0.2, 0.2)), max_size=6
    )
)
def test_any_load_steps_keep_the_plant_sound(changes: list[tuple[float, str, float]]) -> None:
    """And field voltages within their limits."""
    rows = [{"time": t, "kind": "load_step", "load": load, "change": c} for t, load, c in changes]
    assert len(events(*rows)) == len(rows)
    trace = follow(plant("two_area", *rows), frame_times(2))
    field = trace.machines["field_voltage"]
    assert trace.sound.all()
    assert 0 <= field.min() <= field.max() <= 7
