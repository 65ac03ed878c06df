"""Pictures of time-frequency distributions, as PNG files or within other figures."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.measures import recorded
from facts_damping.analysis.plotting.plots import COLOURS, DPI, mark_events
from facts_damping.errors import InputError
from facts_damping.output.picture_files import save_picture
from facts_damping_views.analysis.time_frequency import BAND, LAG, TIME, analyse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase
    from numpy.typing import NDArray

    from facts_damping.record import Record
    from facts_damping_views.analysis.time_frequency import Analysed, Distribution

SIZE = (10.0, 7.5)  # inch
MAP = "RdBu_r"  # white is zero, blue is negative (interference)
GREY = "0.45"


class Settings(NamedTuple):
    """Settings of an analysis: lengths of the windows over lag and time, s; band, Hz."""

    lag: float = LAG
    time: float = TIME
    band: tuple[float, float] = BAND


def distribution_figures(
    records: Sequence[tuple[str, Record, Sequence[float]]], names: Sequence[str], settings: Settings
) -> tuple[dict[str, Figure], list[str]]:
    """Pictures of the named signals (`recorded`) of records: {stem of a file: figure}, and notes.

    `records`: (name, record, frequencies of its modes, Hz). A stem is spwvd_<signal>, of several records
    spwvd_<signal>_<number>. Raises InputError for a signal that is not there or cannot be analysed.
    """
    figures, notes = {}, []
    for number, (title, record, modes) in enumerate(records, 1):
        for name in names:
            values, unit = recorded(record, name)
            try:
                analysed = analyse(record.time_s, values, *settings)
            except InputError as error:
                raise InputError(f"signal {name}: {error}") from error
            if analysed.filled:
                notes.append(f"{title}: {name}: {analysed.filled} ticks are missing and were filled by straight lines")
            figure = Figure(figsize=SIZE, layout="constrained")
            plot_distribution(figure, analysed, unit, settings.band, modes, record)
            heading = _heading(name, title, settings)
            figure.suptitle(heading, fontsize="medium", fontweight="bold", x=0.01, ha="left")
            figures[f"spwvd_{name}" + (f"_{number}" if len(records) > 1 else "")] = figure
    return figures, notes


def save(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write figures as PNG files; returns their paths."""
    return [save_picture(figure, folder / f"{stem}.png", dpi=DPI) for stem, figure in figures.items()]


def _heading(name: str, title: str, settings: Settings) -> str:
    """Title of a picture, with its windows."""
    kind = "SPWVD" if settings.time else "pseudo-WVD" if settings.lag < inf else "WVD"
    windows = [f"lag window {settings.lag:g} s" if settings.lag < inf else "all lags"]
    windows += [f"time window {settings.time:g} s"] if settings.time else []
    return f"{kind} of {name}, {title}; {', '.join(windows)}"


def plot_distribution(
    figure: FigureBase,
    analysed: Analysed,
    unit: str,
    band: tuple[float, float] = BAND,
    modes: Sequence[float] = (),
    record: Record | None = None,
) -> None:
    """Draw a distribution, above it the signal, below its integral over frequency, beside it that over time.

    `unit`: of the signal; `band`: Hz, what is shown; `modes`: Hz, known frequencies, dashed lines; `record`: whose
    events are marked.
    """
    W, t, z = analysed.distribution, analysed.time_s, np.abs(analysed.z)
    places = figure.subplot_mosaic(
        [["signal", "."], ["map", "spectrum"], ["power", "."]], width_ratios=(5, 1), height_ratios=(1, 3, 1)
    )
    above, middle, below, side = (places[place] for place in ("signal", "map", "power", "spectrum"))
    amplitude, power = _Scale(z, unit), _Scale(z**2, f"{unit}²")
    energy, density = _Scale(W.frequency_marginal, f"{unit}² s/Hz"), _Scale(W.values, f"{unit}²/Hz")
    above.plot(t, z / amplitude.factor, color=GREY, linewidth=0.8, label="|z|")
    above.plot(t, analysed.x / amplitude.factor, color=COLOURS[0], linewidth=1.0, label="x")
    below.plot(t, z**2 / power.factor, color=GREY, linewidth=0.8, label="|z|²")
    below.plot(W.time_s, W.time_marginal / power.factor, color=COLOURS[0], linewidth=1.2, label="∫ W df")
    side.plot(W.frequency_marginal / energy.factor, W.frequency_hz, color=COLOURS[0], linewidth=1.2)
    _colour(figure, middle, side, W, density)
    for axes, label in ((above, f"x [{amplitude.unit}]"), (middle, "f [Hz]"), (below, f"[{power.unit}]")):
        axes.set_ylabel(label)
        axes.set_xlim(t[0], 2 * t[-1] - t[-2])
    for axes in (above, below):
        legend = axes.legend(loc="lower left", bbox_to_anchor=(1.01, 0), fontsize="small", frameon=False)
        legend.set_in_layout(False)
    for axes in (middle, side):
        axes.set_ylim(band)
        for frequency in modes:
            axes.axhline(frequency, color="black", linewidth=0.7, linestyle="--")
    for axes in (above, middle):
        axes.tick_params(labelbottom=False)
    side.tick_params(labelleft=False)
    below.set_xlabel("t [s]")
    label = f"∫ W dt\n[{energy.unit}]"
    text = side.annotate(label, (0.5, 0), (0, -20), "axes fraction", "offset points", ha="center", va="top")
    text.set_in_layout(False)  # as a label of the axis it would push map and power apart
    if record is not None:
        mark_events([above, middle, below], record)


class _Scale:
    """Factor, and the matching unit, for values between 1 and 1000."""

    def __init__(self, values: NDArray[np.float64], unit: str) -> None:
        largest = float(np.abs(values).max())
        exponent = 3 * int(np.floor(np.log10(largest) / 3)) if largest > 0 else 0
        self.factor = 10.0**exponent
        self.unit = unit if exponent == 0 else f"$10^{{{exponent}}}$ {unit}"


def _colour(figure: FigureBase, axes: Axes, side: Axes, distribution: Distribution, density: _Scale) -> None:
    """Draw the distribution in colours, and a colour bar limited to the range of the values."""
    half_t, half_f = (distribution.time_s[1] - distribution.time_s[0]) / 2, distribution.frequency_hz[1] / 2
    extent = (
        distribution.time_s[0] - half_t,
        distribution.time_s[-1] + half_t,
        -half_f,
        distribution.frequency_hz[-1] + half_f,
    )
    values = distribution.values.T / density.factor
    largest = float(np.abs(values).max()) or 1.0
    image = axes.imshow(values, cmap=MAP, vmin=-largest, vmax=largest, origin="lower", aspect="auto", extent=extent)
    bar = figure.colorbar(image, ax=side, location="right", pad=0.1)
    bar.set_label(f"W [{density.unit}]")
    bar.ax.set_ylim(min(float(values.min()), 0.0), largest)
