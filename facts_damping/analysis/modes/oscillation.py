"""Stability of a run, amplitude of its oscillations, and settling time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.measures import columns, inline_system, measure_weights, speed_differences
from facts_damping.signals import SPEED_BAND

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record

WINDOW = 5.0  # s, time over which an envelope is taken
BAND = 0.05  # of the largest deviation: smaller signals have settled, smaller amplitudes are negligible
HOLD = 2.0  # s that a signal must stay in the band: half a period at 0.25 Hz, the slowest mode considered
STRIP_ROUNDS, STRIP_SLOPES = 6, 33  # search of a slope, to 16^-6 of its range
RESOLUTION = 1e-9  # p.u.; smaller oscillations are round-off


def is_stable(record: Record) -> bool | None:
    """True: in synchronism to the end; False: synchronism lost; None: unknown (`unknown` says why).

    The end is `configuration["duration"]` (s) less a frame at `configuration["frame_rate"]` (frames/s), with a
    tolerance of half a frame.
    """
    if not record.in_synchronism.all():
        return False
    return True if unknown(record) is None else None


def unknown(record: Record) -> str | None:
    """Why it is unknown whether a run stayed in synchronism; None if it is known."""
    if record.machines.size and np.isnan(record.machines["speed_deviation"]).all():  # streams in place of the plant
        whole = measure_weights(record.configuration) and np.isfinite(columns(speed_differences(record))).all()
        return None if whole else "the streams do not tell all rotor speeds"
    duration, rate = (record.configuration.get(key) for key in ("duration", "frame_rate"))
    if duration is None or rate is None:
        return None
    ended = len(record.time_ns) and record.time_s[-1] >= duration - 1.5 / rate - 1e-9
    return None if ended else "the recording ends too early"


def instability(record: Record) -> str | None:
    """Why an unstable run ended; None if it is stable.

    Loss of synchronism, a frequency out of its band (SPEED_BAND), or a network without a solution.
    """
    if record.in_synchronism.all():
        return None
    last = record.machines[-1]
    known = all(np.isfinite(last[name]).all() for name in ("rotor_angle", "terminal_voltage"))
    nominal = inline_system(record.configuration).get("frequency")
    if known and nominal is not None and np.abs(last["speed_deviation"]).max(initial=0.0) > SPEED_BAND:
        return f"frequency beyond {nominal * (1 - SPEED_BAND):g} to {nominal * (1 + SPEED_BAND):g} Hz"
    return "loss of synchronism" if known else "voltage collapse: the network equations have no solution"


def settling_time(time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0) -> float | None:
    """Time from `since` (s; the last event) until all signals stay in the band around their final values.

    `signals`: (ticks, n), p.u. A final value is the mean of the last 5 s; the band is 5 % of the largest deviation of
    any signal from its final value after `since`. None if a signal leaves the band within the last 2 s, because an
    oscillation crosses the band repeatedly. 0 without any oscillation.
    """
    inside = time_s >= min(since, time_s[-1])
    t, x = time_s[inside], np.reshape(signals, (len(time_s), -1))[inside]
    final = x[t >= t[-1] - min(WINDOW, (t[-1] - t[0]) / 2)].mean(axis=0)
    deviation = np.abs(x - final).max(axis=1)
    peak = deviation.max()
    outside = np.flatnonzero(deviation > BAND * peak)
    if peak < RESOLUTION or not len(outside):
        return 0.0
    if outside[-1] + 1 >= len(t) or t[-1] - t[outside[-1] + 1] < HOLD:
        return None
    return float(t[outside[-1] + 1] - since)


def envelope(
    time_s: NDArray[np.float64], signals: NDArray[np.float64], start: float, end: float
) -> NDArray[np.float64]:
    """Amplitude of each signal (ticks, n) between two times (s): (n,).

    It is half the height of the narrowest straight strip that holds the signal, `min_s (max(x - s t) - min(x - s t)) /
    2`, so neither drift nor offset counts as oscillation. For a wave of at least one and a half periods this is the
    amplitude for any phase; the phases at the ends would tilt a least-squares line.
    """
    inside = (time_s >= start) & (time_s <= end)
    t = time_s[inside] - (start + end) / 2
    return np.array([_half_strip(t, x) for x in signals[inside].T])


def _half_strip(t: NDArray[np.float64], x: NDArray[np.float64]) -> float:
    """Half the height of the narrowest strip, a convex function of the slope, by a search from coarse to fine."""
    height, length = float(np.ptp(x)), float(np.ptp(t))
    if length == 0:
        return 0.0
    slope, reach = 0.0, 2 * height / length  # a steeper strip would be higher than the horizontal one
    for _ in range(STRIP_ROUNDS):
        slopes = slope + reach * np.linspace(-1, 1, STRIP_SLOPES)
        heights = np.ptp(x - t * slopes[:, np.newaxis], axis=1)
        best = int(np.argmin(heights))
        slope, height, reach = float(slopes[best]), float(heights[best]), 2 * reach / (STRIP_SLOPES - 1)
    return height / 2
