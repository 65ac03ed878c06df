"""Verdict of a run with noise: of its response to the events, or of its modes in noise alone."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats

from facts_damping.analysis.effort import saturation_duty
from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.modes.ambient import fit_ambient
from facts_damping.analysis.modes.oscillation import BAND
from facts_damping.analysis.modes.ringdown import COVERED, SKIP, fit_ringdown
from facts_damping.analysis.verdict import DAMPED, GROWING, HANN, LIMIT_CYCLE, UNDECIDED, Judgement, envelopes, judge

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from facts_damping.analysis.modes.ringdown import Fit
    from facts_damping.signals import Record

RESPONSE, RUN, AMBIENT = "response", "run", "ambient noise"  # what a verdict is of
CLEAR_DB = 10.0  # signal-to-residual ratio of a ringdown of a response that may decide
LIMITED, LAST = 0.1, 10.0  # fraction of the last seconds with a setpoint at its limit; above, a loop is at its limits
WINDOW, FEWEST = 20.0, 3  # s, and number, of windows of noise whose variances are compared
SHORTEST = 10.0  # s, of a response whose ringdown is fitted
STEADY = 0.005  # damping ratio; a mode in noise whose interval ends below it is a steady oscillation
AT_LIMITS = "setpoints are at their limits to the end"
LOST_TWIN = "the twin of the run loses synchronism"


class Judged(NamedTuple):
    """A verdict, and what it is of: RESPONSE, RUN or AMBIENT."""

    judgement: Judgement
    of: str


class Twin(NamedTuple):
    """The twin of a run (simulation/twins.py): the same noise without events, or the same events and opposite noise."""

    record: Record
    mirror: bool


class Swings(NamedTuple):
    """What is judged of a run: its speed differences, and their response to the events where there is a twin."""

    time_s: NDArray[np.float64]  # (ticks,)
    names: tuple[str, ...]  # of the differences
    own: NDArray[np.float64]  # (ticks, n), p.u.
    response: NDArray[np.float64] | None  # (ticks, n), p.u.; the twin may have fewer ticks
    times: list[float]  # s, of the events; empty without one
    ringing: int  # ticks until the response has faded

    @property
    def last(self) -> float:
        """Time of the last event, s."""
        return self.times[-1] if self.times else 0.0

    @property
    def judged(self) -> NDArray[np.float64]:
        """The response, else the speed differences, (ticks, n)."""
        return self.own if self.response is None else self.response

    @property
    def indices(self) -> dict[str, float] | None:
        """Performance indices of the response; None without one."""
        found = self.response
        return None if found is None else performance_indices(self.time_s[: len(found)], found)


def swings_of(
    record: Record, twin: Twin | None, differences: Mapping[str, NDArray[np.float64]] | None = None
) -> Swings:
    """The swings of a run; `differences`: those to judge, (ticks,) each, if not those of its configuration."""
    differences = speed_differences(record) if differences is None else differences
    own, times = columns(differences), event_times(record)
    found = response(twin, own)
    ticks = len(own) if found is None else until_faded(record.time_s[: len(found)], found, (times or [0.0])[-1])
    return Swings(record.time_s, tuple(differences), own, found, times, ticks)


def shortened(swings: Swings, end: float) -> Swings:
    """Swings up to a time (s)."""
    ticks = int(np.searchsorted(swings.time_s, end))
    part = None if swings.response is None else swings.response[:ticks]
    return swings._replace(
        time_s=swings.time_s[:ticks], own=swings.own[:ticks], response=part, ringing=min(ticks, swings.ringing)
    )


def judge_run(
    record: Record,
    twin: Twin | None,
    swings: Swings,
    ringdown: Callable[[], Fit | None] | None = None,
    noise: Callable[[], Fit | None] | None = None,
) -> Judged:
    """Judge a run in synchronism: by its modes in the noise without event, by its response with a twin, else itself.

    `ringdown`, `noise`: give fits that were made already, of what is judged and of the run.
    """
    t, last = swings.time_s, swings.last
    ringdown = ringdown or cache(lambda: fit_ringdown(t[: swings.ringing], swings.judged[: swings.ringing], last))
    if not swings.times and record.configuration.get("load_noise"):
        return judge_ambient(noise() if noise else fit_ambient(t, swings.own), swings.own)
    if twin is not None and swings.times:
        duty = saturation_duty(record, max(last, t[-1] - LAST), t[-1])
        return judge_response(swings, ringdown, limited=max(duty.values(), default=0.0) > LIMITED)
    itself = judge(t, swings.own, last, swings.names, ringdown)
    words = "; noise is in it" if noisy(record.configuration) else ""
    return Judged(itself._replace(because=f"{itself.because}{words}"), RUN)


def noisy(configuration: Mapping[str, object]) -> bool:
    """Whether loads or PMUs of a run have noise."""
    measurement = configuration.get("measurement")
    rows = [measurement, *(measurement.get("pmus") or {}).values()] if isinstance(measurement, dict) else []
    return bool(configuration.get("load_noise")) or any(any((row.get("noise") or {}).values()) for row in rows)


def response(twin: Twin | None, signals: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The response of a run with the signals (ticks, n) to its events, by its twin.

    Half the sum of a run and its mirror, else the difference of a run and its twin. Noise cancels in it exactly where
    the loop is linear. None without a twin, or if it loses synchronism.
    """
    if twin is None or not twin.record.in_synchronism.all():
        return None
    other = columns(speed_differences(twin.record))
    ticks = min(len(signals), len(other))
    own, other = signals[:ticks], other[:ticks]
    return np.asarray((own + other) / 2.0 if twin.mirror else own - other)


