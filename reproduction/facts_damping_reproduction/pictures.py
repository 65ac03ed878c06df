"""The pictures that go with the tables: responses, indices over time, distributions, what is learnt, agreement."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.measures import recorded
from facts_damping.analysis.plotting.pictures import PICTURES
from facts_damping.analysis.plotting.plots import COLOURS, mark_events
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping_reproduction.agreement import name
from facts_damping_reproduction.printed import LLC, SCENARIOS, TABLES, ControllerId
from facts_damping_reproduction.runs import BASELINES, changes
from facts_damping_studies.pages import save
from facts_damping_studies.sweeps.batch import Base, make
from facts_damping_views.analysis.time_frequency import BAND, analyse

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping.analysis.plotting.pictures import Panel
    from facts_damping.record import Record

BY_STEM = {picture.stem: picture for picture in PICTURES}
WIDTH, ROW = 11.0, 1.7  # inch
MAP = "RdBu_r"  # white is zero, blue is negative: interference
INDIRECT = tuple(ControllerId("MISO", network, "indirect") for network in ("ANFTSC", "ANFLeWC", "HBsWC"))
CENTRAL = tuple(ControllerId("MIMO", network, "indirect") for network in ("ANFTSC", "ANFLeWC", "HBsWC"))
SINGLE = (*BASELINES, ControllerId("MISO", "ANFTSC", "direct"), ControllerId("MISO", "HBsWC", "direct"), INDIRECT[-1])
BOTH = (LLC, ControllerId("MIMO", "LLC", None), *CENTRAL)


class PictureKind(NamedTuple):
    """A kind of picture: its title, what of a record is shown (`PICTURES`), of whom, with which tables it goes."""

    stem: str
    title: str
    parts: tuple[str, ...]
    whos: tuple[ControllerId, ...]
    tables: tuple[str, ...]
    columns: bool = False  # a column a controller instead of curves over each other


ALONE, LEARNT, TOGETHER = ("4.1", "4.2", "5.1", "5.2", "5.3", "5.4"), ("5.1", "5.2", "5.3", "5.4"), ("6.1", "6.2")
RESPONSES = ("differences", "tie_power", "injected_voltage", "centre_of_angle")
KINDS = (
    PictureKind("responses", "Responses", RESPONSES, SINGLE, ALONE),
    PictureKind("indices", "Performance indices as they grow", ("indices",), SINGLE, ALONE),
    PictureKind("jacobian", "Identified Jacobian", ("jacobian",), INDIRECT, LEARNT),
    PictureKind("rates", "Learning rates", ("learning_rate",), INDIRECT, LEARNT, columns=True),
    PictureKind("spwvd", "SPWVD", (), SINGLE[1:], ALONE),
    PictureKind("mimo_responses", "Responses with SSSC and STATCOM", RESPONSES, BOTH, TOGETHER),
    PictureKind("mimo_jacobian", "Identified Jacobian, SSSC and STATCOM", ("jacobian",), CENTRAL, TOGETHER),
    PictureKind("mimo_rates", "Learning rates, SSSC and STATCOM", ("learning_rate",), CENTRAL, TOGETHER, columns=True),
    PictureKind("mimo_spwvd", "SPWVD, SSSC and STATCOM", (), BOTH, TOGETHER),
)
# Signals of the distributions: local and interarea modes, control effort.
EFFORT = "control effort"
SIGNALS = {"two_area": ("w12", "w34", "w13", EFFORT), "smib": ("w1", EFFORT)}


class Picture(NamedTuple):
    """One file to be plotted: a kind of picture of a scenario."""

    kind: str
    system: str
    scenario: str

    @property
    def file(self) -> str:
        """Its name."""
        return f"{self.kind}_{self.system}_{self.scenario}.png"


def wanted(tables: Sequence[str]) -> list[Picture]:
    """The pictures that go with tables."""
    pictures = [
        Picture(kind.stem, system, scenario)
        for kind in KINDS
        for system in dict.fromkeys(TABLES[table].system for table in tables if table in kind.tables)
        for scenario in SCENARIOS[system].values()
    ]
    return sorted(pictures, key=lambda picture: list(SCENARIOS).index(picture.system))


def plot(folder: Path, picture: Picture) -> Path:
    """Run what a picture shows and plot it: its file."""
    kind = next(kind for kind in KINDS if kind.stem == picture.kind)
    title = f"{kind.title}: {picture.system}, {picture.scenario}"
    records = [(who, _run(picture, who)) for who in kind.whos]
    if kind.parts:
        figure = (side_by_side if kind.columns else overlaid)(title, kind.parts, records)
    else:
        figure = distributions(title, [shown for shown in records if _whole(shown[1])], SIGNALS[picture.system])
    save(figure, folder / picture.file)
    return folder / picture.file


def _run(picture: Picture, who: ControllerId) -> Record:
    """The record of a controller in a scenario, as `facts-damping simulate` has it."""
    base = Base({"system": picture.system, "scenario": picture.scenario}, "reproduce", {}, modes=False)
    return loop.run(make(base, changes(who)))


def _whole(record: Record) -> bool:
    """Whether a run went on to its end: of one that lost synchronism there is little to analyse."""
    return bool(record.in_synchronism.all())


def overlaid(title: str, stems: Sequence[str], records: Sequence[tuple[ControllerId, Record]]) -> Figure:
    """Panels of some pictures below each other, all records in each; a record's n-th panel lies over another's."""
    drawn = [(who, record, [_panels(stem, record) for stem in stems]) for who, record in records]
    rows = [max(len(panels[i]) for _, _, panels in drawn) for i in range(len(stems))]
    figure = Figure(figsize=(WIDTH, 1.0 + ROW * sum(rows)), layout="constrained")
    axes: Any = figure.subplots(sum(rows), 1, sharex=True, squeeze=False)[:, 0]
    for place, (who, record, panels) in enumerate(drawn):
        for i, of_stem in enumerate(panels):
            for k, panel in enumerate(of_stem):
                axis = axes[sum(rows[:i]) + k]
                _curves(axis, record, panel, COLOURS[place % len(COLOURS)], name(who))
                label = "\n".join(filter(None, (_plain(panel.name, who), BY_STEM[stems[i]].label)))
                axis.set_ylabel(label, fontsize="small")
    _finish(figure, title, list(axes), [record for _, record in records])
    return figure


def side_by_side(title: str, stems: Sequence[str], records: Sequence[tuple[ControllerId, Record]]) -> Figure:
    """Panels of some pictures below each other, a column a record, with the names of their curves."""
    drawn = [(who, record, [p for stem in stems for p in _panels(stem, record)]) for who, record in records]
    rows = max((len(panels) for _, _, panels in drawn), default=1)
    figure = Figure(figsize=(1.4 * WIDTH, 1.0 + 1.3 * ROW * rows), layout="constrained")
    axes: Any = figure.subplots(rows, len(drawn), sharex=True, squeeze=False)
    for column, (who, record, panels) in enumerate(drawn):
        axes[0, column].set_title(name(who), fontsize="small")
        for axis, panel in zip(axes[:, column], panels, strict=False):
            for i, (label, curve) in enumerate(panel.curves.items()):
                x = record.time_s if curve.x is None else curve.x
                axis.plot(x, curve.values, color=COLOURS[i % len(COLOURS)], lw=0.9, label=label or None)
            axis.set(yscale="log" if BY_STEM[stems[0]].logarithmic else "linear")
            axis.set_ylabel(_plain(panel.name, who), fontsize="x-small")
            if len(panel.curves) > 1:
                axis.legend(fontsize="xx-small", loc="lower right")
    _finish(figure, title, list(axes.ravel()), [record for _, record in records], legend=False)
    return figure


def distributions(title: str, shown: Sequence[tuple[ControllerId, Record]], signals: Sequence[str]) -> Figure:
    """SPWVD of signals: a row a signal, a column a controller, one scale of colours a row."""
    figure = Figure(figsize=(1.5 * WIDTH, 1.0 + 1.35 * ROW * len(signals)), layout="constrained")
    axes: Any = figure.subplots(len(signals), len(shown), sharex=True, sharey=True, squeeze=False)
    for row, signal in zip(axes, signals, strict=True):
        maps = [_distribution(record, signal) for _, record in shown]
        maximum = (
            max(
                (float(np.abs(distribution.values).max()) for distribution in maps if distribution is not None),
                default=0.0,
            )
            or 1.0
        )
        image = None
        for axis, distribution in zip(row, maps, strict=True):
            if distribution is None:
                axis.text(0.5, 0.5, "at rest", transform=axis.transAxes, ha="center", color="0.5")
                continue
            extent = (
                distribution.time_s[0],
                distribution.time_s[-1],
                distribution.frequency_hz[0],
                distribution.frequency_hz[-1],
            )
            image = axis.imshow(
                distribution.values.T,
                cmap=MAP,
                vmin=-maximum,
                vmax=maximum,
                origin="lower",
                aspect="auto",
                extent=extent,
            )
        if image is not None:
            figure.colorbar(image, ax=list(row), pad=0.01).set_label("W [(p.u.)²/Hz]", fontsize="x-small")
        row[0].set_ylabel(f"{signal}\nf [Hz]", fontsize="small")
        row[0].set_ylim(BAND)
    for axis, (who, _) in zip(axes[0], shown, strict=True):
        axis.set_title(name(who), fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    figure.suptitle(title, fontweight="bold", fontsize="medium")
    return figure


def _distribution(record: Record, signal: str) -> Any:
    """The distribution of a signal, of the first device's setpoint where it is the effort; none of one at rest."""
    values = record.devices["setpoint"][:, 0] if signal == EFFORT else recorded(record, signal)[0]
    if not np.ptp(values):
        return None
    try:
        return analyse(record.time_s, values).distribution
    except InputError:  # too short
        return None


