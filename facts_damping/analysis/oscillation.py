"""Whether a run stays in synchronism, whether its oscillation dies, and when it has died."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.signals import Record

WINDOW = 5.0  # s, over which an envelope is taken
BAND = 0.05  # of the largest deviation: within it a signal has settled, below it one does not matter
HOLD = 2.0  # s, so long a signal must stay in the band: half a period at 0.25 Hz, the slowest mode in sight
RESOLUTION = 1e-9  # p.u.: smaller oscillations are rounding


def is_stable(record: Record) -> bool | None:
    """True: in synchronism to the end; false: lost it; none: not known, for the recording ends too early.

    The end is `configuration["duration"]` (s) less a frame at `configuration["frame_rate"]` (frames/s), give
    or take half a frame.
    """
    if not record.in_synchronism.all():
        return False
    duration, rate = (record.configuration.get(key) for key in ("duration", "frame_rate"))
    if duration is None or rate is None:
        return True
    return True if len(record.time_ns) and record.time_s[-1] >= duration - 1.5 / rate - 1e-9 else None


def settling_time(
    time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0
) -> float | None:
    """Time from `since` (s; the last event) until all signals stay in the band around their final values.

    `signals`: (ticks, n), p.u. A final value is the mean of the last 5 s; the band is 5 % of the largest
    deviation of any signal from its final value after `since`. None if some signal leaves the band
    within the last 2 s, for one that swings is in the band now and then. 0 without any oscillation.
    """
    t, x = _after(time_s, signals, since)
    final = x[t >= t[-1] - min(WINDOW, (t[-1] - t[0]) / 2)].mean(axis=0)
    deviation = np.abs(x - final).max(axis=1)
    peak = deviation.max()
    outside = np.flatnonzero(deviation > BAND * peak)
    if peak < RESOLUTION or not len(outside):
        return 0.0
    if outside[-1] + 1 >= len(t) or t[-1] - t[outside[-1] + 1] < HOLD:
        return None
    return float(t[outside[-1] + 1] - since)


def is_damped(time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0) -> bool:
    """Whether the oscillation dies: each envelope over the last 5 s is below that of the 5 s after `since`.

    `signals`: (ticks, n), p.u.; `since`: s, the last event. A signal whose last envelope is below 5 % of
    the largest first one does not count. Where less than 10 s are left, each window is half of them.
    """
    t, x = _after(time_s, signals, since)
    length = min(WINDOW, (t[-1] - t[0]) / 2)
    first = envelope(t, x, t[0], t[0] + length)
    last = envelope(t, x, t[-1] - length, t[-1])
    matters = last > max(BAND * first.max(), RESOLUTION)
    return bool(np.all(last[matters] < first[matters]))


def envelope(
    time_s: NDArray[np.float64], signals: NDArray[np.float64], start: float, end: float
) -> NDArray[np.float64]:
    """Amplitude of each signal between two times (s): (n,), half peak to peak.

    The straight line of least squares is taken off before, lest drift or offset count as oscillation.
    """
    kept = (time_s >= start) & (time_s <= end)
    t = time_s[kept] - start
    line = np.column_stack([np.ones_like(t), t])
    x = signals[kept]
    residue = x - line @ np.linalg.lstsq(line, x, rcond=None)[0]
    return np.asarray(np.ptp(residue, axis=0) / 2)


def _after(
    time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times and signals (ticks, n) from `since` on, at least the last frame."""
    kept = time_s >= min(since, time_s[-1])
    return time_s[kept], np.reshape(signals, (len(time_s), -1))[kept]
