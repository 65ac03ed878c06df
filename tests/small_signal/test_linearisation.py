"""The linear model against the time domain, and residues against what a small feedback does to the eigenvalues."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import tf2ss

from facts_damping.analysis.modes.ringdown import ringdown_modes
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS
from facts_damping.small_signal import modal_tables
from facts_damping.small_signal.eigenmodes import _label, modes
from facts_damping.small_signal.linearisation import transfer_functions
from tests.plant.running import changed, follow, frame_times, plant, shipped

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.small_signal.eigenmodes import Eigenmode, Residue
    from facts_damping.small_signal.modal_tables import Modal

BOTH = ("sssc", "statcom")
CASES: list[tuple[str, tuple[str, ...]]] = [("two_area", ("sssc",)), ("two_area", BOTH), ("smib", ("sssc",))]


@cache
def linearised(name: str, devices: tuple[str, ...]) -> Modal:
    return modal_tables.analyse(shipped(name), list(devices))


def weights(system: System, signal: str) -> NDArray[np.float64]:
    """A signal's weights over the PMUs' channels."""
    weights_array = np.zeros((len(system.pmus), len(CHANNELS)))
    size = 1.0 / system.frequency if system.signals[signal].channel == "frequency" else 1.0
    for pmu, weight in system.signals[signal].weights.items():
        row = [s.name for s in system.pmus].index(pmu)
        weights_array[row, list(CHANNELS).index(system.signals[signal].channel)] = weight * size
    return weights_array


def observed(system: System, frames: NDArray[np.float64], signal: str) -> NDArray[np.float64]:
    """A signal of frames (times, PMUs, channels)."""
    return np.asarray(np.einsum("tsc,sc->t", np.nan_to_num(frames), weights(system, signal)))


def interarea(modal: Modal) -> Eigenmode:
    (mode,) = [m for m in modal.modes if m.label == "interarea"]
    return mode


def residue(mode: Eigenmode, device: str, signal: str) -> Residue:
    (residue_of_pair,) = [r for r in mode.residues if (r.device, r.signal) == (device, signal)]
    return residue_of_pair


def value(r: Residue) -> complex:
    return r.magnitude * complex(np.exp(1j * np.deg2rad(r.angle_deg)))


@pytest.mark.parametrize(("name", "devices"), CASES)
def test_ringdown_after_a_short_pulse_has_the_mode_s_frequency_and_damping(name: str, devices: tuple[str, ...]) -> None:
    """The strongest mode after 0.2 s at 0.02 p.u. of each device."""
    system = shipped(name)
    targets = [(t, u, d) for d in range(len(devices)) for t, u in ((0.5, 0.02), (0.7, 0.0))]
    trace = follow(plant(system, installed=devices), frame_times(21), targets)
    signals = [name for name, s in system.signals.items() if s.channel == "speed_deviation"]
    ringing = np.array([observed(system, trace.frames, signal) for signal in signals]).T
    ringing_mode = ringdown_modes(trace.t, ringing, since=1.0)[0]
    expected = linearised(name, devices).swings[0]  # the least damped
    assert ringing_mode.frequency_hz == pytest.approx(expected.frequency_hz, rel=1e-4)
    assert ringing_mode.damping_ratio == pytest.approx(expected.damping_ratio, abs=1e-4)


@pytest.mark.parametrize(("name", "devices"), CASES)
def test_start_in_the_shape_of_a_mode_moves_as_that_mode_alone(name: str, devices: tuple[str, ...]) -> None:
    """x - x0 = Re(v exp(lambda t)) in the time domain, all states of each electromechanical mode, for 3 s."""
    modal = linearised(name, devices)
    values, right = np.linalg.eig(modal.model.A)
    built = plant(name, installed=devices)
    speeds = [i for i, state in enumerate(built.state_names) if state.endswith(".omega")]
    for mode in modal.swings:
        at = int(np.argmin(np.abs(values - mode.eigenvalue)))
        v = right[:, at] / np.abs(right[:, at]).max() * 1e-5
        trace = follow(built, frame_times(3), x=built.state.x + v.real)
        expected = (v * np.exp(values[at] * trace.t)[:, None]).real
        assert (np.abs(trace.x - built.state.x - expected).max(axis=0) <= 3e-3 * np.abs(v) + 3e-10).all()
        assert np.abs(expected[:, speeds]).max() > 1e-8


@pytest.mark.parametrize("devices", [("sssc",), BOTH])
def test_two_areas_have_one_interarea_and_two_local_modes(devices: tuple[str, ...]) -> None:
    modal = linearised("two_area", devices)
    assert [mode.label for mode in modal.swings] == ["interarea", "local", "local"]
    assert {mode.label for mode in modal.modes} == {"interarea", "local", "common", "control"}
    common = [mode for mode in modal.modes if mode.label == "common"]
    assert all(abs(mode.eigenvalue) < 5e-3 for mode in common)


def apart(mode: Eigenmode, machine: str, other: str) -> float:
    """Angle between the motions of two machines, deg."""
    return float(abs(np.rad2deg(np.angle(mode.shape[machine] / mode.shape[other]))))


@pytest.mark.parametrize("devices", [("sssc",), BOTH])
def test_shapes_are_areas_against_each_other_and_machines_of_one_area(devices: tuple[str, ...]) -> None:
    between, *local = linearised("two_area", devices).swings
    assert max(apart(between, "G1", "G2"), apart(between, "G3", "G4")) < 30
    assert min(apart(between, a, b) for a in ("G1", "G2") for b in ("G3", "G4")) > 150
    assert min(abs(v) for v in between.shape.values()) > 0.3
    pairs = {frozenset(("G1", "G2")): 0, frozenset(("G3", "G4")): 0}
    for mode in local:
        first, other, *rest = sorted(mode.shape, key=lambda name: -abs(mode.shape[name]))
        assert mode.shape[first] == pytest.approx(1)
        assert apart(mode, first, other) > 150
        assert max(abs(mode.shape[name]) for name in rest) < 0.3
        pairs[frozenset((first, other))] += 1
    assert set(pairs.values()) == {1}


@pytest.mark.parametrize(("others", "label"), [(0.1, "interarea"), (-0.1, "local")])
def test_mode_is_interarea_where_the_areas_hold_most_of_the_motion(others: float, label: str) -> None:
    """G1 and G3 at 1 and -1, their neighbours at x and -x: areas hold (1 + x)^2 / (2 (1 + x^2)) at equal H."""
    system = shipped("two_area")
    system = changed(system, machines=[{**m.model_dump(), "H": 6.0} for m in system.machines])
    shape = {"G1": 1 + 0j, "G2": others + 0j, "G3": -1 + 0j, "G4": -others + 0j}
    assert _label(0.9, shape, system) == label


def test_shape_is_the_motion_in_the_time_domain() -> None:
    """Late in a growing oscillation the speeds stand to each other as in the interarea mode."""
    built = plant("two_area")
    trace = follow(built, frame_times(15), [(0.5, 0.02), (0.7, 0.0)])
    speeds = trace.speeds[trace.t > 6]
    t = trace.t[trace.t > 6]
    mode = interarea(linearised("two_area", ("sssc",)))
    wave = np.exp(mode.eigenvalue * t)
    base = np.column_stack([wave.real, -wave.imag, np.ones_like(t), t])
    fit = np.linalg.lstsq(base, speeds, rcond=None)[0]
    moved = fit[0] + 1j * fit[1]
    expected = np.array([mode.shape[f"G{g}"] for g in (1, 2, 3, 4)])
    np.testing.assert_allclose(moved / moved[2], expected / expected[2], rtol=0, atol=2e-3)


def test_without_areas_swings_are_electromechanical() -> None:
    machines = [{**m.model_dump(), "area": None} for m in shipped("two_area").machines]
    modal = modal_tables.analyse(changed(shipped("two_area"), machines=machines), ["sssc"])
    assert [mode.label for mode in modal.swings] == ["electromechanical"] * 3


def test_common_governor_mode_is_not_a_swing() -> None:
    """A mode of 0.03 Hz in which all speeds are alike."""
    governors = [{**t.model_dump(), "enabled": True} for t in shipped("two_area").governors]
    modal = modal_tables.analyse(changed(shipped("two_area"), governors=governors), ["sssc"])
    assert [mode.label for mode in modal.swings] == ["interarea", "local", "local"]
    (together,) = [mode for mode in modal.modes if 0.01 < mode.frequency_hz < 0.1 and mode.damping_ratio < 0.9]
    assert together.label in ("common", "control")
    assert together.residues == []
    assert max(abs(together.shape[f"G{g}"] / together.shape["G1"] - 1) for g in (2, 3, 4)) < 0.1


@pytest.mark.parametrize("devices", [("sssc",), BOTH])
def test_residue_angles_at_the_interarea_mode(devices: tuple[str, ...]) -> None:
    """177 degrees from the SSSC to w13; to the tie power a quarter turn; 156 from the STATCOM to the speeds."""
    mode = interarea(linearised("two_area", devices))
    assert residue(mode, "sssc", "w13").angle_deg == pytest.approx(177, abs=10)
    assert abs(residue(mode, "sssc", "power").angle_deg) == pytest.approx(90, abs=10)
    if "statcom" in devices:
        assert residue(mode, "statcom", "speed").angle_deg == pytest.approx(156, abs=10)
        assert residue(mode, "statcom", "w13").angle_deg == pytest.approx(156, abs=10)


def eigenvalue(matrix: NDArray[np.float64], near: complex) -> complex:
    values = np.linalg.eigvals(matrix)
    return complex(values[np.argmin(np.abs(values - near))])


def jacobian(f: Callable[[NDArray[np.float64]], NDArray[np.float64]], at: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.array([(f(at + h) - f(at - h)) / 2e-5 for h in 1e-5 * np.eye(len(at))]).T)


CHANNELS_CLOSED = [(BOTH, device, signal) for device in BOTH for signal in ("w12", "w13", "speed", "power")]


@pytest.mark.parametrize(("devices", "device", "signal"), [(("sssc",), "sssc", "w13"), *CHANNELS_CLOSED])
def test_residue_is_the_eigenvalue_s_slope_by_a_gain_around_the_linear_model(
    devices: tuple[str, ...], device: str, signal: str
) -> None:
    """u = K y: d lambda / dK = R at K = 0, for each mode, and the feed-through u = K (1 - K D)^-1 C x."""
    modal = linearised("two_area", devices)
    A, B, C, D, *_ = modal.model
    row, column = list(modal.system.signals).index(signal), devices.index(device)
    for mode in modal.swings:
        r = value(residue(mode, device, signal)) / modal.model.gain(mode.eigenvalue)[row]
        K = 1e-4 / abs(r)
        ends = [
            eigenvalue(A + np.outer(B[:, column], C[row]) * k / (1 - k * D[row, column]), mode.eigenvalue)
            for k in (-K, K)
        ]
        assert (ends[1] - ends[0]) / (2 * K) == pytest.approx(r, rel=1e-4)


@pytest.mark.parametrize(("device", "signal"), [("sssc", "w13"), ("statcom", "speed"), ("sssc", "power")])
def test_residue_is_the_eigenvalue_s_slope_by_a_gain_around_the_plant(device: str, signal: str) -> None:
    """The same with the loop closed around the nonlinear derivatives and measured frames."""
    modal, built = linearised("two_area", BOTH), plant("two_area", installed=BOTH)
    column, work = BOTH.index(device), workspace(built.plant, built.state)
    rest = float(observed(modal.system, follow(built, [0.0]).frames, signal)[0])

    def closed(x: NDArray[np.float64], K: float) -> NDArray[np.float64]:
        reference, dx = np.zeros(2), np.zeros_like(x)
        for _ in range(4 if signal == "power" else 1):  # u = K y(x, u): a contraction by 5 K
            held = built._replace(state=built.state._replace(reference=reference.copy()))
            reference[column] = K * (observed(modal.system, follow(held, [0.0], x=x).frames, signal)[0] - rest)
        derivatives(built.plant, x, reference, copy(built.state).source, 0, dx, work)
        return dx

    mode = interarea(modal)
    row = list(modal.system.signals).index(signal)
    r = value(residue(mode, device, signal)) / modal.model.gain(mode.eigenvalue)[row]
    K = 1e-2 / abs(r)
    ends = [
        eigenvalue(jacobian(lambda x, k=k: closed(x, k), built.state.x), mode.eigenvalue)  # type: ignore[misc]
        for k in (-K, K)
    ]
    assert (ends[1] - ends[0]) / (2 * K) == pytest.approx(r, rel=5e-3)


def test_sign_and_lead_turn_every_residue_to_the_left() -> None:
    for name, devices in CASES:
        for mode in linearised(name, devices).swings:
            assert len(mode.residues) == len(devices) * len(shipped(name).signals)
            for r in mode.residues:
                assert abs(r.lead_deg) <= 90
                turned = value(r) * r.sign * np.exp(1j * np.deg2rad(r.lead_deg))
                assert turned == pytest.approx(-r.magnitude, rel=1e-9)


@pytest.mark.parametrize("signal", ["w13", "speed", "power"])
@pytest.mark.parametrize("device", BOTH)
def test_gain_with_the_lead_of_the_rule_damps_the_interarea_mode(device: str, signal: str) -> None:
    """u = sign K H(s) y with H(j omega) = exp(j lead), two lead-lag sections: the mode goes left by |R| K."""
    modal = linearised("two_area", BOTH)
    row, column = list(modal.system.signals).index(signal), BOTH.index(device)
    A, B, C, D = modal.model.A, modal.model.B[:, [column]], modal.model.C[[row]], modal.model.D[row, column]
    mode = interarea(modal)
    r = residue(mode, device, signal)
    omega, quarter = mode.eigenvalue.imag, np.deg2rad(r.lead_deg) / 4
    T1, T2 = (np.tan(np.pi / 4 + side * quarter) / omega for side in (1, -1))
    size = abs((1 + 1j * omega * T2) / (1 + 1j * omega * T1)) ** 2
    K = 2e-3 / r.magnitude
    numerator, denominator = (np.polymul([T, 1.0], [T, 1.0]) for T in (T1, T2))
    a, b, c, d = tf2ss(r.sign * K * size * numerator, denominator)
    u = np.block([d @ C, c]) / (1 - d * D)  # u = c z + d y, y = C x + D u
    y = np.block([C, np.zeros((1, 2))]) + D * u
    whole = np.block([[A, np.zeros((len(A), 2))], [np.zeros((2, len(A))), a]])
    whole += np.concatenate([B @ u, b @ y])
    moved = (eigenvalue(whole, mode.eigenvalue) - mode.eigenvalue) / (K * r.magnitude)
    assert moved.real == pytest.approx(-1, abs=0.1)
    assert abs(moved.imag) < 0.1


def test_feedthrough_is_that_of_the_series_voltage_to_the_tie_power() -> None:
    """About 5 p.u. per p.u.; speeds do not jump. As measured where the reference differs and no state does."""
    modal, built = linearised("two_area", BOTH), plant("two_area", installed=BOTH)
    D = {name: modal.model.D[i] for i, name in enumerate(modal.system.signals)}
    assert D["power"][0] == pytest.approx(5, abs=0.3)
    for name in ("w12", "w34", "w13", "speed"):
        assert (D[name] == 0).all()
    turning = [name for name, signal in modal.system.signals.items() if signal.channel == "frequency"]
    assert all(abs(row[1]) < 1e-9 for name, row in D.items() if name not in turning)  # a current does not jump
    for name in ("power", "voltage"):
        ends = []
        for u in (-1e-3, 1e-3):
            held = built._replace(state=built.state._replace(reference=np.array([u, 0.0])))
            ends.append(observed(modal.system, follow(held, [0.0]).frames, name)[0])
        assert (ends[1] - ends[0]) / 2e-3 == pytest.approx(D[name][0], rel=1e-4)
    listed = {(t.device, t.signal): t for t in transfer_functions(modal.model, list(modal.system.signals), BOTH)}
    assert listed["sssc", "power"].feedthrough == pytest.approx(D["power"][0])
    assert listed["statcom", "power"].feedthrough == 0


@settings(deadline=None, max_examples=40)
@given(hertz=st.floats(0.02, 8), sigma=st.floats(-0.5, 3), case=st.sampled_from(CASES))
def test_zeros_poles_and_gain_give_the_response(hertz: float, sigma: float, case: tuple[str, tuple[str, ...]]) -> None:
    """gain prod(s - z) / prod(s - p) = F (C (s I - A)^-1 B + D) anywhere in the band of interest, F the washouts."""
    modal = linearised(*case)
    poles = np.linalg.eigvals(modal.model.A)
    s = complex(sigma, 2 * np.pi * hertz)
    response = modal.model.response(s)
    plain = modal.model.C @ np.linalg.inv(s * np.eye(len(poles)) - modal.model.A) @ modal.model.B + modal.model.D
    times = np.array([signal.washout for signal in modal.system.signals.values()])
    washouts = np.array([s * T / (1 + s * T) if T else 1.0 for T in times])
    np.testing.assert_allclose(response, washouts[:, None] * plain)
    for t in factors(case):
        row, column = list(modal.system.signals).index(t.signal), case[1].index(t.device)
        product = t.gain * np.prod(s - np.array(t.zeros)) / np.prod(s - np.array(t.poles))
        assert product == pytest.approx(response[row, column], rel=1e-4)


@cache
def factors(case: tuple[str, tuple[str, ...]]) -> list[Any]:
    modal = linearised(*case)
    return transfer_functions(modal.model, list(modal.system.signals), case[1])


@pytest.mark.parametrize("device", [0, 1])
def test_sinusoidal_setpoint_gives_the_frequency_response(device: int) -> None:
    """0.75 Hz for 40 s at the single machine, with a STATCOM beside it.

    Setpoints are held, which makes the wave smaller and late by half a hold; what goes through at once is seen
    at the end of a hold.
    """
    statcom = {"name": "statcom", "kind": "statcom", "bus": "B3", "setpoint_max": 0.1, "rate_max": 10, "I_max": 5}
    system = shipped("smib")
    system = changed(system, devices=[*(d.model_dump(by_alias=True) for d in system.devices), statcom])
    modal = modal_tables.analyse(system, BOTH)
    hertz, hold, size = 0.75, 1 / 240, 1e-3
    at = np.arange(0, 40, hold)
    targets = [(t, size * np.sin(2 * np.pi * hertz * t), device) for t in at]
    trace = follow(plant(system, installed=BOTH), frame_times(40), targets)
    late = trace.t >= 40 - 9 / hertz - 1e-9
    late[-1] = False  # whole periods
    turn = np.exp(-2j * np.pi * hertz * trace.t[late])
    held, last = np.sinc(hertz * hold) * np.exp(-1j * np.pi * hertz * hold), np.exp(-2j * np.pi * hertz * hold)
    for row, signal in enumerate(system.signals):
        y = observed(system, trace.frames, signal)[late]
        wave = 2j * np.mean((y - y.mean()) * turn)
        at_once = modal.model.D[row, device]
        expected = (modal.model.response(2j * np.pi * hertz)[row, device] - at_once) * held + at_once * last
        # A derivative shows what the integrator's step does to the converter's fast modes.
        close = 5e-3 if system.signals[signal].channel == "frequency" else 1e-3
        assert wave / size == pytest.approx(expected, rel=close), signal


def test_modes_of_a_matrix_need_no_system() -> None:
    """Then nothing is said of kinds but control, and no residue is given."""
    modal = linearised("two_area", ("sssc",))
    plain = modes(modal.model.A, modal.built.state_names)
    assert {mode.label for mode in plain} == {"control"}
    assert [mode.eigenvalue for mode in plain] == [mode.eigenvalue for mode in modal.modes]
    assert all(mode.residues == [] for mode in plain)
