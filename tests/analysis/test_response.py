"""Verdicts under noise: of the response, half the sum of a run and its mirror; and of modes in noise alone."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.signal import lfilter

from facts_damping.analysis.judging import AMBIENT, LOST_TWIN, PULSE, RESPONSE, RUN, judge_ambient
from facts_damping.analysis.modes.ambient import fit_ambient
from facts_damping.analysis.response import MIRROR, WITHOUT_EVENTS, Swings, Twin, variance_ratio
from facts_damping.analysis.summary import Summary, summarise
from facts_damping.record import GridEvent
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record

T = np.arange(0.0, 40.0, 1 / 60)
EVENT = [GridEvent(NANOSECONDS, "fault", "B7")]


def swing(sigma: float, hertz: float = 0.5, size: float = 2e-3) -> np.ndarray[Any, Any]:
    """A wave that begins with the event."""
    after = np.maximum(T - 1.0, 0.0)
    return np.where(T > 1.0, size * np.exp(sigma * after) * np.cos(2 * np.pi * hertz * after), 0.0)


def noise(seed: int, size: float = 4e-4) -> np.ndarray[Any, Any]:
    """A lightly damped mode in noise, as of a plant that never comes to rest."""
    random, swinging = np.random.default_rng(seed), np.zeros(len(T))
    turn = np.exp((-0.12 + 2j * np.pi * 0.5) / 60)
    z = 0.0 + 0.0j
    for k in range(len(T)):
        z = turn * z + random.standard_normal()
        swinging[k] = z.real
    return np.asarray(size * swinging / swinging.std())


@pytest.fixture
def pair(swing_record: Callable[..., Record]) -> Callable[..., tuple[Record, Twin]]:
    """A run and its twin: a response, and noise, as a speed difference."""

    def make(
        response: np.ndarray[Any, Any],
        disturbance: np.ndarray[Any, Any],
        *,
        mirror: bool = False,
        left: np.ndarray[Any, Any] | float = 0.0,  # by the noise in both
    ) -> tuple[Record, Twin]:
        records = []
        for event, sign in ((1.0, 1.0), (1.0, -1.0) if mirror else (0.0, 1.0)):
            record = swing_record(ticks=len(T), events=EVENT)
            record.configuration["load_noise"] = {"std": 0.01}
            moved = event * response + sign * disturbance + left
            record.frames[:, :2, 2] = np.column_stack([moved, 0.0 * T])
            record.machines["speed_deviation"] = record.frames[:, :2, 2]
            records.append(record)
        return records[0], Twin(records[1], MIRROR if mirror else WITHOUT_EVENTS)

    return make


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    ("sigma", "verdict"), [(-0.15, "damped"), (-0.3, "damped"), (0.04, "growing"), (0.0, "limit cycle")]
)
def test_verdict_is_that_of_the_response_whatever_the_noise(
    pair: Any, seed: int, sigma: float, verdict: str, mirror: bool
) -> None:
    record, twin = pair(swing(sigma), noise(seed), mirror=mirror)
    summary = summarise(record, twin=twin)
    assert (summary.verdict, summary.verdict_of) == (verdict, RESPONSE)
    if verdict != "limit cycle":
        assert summary.modes[0].damping_ratio == pytest.approx(-sigma / np.hypot(sigma, np.pi), abs=1e-4)


def test_indices_are_those_of_the_run_itself(pair: Any) -> None:
    record, twin = pair(swing(-0.2), noise(1))
    assert summarise(record, twin=twin).indices == summarise(record).indices


def test_verdict_without_a_mirror_says_that_noise_is_in_it(pair: Any) -> None:
    summary = summarise(pair(swing(-0.2), noise(1))[0])
    assert summary.verdict_of == RUN
    assert str(summary.verdict_because).endswith("; noise is in it")


def test_mirror_that_loses_synchronism_leaves_the_verdict_to_the_run(pair: Any) -> None:
    record, twin = pair(swing(0.08), noise(2, 1e-5))
    twin.record.in_synchronism[-1] = False
    assert summarise(record, twin=twin).verdict == "growing"
    calm, twin = pair(swing(-0.2), noise(2, 1e-5))
    twin.record.in_synchronism[-1] = False
    summary = summarise(calm, twin=twin)
    assert (summary.verdict, summary.verdict_because) == ("undecided", LOST_TWIN)


@pytest.mark.parametrize(("left", "verdict"), [(1e-5, "growing"), (5e-3, "undecided")])
def test_response_that_grows_counts_if_noise_alone_leaves_far_less(pair: Any, left: float, verdict: str) -> None:
    """What noise leaves in a mirror is in the run with the event as in that without."""
    record, twin = pair(swing(0.04), noise(6), mirror=True, left=noise(5, left))
    quiet, mirror = pair(0.0 * T, noise(6), mirror=True, left=noise(5, left))
    summary = summarise(record, twin=twin._replace(quiet=lambda: (quiet, mirror.record)))
    assert (summary.verdict, summary.verdict_of) == (verdict, RESPONSE)
    assert ("small beside the noise" in str(summary.verdict_because)) == (verdict == "undecided")


def test_mirror_that_is_shorter_is_compared_as_far_as_it_goes(pair: Any) -> None:
    record, twin = pair(swing(-0.2), noise(3))
    names = ("time_ns", "frames", "measured_ns", "status", "machines", "devices", "in_synchronism")
    short = replace(twin.record, **{name: getattr(twin.record, name)[:1500] for name in names})
    assert summarise(record, twin=Twin(short, WITHOUT_EVENTS)).verdict == "damped"


def judged(record: Record, twin: Twin) -> Summary:
    return summarise(record, twin=twin)


def ambient(signals: np.ndarray[Any, Any], pulse: np.ndarray[Any, Any] | None = None) -> Swings:
    t = np.arange(len(signals)) / 60
    return Swings(t, ("w12",), signals[:, np.newaxis], [], len(t), pulse=pulse)


def test_noise_alone_is_judged_by_its_modes_or_by_a_pulse() -> None:
    t = np.arange(len(T) * 4) / 60
    signals = np.concatenate([noise(k) for k in range(4)])
    swings = ambient(signals)
    judged_noise = judge_ambient(fit_ambient(t, swings.own), swings)
    assert (judged_noise.judgement.verdict, judged_noise.of) == ("damped", AMBIENT)
    assert judge_ambient(None, swings).judgement.verdict == "undecided"
    steady = ambient(1e-3 * np.sin(2 * np.pi * 0.5 * t) + 1e-6 * signals)
    assert judge_ambient(fit_ambient(t, steady.own), steady).judgement.verdict == "limit cycle"
    for sigma, verdict in ((-0.1, "damped"), (0.1, "growing")):
        judged_pulse = judge_ambient(None, ambient(signals[: len(T)], swing(sigma)[:, np.newaxis]))
        assert (judged_pulse.judgement.verdict, judged_pulse.of) == (verdict, PULSE)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_noise_that_grows_late_is_growth(pair: Any, seed: int, mirror: bool) -> None:
    """The response has decayed before the loop changes; what grows then is noise."""
    late = noise(seed, 1e-4) * np.exp(0.25 * np.maximum(T - 22.0, 0.0))
    summary = judged(*pair(swing(-0.5), late, mirror=mirror))
    assert (summary.verdict, summary.verdict_of) == ("growing", RUN)
    assert judged(*pair(swing(-0.5), noise(seed, 1e-4), mirror=mirror)).verdict == "damped"


def test_interval_of_a_ratio_of_variances_holds_the_ratio() -> None:
    """Two resonances of different damping in the same noise: the ratio of many seeds is in nine of ten intervals."""
    dt, ticks, waves = 0.05, 2400, np.random.default_rng(7).standard_normal((150, 2400, 1))

    def resonance(damping: float) -> Any:
        pole = np.exp((-damping + 2j * np.pi * 0.6) * dt)
        return np.array([lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], wave, axis=0) for wave in waves])

    t: Any = dt * np.arange(ticks)
    strong, weak = resonance(0.5), resonance(0.1)
    truth = np.square(strong).sum() / np.square(weak).sum()
    ratios: Any = [variance_ratio(t, a, b) for a, b in zip(strong, weak, strict=True)]
    assert np.mean([low <= truth <= high for _, low, high in ratios]) > 0.85
    assert variance_ratio(t[:1000], strong[0, :1000], weak[0, :1000]) is None
