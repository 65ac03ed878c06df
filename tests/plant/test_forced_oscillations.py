"""Forced oscillations: against the linear plant, their forms, and that they depend on time alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_case
from facts_damping.nodes.live_plant import LivePlant
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.record import RunChange
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH
from facts_damping.simulation import loop
from facts_damping.simulation.changes import apply
from facts_damping.simulation.twins import mirrored
from facts_damping.small_signal.linearisation import linearise
from tests.plant.running import changed, follow, frame_times, plant, shipped

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built


def at(**fields: Any) -> dict[str, Any]:
    return {"time": 0.0, "kind": "forced_oscillation", "frequency": 0.8, "amplitude": 0.001, **fields}


def controlled() -> System:
    """two_area with governors and stabilisers, so that all modes fade."""
    system = shipped("two_area")
    rows = {
        name: [{**control.model_dump(by_alias=True), "enabled": True} for control in getattr(system, name)]
        for name in ("governors", "stabilisers")
    }
    return changed(system, **rows)


def input_of(built: Built, element: dict[str, str]) -> NDArray[np.float64]:
    """Derivative of the slopes by the relative power of a machine or of a load that is a port, or by a setpoint."""
    slopes, work = [], workspace(built.plant, built.state)
    for size in (1e-5, -1e-5):
        if "machine" in element:
            work.forced[0] = size
        elif "exciter" in element:
            work.value[0] = size
        else:
            work.noise[0, 0] = size
        dx = np.zeros_like(built.state.x)
        state = copy(built.state)
        derivatives(built.plant, state.x, state.reference, state.source, 0, dx, work)
        slopes.append(dx)
    return (slopes[0] - slopes[1]) / 2e-5


@pytest.mark.parametrize("element", [{"machine": "G1"}, {"load": "load_2"}, {"exciter": "G3"}])
@pytest.mark.parametrize("frequency", [0.4, 1.1])
def test_speeds_are_those_of_the_linear_plant(element: dict[str, str], frequency: float) -> None:
    """Amplitude and phase within 1 %."""
    built = plant(controlled(), at(**element, frequency=frequency, ramp=5.0), installed=[])
    rest = plant(controlled(), at(**element, duration=1e-3, time=1e4), installed=[])
    b = input_of(rest, element)
    speeds = [i for i, name in enumerate(built.state_names) if name.endswith(".omega")]
    if "machine" in element:
        m = built.plant.machines[0]
        expected = np.zeros_like(b)
        expected[m["offset"] + 1] = built.plant.mechanical_power[0, 0] / (2.0 * m["H"])
        np.testing.assert_allclose(b, expected, rtol=1e-6, atol=1e-9)
    A, _ = linearise(rest)
    omega = 2.0 * math.pi * frequency
    linear = np.linalg.solve(1j * omega * np.eye(len(A)) - A, 0.001 * b)[speeds]
    trace = follow(built, frame_times(60, rate=20))
    late = trace.t >= 40.0
    t = trace.t[late]
    columns = np.column_stack([np.sin(omega * t), np.cos(omega * t), np.ones_like(t), t, t * t])
    fit, *_ = np.linalg.lstsq(columns, trace.speeds[late], rcond=None)
    phasors = fit[0] + 1j * fit[1]
    np.testing.assert_allclose(phasors, linear, rtol=0.01, atol=0.01 * np.abs(linear).max())


@settings(max_examples=8, deadline=None)
@given(
    element=st.sampled_from([{"machine": "G3"}, {"load": "load_1"}]),
    time=st.floats(0, 1),
    duration=st.none() | st.floats(1e-3, 1),
    waveform=st.sampled_from(["sine", "square"]),
)
def test_forced_oscillation_of_amplitude_0_changes_no_bit(element: dict[str, str], **fields: Any) -> None:
    """Bit for bit."""
    traces = [
        follow(plant("two_area", *rows), frame_times(1)) for rows in ([], [at(**element, **fields, amplitude=0.0)])
    ]
    for array, other in zip(*traces, strict=True):
        assert array.tobytes() == other.tobytes()


def start_power(built: Built) -> float:
    """Mechanical power of G1 without its oscillation, p.u."""
    return float(built.plant.mechanical_power[0, 0] * built.plant.machines["ratio"][0])


def powers(*rows: dict[str, Any], times: list[float]) -> NDArray[np.float64]:
    """Mechanical power of G1 relative to its start."""
    built = plant("two_area", *rows, installed=[])
    return np.asarray(follow(built, times).machines["mechanical_power"][:, 0] / start_power(built))


def test_start_ramp_and_end_of_a_sine() -> None:
    times = frame_times(4, rate=50)
    power = powers(at(time=0.51, machine="G1", amplitude=0.1, ramp=1.003, duration=2.4), times=times)
    t = np.array(times) - 0.51
    expected = 1.0 + 0.1 * np.clip(t / 1.003, 0.0, 1.0) * np.sin(2 * math.pi * 0.8 * t)
    expected[(t < 0) | (t >= 2.4)] = 1.0
    np.testing.assert_allclose(power, expected, rtol=1e-12)


def test_square_has_the_sign_of_its_sine() -> None:
    times = frame_times(3, rate=60)
    power = powers(at(machine="G1", amplitude=0.1, frequency=1.5, waveform="square", duration=2.0), times=times)
    halves = np.floor(np.array(times) * 3.0 + 1e-9)
    expected = np.where(np.array(times) < 2.0, 1.0 + 0.1 * (-1.0) ** halves, 1.0)
    np.testing.assert_allclose(power, expected, rtol=1e-12)


@settings(max_examples=20, deadline=None)
@given(frequency=st.floats(1e-3, 120.0), k=st.integers(0, 10**6))
def test_square_changes_at_its_edges(frequency: float, k: int) -> None:
    """At the last ns before an edge, and at the edge."""
    built = plant("two_area", at(machine="G1", amplitude=0.1, frequency=frequency, waveform="square"), installed=[])
    work, machines = workspace(built.plant, built.state), np.zeros(4, MACHINE_TRUTH)
    frame, devices = np.zeros((len(built.plant.pmu_machine), len(CHANNELS))), np.zeros(0, DEVICE_TRUTH)
    power, edge = [], int((k + 1) * 5e8 / frequency)
    for now in (edge - 1, edge):
        measure(built.plant, copy(built.state), now, frame, machines, devices, work)
        power.append(machines["mechanical_power"][0] / start_power(built) - 1.0)
    assert power == pytest.approx([0.1 - 0.2 * (k % 2), 0.2 * (k % 2) - 0.1])


def test_several_add_up() -> None:
    slow, other = at(machine="G1", frequency=0.7), at(machine="G1", frequency=1.9, time=0.3)
    times = frame_times(2)
    both, first, second = (powers(*rows, times=times) - 1.0 for rows in ((slow, other), (slow,), (other,)))
    np.testing.assert_allclose(both, first + second, rtol=0, atol=1e-15)


def test_power_depends_on_time_not_on_the_frames() -> None:
    """With frames twice as dense the run is the same, but for the steps beside edges."""
    rows = [at(machine="G1", amplitude=0.05, frequency=3.0), at(load="load_1", amplitude=0.05, waveform="square")]
    sparse, dense = (follow(plant("two_area", *rows), frame_times(2, rate=rate)) for rate in (60, 120))
    np.testing.assert_allclose(dense.x[::2], sparse.x, rtol=0, atol=1e-6)
    assert np.abs(sparse.speeds).max() > 1e-4


def test_integration_keeps_its_order() -> None:
    """With a quarter of the step the error falls by about 4^4, with start, end, ramp and edges between steps."""
    rows = [
        at(time=0.0123, machine="G1", amplitude=0.05, frequency=3.0, ramp=0.3117, duration=0.7331),
        at(time=0.0431, machine="G3", amplitude=0.05, frequency=2.17, waveform="square"),
    ]
    systems = [changed(shipped("two_area"), step=step) for step in (1 / 60, 1 / 240, 1 / 1920)]
    ends = [follow(plant(system, *rows, installed=[]), [0.0, 1.0]).x[-1] for system in systems]
    coarse, fine = (np.abs(course - ends[-1]).max() for course in ends[:2])
    assert fine < coarse / 100


def test_tripped_machine_has_none() -> None:
    trip = {"time": 1.0, "kind": "generator_trip", "machine": "G4"}
    trace = follow(plant("two_area", at(machine="G4", amplitude=0.1, duration=2.0), trip), frame_times(2.5))
    assert (trace.machines["mechanical_power"][trace.t >= 1.0, 3] == 0).all()


def test_forced_oscillation_of_a_machine_bypasses_its_governor() -> None:
    """The mechanical power has it at once, where a step of the reference takes its time."""
    built = plant(controlled(), at(machine="G1", amplitude=0.1, waveform="square"), installed=[])
    trace = follow(built, [0.0, 1e-3])
    assert trace.machines["mechanical_power"][0, 0] / start_power(built) == pytest.approx(1.1, rel=1e-6)


LIVE = ["duration=2.5", "controllers=[]", "scenario=[]"]
ROWS = [
    "kind: forced_oscillation, machine: G1, frequency: 0.7, amplitude: 0.05, duration: 0.8",
    "kind: forced_oscillation, load: load_2, frequency: 1.9, amplitude: 0.05, waveform: square",
    "kind: brake, bus: B9, power: 200, duration: 0.5",
]


def live(rows: list[str], *sets: str) -> NDArray[np.float64]:
    """Frames of a node's plant in which events happen at ticks 60, 72, 84, ..."""
    case = load_case(None, [*LIVE, *sets])
    node, frames = LivePlant(case), []
    acts: dict[int, Callable[[int], None]] = {}
    for tick in range(case.ticks):
        if tick in acts:
            acts[tick](tick)
        node.measure(tick)
        frames.append(node.frame.copy())
        k, rest = divmod(tick + 1 - 60, 12)
        if rest == 0 and 0 <= k < len(rows):
            acts[tick + 1] = node.ask_event(f"{{{rows[k]}}}")
        node.advance([])
    return np.array(frames)


