"""All that is beside the linear network: Kirchhoff's laws, loads and their voltage, slopes of the ports' laws."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from facts_damping.devices.table import KINDS
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.converters.site import DEVICE, INVERTER, LOAD, OTHER_END, SALIENT
from facts_damping.plant.dynamics import solve_network
from facts_damping.plant.laws import law
from facts_damping.plant.model import copy, workspace
from tests.plant.channels import ACTIVE, REACTIVE, VOLTAGE
from tests.plant.inverters import following
from tests.plant.running import changed, follow, frame_times, moved, plant, shipped, slopes
from tests.plant.small import SPUR, between_infinite_buses
from tests.plant.test_properties import branches, everywhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.grid import Load
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built
    from tests.plant.running import Trace

BOTH = ["sssc", "statcom"]
POWER = {"P_fractions": {"power": 1.0}, "Q_fractions": {"power": 1.0}}

SVC = {
    "name": "svc",
    "kind": "svc",
    "bus": "B9",
    "setpoint_max": 0.1,
    "rate_max": 10.0,
    "B_min": -1.0,
    "B_max": 2.0,
    "K": 50.0,
}
HVDC = {
    "name": "hvdc",
    "kind": "hvdc",
    "from": "B7",
    "to": "B9",
    "P": 100.0,
    "P_max": 150.0,
    "setpoint_max": 0.1,
    "rate_max": 10.0,
    "loss": 0.02,
    "R": 0.01,
    "pf_from": 0.9,
    "pf_to": 0.85,
}
MODULATION = {
    "name": "modulation",
    "kind": "load_modulation",
    "bus": "B7",
    "setpoint_max": 0.5,
    "rate_max": 10.0,
    "pf": 0.9,
}
TCSC = {
    "name": "tcsc",
    "kind": "tcsc",
    "line": "line_4",
    "X": 0.01,
    "X_min": 0.0,
    "X_max": 0.2,
    "setpoint_max": 0.1,
    "rate_max": 1.0,
}
AT_INVERTER = {"name": "at_inverter", "kind": "inverter_input", "inverter": "I1", "input": "Vplant"}
INPUT = {"name": "input", "kind": "exciter_input", "machine": "G2"}  # without a port
BESS = {
    "name": "bess",
    "kind": "bess",
    "bus": "B10",
    "setpoint_max": 0.5,
    "rate_max": 10.0,
    "S_rated": 50.0,
    "E_rated": 10.0,
    "K": 0.6,
}
COMPENSATOR = {"name": "csvgn1", "kind": "csvgn1", "bus": "B6", "MBASE": 200.0, "CBASE": 80.0, "Q": 20.0, "K": 20.0}
COMPENSATOR |= {"T3": 0.1, "T5": 0.01}

# What a machine may be beside the shipped one: salient in the stator, saturated, with fewer circuits.
MACHINES: list[dict[str, Any]] = [
    {},
    {"Xq2": 0.22},
    {"model": "two_axis"},
    {"model": "genrou", "S10": 0.04, "S12": 0.22},
    {"model": "genrou", "Xq2": 0.28, "Xd2": 0.25, "D": 1.0},
    {"Xq1": None, "Tq01": None, "Xq2": 0.21},
]


@st.composite
def fractions(draw: st.DrawFn) -> dict[str, float]:
    """Fractions of impedance, current and power."""
    first, second = sorted((draw(st.floats(0, 1)), draw(st.floats(0, 1))))
    return {"impedance": first, "current": second - first, "power": 1 - second}


@st.composite
def systems(draw: st.DrawFn) -> System:
    """The two areas with other loads, machines and taps, and with PMUs at every branch."""
    rows = shipped("two_area").model_dump(by_alias=True)
    for load in rows["loads"]:
        load |= {
            "P_fractions": draw(fractions()),
            "Q_fractions": draw(fractions()),
            "V_min": draw(st.floats(0.5, 0.9)),
            "at": draw(st.sampled_from(["nominal", "solved"])),
        }
    rows["loads"].append(
        {"name": "load_3", "bus": "B6", "P": 80.0, "Q": draw(st.floats(-40, 40)), "P_fractions": draw(fractions())}
    )
    rows["machines"] = [{**m, **draw(st.sampled_from(MACHINES))} for m in rows["machines"]]
    taps = [{"tap": draw(st.floats(0.97, 1.03)), "phase_shift": draw(st.floats(-3, 3))} for _ in rows["transformers"]]
    rows["transformers"] = [{**t, **tap} for t, tap in zip(rows["transformers"], taps, strict=True)]
    return everywhere(changed(shipped("two_area"), **rows))


def zip_power(load: Load, voltage: NDArray[np.float64], reference: float) -> NDArray[np.complex128]:
    """What a load draws at voltages |V|, p.u.: P [z r^2 + i r + p], below V_min P [z + (i V_min + p) / V_min^2] r^2."""
    r, low = voltage / reference, load.V_min
    drawn = []
    for fraction, rated in ((load.P_fractions, load.P), (load.Q_fractions, load.Q)):
        z, i, p = fraction.impedance, fraction.current, fraction.power
        drawn.append(rated / 100 * np.where(r >= low, z * r**2 + i * r + p, (z + (i * low + p) / low**2) * r**2))
    return np.asarray(drawn[0] + 1j * drawn[1])


def unbalanced(
    system: System, trace: Trace, scales: dict[str, NDArray[np.float64]]
) -> dict[str, NDArray[np.complex128]]:
    """Power that is left over at each bus, from PMUs at all branches and machines, loads, shunts, STATCOM."""
    pmu = {s.name: trace.frames[:, i] for i, s in enumerate(system.pmus)}
    power = {name: rows[:, ACTIVE] + 1j * rows[:, REACTIVE] for name, rows in pmu.items()}
    magnitude = {s.bus or "": pmu[s.name][:, VOLTAGE] for s in system.pmus}
    left: dict[str, NDArray[np.complex128]] = {bus.name: np.zeros(len(trace.t), complex) for bus in system.buses}
    for m in system.machines:
        left[m.bus] += power[m.name]
    for branch in branches(system):
        left[branch.from_bus or ""] -= power[f"{branch.name}.from"]
        left[branch.to_bus or ""] -= power[f"{branch.name}.to"]
    for load in system.loads:
        at = magnitude[load.bus]
        reference = 1.0 if load.at == "nominal" else float(at[0])
        left[load.bus] -= scales.get(load.name, 1.0) * zip_power(load, at, reference)
    for shunt in system.shunts:
        left[shunt.bus] += 1j * shunt.Q / 100 * magnitude[shunt.bus] ** 2
    device = trace.devices[:, -1]
    left["B8W"] += device["active_power"] + 1j * device["reactive_power"]
    return left


@settings(deadline=None, max_examples=15)
@given(system=systems(), depth=st.floats(0.02, 0.3), change=st.floats(-0.15, 0.05))
def test_kirchhoff_s_laws_hold_with_any_loads_machines_taps_and_devices(
    system: System, depth: float, change: float
) -> None:
    """Before, during and after a fault through a reactance, with a stepped load and both devices at work."""
    rows = [
        {"time": 0.1, "kind": "load_step", "load": "load_2", "change": change},
        {"time": 0.2, "kind": "fault", "bus": "B9", "x": depth, "duration": 0.1},
    ]
    built = plant(system, *rows, installed=BOTH)
    trace = follow(built, frame_times(0.5), [(0.05, 0.05, 0), (0.05, -0.05, 1)])
    until_collapse = np.cumprod(trace.sound).astype(
        bool
    )  # where loads of constant power let the voltage collapse it ends
    assert until_collapse[trace.t < 0.1].all()
    scales = {"load_2": np.where(trace.t >= 0.1, 1 + change, 1.0)}
    left = unbalanced(system, trace, scales)
    at = next(i for i, s in enumerate(system.pmus) if s.bus == "B9")
    burning = (trace.t >= 0.2) & (trace.t < 0.3)
    left["B9"] -= 1j / depth * trace.frames[:, at, VOLTAGE] ** 2 * burning
    assert np.abs(list(left.values()))[:, until_collapse].max() < 1e-7
    assert np.abs(slopes(built)).max() < 1e-7


def test_constant_power_is_constant_above_v_min_and_an_impedance_below() -> None:
    """What the branches at its bus bring; a fault near by passes through both."""
    system = shipped("two_area")
    loads = [{**load.model_dump(), **POWER, "at": "solved", "V_min": 0.85} for load in system.loads]
    system = everywhere(changed(system, loads=loads, shunts=[]))
    fault = {"time": 0.2, "kind": "fault", "bus": "B10", "x": 0.02, "duration": 0.1}
    trace = follow(plant(system, fault, installed=[]), frame_times(1, 240))
    assert trace.sound.all()
    names = [s.name for s in system.pmus]
    for load in system.loads:
        pmus = [i for i, s in enumerate(system.pmus) if s.bus == load.bus]
        assert len(pmus) >= 3
        drawn = -(trace.frames[:, pmus, ACTIVE] + 1j * trace.frames[:, pmus, REACTIVE]).sum(axis=1)
        r = trace.frames[:, pmus[0], VOLTAGE] / trace.frames[0, pmus[0], VOLTAGE]
        expected = complex(load.P, load.Q) / 100 * np.where(r >= 0.85, 1.0, (r / 0.85) ** 2)
        np.testing.assert_allclose(drawn, expected, rtol=0, atol=1e-7)
        assert np.ptp(r[r >= 0.85]) > 0.02
    low = trace.frames[:, names.index("line_9_10.from"), VOLTAGE] < 0.7
    assert 20 < low.sum() < 30


def loaded(P: float, V_min: float = 0.7, **fields: Any) -> System:
    """A load of P p.u. at the end of a lossless line from an infinite bus."""
    row = {"name": "load", "bus": "S", "P": 100 * P, "at": "nominal", **POWER, "V_min": V_min, **fields}
    return between_infinite_buses([], loads=[row])


@pytest.mark.parametrize("P", [2.0, 8.0, 12.0, 12.4])
@pytest.mark.parametrize("step", [0.0, -0.5, 0.005])
def test_constant_power_behind_a_reactance_has_the_textbook_s_voltage(P: float, step: float) -> None:
    """V^2 = (E^2 + sqrt(E^4 - 4 P^2 X^2)) / 2, the upper of two solutions."""
    built = plant(loaded(P, 0.3), {"time": 0.5, "kind": "load_step", "load": "load", "change": step})
    trace = follow(built, [0.0, 0.6])
    for k, drawn in enumerate((P, P * (1 + step))):
        expected = np.sqrt((1 + np.sqrt(1 - (2 * drawn * SPUR) ** 2)) / 2)
        assert trace.frames[k, 2, VOLTAGE] == pytest.approx(expected, abs=1e-7)
        assert trace.frames[k, 2, ACTIVE] == pytest.approx(-drawn, abs=1e-7)


@pytest.mark.parametrize("P", [12.0, 14.0, 20.0, 40.0])
def test_below_v_min_the_voltage_is_that_of_an_impedance(P: float) -> None:
    """V = E / sqrt(1 + (X P / V_min^2)^2), where that is below V_min."""
    built = plant(loaded(8.0, 0.9), {"time": 0.5, "kind": "load_step", "load": "load", "change": P / 8 - 1})
    trace = follow(built, [0.0, 0.6])
    expected = 1 / np.hypot(1, SPUR * P / 0.81)
    assert expected < 0.9
    assert trace.sound.all()
    assert trace.frames[1, 2, VOLTAGE] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("P", [12.6, 15.0, 30.0])
def test_load_beyond_what_the_network_can_carry_collapses_to_an_impedance(P: float) -> None:
    """E^2 / (2 X) = 12.5 p.u. is the most; a V_min near zero leaves no other way out than next to no voltage."""
    built = plant(loaded(8.0, 0.01), {"time": 0.5, "kind": "load_step", "load": "load", "change": P / 8 - 1})
    trace = follow(built, [0.0, 0.6])
    assert trace.frames[1, 2, VOLTAGE] == pytest.approx(1 / np.hypot(1, SPUR * P / 1e-4), rel=1e-6)


@pytest.mark.parametrize("V_min", [0.5, 0.7, 0.9])
def test_network_with_constant_power_loads_has_a_solution_in_every_fault(V_min: float) -> None:
    """Their draw is bounded and continuous, so there is one: also where one load is an impedance, the other not."""
    system = shipped("two_area")
    system = changed(system, loads=[{**load.model_dump(), **POWER, "V_min": V_min} for load in system.loads])
    for bus in ("B5", "B7", "B8W", "B9", "B10", "B11"):
        for x in (0.005, 0.05, 0.2):
            fault = {"time": 0.5, "kind": "fault", "bus": bus, "x": x, "duration": 0.1}
            assert follow(plant(system, fault, installed=[]), [0.0, 0.5]).sound.all(), (bus, x)


def test_statcom_whose_current_its_bus_cannot_carry_is_blocked() -> None:
    """|V| = sqrt(|Voc|^2 - Im(Z i)^2) + Re(Z i): none for an active current of 40 p.u. in the middle of the tie."""
    built = plant("two_area", installed=["statcom"])
    trace = follow(built, [0.0], x=moved(built, {"statcom.id": 40.0}))
    assert trace.devices["blocked"][0, 0] == 1
    assert trace.devices["current"][0, 0] == 0
    assert trace.sound.all()


def test_run_whose_states_are_no_numbers_ends() -> None:
    built = plant("two_area", installed=["sssc"])
    trace = follow(built, [0.0, 0.1], x=np.full_like(built.state.x, np.nan))
    assert not trace.sound.any()


@pytest.mark.parametrize("P", [13.0, 18.0, 25.0])
def test_load_beyond_it_that_becomes_an_impedance_is_one(P: float) -> None:
    """With the default V_min the voltage that an impedance leaves is a solution: 0.686, 0.562, 0.440 p.u."""
    built = plant(loaded(8.0), {"time": 0.5, "kind": "load_step", "load": "load", "change": P / 8 - 1})
    trace = follow(built, [0.0, 0.6])
    assert trace.frames[1, 2, VOLTAGE] == pytest.approx(1 / np.hypot(1, SPUR * P / 0.49), abs=1e-9)


@pytest.mark.parametrize("bus", ["B5", "B7", "B10"])
def test_fault_finds_loads_of_constant_power_as_impedances(bus: str) -> None:
    """Through 0.2 p.u., the default V_min: voltages of 0.68 and 0.67, 0.69 and 0.68, 0.84 and 0.67 at the two loads."""
    system = shipped("two_area")
    system = changed(system, loads=[{**load.model_dump(), **POWER} for load in system.loads])
    fault = {"time": 0.5, "kind": "fault", "bus": bus, "x": 0.1 if bus == "B5" else 0.2, "duration": 0.1}
    assert follow(plant(system, fault, installed=[]), [0.0, 0.5]).sound.all()


@cache
def of_all_kinds() -> Built:
    """A plant with a port of each kind, and a device of each."""
    system = shipped("two_area")
    machines = [{**m.model_dump(), "Xq2": 0.22 if m.name == "G3" else 0.25} for m in system.machines]
    mixed = {"impedance": 0.2, "current": 0.5, "power": 0.3}
    loads = [{**load.model_dump(), "P_fractions": mixed, "Q_fractions": {"power": 1.0}} for load in system.loads]
    added = SVC, HVDC, MODULATION, BESS, TCSC, INPUT, COMPENSATOR, AT_INVERTER
    devices = [*(d.model_dump(by_alias=True) for d in system.devices), *added]
    names = [device["name"] for device in devices]
    inverter, controls = following("I1", "B6", 60.0, Q=10.0)
    tables = {"machines": machines, "loads": loads, "inverters": [inverter], "inverter_controls": controls}
    return plant(place(changed(system, **tables, devices=devices)), installed=names)


@pytest.mark.parametrize("p", range(13))
@settings(deadline=None, max_examples=80)
@given(
    magnitude=st.one_of(st.floats(0.05, 9.9), st.floats(10.1, 15)),  # below and above the SSSC's rated current
    turn=st.floats(-np.pi, np.pi),
    moved=st.tuples(*[st.floats(-0.05, 0.05)] * 4),
    reference=st.floats(-0.1, 0.1),
)
def test_slopes_of_every_port_are_those_of_its_law(
    p: int, magnitude: float, turn: float, moved: tuple[float, float, float, float], reference: float
) -> None:
    """The derivative (2, 2) of the source by the response against central differences, away from kinks."""
    built = of_all_kinds()
    assert set(built.plant.ports["kind"]) == {SALIENT, LOAD, DEVICE, OTHER_END, INVERTER}
    assert set(built.plant.devices["kind"]) == set(range(len(KINDS)))
    assert len(built.plant.ports) == 13
    work, x = workspace(built.plant, built.state), np.array(built.state.x)
    for name, value in zip(("sssc.x_ac", "sssc.vdc", "statcom.iq", "svc.B"), moved, strict=True):
        x[built.state_names.index(name)] += value
    references = np.full(len(KINDS), reference)
    solve_network(built.plant, x, references, copy(built.state).source, 0, work)

    def source_at(q: complex) -> complex:
        work.response[p] = q
        return complex(law(built.plant, x, references, 0, p, work))

    q, h = magnitude * np.exp(1j * turn), 1e-6 * max(1.0, magnitude)
    columns = []
    for direction in (1.0, 1j):
        low, middle, high = (source_at(q + step * h * direction) for step in (-1, 0, 1))
        assume(abs(high - 2 * middle + low) < 1e-4 * h * (1 + abs(middle) / magnitude))  # no kink between
        columns.append((high - low) / (2 * h))
    source_at(q)
    slopes_found = work.slope[p]
    expected = np.array([[c.real for c in columns], [c.imag for c in columns]])
    np.testing.assert_allclose(slopes_found, expected, rtol=1e-5, atol=1e-5 * (1 + np.abs(expected).max()))


@settings(deadline=None, max_examples=40)
@given(
    moved=st.lists(st.floats(-0.1, 0.1), min_size=5, max_size=5),
    references=st.tuples(*[st.floats(-0.1, 0.1)] * len(KINDS)),
)
def test_ports_of_all_kinds_are_solved_together(moved: list[float], references: tuple[float, ...]) -> None:
    """Every law holds at its response, and every response is the network's to all sources."""
    built = of_all_kinds()
    work, x, source = workspace(built.plant, built.state), np.array(built.state.x), copy(built.state).source
    for name, value in zip(("G1.delta", "sssc.vdc", "statcom.id", "statcom.iq", "svc.B"), moved, strict=True):
        x[built.state_names.index(name)] += value
    reference = np.array(references)
    solve_network(built.plant, x, reference, source, 0, work)
    assert not work.blocked.any()
    machines = len(built.plant.machines)
    outputs = built.plant.network[0] @ work.inputs
    for p in range(len(source)):
        assert outputs[machines + p] == pytest.approx(work.response[p], abs=1e-11)
        assert law(built.plant, x, reference, 0, p, work) == pytest.approx(source[p], abs=1e-10)
    assert np.abs(source[:4]).min() > 1e-6
