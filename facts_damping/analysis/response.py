"""The response of a run to its events, free of noise, by its twin; and the noise in it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import stats

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.modes.oscillation import BAND
from facts_damping.analysis.modes.ringdown import SKIP
from facts_damping.analysis.verdict import HANN, envelopes

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from facts_damping.record import Record

SHORTEST = 10.0  # s, of a response whose ringdown is fitted
WINDOW, FEWEST = 20.0, 3  # s, and number, of windows of noise whose variances are compared
PULSE_END = 1.5  # s, end of the pulse in the twin of a run without events
WITHOUT_EVENTS, OUTAGE, MIRROR, PULSED = "without events", "outage", "mirror", "pulsed"  # kinds of twins

PARTS = ("response", "noise", "pulse")  # of swings


class Twin(NamedTuple):
    """The twin of a run, and its kind (simulation/twins.py)."""

    record: Record
    kind: str
    quiet: Callable[[], tuple[Record, Record]] | None = None  # simulates run and mirror without events


class Swings(NamedTuple):
    """What is judged of a run: its speed differences, and where there is a twin their parts; (ticks, n), p.u.

    A twin may have fewer ticks than the run, and a response and a pulse have as many.
    """

    time_s: NDArray[np.float64]  # (ticks,)
    names: tuple[str, ...]  # of the differences
    own: NDArray[np.float64]
    times: list[float]  # s, of the events; empty without one
    ringing: int  # ticks until the response has faded
    response: NDArray[np.float64] | None = None  # to the events
    noise: NDArray[np.float64] | None = None  # what is not the response
    pulse: NDArray[np.float64] | None = None  # the response to the twin's pulse, of a run without events
    kind: str | None = None  # of the twin
    quiet: Callable[[], tuple[Record, Record]] | None = None  # simulates run and mirror without events

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
        """Performance indices of the response; None without one, or if the twin's own trip is in it."""
        response = self.response
        if response is None or self.kind == OUTAGE:
            return None
        return performance_indices(self.time_s[: len(response)], response)


def swings_of(
    record: Record, twin: Twin | None, differences: Mapping[str, NDArray[np.float64]] | None = None
) -> Swings:
    """The swings of a run; `differences`: those to judge, (ticks,) each, if not those of its configuration.

    With the swings w of the run and w' of its twin, the response is (w + w') / 2 with a mirror, w' - w to a pulse, else
    w - w'; noise is (w - w') / 2 or w'. Noise cancels in a response exactly where the loop is linear. There are no
    parts without a twin, or if it loses synchronism.
    """
    differences = speed_differences(record) if differences is None else differences
    whole, times = columns(differences), event_times(record)
    plain = Swings(record.time_s, tuple(differences), whole, times, len(whole))
    if twin is None or not twin.record.in_synchronism.all():
        return plain
    other = columns(speed_differences(twin.record))
    ticks = min(len(whole), len(other))
    swing, other = whole[:ticks], other[:ticks]
    if twin.kind == PULSED:
        return plain._replace(pulse=other - swing)
    response, noise = ((swing + other) / 2.0, (swing - other) / 2.0) if twin.kind == MIRROR else (swing - other, other)
    ringing = until_faded(record.time_s[:ticks], response, plain.last)
    return plain._replace(response=response, noise=noise, ringing=ringing, kind=twin.kind, quiet=twin.quiet)


def less_noise(swings: Swings) -> tuple[Swings, NDArray[np.float64]]:
    """Swings whose response is without what noise alone leaves in it, and that, (ticks, n), p.u.

    With a mirror, noise cancels in first order. What is left, half the sum of run and mirror without events, is
    subtracted; then an error in proportion to the event remains. Nothing changes if it loses synchronism.
    """
    pair = swings.quiet() if swings.quiet else ()
    response = swings.judged
    if not pair or not all(record.in_synchronism.all() for record in pair):
        return swings, np.zeros_like(response)
    first, second = (columns(speed_differences(record))[: len(response)] for record in pair)
    left = (first + second) / 2.0
    response = response - left
    ringing = until_faded(swings.time_s[: len(response)], response, swings.last)
    return swings._replace(response=response, ringing=ringing), left


def shortened(swings: Swings, end: float) -> Swings:
    """Swings up to a time (s)."""
    ticks = int(np.searchsorted(swings.time_s, end))
    part: Any = {name: None if (x := getattr(swings, name)) is None else x[:ticks] for name in PARTS}
    return swings._replace(
        time_s=swings.time_s[:ticks], own=swings.own[:ticks], ringing=min(ticks, swings.ringing), **part
    )


def noisy(configuration: Mapping[str, object]) -> bool:
    """Whether loads or PMUs of a run have noise."""
    measurement = configuration.get("measurement")
    rows = [measurement, *(measurement.get("pmus") or {}).values()] if isinstance(measurement, dict) else []
    return bool(configuration.get("load_noise")) or any(any((row.get("noise") or {}).values()) for row in rows)


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


def variance_ratio(
    time_s: NDArray[np.float64], signals: NDArray[np.float64], other: NDArray[np.float64]
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
        for x in (signals, other)
    )
    less = np.log((a.sum() - a) / (b.sum() - b))
    error = np.sqrt((count - 1) / count * np.square(less - less.mean()).sum())
    middle, half = np.log(a.sum() / b.sum()), stats.t.ppf(0.975, count - 1) * error
    low, value, high = np.exp([middle - half, middle, middle + half])
    return float(value), float(low), float(high)
