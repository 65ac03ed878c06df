"""Pictures of records, one or several overlaid, as PNG files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.measures import SPEED, measure_weights, speed_differences
from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS, NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from facts_damping.signals import Record

POWER, VOLTAGE = (list(CHANNELS).index(name) for name in ("active_power", "voltage_magnitude"))
WIDTH, PANEL_HEIGHT, MARGIN = 9.0, 2.3, 1.3  # inch
DPI = 150
# Okabe and Ito's palette without its yellow: distinct also for the colour-blind.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
SETPOINT, LIMIT = "setpoint in force", "limit of the setpoint"
NEARBY = 0.03  # of the time axis: events so close share a label


@dataclass(frozen=True)
class Panel:
    """A signal of a record: name, values (ticks,), perhaps a second, dashed curve, and horizontal limits."""

    name: str
    values: NDArray[np.float64]
    dashed: NDArray[np.float64] | None = None
    limits: tuple[float, ...] = field(default=())


class Picture(NamedTuple):
    """A file: its stem, title, label of the ordinate, panels of a record, all of one in one axes?."""

    stem: str
    title: str
    label: str
    panels: Callable[[Record], list[Panel]]
    together: bool


def plot_record(record: Record, folder: Path | str) -> list[Path]:
    """Plot one record: paths of the PNG files. Pictures that would be empty are left out."""
    return plot_comparison([("", record)], folder)


def plot_comparison(records: Sequence[tuple[str, Record]], folder: Path | str) -> list[Path]:
    """Plot several records (name, record) over each other: paths of the PNG files in `folder`.

    speeds.png, differences.png, tie_power.png, voltage.png, injected_voltage.png. Vertical lines mark the events of the
    first record. Raises InputError without records.
    """
    if not records:
        raise InputError("plots: no record given; allowed: at least one")
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    paths = []
    for picture in PICTURES:
        figure = _figure(picture, records)
        if figure is not None:
            path = place / f"{picture.stem}.png"
            figure.savefig(path, dpi=DPI)
            paths.append(path)
    return paths


def _speeds(record: Record) -> list[Panel]:
    return [Panel(record.stations[i], 1e3 * record.frames[:, i, SPEED]) for i in _stations(record, machines=True)]


def _differences(record: Record) -> list[Panel]:
    if not measure_weights(record.configuration):
        return []
    return [Panel(name, 1e3 * values) for name, values in speed_differences(record).items()]


def _tie_power(record: Record) -> list[Panel]:
    return [Panel(f"{record.stations[i]}", record.frames[:, i, POWER]) for i in _stations(record, machines=False)]


def _voltages(record: Record) -> list[Panel]:
    limits = _limits(record.configuration)
    injected, reference = record.devices["injected_voltage"], record.devices["reference"]
    values = np.where(np.isfinite(injected), injected, reference)  # in parallel: the offset of the voltage reference
    return [
        Panel(name, values[:, i], record.devices["setpoint"][:, i], limits.get(name, ()))
        for i, name in enumerate(record.device_names)
    ]


def _bus_voltages(record: Record) -> list[Panel]:
    return [Panel(record.stations[i], record.frames[:, i, VOLTAGE]) for i in _stations(record, machines=False)]


PICTURES = (
    Picture("speeds", "Speed deviation", "Δω [10⁻³ p.u.]", _speeds, together=True),
    Picture("differences", "Speed difference", "Δω [10⁻³ p.u.]", _differences, together=True),
    Picture("tie_power", "Active power", "P [p.u.]", _tie_power, together=True),
    Picture("voltage", "Bus voltage", "V [p.u.]", _bus_voltages, together=True),
    Picture("injected_voltage", "Injected voltage", "v [p.u.]", _voltages, together=False),
)


def _stations(record: Record, *, machines: bool) -> Iterator[int]:
    """Indices of the stations at machines, or of the others that measure a power: those without a speed."""
    for index in range(len(record.stations)):
        has_speed = bool(np.isfinite(record.frames[:, index, SPEED]).any())
        has_power = bool(np.isfinite(record.frames[:, index, POWER]).any())
        if has_speed if machines else has_power and not has_speed:
            yield index


def _limits(configuration: dict[str, Any]) -> dict[str, tuple[float, ...]]:
    """Limits of the devices' setpoints, p.u., from a system inline."""
    system = configuration.get("system")
    devices = system.get("devices", []) if isinstance(system, dict) else []
    return {one["name"]: (-one["v_max"], one["v_max"]) for one in devices if "v_max" in one}