def _panels(stem: str, record: Record) -> list[Panel]:
    return BY_STEM[stem].panels(record)


def _plain(label: str, who: ControllerId) -> str:
    """A panel's name without its controller's, which the legend or the column tells."""
    parts = [
        line
        for line in label.split("\n")
        if who.controller not in line.replace("_", "-") and who.controller not in line
    ]
    role = "identifier" if " identifier" in label else ""
    return "\n".join(filter(None, (role, *parts)))


def _curves(axis: Any, record: Record, panel: Panel, colour: str, label: str) -> None:
    for curve in panel.curves.values():
        x = record.time_s if curve.x is None else curve.x
        axis.plot(
            x, curve.values, color=colour, lw=1.0, label=label, drawstyle="steps-post" if curve.steps else "default"
        )
        label = "_"


def _finish(figure: Figure, title: str, axes: list[Any], records: Sequence[Record], *, legend: bool = True) -> None:
    """Grid, events, limits of time, legend, title."""
    whole = max(records, key=lambda record: record.time_s[-1])
    for axis in axes:
        axis.grid(visible=True, color="0.92")
        axis.set_xlim(0.0, whole.time_s[-1])
    mark_events(axes, whole)
    axes[-1].set_xlabel("t [s]")
    if legend:
        entries: dict[str, Any] = {}
        for axis in axes:
            entries |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
        figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=4, fontsize="small")
    figure.suptitle(title, fontweight="bold", fontsize="medium")
