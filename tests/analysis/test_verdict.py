"""Verdicts on signals whose truth is known, and on runs that were once called damped while they swung on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.special import stdtrit

from facts_damping.analysis.effort import saturation_duty
from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.modes.confidence import student_quantile
from facts_damping.analysis.summary import summarise
from facts_damping.analysis.verdict import DAMPED, GROWING, LIMIT_CYCLE, UNDECIDED, judge
from facts_damping.api import simulate
from facts_damping.case.loading import load_case
from facts_damping.simulation.loop import run
from facts_damping.simulation.twins import twin_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.record import Record

T = np.arange(1200) / 60
LONG = np.arange(2400) / 60
FEW = settings(max_examples=25)
FREQUENCY, PHASE = st.floats(0.4, 1.5), st.floats(0, 6.3)


def wave(
    sigma: float, frequency: float = 0.5, phase: float = -1.6, *, start: float = 1.0, t: NDArray[np.float64] = T
) -> NDArray[np.float64]:
    """A swing of 1e-3 p.u. that begins at `start`."""
    after = np.maximum(t - start, 0)
    return np.where(t < start, 0, 1e-3 * np.exp(sigma * after) * np.cos(2 * np.pi * frequency * after + phase))


@given(sigma=st.floats(0.01, 1), frequency=FREQUENCY, phase=PHASE, drift=st.floats(-0.1, 0.1))
@FEW
def test_decay_is_damped_growth_is_growing(sigma: float, frequency: float, phase: float, drift: float) -> None:
    line = 3 + drift * T
    for sign, verdict in ((-1, DAMPED), (1, GROWING)):
        judgement = judge(T, wave(sign * sigma, frequency, phase) + line, 1.0)
        assert judgement.verdict == verdict
        if sign == 1 or sigma < 0.15:
            assert judgement.growth
            assert judgement.growth.low <= sign * sigma <= judgement.growth.high


@pytest.mark.parametrize("rate", [0.11, 0.2])
def test_real_eigenvalue_that_grows_is_drift_and_a_swing_is_not(rate: float) -> None:
    drift = np.where(LONG < 1.0, 0.0, 1e-4 * (np.exp(rate * (LONG - 1.0)) - 1.0))
    judgement = judge(LONG, drift + wave(-0.4, t=LONG), 1.0)
    assert (judgement.verdict, judgement.because) == (GROWING, "it drifts: no swing grows")
    assert judge(LONG, wave(rate, t=LONG), 1.0).because == "it grows"


@given(frequency=FREQUENCY, phase=PHASE)
@FEW
def test_steady_wave_is_a_limit_cycle(frequency: float, phase: float) -> None:
    for x in (wave(0, frequency, phase), np.clip(3 * wave(0, frequency, phase), -1e-3, 1e-3)):
        judgement = judge(T, x, 1.0)
        assert judgement.verdict == LIMIT_CYCLE
        assert judgement.amplitude_pu == pytest.approx(1e-3, rel=0.35)  # a clipped one is nearly a square: 1.27


def test_intervals_hold_the_truth_in_noise_and_growth_is_never_damped() -> None:
    """1 % and 3 % of white noise; at least 95 % of the intervals, give or take what 300 draws leave open."""
    random = np.random.default_rng(5)
    held, widths = [], []
    for _ in range(300):
        sigma, frequency, phase = random.uniform(-0.1, 0.1), random.uniform(0.4, 1.5), random.uniform(0, 6.3)
        noise = random.choice([1e-5, 3e-5]) * random.standard_normal(len(T))
        judgement = judge(T, wave(sigma, frequency, phase) + noise, 1.0)
        assert judgement.growth
        assert not (sigma > 0.005 and judgement.verdict == DAMPED)
        held.append(judgement.growth.low <= sigma <= judgement.growth.high)
        widths.append(judgement.growth.high - judgement.growth.low)
    assert np.mean(held) > 0.95 - 1.64 * np.sqrt(0.95 * 0.05 / 300)
    assert np.median(widths) < 0.02  # narrow enough to say something: a damping ratio of 0.001 to each side


@given(sigma=st.sampled_from([-0.1, -0.05, 0.0, 0.05]), apart=st.sampled_from([0.06, 0.1, 0.3]), a=PHASE, b=PHASE)
@FEW
def test_beats_are_no_growth(sigma: float, apart: float, a: float, b: float) -> None:
    """Two modes whose envelope falls and rises by 19 to 1: their common growth counts."""
    judgement = judge(LONG, wave(sigma, 0.7, a, t=LONG) + 0.9 * wave(sigma, 0.7 + apart, b, t=LONG), 1.0)
    assert judgement.verdict == (DAMPED if sigma < 0 else GROWING if sigma > 0 else LIMIT_CYCLE)


def test_beats_that_are_slower_than_the_record_are_never_told_wrongly() -> None:
    """Half a beat looks like growth, the other half like decay: then nothing is said, or what is right."""
    random = np.random.default_rng(2)
    for sigma, right in ((-0.05, DAMPED), (0.0, LIMIT_CYCLE), (0.05, GROWING)):
        for _ in range(15):
            a, b = random.uniform(0, 6.3, 2)
            x = wave(sigma, 0.7, a) + 0.4 * wave(sigma, 0.73, b)
            assert judge(T, x + 1e-6 * random.standard_normal(len(T)), 1.0).verdict in (right, UNDECIDED)


def test_mode_that_changes_with_its_amplitude_does_not_grow() -> None:
    """A delay near the margin: the swing decays, faster when small; as two waves one of them would grow."""
    record = simulate(scenario="multiple", duration=40, link={"up": [{"stage": "network", "delay": 0.159}]})
    w13 = speed_differences(record)["w13"]
    assert np.ptp(w13[record.time_s > 35]) < 0.85 * np.ptp(w13[(record.time_s > 11) & (record.time_s < 16)])
    assert summarise(record).verdict in (DAMPED, UNDECIDED)


@given(decay=st.sampled_from([0.2, 0.5]), frequency=st.floats(0.5, 0.8), a=PHASE, b=PHASE)
@FEW
def test_verdict_is_of_the_slow_mode_behind_a_fast_decay(decay: float, frequency: float, a: float, b: float) -> None:
    fast = wave(-decay, frequency, a)
    for sigma, verdict in ((0.03, GROWING), (0.0, LIMIT_CYCLE), (-0.03, DAMPED)):
        assert judge(T, fast + 0.2 * wave(sigma, 1.1, b), 1.0).verdict == verdict
    assert judge(T, fast + 0.01 * wave(0.01, 1.1, b), 1.0).verdict == DAMPED  # below 5 % of the largest: too small


def test_swing_that_decays_to_chatter_is_not_damped() -> None:
    """Chatter: a wave of 10 to 20 % of the first swing, whose amplitude wanders by a tenth and whose phase wanders."""
    judgements = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        lag = np.exp(-1 / 60)  # of a second
        wander = lfilter([np.sqrt(1 - lag**2)], [1, -lag], random.standard_normal((2, len(LONG))), axis=1)
        size = random.uniform(1e-4, 2e-4) * (1 + 0.1 * wander[0])
        chatter = size * np.sin(2 * np.pi * 0.6 * LONG + 0.2 * wander[1] + random.uniform(0, 6.3))
        judgements.append(judge(LONG, wave(-random.uniform(0.3, 1), 0.6, t=LONG) + chatter, 1.0))
        assert judgements[-1].amplitude_pu == pytest.approx(np.median(size), rel=0.2)
    verdicts = [judgement.verdict for judgement in judgements]
    assert verdicts.count(LIMIT_CYCLE) >= 45
    assert verdicts.count(DAMPED) <= 3  # an interval of 95 % lies wholly below zero now and then


@pytest.mark.parametrize("frequency", [0.45, 0.6, 1.1])
def test_growth_that_ends_at_a_limit_is_a_limit_cycle(frequency: float) -> None:
    grown = 1e-4 * np.exp(np.minimum(0.1 * np.maximum(LONG - 1, 0), 2.0))
    x = grown * np.sin(2 * np.pi * frequency * LONG) * (LONG > 1)
    assert judge(LONG, x, 1.0).verdict == LIMIT_CYCLE
    assert judge(LONG[LONG < 18], x[LONG < 18], 1.0).verdict == GROWING  # not there yet
    assert judge(LONG, x, 1.0).amplitude_pu == pytest.approx(1e-4 * np.exp(2), rel=0.05)


def test_worst_signal_decides() -> None:
    judgement = judge(T, np.column_stack([wave(-0.3), 0.2 * wave(0.05)]), 1.0, ["w12", "w13"])
    assert (judgement.verdict, judgement.growth and judgement.growth.signal) == (GROWING, "w13")
    assert judge(T, np.column_stack([wave(-0.3), 1e-3 * wave(0.05)]), 1.0).verdict == DAMPED  # too small to matter
    assert judge(T, np.column_stack([wave(0.0), wave(-0.1)]), 1.0).verdict == LIMIT_CYCLE


def test_still_signal_is_damped_and_noisy_or_short_ones_are_undecided() -> None:
    random = np.random.default_rng(1)
    still = judge(T, np.full(1200, 0.3), 1.0)
    assert (still.verdict, still.growth) == (DAMPED, None)
    assert judge(T[:1], wave(-0.5)[:1]).verdict == DAMPED
    assert judge(T, 1e-10 * random.standard_normal(1200), 1.0).verdict == DAMPED  # rounding
    for seed in range(20):  # white noise and a walk neither decay, nor grow, nor do they oscillate
        noise = np.random.default_rng(seed).standard_normal(1200)
        assert judge(T, 1e-4 * noise, 1.0).verdict == UNDECIDED
    late = judge(T, wave(-0.05, start=17.0), 17.0)  # 3 s after the last event
    assert late.verdict == UNDECIDED
    assert late.because == "too short: 2.0 s of oscillation, from 18.0 to 20.0 s; 8 s are needed"
    noisy = wave(-0.05) + 3e-5 * random.standard_normal(1200)  # from 1 s on; no sum of waves
    for end, said in (
        (8.1, "too short: 7.0 s of oscillation, from 1.0 to 8.0 s; 8 s are needed"),
        (9.1, "it may grow"),
    ):
        assert judge(T[end > T], noisy[end > T]).because.startswith(said)
    assert judge(T, np.where(T < 5, wave(-0.1), np.nan), 1.0).verdict == UNDECIDED


def test_of_a_summary(swing_record: Callable[..., Record]) -> None:
    summary: Any = summarise(swing_record(damping=0.0))
    assert (summary.verdict, summary.damped) == (LIMIT_CYCLE, False)
    assert summary.limit_cycle.amplitude_pu == pytest.approx(2e-3, rel=0.05)
    assert set(summary.limit_cycle.saturation_duty) == {"sssc"}
    grows: Any = summarise(swing_record(damping=-0.1))
    assert (grows.verdict, grows.limit_cycle) == (GROWING, None)
    assert grows.growth_per_s.low <= 0.1 <= grows.growth_per_s.high
    assert grows.growth_per_s.signal == "w12"
    early = summarise(swing_record(600, configuration={**swing_record().configuration, "duration": 20}))
    assert (early.verdict, early.damped) == (UNDECIDED, False)


# Fault in the middle of line 1, cleared by its opening; tie power 404 MW.
TRIP = [
    {"time": 1.0, "kind": "fault", "line": "line_1", "location": 0.5},
    {"time": 1.1, "kind": "clear", "line": "line_1"},
    {"time": 1.1, "kind": "line_out", "line": "line_1"},
]


def tripped(duration: float, **controller: Any) -> Record:
    """The run with a controller."""
    return simulate(scenario=TRIP, duration=duration, controllers=[controller])


def test_swing_grows_whose_first_one_is_larger_than_what_follows() -> None:
    record = tripped(60, name="LLC", parameters={"gain": 0.8})
    assert record.frames[0, record.pmus.index("TIE"), 3] == pytest.approx(4.04, abs=0.01)
    t, signals, last = record.time_s, columns(speed_differences(record)), event_times(record)[-1]
    page = (Path(__file__).parents[2] / "docs" / "measures.md").read_text(encoding="utf-8")
    for horizon in (20, 40, 60):
        inside = t < horizon
        judgement = judge(t[inside], signals[inside], last, list(speed_differences(record)))
        assert judgement.verdict == GROWING
        assert judgement.growth
        assert 0.0 < judgement.growth.low < judgement.growth.high < 0.03
        interval_text = f"{judgement.growth.value:.4f} ({judgement.growth.low:.4f} to {judgement.growth.high:.4f})"
        assert interval_text in " ".join(page.split())
    w12, w13 = (speed_differences(record)[name] for name in ("w12", "w13"))
    assert np.ptp(w12[(t > 1) & (t < 3)]) > 1.2 * np.ptp(w12[(t > 3) & (t < 25)])
    assert np.ptp(w13[(t > 35) & (t < 40)]) > 1.3 * np.ptp(w13[(t > 7) & (t < 12)])  # it does grow


def test_tuned_lead_lag_far_from_its_training_is_a_limit_cycle() -> None:
    less: dict[str, Any] = {"system.machines.0.P": 500}
    record = simulate(scenario=TRIP, duration=40, controllers=[{"name": "LLC-tuned"}], **less)
    summary: Any = summarise(record)
    assert summary.verdict == LIMIT_CYCLE
    assert summary.limit_cycle.amplitude_pu > 5e-4
    assert summarise(tripped(40, name="LLC-tuned")).verdict == DAMPED


@FEW
@given(st.floats(0.9, 1000.0), st.floats(0.5, 0.99))
def test_quantile_of_student_s_t_is_scipy_s(free: float, probability: float) -> None:
    assert student_quantile(free, probability) == pytest.approx(stdtrit(free, probability), rel=1e-8, abs=1e-12)


def test_loop_bounded_by_its_devices_current_is_no_sound_one() -> None:
    """The limit of a STATCOM's current bounds the swing before its setpoint is at a limit; a mirror cancels it."""
    law = "{name: LLC, signals: [frequency], devices: [statcom], parameters: {gain: -40}}"
    sets = ["duration=30", "supervision=null", "arm_at=null", "devices=[statcom]", f"controllers=[{law}]"]
    link = "link={up: [{model: constant, delay: 0.05}], down: []}"
    step = "scenario=[{time: 2.0, kind: load_step, load: load_1, change: 0.02}]"
    record = run(load_case("two_area_deployment", [*sets, link, step, "system.devices.1.I_max=0.3"]))
    assert saturation_duty(record) == {"statcom": 0.0}
    assert summarise(record, method=None, twin=twin_of(record)).verdict == LIMIT_CYCLE
