"""The page of what holds in a deployment: its text with the figures in it, its picture, and everything as CSV."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from pyarrow import csv

from facts_damping import terminal
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.studies.pages import save
from facts_damping.studies.sweeps.results import table
from facts_damping.terminal import write_whole
from facts_damping_reproduction.paired import Effect
from facts_damping_reproduction.templates import render
from facts_damping_reproduction.what_holds import UNCONVERGED, has_place

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_reproduction.what_holds import Answer, Borne, Judgement, Ranked

PAGE, EVERYBODY, PICTURE = "what_holds.md", "what_holds_all.md", "what_holds.png"
QUESTIONS = ("over_none", "learning", "adaptive", "second", "compensation", "supervision", "device_lost")
RANGE = (-1.8, 0.7)  # of colours, logarithm of the ratio
NOTHING = Effect(0, 0, 0, 0, None, None, None)
COMMAND = "facts-damping reproduce --profile deployment"


def write(told: Judgement, folder: Path) -> list[Path]:
    """Both pages, the picture, and CSV files."""
    save(picture(told), folder / PICTURE)
    write_whole(folder / PAGE, _render(PAGE, told))
    write_whole(folder / EVERYBODY, _render(EVERYBODY, told))
    made = [folder / PAGE, folder / EVERYBODY, folder / PICTURE]
    for stem, rows in document(told).items():
        if rows:
            csv.write_csv(table(rows), folder / f"{stem}.csv")
            made.append(folder / f"{stem}.csv")
    return made


def document(told: Judgement) -> dict[str, list[dict[str, Any]]]:
    """The figures as rows."""
    return {
        "everybody": [
            {
                "who": one.who.label,
                "training_score": one.who.score,
                **one.over_none._asdict(),
                "converged": one.converged,
                "checked": one.checked,
                "saturated": one.saturated,
                "tripped": one.tripped,
                "ranked": one.place,
            }
            for one in told.ranked
        ],
        "effects": [
            {"question": question, "who": one.who, "against": one.against, "event": event, **found._asdict()}
            for question in QUESTIONS
            for one in getattr(told, question)
            for event, found in effects(one).items()
        ],
        "delays": [
            {"who": one.who.label, "more_delay_s": delay, **found._asdict()}
            for one in told.borne
            for delay, found in one.by_delay.items()
        ],
    }


def effects(one: Answer) -> dict[str, Effect]:
    """The effects of an answer by event, and of several together."""
    return {**one.events, "new events": one.new_events, "new conditions": one.new_conditions, "all": one.all}


def _render(name: str, told: Judgement) -> str:
    functions = {one.__name__: one for one in (finalist_table, everybody_table, answer_table, delay_table, lost_table)}
    return render(name, told=told, command=COMMAND, picture=PICTURE, found=partial(_found, told), **functions)


def _found(told: Judgement, question: str, name: str, event: str = "all") -> str:
    """An effect by its question and who it is of, as text."""
    one = next((answer for answer in getattr(told, question) if answer.who == name), None)
    return "-" if one is None else percent(effects(one).get(event, NOTHING))


# Cells


def percent(found: Effect) -> str:
    """How much less or more the index is than the reference's, with its interval: -31 % [-40, -20]."""
    if found.ratio is None or found.low is None or found.high is None:
        return "-"
    low, middle, high = (_signed(value) for value in (found.low, found.ratio, found.high))
    return f"{middle} % [{low}, {high}]"


def ratio(found: Effect) -> str:
    """The same without the interval."""
    return "-" if found.ratio is None else f"{_signed(found.ratio)} %"


def _signed(ratio: float) -> str:
    """A ratio as a change in per cent; no change has no sign."""
    change = round(100.0 * (ratio - 1.0))
    return f"{change:+d}" if change else "0"


def span(one: Borne) -> str:
    """Up to which delay it is better than no control, ms."""
    maximum = max(one.by_delay)
    if one.helps_to is None:
        return "none"
    return f"{'> ' if one.helps_to == maximum else ''}{1000.0 * one.helps_to:.0f}"


def finalist_table(told: Judgement) -> str:
    """Who was judged on all draws, the best first; last those that have no place in an order."""
    places = {one.who.label: one for one in told.ranked}
    borne = {one.who.label: one for one in told.borne}
    rows = []
    for one in in_order(told):
        place, delay = places.get(one.who), borne.get(one.who)
        sure = "~" if told.changed[one.who] > UNCONVERGED else ""
        rows.append(
            [
                sure + one.who,
                percent(one.new_events),
                percent(one.new_conditions),
                f"{one.all.lost}",
                f"{one.all.kept}",
                span(delay) if delay else "",
                f"{100.0 * place.saturated:.0f} %" if place else "",
                f"{100.0 * place.tripped:.0f} %" if place else "",
            ]
        )
    titles = ["controller", "new events", "new conditions", "lost", "kept", "delay, ms", "saturated", "tripped"]
    return "\n".join(terminal.table(titles, rows, 1, markdown=True))


