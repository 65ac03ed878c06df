"""One machine at an infinite bus: the thesis's operating points and scenarios, and the textbook's equal areas."""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.simulation import loop
from facts_damping.small_signal.eigenmodes import modes
from facts_damping.small_signal.linearisation import linearise
from tests.plant.channels import ACTIVE, ANGLE, VOLTAGE
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System
    from facts_damping.record import Record

LOADINGS = ("nominal", "light", "heavy")


def simulated(scenario: str, *sets: str) -> Record:
    return loop.run(load_case(None, ["system=smib", f"scenario={scenario}", *sets]))


def swing(system: System) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio of the rotor's mode."""
    built = plant(system)
    (mode,) = [m for m in modes(linearise(built)[0], built.state_names, system) if m.label == "local"]
    return mode.frequency_hz, mode.damping_ratio


@pytest.mark.parametrize(
    ("loading", "megawatts", "degrees"), [("nominal", 1311, 20.17), ("light", 574, 11.7), ("heavy", 1840, 25.0)]
)
def test_operating_points_are_the_thesis_s(loading: str, megawatts: float, degrees: float) -> None:
    """4.5.1, 4.7.1: flow from B-3 to B-4, as the PMU at B-3 measures it; rotor angle against the terminal voltage."""
    trace = follow(plant(shipped("smib", None, loading)), [0.0])
    assert trace.frames[0, 1, ACTIVE] * 100 == pytest.approx(megawatts, rel=0.01)
    angle = trace.machines["rotor_angle"][0, 0] - trace.frames[0, 0, ANGLE]
    assert np.rad2deg(angle) == pytest.approx(degrees, abs=0.4)


@pytest.mark.parametrize("installed", [[], ["sssc"]])
@pytest.mark.parametrize("loading", LOADINGS)
def test_smib_starts_and_stays_at_rest_at_every_loading(loading: str, installed: list[str]) -> None:
    """Heavy loading has a growing mode: exp(0.04 * 20) is 2.2."""
    built = plant(shipped("smib", None, loading), installed=installed)
    assert np.abs(slopes(built)).max() < 1e-9
    trace = follow(built, frame_times(20, 1))
    assert np.abs(trace.x - built.state.x).max() < 1e-9


@pytest.mark.parametrize("loading", LOADINGS)
def test_loading_is_the_scenario_s_dispatch(loading: str) -> None:
    """0.75, 0.4, 1.0 of 2100 MVA at the machine's terminals; the infinite bus takes what load and losses leave."""
    system = shipped("smib", None, loading)
    built = plant(system)
    fraction = {"nominal": 0.75, "light": 0.4, "heavy": 1.0}[loading]
    assert built.flow.generation["G1"].real == pytest.approx(21 * fraction, abs=1e-9)
    trace = follow(built, [0.0])
    assert trace.frames[0, 0, ACTIVE] == pytest.approx(21 * fraction, abs=1e-9)
    load = 2.5 * abs(built.flow.voltage[1]) ** 2
    losses = built.flow.generation["G1"] + built.flow.generation["GRID"] - load
    assert 0.1 < losses.real < 0.05 * 21


def test_mode_under_heavy_loading_grows() -> None:
    assert swing(shipped("smib", None, "heavy")) == pytest.approx((1.236, -0.005), abs=5e-4)
    for loading in ("nominal", "light"):
        assert swing(shipped("smib", None, loading))[1] > 0.02


def test_heavy_loading_loses_synchronism_without_control() -> None:
    """180 degrees against the infinite bus are passed at 19.6 s."""
    record = simulated("heavy", "controllers=[]")
    assert record.time_s[-1] == pytest.approx(19.6, abs=0.1)
    assert not record.in_synchronism[-1]
    angle = record.machines["rotor_angle"][:, 0]
    assert angle[-2] <= math.pi < angle[-1]


def test_heavy_loading_is_damped_by_the_lead_lag_controller() -> None:
    record = simulated("heavy")
    assert record.time_s[-1] > 39.9
    assert record.in_synchronism.all()
    speed = np.abs(record.machines["speed_deviation"][:, 0])
    assert speed[record.time_s < 3].max() > 5e-3
    assert speed[record.time_s > 35].max() < 5e-5


@pytest.mark.parametrize("scenario", ["nominal", "light"])
def test_lighter_loadings_ring_down_and_faster_with_control(scenario: str) -> None:
    late = []
    for sets in (["controllers=[]"], []):
        record = simulated(scenario, *sets)
        assert record.in_synchronism.all()
        speed = np.abs(record.machines["speed_deviation"][:, 0])
        late.append(speed[(record.time_s > 8) & (record.time_s < 9)].max() / speed.max())
    assert late[0] < 0.5
    assert late[1] < 0.3 * late[0]


def test_loss_of_a_circuit_needs_control() -> None:
    """After it the weaker line carries nominal power only with the lead-lag controller."""
    record = simulated("multiple", "controllers=[]")
    assert 5 < record.time_s[-1] < 9
    assert not record.in_synchronism[-1]
    record = simulated("multiple")
    assert record.time_s[-1] > 19.9
    assert record.in_synchronism.all()
    speed = np.abs(record.machines["speed_deviation"][:, 0])
    assert speed[record.time_s > 19].max() < 0.1 * speed[record.time_s > 5].max()


def watched(angle: float = 0.0, **fields: Any) -> System:
    """The system with a PMU at the infinite bus, whose voltage has an angle (deg)."""
    system = shipped("smib")
    pmus = [s.model_dump() for s in system.pmus]
    pmus.append({"name": "GRID", "bus": "B4", "branches": ["line_1", "line_2"]})
    grid = {**system.infinite_buses[0].model_dump(), "angle": angle}
    return changed(system, pmus=pmus, infinite_buses=[grid], **fields)


