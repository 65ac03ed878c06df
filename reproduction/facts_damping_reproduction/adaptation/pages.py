"""The page of the experiment: answers, a figure, and tables as CSV; all sentences follow from the results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from pyarrow import csv

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping_reproduction.adaptation import decide
from facts_damping_reproduction.adaptation.cases import EVENTS, KINDS
from facts_damping_reproduction.adaptation.decide import BETTER, OPEN, WORSE, Ratio
from facts_damping_reproduction.adaptation.experiment import plan
from facts_damping_reproduction.adaptation.laws import write_laws
from facts_damping_reproduction.templates import render
from facts_damping_studies.score.entries import NONE
from facts_damping_studies.sweeps.results import table as arrow

if TYPE_CHECKING:
    from pathlib import Path

MOVED = KINDS[1:]  # where the grid is not as it was designed for
FIXED = ("LLC-tuned", "LQG")
SAYS = {BETTER: "Yes", WORSE: "No, it is worse", decide.ALIKE: "No", OPEN: "It cannot be told"}
Every = Sequence[Mapping[str, Any]]  # the results of a set of devices: of an experiment, and of its repetitions
BEST = "the best fixed controller"
DRAWN = "kinds drawn, too"
OF_CASES = ("kinds", "events")  # what results have of each case
FILES = ("what_holds", "what_holds_both")  # of the laws that the searches found, by devices
OF_LAWS = {
    "system": "two_area",
    "profile": "deployment",
    "scenario": "what_holds",
    "command": "facts-damping reproduce --profile deployment",
}
ABOUT = "Laws of docs/what_holds.md, by the seeds of their searches; objective: mean log index relative to no control."


class Question(NamedTuple):
    """What is asked: an arm beside another, in some kinds of cases."""

    words: str
    arm: str
    against: str
    kinds: Sequence[str]


QUESTIONS = (
    Question(f"the neuro-fuzzy controller that learns against {BEST}", "neuro-fuzzy", BEST, MOVED),
    Question("the same, where the grid is as it was designed for", "neuro-fuzzy", BEST, KINDS[:1]),
    Question("learning against the same controller tuned without", "neuro-fuzzy", "neuro-fuzzy, not learning", MOVED),
    Question("learning on against stopping at the event", "neuro-fuzzy", "neuro-fuzzy, frozen at the event", MOVED),
    Question("an adaptive gain on the lead-lag", "LLC-tuned, adaptive gain", "LLC-tuned", MOVED),
    Question("an LQG for a model identified in the first minute", "LQG, model identified", "LQG", MOVED),
)


def questions(every: Every) -> list[Question]:
    """The questions that the arms permit, with the fixed controller that was best in training."""
    best = decide.best_fixed(every, FIXED)
    known = [question._replace(against=best) if question.against == BEST else question for question in QUESTIONS]
    return [question for question in known if {question.arm, question.against}.issubset(every[0]["arms"])]


def pairs(every: Every) -> list[tuple[str, str]]:
    """The pairs of arms that the questions compare, each once."""
    return list(dict.fromkeys((question.arm, question.against) for question in questions(every)))


def ratios(every: Every) -> list[Ratio]:
    """Every arm against no control, and the pairs of the questions, in each kind of cases and where the grid moved."""
    margin, kinds = plan()["margin"], [(kind,) for kind in KINDS]
    compared = dict.fromkeys([*((arm, NONE) for arm in every[0]["arms"]), *pairs(every)])
    return [decide.ratio(every, *pair, group, margin) for pair in compared for group in (*kinds, MOVED, KINDS)]


def of(comparisons: Sequence[Ratio], arm: str, against: str, kinds: Sequence[str]) -> Ratio:
    """One of the ratios."""
    return next(
        comparison
        for comparison in comparisons
        if (comparison.arm, comparison.against, comparison.kinds) == (arm, against, ", ".join(kinds))
    )


def answers(every: Every, comparisons: Sequence[Ratio]) -> list[str]:
    """The question's answers, one sentence each."""
    main, same, *others = questions(every)
    first, nominal = of(comparisons, *main[1:]), of(comparisons, *same[1:])
    cost = "it costs something" if nominal.decision == WORSE else "it is not shown to cost anything"
    moved, learns = "where the grid has moved or the model is wrong", "the neuro-fuzzy controller that learns"
    lines = [
        f"**{SAYS[first.decision]}**: {moved}, {learns} has {first.text()} against `{first.against}`.",
        f"Where the grid is as it was designed for, {cost}: {nominal.text()} against `{nominal.against}`.",
    ]
    for asked in others:
        comparison = of(comparisons, *asked[1:])
        lines.append(
            f"{asked.words[0].upper()}{asked.words[1:]}: {SAYS[comparison.decision].lower()}, {comparison.text()}."
        )
    return lines