def from_file(rows: list[str], *sets: str) -> NDArray[np.float64]:
    """Frames of a run whose scenario has the events of `live`."""
    listed = ", ".join(f"{{time: {1.0 + 0.2 * k!r}, {row}}}" for k, row in enumerate(rows))
    return loop.run(load_case(None, [*LIVE, *sets, f"scenario=[{listed}]"])).frames


@pytest.mark.parametrize(("rows", "sets"), [(ROWS[::2], []), (ROWS, ["load_noise.std=0.01"])])
def test_events_of_a_running_plant_are_those_of_a_file(rows: list[str], sets: list[str]) -> None:
    """Bit for bit, also of a load that is a port before."""
    assert live(rows, *sets).tobytes() == from_file(rows, *sets).tobytes()


@pytest.mark.parametrize("devices", ["[]", "[sssc]"])
def test_load_becomes_a_port_during_a_run(devices: str) -> None:
    """An impedance before, so that the networks are reduced differently: equal to the rounding."""
    live_run, expected = (run(ROWS, f"devices={devices}") for run in (live, from_file))
    np.testing.assert_allclose(live_run[:60], expected[:60], rtol=0, atol=1e-9)
    np.testing.assert_allclose(live_run, expected, rtol=0, atol=1e-7)
    assert np.nanmax(np.abs(live_run[-1] - live_run[0])) > 1e-3


