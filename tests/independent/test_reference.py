"""The reference model of any system: held against what is known, then the package against it."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from facts_damping.signals import to_ns
from facts_damping.small_signal.linearisation import linearise
from facts_damping_library.devices.inverter_input import InverterInput
from tests.independent.reference import Model, Run
from tests.independent.reference_cases import CASES as WITHOUT_INVERTERS
from tests.independent.reference_devices import Battery, Capacitor, Input, Link, Modulated, Ramp
from tests.independent.reference_grid import Stage
from tests.independent.reference_inverter_cases import CASES as WITH_INVERTERS
from tests.independent.reference_network import Network
from tests.plant.running import events, follow, frame_times, plant, shipped, ssscs
from tests.plant.test_options import CASES as OPTIONS
from tests.plant.test_options import andes
from tests.plant.test_power_flow import PRINTED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

CASES = {**WITHOUT_INVERTERS, **WITH_INVERTERS}
SAME = {"limited_fine": "limited"}  # systems that differ by the package's step alone


@cache
def both(name: str) -> tuple[System, Built, Model]:
    """A case's system, as the package and as the reference model build it."""
    case = CASES[name]
    system = case.build()
    devices = [device.name for device in system.devices]
    return system, plant(system, *case.events, installed=devices), Model(system)


def apart(ours: NDArray[Any], theirs: NDArray[Any], near: float) -> float:
    """Largest distance of eigenvalues in pairs, without those near zero, where round-off counts for much."""
    distance = np.abs(ours[:, None] - theirs[None, :])
    pairs = linear_sum_assignment(distance)
    assert len(ours) == len(theirs)
    return float(distance[pairs][np.abs(ours[pairs[0]]) > near].max())


def test_reference_has_the_four_digits_of_the_thesis() -> None:
    """Powers and voltages with a solid middle bus; the current with the SSSC."""
    system = shipped("two_area")
    (bare,) = (device.model_copy(update={"rs": 1e-9}) for device in ssscs(system))
    flow = Model(system.model_copy(update={"devices": [bare]}), []).flow
    np.testing.assert_array_equal(np.round(np.array(list(flow.S.values())) / 9, 4), PRINTED)
    assert [round(abs(flow.V[bus]), 4) for bus in ("B7", "B9")] == [0.9916, 1.0028]
    assert abs(Model(system).flow.I["sssc"]) == pytest.approx(4.15, abs=0.005)


def test_ramps_have_a_rate_and_a_limit() -> None:
    """A target is reached at 5 p.u./s, or left unfinished at the next one; targets are within +-0.1."""
    (p,) = ssscs(shipped("two_area"))
    followed = Ramp(p, [(1.0, 0.3), (1.01, -0.1)], 2.0).at(np.array([0.99, 1.004, 1.01, 1.03, 1.04, 2.0]))
    np.testing.assert_allclose(followed, [0, 0.02, 0.05, -0.05, -0.1, -0.1], rtol=0, atol=1e-12)


def test_bolted_fault_is_the_limit_of_a_small_impedance() -> None:
    model = Model(shipped("two_area"), ["sssc"])
    exact, near = (Network(model, Stage(faults={"line_4": (0.9, z)})) for z in (0j, 1e-9 + 0j))
    V, close = (network.solve(model.known(model.start, {"sssc": 0.02}))[0].V for network in (exact, near))
    assert abs(V[-1]) < 1e-12
    np.testing.assert_allclose(close, V, rtol=0, atol=1e-6)


@pytest.mark.parametrize("option", OPTIONS)
def test_reference_has_the_eigenvalues_of_andes(option: str) -> None:
    """Saturation, loads, controls, taps of kundur_12_6; measured 2e-6."""
    system = shipped("kundur_12_6")
    fields = {**system.model_dump(by_alias=True), **OPTIONS[option]()}
    assert apart(Model(type(system).model_validate(fields)).eigenvalues(), andes(option), 0.02) < 5e-6