def in_order(told: Judgement) -> list[Answer]:
    """Answers over no control, the best first; last who has no place in an order."""
    return sorted(
        told.over_none, key=lambda one: (not has_place(told.changed[one.who], one.all), one.all.ratio or np.inf)
    )


def everybody_table(ranked: Sequence[Ranked]) -> str:
    """All candidates; those without a place last, with the reason."""
    rows = []
    for i, one in enumerate(ranked, 1):
        unsure = one.checked - one.converged
        reasons = [f"{one.over_none.lost} lost"] if one.over_none.lost else []
        reasons += [f"{unsure} of {one.checked} not converged"] if unsure > UNCONVERGED else []
        rows.append(
            [
                str(i) if one.place else "",
                one.who.label,
                "" if one.who.score is None else f"{one.who.score:.2f}",
                percent(one.over_none),
                f"{one.over_none.kept}",
                f"{100.0 * one.saturated:.0f} %",
                f"{100.0 * one.tripped:.0f} %",
                ", ".join(reasons),
            ]
        )
    titles = ["", "controller", "training", "ITAE relative to no control", "kept", "saturated", "tripped"]
    titles += ["why not ranked"]
    return "\n".join(terminal.table(titles, rows, 2, markdown=True))


def answer_table(answers: Sequence[Answer], *events: str) -> str:
    """Pairs side by side, with some of the events by name."""
    rows = [
        [one.who, one.against, percent(one.new_events), percent(one.new_conditions)]
        + [percent(one.events[event]) if event in one.events else "-" for event in events]
        for one in answers
    ]
    titles = ["controller", "relative to", "new events", "new conditions", *events]
    return "\n".join(terminal.table(titles, rows, 2, markdown=True))


# The picture


def picture(told: Judgement) -> Figure:
    """ITAE of finalists beside no control: by event, and by added delay."""
    own = in_order(told)
    events = list(own[0].events)
    values = np.array([[_log(one.events[event]) for event in events] for one in own])
    figure = Figure(figsize=(15.0, 2.6 + 0.32 * len(own)), layout="constrained")
    axes: Any = figure.subplots(1, 2, width_ratios=[2.2, 1.0])
    norm = TwoSlopeNorm(0.0, vmin=RANGE[0], vmax=RANGE[1])
    axes[0].imshow(values, cmap="RdBu_r", norm=norm, aspect="auto")
    for i, one in enumerate(own):
        for j, event in enumerate(events):
            found = one.events[event]
            text = ratio(found) if found.ratio is not None else "kept" if found.kept else "lost"
            weight = "normal" if found.better is None else "bold"
            dark = abs(norm(values[i, j]) - 0.5) > 0.3 if np.isfinite(values[i, j]) else False
            axes[0].text(
                j, i, text, ha="center", va="center", fontsize=7, fontweight=weight, color="white" if dark else "black"
            )
    axes[0].set_xticks(range(len(events)), events, rotation=35, ha="right")
    axes[0].set_yticks(range(len(own)), [one.who for one in own])
    axes[0].set_title("ITAE relative to no control, by event (bold: the interval excludes 0)", fontsize="medium")
    for k, borne in enumerate(told.borne):
        known = [(1000.0 * d, f.ratio) for d, f in sorted(borne.by_delay.items()) if f.ratio is not None]
        style = {"color": COLOURS[k % len(COLOURS)], "ls": ("-", "--", ":", "-.")[k // len(COLOURS) % 4]}
        axes[1].plot(*np.array(known).reshape(-1, 2).T, label=borne.who.label, lw=1.2, **style)
    axes[1].axhline(1.0, color="0.4", lw=0.8)
    axes[1].set(yscale="log", xlabel="more delay, ms", ylabel="ITAE relative to no control", ylim=(0.14, 1.3))
    axes[1].grid(visible=True, color="0.92")
    axes[1].set_yticks(shown := [0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0], [f"{one:g}" for one in shown], minor=False)
    axes[1].set_yticks([], minor=True)
    axes[1].legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.07))
    return figure


def delay_table(told: Judgement) -> str:
    """Up to which added delay each is better than no control, and what it is over that at some."""
    shown = [delay for delay in told.borne[0].by_delay if round(1000 * delay) % 100 == 0]
    rows = [
        [one.who.label, span(one), *(ratio(one.by_delay[delay]) for delay in shown)]
        for one in sorted(told.borne, key=lambda one: -(one.helps_to if one.helps_to is not None else -1.0))
    ]
    titles = ["controller", "up to, ms", *(f"{1000 * delay:.0f} ms more" for delay in shown)]
    return "\n".join(terminal.table(titles, rows, 1, markdown=True))


def lost_table(answers: Sequence[Answer]) -> str:
    """Who has two devices, with one of them lost."""
    events = list(answers[0].events) if answers else []
    rows = [[one.who, *(percent(one.events[event]) for event in events)] for one in answers]
    return "\n".join(terminal.table(["controller", *events], rows, 1, markdown=True))


def _log(found: Effect) -> float:
    return np.nan if found.ratio is None else float(np.log(found.ratio))