def rows(ratios_by_devices: Mapping[str, Sequence[Ratio]]) -> list[dict[str, Any]]:
    """For the CSV: the ratios by the devices."""
    return [
        {"devices": devices, **comparison._asdict()}
        for devices, comparisons in ratios_by_devices.items()
        for comparison in comparisons
    ]


def arm_table(every: Every, comparisons: Sequence[Ratio]) -> list[str]:
    """A row for each arm: change against no control by kind, searches, damping, effort."""
    lines = []
    for arm in every[0]["arms"]:
        runs = [
            row for experiment in every for (name, _), some in experiment["rows"].items() if name == arm for row in some
        ]
        searched = [
            result for experiment in every for (name, _), result in experiment["searches"].items() if name == arm
        ]
        loops = f"{sum(result['loops'] for result in searched)}" if searched else "-"
        values = [result["value"] for result in searched]
        ends = f"{np.mean(values):.2f} ({np.std(values):.2f})" if values else "-"
        damping = [row["damping_ratio"] for row in runs if not row["lost"] and row["damping_ratio"] is not None]
        efforts = [row["effort"] for row in runs if not row["lost"]]
        lines.append(
            [
                arm,
                *(of(comparisons, arm, NONE, (kind,)).text() for kind in KINDS),
                f"{100 * np.median(damping):.1f}" if damping else "-",
                f"{100 * np.mean(efforts):.1f}" if efforts else "-",
                str(sum(row["lost"] for row in runs)) + f" of {len(runs)}",
                loops,
                ends,
            ]
        )
    heads = ["arm", *KINDS, "damping ratio, %", "effort, %", "lost", "training loops", "training, mean (spread)"]
    return table(heads, lines, 1, markdown=True)


def pair_table(every: Every, comparisons: Sequence[Ratio]) -> list[str]:
    """The pairs of the questions."""
    lines = [
        [
            arm,
            against,
            *(of(comparisons, arm, against, kinds).text() for kinds in (*((kind,) for kind in KINDS), MOVED)),
            of(comparisons, arm, against, MOVED).decision,
        ]
        for arm, against in pairs(every)
    ]
    return table(["arm", "against", *KINDS, "both of these", "decision"], lines, 2, markdown=True)


def event_ratios(every: Every, comparisons: Sequence[Ratio]) -> dict[str, list[Ratio]]:
    """The pairs of the questions where the grid moved, by the kind of event, and with kinds of events drawn, too."""
    of_kinds = {event: [of_event(some, event) for some in every] for event in EVENTS if event in every[0]["events"]}
    by_event = {
        event: [decide.ratio(experiments, *pair, MOVED, plan()["margin"]) for pair in pairs(every)]
        for event, experiments in of_kinds.items()
    }
    return {**by_event, DRAWN: [of(comparisons, *pair, MOVED) for pair in pairs(every)]}


def event_table(by_event: Mapping[str, Sequence[Ratio]]) -> list[str]:
    """A row for each pair of `event_ratios`."""
    drawn = by_event[DRAWN]
    lines = [
        [whole.arm, whole.against, *(comparisons[i].text() for comparisons in by_event.values()), whole.decision]
        for i, whole in enumerate(drawn)
    ]
    return table(["arm", "against", *by_event, "decision"], lines, 2, markdown=True)


def of_event(experiment: Mapping[str, Any], event: str) -> dict[str, Any]:
    """Results with the cases of a kind of event."""
    at = [i for i, name in enumerate(experiment["events"]) if name == event]
    rows_of_event = {key: [case_rows[i] for i in at] for key, case_rows in experiment["rows"].items()}
    return {**experiment, "rows": rows_of_event} | {name: [experiment[name][i] for i in at] for name in OF_CASES}


def repetitions(every: Mapping[int, Mapping[str, Any]], comparisons: Sequence[Ratio]) -> list[str]:
    """The answer of each repetition, by its seed, of all together (`comparisons`), and how many decide as these do."""
    lines = []
    for asked in questions(list(every.values())):
        first = of(comparisons, asked.arm, asked.against, asked.kinds)
        decisions = [
            decide.ratio([experiment], asked.arm, asked.against, asked.kinds, plan()["margin"])
            for experiment in every.values()
        ]
        alike = sum(decision.decision == first.decision for decision in decisions)
        cells = [f"{decision.text()}: {decision.decision}" for decision in (*decisions, first)]
        lines.append([asked.words, *cells, f"{alike} of {len(decisions)}"])
    heads = ["question", *(f"seed {seed}" for seed in every), "all together", "decide so"]
    return table(heads, lines, 1, markdown=True)


