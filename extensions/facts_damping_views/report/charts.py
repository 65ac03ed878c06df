"""Charts of a report: the pictures of `analysis` with all runs in each, the modes, and time-frequency distributions.

Long traces and large distributions are thinned for display.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.measures import event_times, measure_weights, speed_differences
from facts_damping.analysis.modes.ringdown import interval
from facts_damping.analysis.plotting.pictures import PICTURES, shown, title_of
from facts_damping.errors import InputError
from facts_damping_views.analysis.time_frequency import BAND, analyse
from facts_damping_views.report.contents import SENTENCES, Chart, Curve, Map, Maps, Panel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.plotting import pictures as analysed
    from facts_damping.analysis.plotting.pictures import Picture
    from facts_damping.analysis.summary import ModeFit
    from facts_damping_views.analysis.time_frequency import Distribution
    from facts_damping_views.report.contents import ReportedRun

BEFORE, AFTER = 2.0, 58.0  # s before and after the first event shown in detail
POINTS = 6000  # of a trace, at most: three per pixel of a wide screen
COLUMNS, ROWS = 300, 150  # size of a map, at most
UNIT = "(10⁻³ p.u.)²/Hz"
DIGITS = 3  # significant digits of a value of a map: more would be invisible and compress badly


def charts(runs: Sequence[ReportedRun], stems: Sequence[str]) -> list[Chart]:
    """The pictures with the given stems, of all runs; empty ones are left out."""
    pictures = {picture.stem: picture for picture in PICTURES}
    drawn = [_chart(pictures[stem], runs) for stem in stems]
    return [chart for chart in drawn if chart.panels]


def _chart(picture: Picture, runs: Sequence[ReportedRun]) -> Chart:
    """One picture: a panel for each name that any run has."""
    by_run = [{panel.name: panel for panel in picture.panels(run.record)} for run in runs]
    names = shown(picture, by_run)
    by_name = {name: [(index, row[name]) for index, row in enumerate(by_run) if name in row] for name in names}
    panels = [panel for panel in (_panel(*parts, runs, picture.over_time) for parts in by_name.items()) if panel.curves]
    texts = picture.stem, title_of(picture, by_run, names), SENTENCES[picture.stem], picture.over, picture.label
    return Chart(*texts, panels, picture.over_time, picture.logarithmic, picture.words)


def _panel(
    name: str, parts: Sequence[tuple[int, analysed.Panel]], runs: Sequence[ReportedRun], over_time: bool
) -> Panel:
    curves: list[Curve] = []
    levels: dict[float, None] = {}
    for index, panel in parts:
        time_s, since = runs[index].record.time_s, min(event_times(runs[index].record), default=0.0)
        for label, line in panel.curves.items():
            x = time_s if line.x is None else line.x
            x, y = detailed(x, line.values, since) if over_time else steps(x, line.values)
            curves.append(Curve(index, x, y, name=label))
        if panel.dashed is not None:
            curves.append(Curve(index, *detailed(time_s, panel.dashed, since), "dashed", "setpoint"))
        if panel.regions is not None:
            at, whole = np.array(panel.regions[:2]), panel.curves[""]
            height = np.interp(at, time_s if whole.x is None else whole.x, whole.values)
            curves.append(Curve(index, at, height, "points"))
        levels |= dict.fromkeys(panel.limits)
    return Panel(" ".join(name.split()), [curve for curve in curves if np.isfinite(curve.y).any()], list(levels))


def modes(runs: Sequence[ReportedRun]) -> list[Chart]:
    """Frequency over damping ratio of each mode, with 95 % intervals; empty if no run has modes."""
    curves = [curve for i, run in enumerate(runs) for mode in run.summary.modes for curve in _cross(i, mode)]
    texts = "modes", "Damping of the modes", SENTENCES["modes"], "damping ratio [%]", "f [Hz]"
    return [Chart(*texts, [Panel("", curves)], over_time=False)] if curves else []


def _cross(run: int, mode: ModeFit) -> list[Curve]:
    ratio, frequency = 100 * mode.damping_ratio, mode.frequency_hz
    at = Curve(run, np.array([ratio]), np.array([frequency]), "points")
    errors = 100 * (mode.damping_ratio_error or 0.0), mode.frequency_error_hz or 0.0
    across, along = np.array(interval(ratio, errors[0])), np.array(interval(frequency, errors[1]))
    return [at, Curve(run, across, np.full(2, frequency)), Curve(run, np.full(2, ratio), along)]


def maps(runs: Sequence[ReportedRun]) -> list[Maps]:
    """The distribution of each run's last speed difference, if available; empty if there is none."""
    distributions = [distribution for index, run in enumerate(runs) for distribution in _map(index, run)]
    return [Maps("spwvd", "Time and frequency (SPWVD)", SENTENCES["spwvd"], distributions)] if distributions else []


