"""Time-frequency distributions of the runs, thinned for display."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.measures import measure_weights, speed_differences
from facts_damping.analysis.time_frequency import BAND, analyse
from facts_damping.errors import InputError
from facts_damping.report.contents import Map, Maps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.time_frequency import Distribution
    from facts_damping.report.contents import ReportedRun

COLUMNS, ROWS = 300, 150  # size of a map, at most
UNIT = "(10⁻³ p.u.)²/Hz"
DIGITS = 3  # significant digits of a value: more would be invisible and compress badly


def maps(runs: Sequence[ReportedRun]) -> list[Maps]:
    """The distribution of each run's last speed difference, if available; empty if there is none."""
    made = [one for index, run in enumerate(runs) for one in _map(index, run)]
    sentence = (
        "At which frequency a speed difference swings, and when: smoothed pseudo Wigner-Ville distribution, red where "
        "there is much, pale where there is nothing, blue what two components make by interference. An oscillation "
        "that dies fades to the right. Dashed are the modes of the mode table. Each picture has its own scale."
    )
    return [Maps("spwvd", "Time and frequency (SPWVD)", sentence, made)] if made else []


def _map(index: int, run: ReportedRun) -> list[Map]:
    """The map of a run; empty without a speed difference or if the run is too short."""
    if not measure_weights(run.record.configuration):
        return []
    name, values = list(speed_differences(run.record).items())[-1]
    try:
        found = analyse(run.record.time_s, 1e3 * values).distribution
    except InputError:
        return []
    lines = [mode["frequency_hz"] for mode in run.summary["modes"]]
    return [Map(index, f"{name}, {run.name} [{UNIT}]", *_thinned(found), UNIT, lines)]


def _thinned(found: Distribution) -> tuple[tuple[float, float, float, float], NDArray[np.float32]]:
    """Outer edges and values (frequencies, times) within the band: the largest value by magnitude of each block."""
    t, f = found.time_s, found.frequency_hz
    inside = np.flatnonzero((f >= BAND[0]) & (f <= BAND[1]))
    values = _blocks(_blocks(found.values[:, inside], COLUMNS).T, ROWS)
    dt, df = t[1] - t[0], f[1]
    low, high = f[inside[[0, -1]]]
    extent = float(t[0] - dt / 2), float(t[-1] + dt / 2), float(low - df / 2), float(high + df / 2)
    scale = float(np.abs(values).max()) or 1.0
    return extent, (np.round(values / scale, DIGITS) * scale).astype(np.float32)


def _blocks(values: NDArray[np.float64], maximum: int) -> NDArray[np.float64]:
    """Group rows into at most `maximum` blocks of nearly equal size; of each the largest magnitude by column."""
    starts = np.linspace(0, len(values), min(len(values), maximum) + 1).astype(int)[:-1]
    high, low = np.maximum.reduceat(values, starts), np.minimum.reduceat(values, starts)
    return np.where(high >= -low, high, low)
