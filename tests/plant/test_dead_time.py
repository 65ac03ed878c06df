"""A converter's own dead time and response time: exact times, the lag's closed form, releases, the linear plant."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.parameters.plant.watchdog import Watchdog
from facts_damping.plant import build as plant_build
from facts_damping.plant import watchdog
from facts_damping.plant.build import build
from facts_damping.plant.integration import advance
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import to_ns
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_studies.margins.linear_closed_loop import DelayedLoop, Discrete, approximate, delayed_loop, sampled
from tests.plant.running import follow, plant, shipped, table, with_device
from tests.studies.test_linear_closed_loop import random_loop

MS = 1_000_000
DEAD = 0.010700003  # s
STEPS = [(0.0123, 0.05), (0.0173, -0.02), (0.0181, 0.01)]  # all under way at once
RATE = 5.0  # p.u./s, of the SSSC


@pytest.fixture(params=[False, True])
def is_large(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """The plant as it is, and as a large grid, of which arrivals before a dead time divide no steps."""
    if request.param:
        monkeypatch.setattr(plant_build, "LARGE", 0)
    return bool(request.param)


def test_setpoints_act_after_the_dead_time_to_the_nanosecond(is_large: bool) -> None:
    """What the device does is what it did without, later, also between frames and steps."""
    late, times = plant(with_device("sssc", dead_time=DEAD)), np.arange(0.0, 0.08, 0.0007)
    trace, prompt = (
        follow(late, times, STEPS),
        follow(plant(shipped("two_area")), times, [(t + DEAD, v) for t, v in STEPS]),
    )
    np.testing.assert_allclose(trace.reference, prompt.reference, rtol=0, atol=1e-15)
    tolerance = 1e-9 if is_large else 1e-13  # the arrivals divide steps, too
    np.testing.assert_allclose(trace.x, prompt.x, rtol=0, atol=tolerance)
    assert set(trace.devices["setpoint"][:, 0]) == {0.0, 0.05, -0.02, 0.01}


def test_dead_time_is_as_the_link_s_way_down() -> None:
    """A closed loop with 13 ms in the device, and one with 13 ms on the way to it: the same to the last bit."""
    sets = ["scenario=large", "duration=3", "watchdog=off"]
    in_device = loop.run(load_case(None, [*sets, "system.devices.0.dead_time=0.013"]))
    other = loop.run(load_case(None, [*sets, 'link={"down": [{"model": "constant", "delay": 0.013}]}']))
    assert np.ptp(in_device.devices["reference"]) > 0.05
    np.testing.assert_array_equal(in_device.machines, other.machines)
    np.testing.assert_array_equal(in_device.devices["reference"], other.devices["reference"])


@pytest.mark.usefixtures("is_large")
def test_flood_is_thinned_and_its_last_setpoint_acts_when_it_should() -> None:
    """A microsecond apart, fifty times as dense as there is room for: none acts early, the last one at its time."""
    values = np.linspace(1e-4, 0.05, 3000)
    sent = 0.001 + 1e-6 * np.arange(len(values))
    built = plant(with_device("sssc", dead_time=0.002, rate_max=1000.0))
    times = np.append(np.arange(0.0, 0.006, 5e-5), sent[-1] + 0.002 + 1e-8)
    times.sort()
    trace = follow(built, times, list(zip(sent.tolist(), values.tolist(), strict=True)))
    newest = np.searchsorted(sent, times - 0.002 + 1e-9, side="right")
    references = trace.devices["setpoint"][:, 0]
    assert (references <= np.append(0.0, values)[newest] + 1e-15).all()
    assert len(set(references)) > 10
    assert references[times > sent[-1] + 0.002].min() == values[-1]


@pytest.mark.parametrize("T", [0.0004, 0.02])
def test_response_is_that_of_a_first_order_lag_to_the_ramp(T: float) -> None:
    """Ramp, then rest: its convolution with exp(-t/T)/T; as exact with a lag of a fifth of the step."""
    built = plant(with_device("sssc", response_time=T))
    times = np.arange(0.0, 0.1, 0.0013)
    trace = follow(built, times, [(0.01, 0.05)])
    start, end = 0.01, 0.01 + 0.05 / RATE

    def ramp(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        return RATE * (t - T * (1.0 - np.exp(-t / T)))

    reference = trace.x[:, built.state_names.index("sssc.reference")]
    np.testing.assert_allclose(reference, ramp(times - start) - ramp(times - end), rtol=0, atol=2e-8)
    # The converter acts on that, not on the ramp: its voltage follows within its own few per cent of error.
    wanted = trace.devices["injected_voltage"][:, 0]
    np.testing.assert_allclose(wanted, reference, rtol=0, atol=5e-3)


@pytest.mark.parametrize("dead", [0.0, 0.06])
def test_release_waits_for_nothing_and_what_is_under_way_acts_no_more(dead: float) -> None:
    """Setpoints each 10 ms until 0.1 s, time-out 50 ms: to zero from 0.15 s on, whatever was under way."""
    settings = np.array([watchdog.settings(Watchdog(timeout=0.05, max_age=10.0, release_rate=0.2), 60)])
    built = build(with_device("sssc", dead_time=dead, response_time=0.01), ["sssc"], [], settings)
    state, work = copy(built.state), workspace(built.plant, built.state)
    setpoints = table([(0.01 * k, 0.01 * k) for k in range(1, 11)])
    setpoints["measured_ns"] = setpoints["issued_ns"] = setpoints["effective_ns"]
    advance(built.plant, state, 0, 150 * MS, setpoints, len(setpoints), work)
    before = state.reference[0]
    assert before == pytest.approx(0.1 if dead == 0.0 else 0.09, abs=0.011)
    nothing, last = setpoints[:0], before
    for k in range(60):
        advance(built.plant, state, (150 + 10 * k) * MS, (160 + 10 * k) * MS, nothing, 0, work)
        assert state.reference[0] == pytest.approx(max(0.0, before - 0.002 * (k + 1)), abs=1e-9)
        assert state.reference[0] <= last
        last = state.reference[0]
    watchdog.rearm(state.watch, 750 * MS)
    fresh = table([(0.75, 0.03), (0.79, 0.04)])
    fresh["measured_ns"] = fresh["issued_ns"] = fresh["effective_ns"]
    acts = 750 * MS + to_ns(dead)
    advance(built.plant, state, 750 * MS, acts, fresh, 2 if dead else 0, work)
    assert state.target[0] == 0.0
    advance(built.plant, state, acts, acts + 10 * MS, fresh, 0 if dead else 1, work)
    assert state.target[0] == 0.03


def test_modes_know_both() -> None:
    """A state with the eigenvalue -1/T, and residues times exp(-lambda Td) / (1 + lambda T)."""
    T, dead = 0.02, 0.015
    plain, late = (
        analyse(shipped("two_area"), ["sssc"]),
        analyse(with_device("sssc", response_time=T, dead_time=dead), ["sssc"]),
    )
    assert "sssc.reference" in late.built.state_names
    assert np.abs(np.linalg.eigvals(linearise(late.built)[0]) + 1.0 / T).min() < 1e-9
    for mode, other in zip(plain.swings, late.swings, strict=True):
        value = mode.eigenvalue
        assert abs(value - other.eigenvalue) < 1e-7
        by = np.exp(-value * dead) / (1.0 + value * T)
        for r, s in zip(mode.residues, other.residues, strict=True):
            if plain.system.signals[r.signal].channel == "frequency":
                continue  # an exact one leaves out the jump of an angle, which a lag makes a part of the swing
            assert s.magnitude == pytest.approx(r.magnitude * abs(by), rel=1e-5)
            turned = (s.angle_deg - r.angle_deg + 180.0) % 360.0 - 180.0
            assert np.rad2deg(np.angle(by)) == pytest.approx(turned, abs=1e-3)
    at = 4.0j
    ratio = late.model.response(at) / plain.model.response(at)
    rows = [i for i, signal in enumerate(plain.system.signals.values()) if signal.channel != "frequency"]
    np.testing.assert_allclose(ratio[rows], np.exp(-at * dead) / (1.0 + at * T), rtol=1e-5)


def test_linear_closed_loop_has_the_dead_time_as_delay() -> None:
    """50 ms in the device as 50 ms more on the link; the controllers know of both."""
    link = 'link={"up": [{"model": "constant", "delay": 0.03}]}'
    in_device = load_case(None, [link, "system.devices.0.dead_time=0.05", "system.devices.0.response_time=0.02"])
    other = load_case(None, [link, "system.devices.0.response_time=0.02"])
    np.testing.assert_array_equal(sampled(delayed_loop(in_device), 0.03), sampled(delayed_loop(other), 0.08))
    lqg = ["controllers=[{name: LQG, devices: [sssc], signals: [w13]}]", link, "system.devices.0.dead_time=0.05"]
    assert load_case(None, lqg).controllers[0].number("loop_delay") == pytest.approx(0.08)


def together(parts: DelayedLoop, dead: tuple[float, float]) -> DelayedLoop:
    """The two controllers of a loop as one of two devices with dead times."""
    first, second = parts.controllers
    zero = np.zeros((1, 1))
    merged = Discrete(
        np.block([[first.A, zero], [zero, second.A]]),
        np.block([[first.B, zero], [zero, second.B]]),
        np.block([[first.C, zero], [zero, second.C]]),
        np.block([[first.D, zero], [zero, second.D]]),
        [*first.signals, *second.signals],
        [*first.devices, *second.devices],
        0.0,
        dead,
    )
    return parts._replace(controllers=[merged])


@pytest.mark.parametrize("lag", [0.013, 0.07])
def test_devices_of_one_controller_have_their_own_dead_times(lag: float) -> None:
    """As two controllers of which one has the longer link (held against SciPy elsewhere): the same eigenvalues."""
    parts = random_loop(3, lag, 7)
    whole = together(parts, (0.0, lag))
    for matrices in (
        [sampled(x, 0.04) for x in (parts, whole)],
        [approximate(x, 0.04, 2, 0.01) for x in (parts, whole)],
    ):
        apart, of_one_controller = (np.linalg.eigvals(matrix) for matrix in matrices)
        for value in apart[np.abs(apart) > 1e-2]:
            assert np.abs(of_one_controller - value).min() < 1e-9