def until_faded(time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float) -> int:
    """Ticks of a response (ticks, n) until it has faded to 5 % of its largest amplitude after `since` (s).

    What follows is the noise that is left; it only disturbs a ringdown.
    """
    begin = int(np.searchsorted(time_s, since + SKIP))
    if begin + 2 > len(signals) or not np.isfinite(signals).all():
        return len(signals)
    dt = float(np.median(np.diff(time_s)))
    points, sizes = envelopes(signals[begin:], dt)
    if not len(points):
        return len(signals)
    largest = sizes.max(axis=1)
    last = int(np.flatnonzero(largest >= BAND * largest.max())[-1])
    end = since + SKIP + max(float(points[last]) + HANN / 2, SHORTEST)
    return min(len(signals), int(np.searchsorted(time_s, end)))


def judge_response(swings: Swings, ringdown: Callable[[], Fit | None], *, limited: bool) -> Judged:
    """Judge a run by its response; without one, its twin has lost synchronism.

    `ringdown`: gives that of the response; `limited`: setpoints are at their limits to the end. A loop at its limits,
    or one that grows, is not the image of its mirror: then the run itself counts, where it grows or does not decay.
    """
    ticks = len(swings.judged)
    t, own = swings.time_s[:ticks], swings.own[:ticks]
    found = None if swings.response is None else judge(t, swings.response, swings.last, swings.names, ringdown)
    if found is None or limited or found.verdict == UNDECIDED:
        itself = judge(t, own, swings.last, swings.names)
        if itself.verdict in (GROWING, LIMIT_CYCLE) and (limited or found is None or not _decays(ringdown())):
            return Judged(itself, RUN)
    if found is None or limited:
        return Judged(itself._replace(verdict=UNDECIDED, because=AT_LIMITS if limited else LOST_TWIN), RUN)
    if found.verdict == UNDECIDED and _decays(ringdown()):
        found = found._replace(verdict=DAMPED, because="the modes of its response are damped")
    return Judged(found, RESPONSE)


def _decays(fit: Fit | None) -> bool:
    """Whether a ringdown is clear, and the damping ratios of all its modes are above zero with their intervals."""
    if fit is None or not fit.modes or fit.snr_db < CLEAR_DB:
        return False
    return all(mode.damping_ratio > COVERED * np.nan_to_num(mode.damping_ratio_error, nan=np.inf) for mode in fit.modes)


def variance_ratio(
    time_s: NDArray[np.float64], own: NDArray[np.float64], other: NDArray[np.float64]
) -> tuple[float, float, float] | None:
    """Variance of signals (ticks, n) in noise relative to others in the same noise, with its interval.

    The interval is from the jackknife over windows of 20 s, with Student's t for 95 %; as the windows are not
    independent, it held the ratio of many seeds in 90 % of runs of 60 to 300 s. None for less than a minute.
    """
    dt = float(np.median(np.diff(time_s)))
    count = int(len(time_s) * dt / WINDOW + 1e-6)
    if count < FEWEST:
        return None
    each = len(time_s) // count
    a, b = (
        np.square(x[: count * each] - x[: count * each].mean(axis=0)).reshape(count, -1).sum(axis=1)
        for x in (own, other)
    )
    less = np.log((a.sum() - a) / (b.sum() - b))
    error = np.sqrt((count - 1) / count * np.square(less - less.mean()).sum())
    middle, half = np.log(a.sum() / b.sum()), stats.t.ppf(0.975, count - 1) * error
    low, value, high = np.exp([middle - half, middle, middle + half])
    return float(value), float(low), float(high)


def judge_ambient(fit: Fit | None, signals: NDArray[np.float64]) -> Judged:
    """Judge a run with noise and no event by its modes and their 95 % intervals."""
    if fit is None or not fit.modes:
        return _ambient(UNDECIDED, "no event, and no mode found in the noise", signals)
    halves = [COVERED * np.nan_to_num(mode.damping_ratio_error, nan=np.inf) for mode in fit.modes]
    ends = [
        (mode.damping_ratio - half, mode.damping_ratio + half) for mode, half in zip(fit.modes, halves, strict=True)
    ]
    if min(high for _, high in ends) < STEADY:
        return _ambient(LIMIT_CYCLE, "a mode neither grows nor decays in the noise", signals)
    if min(low for low, _ in ends) > 0.0:
        return _ambient(DAMPED, "no event: its modes in the noise are damped", signals)
    return _ambient(UNDECIDED, "no event: the interval of a mode's damping ratio in the noise holds zero", signals)


def _ambient(verdict: str, because: str, signals: NDArray[np.float64]) -> Judged:
    amplitude = float(np.sqrt(2.0) * signals.std(axis=0).max())
    return Judged(Judgement(verdict, because, None, 0.0, amplitude), AMBIENT)