def plot(comparisons: Sequence[Ratio], path: Path) -> Path:
    """Change against no control by arm, a colour for each kind of cases."""
    arms = list(dict.fromkeys(comparison.arm for comparison in comparisons))
    figure = Figure(figsize=(6.5, 1.0 + 0.5 * len(arms)), layout="constrained")
    axes = figure.subplots()
    for i, (kind, colour) in enumerate(zip(KINDS, COLOURS, strict=False)):
        shown = [of(comparisons, arm, NONE, (kind,)) for arm in arms]
        at = [j + 0.2 * (i - 1) for j in range(len(arms))]
        axes.hlines(
            at,
            [comparison.low for comparison in shown],
            [comparison.high for comparison in shown],
            color=colour,
            lw=1.5,
        )
        axes.plot([comparison.ratio for comparison in shown], at, "o", color=colour, ms=5, label=kind)
    axes.set_yticks(range(len(arms)), arms)
    axes.invert_yaxis()
    axes.axvline(1.0, color="black", lw=0.8)
    ticks = [0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5]
    axes.set(xscale="log", xlabel="index relative to no control [%]; left is better")
    axes.set_xticks(ticks, [f"{100 * (tick - 1):+.0f}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.grid(visible=True, axis="x", lw=0.3)
    axes.legend(frameon=False, fontsize="small")
    return save_picture(figure, path)


def plot_searches(every: Every, path: Path) -> Path:
    """The best of training over the generations, a line for each search."""
    figure = Figure(figsize=(6.5, 3.6), layout="constrained")
    axes = figure.subplots()
    searches = [(arm, result) for result in every for (arm, _), result in result["searches"].items()]
    for arm, colour in zip(dict.fromkeys(arm for arm, _ in searches), COLOURS, strict=False):
        curves = [result["curve"] for name, result in searches if name == arm]
        for i, curve in enumerate(curves):
            axes.plot(np.arange(1, len(curve) + 1), curve, color=colour, lw=0.8, label=None if i else arm)
    axes.set(xlabel="generation", ylabel="best of training: log index relative to no control")
    axes.grid(visible=True, lw=0.3)
    axes.legend(frameon=False, fontsize="small")
    return save_picture(figure, path)


def by_devices(every: Mapping[int, Mapping[str, Mapping[str, Any]]]) -> dict[str, Every]:
    """The results of each set of devices that has some, from results by seed, then devices."""
    by_set = {name: [of_seed[name] for of_seed in every.values() if name in of_seed] for name in plan()["sets"]}
    return {name: experiments for name, experiments in by_set.items() if experiments}


def write(
    every: Mapping[int, Mapping[str, Mapping[str, Any]]], ratios_by_devices: Mapping[str, Sequence[Ratio]], folder: Path
) -> list[Path]:
    """The page, the figures, and all ratios as CSV; returns the paths.

    `every`: results by seed, then devices; `ratios_by_devices`: their ratios by devices.
    """
    (name, first), *others = by_devices(every).items()
    by_event = event_ratios(first, ratios_by_devices[name])
    csv.write_csv(arrow(rows(ratios_by_devices)), folder / "what_holds.csv")
    of_events = [{"event": event, **row._asdict()} for event, some in by_event.items() for row in some]
    csv.write_csv(arrow(of_events), folder / "by_event.csv")
    pictures = [plot(ratios_by_devices[name], folder / "what_holds.png"), plot_searches(first, folder / "searches.png")]
    values: dict[str, Any] = {
        "question": plan()["question"].strip(),
        "rule": plan()["rule"].strip(),
        "answers": "\n".join(f"- {line}" for line in answers(first, ratios_by_devices[name])),
        "arms": "\n".join(arm_table(first, ratios_by_devices[name])),
        "pairs": "\n".join(pair_table(first, ratios_by_devices[name])),
        "by_event": "\n".join(event_table(by_event)),
        "network": f"`{first[0]['network']['name']}` {first[0]['network']['scheme']}",
        "cases": str(len(first[0]["kinds"])),
        "seeds": str(plan()["search"]["seeds"]),
        "repeated": len(every) - 1,
        "repetitions": "\n".join(repetitions(dict(zip(every, first, strict=True)), ratios_by_devices[name])),
        "both": [
            {
                "arms": "\n".join(arm_table(experiments, ratios_by_devices[devices])),
                "pairs": "\n".join(pair_table(experiments, ratios_by_devices[devices])),
            }
            for devices, experiments in others
        ],
    }
    write_whole(folder / "what_holds.md", render("adaptation/what_holds.md", **values))
    laws = [
        write_laws(experiments[0]["searches"], folder / f"{name}.yaml", ABOUT, **OF_LAWS)
        for name, experiments in zip(FILES, by_devices(every).values(), strict=False)
    ]
    return [folder / "what_holds.md", *pictures, folder / "what_holds.csv", folder / "by_event.csv", *laws]