def _map(index: int, run: ReportedRun) -> list[Map]:
    """The map of a run; empty without a speed difference or if the run is too short."""
    if not measure_weights(run.record.configuration):
        return []
    name, values = list(speed_differences(run.record).items())[-1]
    try:
        distribution = analyse(run.record.time_s, 1e3 * values).distribution
    except InputError:
        return []
    lines = [mode.frequency_hz for mode in run.summary.modes]
    return [Map(index, f"{name}, {run.name} [{UNIT}]", *_thinned(distribution), UNIT, lines)]


def _thinned(distribution: Distribution) -> tuple[tuple[float, float, float, float], NDArray[np.float32]]:
    """Outer edges and values (frequencies, times) within the band: the largest value by magnitude of each block."""
    t, f = distribution.time_s, distribution.frequency_hz
    inside = np.flatnonzero((f >= BAND[0]) & (f <= BAND[1]))
    values = _blocks(_blocks(distribution.values[:, inside], COLUMNS).T, ROWS)
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


# Thinning: traces that look the same with fewer points


def envelope(
    x: NDArray[np.float64], y: NDArray[np.float64], maximum: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A trace of at most `maximum` points that looks the same: smallest and largest value of each block of samples.

    `x`, `y`: (n,); short traces are returned unchanged. Otherwise each block gives two points, in order of occurrence,
    at the block's first and middle x, so that traces over the same x share it. NaN is ignored beside numbers.
    """
    if len(x) <= maximum:
        return x, y
    size = -(-2 * len(x) // maximum)
    starts = np.arange(0, len(x), size)
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    padded = np.append(y, np.full(-len(y) % size, np.nan)).reshape(-1, size)
    falls = np.argmax(padded == high[:, np.newaxis], axis=1) < np.argmax(padded == low[:, np.newaxis], axis=1)
    values = np.column_stack([np.where(falls, high, low), np.where(falls, low, high)])
    ends = np.minimum(starts + size, len(x)) - 1
    return x[np.column_stack([starts, (starts + ends + 1) // 2]).ravel()], values.ravel()


def detailed(
    time_s: NDArray[np.float64], y: NDArray[np.float64], since: float, maximum: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Envelope of a long trace, with a separate envelope for the minute after `since` (s; the first event).

    Zooming into a long run then shows the oscillation. At most `3 maximum` points.
    """
    if len(time_s) <= maximum:
        return time_s, y
    edges = np.searchsorted(time_s, [since - BEFORE, since + AFTER])
    parts = [
        envelope(x, part, maximum)
        for x, part in zip(np.split(time_s, edges), np.split(y, edges), strict=True)
        if len(x)
    ]
    return np.concatenate([x for x, _ in parts]), np.concatenate([part for _, part in parts])


def steps(
    x: NDArray[np.float64], y: NDArray[np.float64], maximum: int = POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A staircase of at most `maximum` points: each y holds until the next x.

    `x`, `y`: (n,), n > 0, x non-decreasing. For equal x the last y counts; if there are too many steps, every k-th is
    kept, and always the last.
    """
    ends = np.flatnonzero(np.append(x[1:] != x[:-1], True))
    shown_ends = ends[np.unique(np.linspace(0, len(ends) - 1, min(len(ends), maximum // 2)).astype(int))]
    return np.repeat(x[shown_ends], 2), np.append(y[0], np.repeat(y[shown_ends], 2)[:-1])