@pytest.mark.parametrize(
    ("P", "flow", "angle"), [(840.0, 574.0, 11.7), (1575.0, 1311.0, 20.17), (2100.0, 1840.0, 25.0)]
)
def test_reference_has_the_published_flows_of_smib(P: float, flow: float, angle: float) -> None:
    """Thesis 4.5.1 and 4.7.1: flow from B3 to B4 within 1 %, angle to the terminal voltage within 0.4 degrees."""
    system = shipped("smib")
    machine = system.machines[0].model_copy(update={"P": P})
    model = Model(system.model_copy(update={"machines": [machine]}))
    power = (model.flow.V["B3"] * np.conj(model.flow.I["sssc"])).real * system.base_power
    assert power == pytest.approx(flow, rel=0.01)
    assert np.rad2deg(model.x0[0] - np.angle(model.flow.V["B1"])) == pytest.approx(angle, abs=0.4)


@pytest.mark.parametrize("name", CASES)
def test_power_flow_and_start_agree(name: str) -> None:
    """Measured 6e-13."""
    system, built, model = both(name)
    assert np.abs(model.rates(model.x0, {}, model.healthy)).max() < 1e-11
    for bus, V in zip(built.flow.names, built.flow.voltage, strict=True):
        assert abs(V - model.flow.V[bus]) < 1e-11
    for machine in system.machines:
        assert abs(built.flow.generation[machine.name] - model.flow.S[machine.name]) < 1e-10
    start = dict(zip(built.state_names, built.state.x, strict=True))
    common = [(start[state], x) for state, x in zip(model.names, model.x0, strict=True) if state in start]
    assert len(common) >= 2 * len(system.machines)
    assert max(abs(ours - theirs) for ours, theirs in common) < 1e-11


@pytest.mark.parametrize("name", CASES)
def test_eigenvalues_agree(name: str) -> None:
    """Measured 5e-7, of which most is at eigenvalues around 1000 1/s."""
    _, built, model = both(name)
    assert apart(np.linalg.eigvals(linearise(built)[0]), model.eigenvalues(), 0.2) < 2e-6


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.build().devices])
def test_transfer_functions_agree(name: str) -> None:
    """From setpoints to speeds at 0.6 Hz, relative to the largest."""
    system, built, model = both(name)
    responses = []
    for names, (A, B) in ((built.state_names, linearise(built)), (model.names, model.state_matrix())):
        speeds = [list(names).index(f"{machine.name}.omega") for machine in system.machines]
        responses.append(np.linalg.solve(4.0j * np.eye(len(A)) - A, B)[speeds])
    assert np.abs(responses[1]).max(axis=0).min() > 1e-4
    assert (np.abs(responses[0] - responses[1]) / np.abs(responses[1]).max(axis=0)).max() < 1e-6


@cache
def course(name: str) -> Run:
    """A case's course by the reference, a hundred times as sharp as its bound."""
    case, (_, _, model) = CASES[name], both(name)
    sharp = max(1e-10, case.bound / 100.0)
    t = np.array([to_ns(t) for t in frame_times(case.end)]) * 1e-9
    return model.simulate(t, events(*case.events), case.targets, method=case.method, rtol=sharp, atol=sharp / 100.0)


def inverter_current(model: Model, run: Run, name: str) -> float:
    """Current of an inverter at the end of a course, p.u. of the system."""
    i = [unit.row.name for unit in model.inverters].index(name)
    unit, first = model.inverters[i], model.first[i]
    x, V = run.x[-1, first : first + len(unit.states)].tolist(), complex(run.V[unit.row.bus][-1])
    sets = model.set_at(name, {device: float(values[-1]) for device, values in run.references.items()})
    return abs(unit.current(x, V, sets)) * float(unit.row.rating) / model.system.base_power