def test_reset_ends_what_was_asked_for() -> None:
    case = load_case(None, LIVE)
    node = LivePlant(case)
    node.measure(0)
    node.ask_event(f"{{{ROWS[1]}}}")(1)
    node.advance([])
    node.measure(1)
    node.ask_reset()(2)
    node.measure(2)
    assert len(node._measured.plant.oscillations) == len(node._measured.plant.loads) == 0
    assert len(node.state.source) == 1  # the SSSC's
    assert (node.machines["speed_deviation"] == 0.0).all()


def test_noise_of_other_loads_stays_theirs() -> None:
    """The twin of a run with noise, in which a load without noise becomes a port: its noise keeps its sign."""
    case = load_case(None, [*LIVE, "load_noise.std=0.01", "load_noise.loads.load_1.std=0"])
    built = mirrored(loop.build_loop(case))
    event = "{kind: forced_oscillation, load: load_1, frequency: 1, amplitude: 0.1}"
    now, _ = apply(built, case, case, RunChange(10, "plant_sim", "plant", 0, "event", "", event))
    assert now.measured.plant.load_noise.shape[1] == 2
    np.testing.assert_array_equal(now.measured.plant.load_noise[:, :1], built.measured.plant.load_noise)
    np.testing.assert_array_equal(now.measured.plant.load_noise[:, 1], 0.0)
    assert len(now.measured.plant_state.source) == len(built.measured.plant_state.source) + 1