def _figure(picture: Picture, records: Sequence[tuple[str, Record]]) -> Figure | None:
    """One picture; none if no record has anything to show in it."""
    shown = [(name, record, {panel.name: panel for panel in picture.panels(record)}) for name, record in records]
    names = list(dict.fromkeys(panel for _, _, panels in shown for panel in panels))
    if not names:
        return None
    single = len(records) == 1
    rows = [names] if single and picture.together else [[name] for name in names]
    figure = Figure(figsize=(WIDTH, MARGIN + PANEL_HEIGHT * max(len(rows), 1.5)), layout="constrained")
    grid = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, row in zip(grid, rows, strict=True):
        for position, (name, record, panels) in enumerate(shown):
            for offset, panel in enumerate(row):
                if panel in panels:
                    label = panel if single and picture.together else name or "injected"
                    _draw(axes, record, panels[panel], label, COLOURS[(position + offset) % len(COLOURS)])
        _dress(axes, picture.label if len(row) > 1 else f"{row[0]}\n{picture.label}")
    mark_events(list(grid), records[0][1])
    grid[-1].set_xlabel("t [s]")
    grid[-1].set_xlim(*_span([record for _, record in records]))
    figure.suptitle(picture.title, fontsize="medium", fontweight="bold", x=0.01, ha="left")
    _add_legend(figure, list(grid))
    return figure


def _draw(axes: Axes, record: Record, panel: Panel, label: str, colour: str) -> None:
    """One signal of one record."""
    axes.plot(record.time_s, panel.values, color=colour, linewidth=1.2, label=label)
    if panel.dashed is not None:
        axes.plot(record.time_s, panel.dashed, color="0.1", linewidth=0.6, linestyle="--", label=SETPOINT)
    for limit in panel.limits:
        axes.axhline(limit, color="#B00020", linewidth=0.8, linestyle=":", label=LIMIT)


def _dress(axes: Axes, label: str) -> None:
    """Label and grid of an axes."""
    axes.set_ylabel(label)
    axes.grid(visible=True, color="0.92")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _add_legend(figure: Figure, grid: Sequence[Axes]) -> None:
    """One legend for all axes, outside of them, each label once."""
    entries: dict[str, Artist] = {}
    for axes in grid:
        handles, labels = axes.get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True)) | entries
    ordered = sorted(entries, key=(SETPOINT, LIMIT).__contains__)
    columns = min(len(entries), 5)
    figure.legend(
        [entries[label] for label in ordered], ordered, loc="outside upper right", ncols=columns, fontsize="small",
        frameon=False,
    )  # fmt: skip


def _span(records: Sequence[Record]) -> tuple[float, float]:
    """First and last instant of all records, s, the last frame included."""
    first, last = min(one.time_s[0] for one in records), max(one.time_s[-1] for one in records)
    frame = max(float(np.median(np.diff(one.time_s))) if len(one.time_ns) > 1 else 1e-3 for one in records)
    return float(first), float(last) + frame


def mark_events(grid: Sequence[Axes], record: Record) -> None:
    """Vertical lines at the events in all axes, their kinds above the first."""
    for axes in grid:
        for time, _ in _events(record, 0.0):
            axes.axvline(time, color="0.6", linewidth=0.8, linestyle="--", zorder=1)
    for time, kinds in _events(record, NEARBY):
        grid[0].annotate(
            kinds.replace("_", " "), (time, 1.02), xycoords=("data", "axes fraction"), fontsize="x-small",
            color="0.35", ha="left", va="bottom",
        )  # fmt: skip


def _events(record: Record, nearby: float) -> list[tuple[float, str]]:
    """Time (s) and kind of the events within the record; those closer than `nearby` of its span in one."""
    grouped: list[tuple[float, float, str]] = []
    span = record.time_s[-1] - record.time_s[0]
    for event in record.events:
        time, kind = event["time_ns"] / NANOSECONDS, str(event["kind"])
        if time > record.time_s[-1]:
            continue
        if grouped and time - grouped[-1][1] <= nearby * span:
            grouped[-1] = (grouped[-1][0], time, f"{grouped[-1][2]}, {kind}")
        else:
            grouped.append((time, time, kind))
    return [(first, kinds) for first, _, kinds in grouped]
