"""The pictures that go with the tables: responses, indices over time, distributions, what is learnt, agreement."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.pictures import PICTURES
from facts_damping.analysis.plots import COLOURS, mark_events
from facts_damping.analysis.recorded import recorded
from facts_damping.analysis.time_frequency import BAND, analyse
from facts_damping.errors import InputError
from facts_damping.reproduction.agreement import name
from facts_damping.reproduction.printed import LLC, SCENARIOS, Who
from facts_damping.reproduction.runs import BASELINES, changes
from facts_damping.studies.batch import Base, closed_loop, make
from facts_damping.studies.pages import save

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping.analysis.pictures import Panel
    from facts_damping.signals import Record

BY_STEM = {picture.stem: picture for picture in PICTURES}
WIDTH, ROW = 11.0, 1.7  # inch
MAP = "RdBu_r"  # white is zero, blue is negative: interference
INDIRECT = tuple(Who("MISO", one, "indirect") for one in ("ANFTSC", "ANFLeWC", "HBsWC"))
CENTRAL = tuple(Who("MIMO", one, "indirect") for one in ("ANFTSC", "ANFLeWC", "HBsWC"))
SINGLE = (*BASELINES, Who("MISO", "ANFTSC", "direct"), Who("MISO", "HBsWC", "direct"), INDIRECT[-1])
BOTH = (LLC, Who("MIMO", "LLC", None), *CENTRAL)


class Kind(NamedTuple):
    """A kind of picture: its title, what of a record is shown (`PICTURES`, or signals), and of whom."""

    stem: str
    title: str
    parts: tuple[str, ...]
    whos: tuple[Who, ...]
    systems: tuple[str, ...] = tuple(SCENARIOS)
    columns: bool = False  # a column a controller instead of curves over each other


RESPONSES = ("differences", "tie_power", "injected_voltage", "centre_of_angle")
KINDS = (
    Kind("responses", "Responses", RESPONSES, SINGLE),
    Kind("indices", "Performance indices as they grow", ("indices",), SINGLE),
    Kind("jacobian", "Identified Jacobian", ("jacobian",), INDIRECT),
    Kind("rates", "Learning rates", ("learning_rate",), INDIRECT, columns=True),
    Kind("mimo_responses", "Responses with SSSC and STATCOM", RESPONSES, BOTH, ("two_area",)),
    Kind("mimo_jacobian", "Identified Jacobian, SSSC and STATCOM", ("jacobian",), CENTRAL, ("two_area",)),
    Kind("mimo_rates", "Learning rates, SSSC and STATCOM", ("learning_rate",), CENTRAL, ("two_area",), columns=True),
)
# Signals of the distributions: local and interarea modes, control effort.
EFFORT = "control effort"
SIGNALS = {"two_area": ("w12", "w34", "w13", EFFORT), "smib": ("w1", EFFORT)}
DISTRIBUTIONS = {"spwvd": SINGLE[1:], "mimo_spwvd": BOTH}


class Picture(NamedTuple):
    """One file to be drawn: a kind of picture (or of distributions) of a scenario."""

    kind: str
    system: str
    scenario: str

    @property
    def file(self) -> str:
        """Its name."""
        return f"{self.kind}_{self.system}_{self.scenario}.png"


def wanted(systems: Sequence[str], *, mimo: bool) -> list[Picture]:
    """The pictures of systems; with or without those of SSSC and STATCOM together."""
    kinds = [(kind.stem, kind.systems) for kind in KINDS]
    kinds += [("spwvd", tuple(SCENARIOS)), ("mimo_spwvd", ("two_area",))]
    return [
        Picture(stem, system, scenario)
        for system in systems
        for stem, own in kinds
        if system in own and (mimo or not stem.startswith("mimo"))
        for scenario in SCENARIOS[system].values()
    ]


def draw(folder: Path, picture: Picture) -> Path:
    """Run what a picture shows and draw it: its file."""
    path = folder / picture.file
    title = f"{picture.system}, {picture.scenario}"
    if picture.kind in DISTRIBUTIONS:
        shown = [(who, _run(picture, who)) for who in DISTRIBUTIONS[picture.kind]]
        save(distributions(title, [one for one in shown if _whole(one[1])], SIGNALS[picture.system]), path)
        return path
    kind = next(kind for kind in KINDS if kind.stem == picture.kind)
    records = [(who, _run(picture, who)) for who in kind.whos]
    save((side_by_side if kind.columns else overlaid)(f"{kind.title}: {title}", kind.parts, records), path)
    return path


def _run(picture: Picture, who: Who) -> Record:
    """The record of a controller in a scenario, as `facts-damping simulate` has it."""
    base = Base({"system": picture.system, "scenario": picture.scenario}, "reproduce", {}, modes=False)
    return closed_loop(make(base, changes(who)))


def _whole(record: Record) -> bool:
    """Whether a run went on to its end: of one that lost synchronism there is little to analyse."""
    return bool(record.in_synchronism.all())


def overlaid(title: str, stems: Sequence[str], records: Sequence[tuple[Who, Record]]) -> Figure:
    """Panels of some pictures below each other, all records in each; a record's n-th panel lies over another's."""
    found = [(who, record, [_panels(stem, record) for stem in stems]) for who, record in records]
    rows = [max(len(panels[i]) for _, _, panels in found) for i in range(len(stems))]
    figure = Figure(figsize=(WIDTH, 1.0 + ROW * sum(rows)), layout="constrained")
    axes: Any = figure.subplots(sum(rows), 1, sharex=True, squeeze=False)[:, 0]
    for place, (who, record, panels) in enumerate(found):
        for i, own in enumerate(panels):
            for k, panel in enumerate(own):
                axis = axes[sum(rows[:i]) + k]
                _curves(axis, record, panel, COLOURS[place % len(COLOURS)], name(who))
                label = "\n".join(filter(None, (_plain(panel.name, who), BY_STEM[stems[i]].label)))
                axis.set_ylabel(label, fontsize="small")
    _finish(figure, title, list(axes), [record for _, record in records])
    return figure


def side_by_side(title: str, stems: Sequence[str], records: Sequence[tuple[Who, Record]]) -> Figure:
    """Panels of some pictures below each other, a column a record, with the names of their curves."""
    found = [(who, record, [p for stem in stems for p in _panels(stem, record)]) for who, record in records]
    rows = max((len(panels) for _, _, panels in found), default=1)
    figure = Figure(figsize=(1.4 * WIDTH, 1.0 + 1.3 * ROW * rows), layout="constrained")
    axes: Any = figure.subplots(rows, len(found), sharex=True, squeeze=False)
    for column, (who, record, panels) in enumerate(found):
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


def distributions(title: str, shown: Sequence[tuple[Who, Record]], signals: Sequence[str]) -> Figure:
    """SPWVD of signals: a row a signal, a column a controller, one scale of colours a row."""
    figure = Figure(figsize=(1.5 * WIDTH, 1.0 + 1.35 * ROW * len(signals)), layout="constrained")
    axes: Any = figure.subplots(len(signals), len(shown), sharex=True, sharey=True, squeeze=False)
    for row, signal in zip(axes, signals, strict=True):
        found = [_distribution(record, signal) for _, record in shown]
        most = max((float(np.abs(one.values).max()) for one in found if one is not None), default=0.0) or 1.0
        image = None
        for axis, one in zip(row, found, strict=True):
            if one is None:
                axis.text(0.5, 0.5, "at rest", transform=axis.transAxes, ha="center", color="0.5")
                continue
            extent = (one.time_s[0], one.time_s[-1], one.frequency_hz[0], one.frequency_hz[-1])
            image = axis.imshow(
                one.values.T, cmap=MAP, vmin=-most, vmax=most, origin="lower", aspect="auto", extent=extent
            )
        if image is not None:
            figure.colorbar(image, ax=list(row), pad=0.01).set_label("W [(p.u.)²/Hz]", fontsize="x-small")
        row[0].set_ylabel(f"{signal}\nf [Hz]", fontsize="small")
        row[0].set_ylim(BAND)
    for axis, (who, _) in zip(axes[0], shown, strict=True):
        axis.set_title(name(who), fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    figure.suptitle(f"SPWVD: {title}", fontweight="bold", fontsize="medium")
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


def _plain(label: str, who: Who) -> str:
    """A panel's name without its controller's, which the legend or the column tells."""
    parts = [
        one for one in label.split("\n") if who.controller not in one.replace("_", "-") and who.controller not in one
    ]
    own = "identifier" if " identifier" in label else ""
    return "\n".join(filter(None, (own, *parts)))


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
