"""Verdict of a run with noise: of its response to the events, or of its modes in noise alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import BAND
from facts_damping.analysis.modes.ringdown import COVERED, SKIP
from facts_damping.analysis.verdict import DAMPED, GROWING, HANN, LIMIT_CYCLE, UNDECIDED, Judgement, envelopes, judge

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.modes.ringdown import Fit
    from facts_damping.signals import Record

RESPONSE, RUN, AMBIENT = "response", "run", "ambient noise"  # what a verdict is of
CLEAR_DB = 10.0  # signal-to-residual ratio of a ringdown of a response that may decide
LIMITED, LAST = 0.1, 10.0  # fraction of the last seconds with a setpoint at its limit; above, a loop is at its limits
SHORTEST = 10.0  # s, of a response whose ringdown is fitted
STEADY = 0.005  # damping ratio; a mode in noise whose interval ends below it is a steady oscillation
AT_LIMITS = "setpoints are at their limits to the end"
LOST_TWIN = "the twin of the run loses synchronism"


class Judged(NamedTuple):
    """A verdict, and what it is of: RESPONSE, RUN or AMBIENT."""

    judgement: Judgement
    of: str


def noisy(configuration: Mapping[str, object]) -> bool:
    """Whether loads or PMUs of a run have noise."""
    measurement = configuration.get("measurement")
    rows = [measurement, *(measurement.get("pmus") or {}).values()] if isinstance(measurement, dict) else []
    return bool(configuration.get("load_noise")) or any(any((row.get("noise") or {}).values()) for row in rows)


class Twin(NamedTuple):
    """The twin of a run (simulation/twins.py): the same noise without events, or the same events and opposite noise."""

    record: Record
    mirror: bool


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


def judge_response(
    time_s: NDArray[np.float64],
    signals: NDArray[np.float64] | None,
    own: NDArray[np.float64],
    since: float,
    names: Sequence[str],
    ringdown: Callable[[], Fit | None],
    *,
    limited: bool,
) -> Judged:
    """Judge a run with the signals `own` by its response (ticks, n); None: its twin has lost synchronism.

    `ringdown`: gives that of the response; `limited`: setpoints are at their limits to the end. A loop at its limits,
    or one that grows, is not the image of its mirror: then the run itself counts, where it grows or does not decay.
    """
    ticks = len(own if signals is None else signals)
    t, own = time_s[:ticks], own[:ticks]
    found = None if signals is None else judge(t, signals, since, names, ringdown)
    if found is None or limited or found.verdict == UNDECIDED:
        itself = judge(t, own, since, names)
        if itself.verdict in (GROWING, LIMIT_CYCLE) and (limited or found is None or not _decays(ringdown())):
            return Judged(itself, RUN)
    if found is None or signals is None or limited:
        return Judged(itself._replace(verdict=UNDECIDED, because=AT_LIMITS if limited else LOST_TWIN), RUN)
    if found.verdict == UNDECIDED and _decays(ringdown()):
        found = found._replace(verdict=DAMPED, because="the modes of its response are damped")
    return Judged(found, RESPONSE)


def _decays(fit: Fit | None) -> bool:
    """Whether a ringdown is clear, and the damping ratios of all its modes are above zero with their intervals."""
    if fit is None or not fit.modes or fit.snr_db < CLEAR_DB:
        return False
    return all(mode.damping_ratio > COVERED * np.nan_to_num(mode.damping_ratio_error, nan=np.inf) for mode in fit.modes)


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