def test_infinite_bus_keeps_its_voltage_in_a_fault_at_another_bus() -> None:
    fault = {"time": 0.1, "kind": "fault", "bus": "B2", "duration": 0.1}
    trace = follow(plant(watched(-50.0), fault), frame_times(1))
    assert np.ptp(trace.frames[:, 1, VOLTAGE]) > 0.3
    assert np.ptp(trace.frames[:, 2, ACTIVE]) > 3
    np.testing.assert_allclose(trace.frames[:, 2, VOLTAGE], 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(trace.frames[:, 2, ANGLE], math.radians(-50), rtol=0, atol=1e-15)


def test_fault_at_the_infinite_bus_holds_it_at_zero_and_it_comes_back() -> None:
    """Meanwhile its lines take losses alone, so that the machine speeds up."""
    fault = {"time": 0.1, "kind": "fault", "bus": "B4", "duration": 0.05}
    trace = follow(plant(watched(), fault), frame_times(4, 100))
    burning = (trace.t >= 0.1) & (trace.t < 0.15)
    assert (trace.frames[burning, 2, VOLTAGE] == 0).all()
    np.testing.assert_allclose(trace.frames[~burning, 2, VOLTAGE], 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(trace.frames[burning, 2, ACTIVE], 0, rtol=0, atol=1e-12)
    assert trace.machines["electrical_power"][burning, 0].max() < 0.3 * 15.75
    assert (np.diff(trace.speeds[burning, 0]) > 1e-4).all()
    assert trace.sound.all()


@pytest.mark.parametrize("angle", [0.0, 40.0, -100.0])
@pytest.mark.parametrize("side", [1, -1])
def test_synchronism_counts_against_the_infinite_bus(angle: float, side: int) -> None:
    built = plant(watched(angle))
    x = built.state.x.copy()
    for beyond, sound in ((-1e-3, True), (1e-3, False)):
        x[0] = math.radians(angle) + side * (math.pi + beyond)
        assert follow(built, [0.0], x=x).sound[0] == sound


def test_angle_of_the_infinite_bus_is_of_no_account() -> None:
    fault = {"time": 0.1, "kind": "fault", "line": "line_1", "duration": 0.1}
    traces = [follow(plant(watched(angle), fault), frame_times(2), [(0.3, 0.05)]) for angle in (0.0, 123.0)]
    assert np.abs(traces[0].speeds).max() > 5e-3
    np.testing.assert_allclose(traces[1].speeds, traces[0].speeds, rtol=0, atol=1e-11)
    moved = traces[1].machines["rotor_angle"] - traces[0].machines["rotor_angle"]
    np.testing.assert_allclose(moved, math.radians(123), rtol=0, atol=1e-10)


# The textbook's machine: constant E' behind a reactance, no loss anywhere. Kundur 1994, 13.1.
P, H, XD1, XT, XL = 0.8, 3.5, 0.3, 0.15, 0.5
CLASSICAL = {"model": "classical", "H": H, "Xd1": XD1}


def textbook() -> System:
    line = {"from": "B2", "to": "B4", "r": 0.0, "x": 2 * XL}
    return changed(
        shipped("smib"),
        base_power=100,
        buses=[{"name": name, "nominal_voltage": 100} for name in ("B1", "B2", "B4")],
        lines=[{"name": name, **line} for name in ("line_1", "line_2")],
        transformers=[{"name": "T1", "from": "B1", "to": "B2", "rating": 100, "x": XT}],
        loads=[],
        machines=[{"name": "G1", "bus": "B1", "area": "plant", "rating": 100, "P": 100 * P, "V": 1.0, **CLASSICAL}],
        exciters=[],
        devices=[],
        pmus=[{"name": "G1", "machine": "G1"}],
        signals={},
        measures={},
    )


def textbook_start() -> tuple[float, float]:
    """EMF (p.u.) and angle (rad) of the textbook's machine: |V| = 1 at both ends of XT + XL carries P."""
    theta = math.asin(P * (XT + XL))
    current = (cmath.exp(1j * theta) - 1) / (1j * (XT + XL))
    emf = cmath.exp(1j * theta) + 1j * XD1 * current
    return abs(emf), cmath.phase(emf)


def test_classical_machine_swings_with_the_textbook_s_frequency() -> None:
    """omega^2 = omega_0 E V cos(delta) / (2 H X), undamped."""
    emf, delta = textbook_start()
    stiffness = emf * math.cos(delta) / (XD1 + XT + XL)
    expected = math.sqrt(2 * math.pi * 60 * stiffness / (2 * H)) / (2 * math.pi)
    assert swing(textbook()) == pytest.approx((expected, 0), abs=1e-8)


@pytest.mark.parametrize(("fraction", "stable"), [(0.998, True), (1.002, False)])
def test_critical_clearing_time_is_that_of_equal_areas(fraction: float, *, stable: bool) -> None:
    """A fault at the infinite bus leaves Pe = 0: cos(d_c) = (pi - 2 d_0) sin(d_0) - cos(d_0) (Kundur 1994, 13.1)."""
    _, delta = textbook_start()
    critical = math.acos((math.pi - 2 * delta) * math.sin(delta) - math.cos(delta))
    time = math.sqrt(4 * H * (critical - delta) / (2 * math.pi * 60 * P))
    fault = {"time": 0.1, "kind": "fault", "bus": "B4", "duration": fraction * time}
    trace = follow(plant(textbook(), fault), frame_times(3, 240))
    assert trace.sound.all() == stable