@pytest.mark.parametrize("name", CASES)
def test_courses_agree(name: str) -> None:
    """Speeds within the case's bound; angles, voltages and devices follow from them."""
    case, (system, built, model) = CASES[name], both(name)
    devices = [device.name for device in system.devices]
    targets = [(time, value, devices.index(device)) for device, rows in case.targets.items() for time, value in rows]
    trace = follow(built, frame_times(case.end), sorted(targets))
    run = course(SAME.get(name, name))
    np.testing.assert_array_equal(run.t, trace.t)
    tripped = {row["machine"] for row in case.events if row["kind"] == "generator_trip"}
    running = [g for g, machine in enumerate(system.machines) if machine.name not in tripped]
    assert trace.sound.all()
    assert np.ptp(run.speeds[:, running], axis=0).max() > max(1e-4, 20 * case.bound)
    np.testing.assert_allclose(trace.speeds[:, running], run.speeds[:, running], rtol=0, atol=case.bound)
    angles = trace.machines["rotor_angle"]
    np.testing.assert_allclose(angles[:, running], run.angles[:, running], rtol=0, atol=1000 * case.bound)
    terminals = [np.abs(run.V[machine.bus][-1]) for machine in system.machines]
    voltage = trace.machines["terminal_voltage"][-1]
    np.testing.assert_allclose(voltage, terminals, rtol=0, atol=1000 * case.bound)
    inverters = tuple(f"{row.name}." for row in system.inverters)
    for state in (name for name in run.names if name.startswith(inverters) and name in built.state_names):
        x, theirs = trace.x[:, built.state_names.index(state)], run.state(state)
        np.testing.assert_allclose(x, theirs, rtol=0, atol=1000 * case.bound * max(1.0, float(np.ptp(theirs))))
    for d, device in enumerate(devices):
        np.testing.assert_allclose(trace.reference[:, d], run.references[device], rtol=0, atol=1e-9)
        end = trace.devices[-1, d]
        if f"{device}.vdc" in run.names:
            assert end["dc_voltage"] == pytest.approx(run.state(f"{device}.vdc")[-1], rel=0, abs=1000 * case.bound)
        elif isinstance(row := system.devices[d], InverterInput):
            current = inverter_current(model, run, row.inverter)
            assert end["current"] == pytest.approx(current, rel=0, abs=1000 * case.bound)
        elif isinstance(model.converters[device][0], Input):
            assert end["current"] == 0
        elif isinstance(bank := model.converters[device][0], Capacitor):
            first, second = (run.V[bus][-1] for bus in bank.p.ends)
            x = run.state(f"{device}.x")[-1]
            current = abs((first - second) / complex(bank.p.rs, -x))
            assert end["current"] == pytest.approx(current, rel=0, abs=1e5 * case.bound)
            assert end["injected_voltage"] == pytest.approx(x * current, rel=0, abs=1000 * case.bound)
        elif isinstance(link := model.parallel[device], Link):
            z, known = [run.state(f"{device}.{state}")[-1] for state in link.states], float(run.references[device][-1])
            u = run.state(f"{device}.reference")[-1] if device in model.lags else known
            S = link.powers(z, float(u), abs(run.V[link.p.buses[0]][-1]))[0]
            assert end["active_power"] == pytest.approx(S.real, rel=0, abs=1000 * case.bound)
            assert end["reactive_power"] == pytest.approx(S.imag, rel=0, abs=1000 * case.bound)
        elif isinstance(load := model.parallel[device], Modulated | Battery):
            V = float(abs(run.V[system.devices[d].place][-1]))
            z = [run.state(f"{device}.{state}")[-1] for state in load.states]
            u = run.state(f"{device}.reference")[-1] if device in model.lags else run.references[device][-1]
            S = load.power(z, float(u), V)
            assert end["active_power"] == pytest.approx(S.real, rel=0, abs=1000 * case.bound)
            assert end["reactive_power"] == pytest.approx(S.imag, rel=0, abs=1000 * case.bound)
        else:
            V = abs(run.V[system.devices[d].place][-1])
            reactive_power = run.state(f"{device}.B")[-1] * V**2
            assert end["reactive_power"] == pytest.approx(reactive_power, rel=0, abs=1000 * case.bound)
