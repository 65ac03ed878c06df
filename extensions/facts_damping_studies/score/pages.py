"""A card as text, as a page with a picture, and a ranking of cards."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from pyarrow import csv

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping_studies.score.card import NONE, NOTICED
from facts_damping_studies.sweeps.results import table as arrow

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_studies.score.card import Set
    from facts_damping_studies.score.score_card import ScoreCard
    from facts_damping_studies.score.statistics import Estimate

TICKS = (-90, -75, -50, 0, 100, 300, 900)  # %


def change_text(change: Estimate) -> str:
    """A change with its interval, `-29 % [-39, -16]`."""
    percent, low, high = (f"{value:+.0f}" if abs(value) >= 0.5 else "0" for value in change)
    return f"{percent} % [{low}, {high}]"


def answer(card: ScoreCard) -> list[str]:
    """The card in a few sentences."""
    against = [f"{other}: {change_text(change)}" for other, change in card.against.items()]
    harm = ", ".join(card.does_harm) or "in no kind of case"
    duty = f"at a limit {100 * card.saturated:.1f} % of the time"
    lines = [
        f"{card.controller}: score {card.score:.1f} ({card.set}, {len(card.cases)} cases)",
        f"index relative to no control: {change_text(card.change)}",
        *([f"relative to others: {'; '.join(against)}"] if against else []),
        f"worse than no control: {harm}",
        f"synchronism lost in {card.lost} cases, without control in {card.lost_without_control}",
        f"taken off by a supervisor in {card.tripped} of {len(card.cases)} cases",
        *([f"better than no control up to {delays(card)} more delay"] if has_delays(card) else []),
        f"mean setpoint {100 * card.effort:.1f} % of the limit; {duty}",
    ]
    if card.hunted is not None:
        lines.append(f"ITAE in the worst of {card.hunted.cases} hunted cases: {worst_text(card)}")
    if card.score <= 0.0:
        lines.insert(1, "It cannot be said to be better than no control.")
    return lines


def worst_text(card: ScoreCard) -> str:
    """The worst hunted case: ITAE relative to no control, kind of the case and fault; - if there is none."""
    worst = None if card.hunted is None else card.hunted.worst
    return f"{worst.ratio:.3g} times ({worst.kind}, {worst.fault})" if worst is not None and worst.ratio else "-"


def has_delays(card: ScoreCard) -> bool:
    """Whether its set has kinds of cases with more delay."""
    return any(kind.startswith("delay ") for kind in card.kinds)


def delays(card: ScoreCard) -> str:
    """The largest delay of the kinds `delay ...` up to which a controller is better than no control."""
    last = "0 ms"
    for kind, row in card.kinds.items():
        if kind.startswith("delay "):
            if row.change.high > -NOTICED:
                break
            last = kind.removeprefix("delay ")
    return last


def kinds_table(card: ScoreCard, *, markdown: bool = False) -> list[str]:
    """A row for each kind of cases."""
    rows = [
        [kind, str(row.cases), change_text(row.change), str(row.lost), str(row.tripped)]
        for kind, row in card.kinds.items()
    ]
    heads = ["cases", "number", "index relative to no control", "lost", "tripped"]
    return table(heads, rows, 1, markdown=markdown)


WORST = "ITAE in the worst hunted case"  # the last column, if cases were hunted


def ranking_table(cards: Sequence[ScoreCard], *, markdown: bool = False) -> list[str]:
    """A row for each card, and one for no control."""
    columns: dict[str, list[Any]] = {
        "controller": [card.controller for card in cards],
        "score": [f"{card.score:.1f}" for card in cards],
        "index relative to no control": [change_text(card.change) for card in cards],
        "lost": [card.lost for card in cards],
        "tripped": [card.tripped for card in cards],
        "helps to a delay of": [delays(card) for card in cards],
        "harm": [_harm(card) or "-" for card in cards],
        WORST: [worst_text(card) for card in cards],
    }
    if not has_delays(cards[0]):
        del columns["helps to a delay of"]
    if cards[0].hunted is None:
        del columns[WORST]
    none = {"controller": NONE, "score": "0", "lost": cards[0].lost_without_control}
    at = next((i for i, card in enumerate(cards) if card.score < 0.0), len(cards))
    for name, values in columns.items():
        values.insert(at, none.get(name, ""))
    return table(list(columns), list(zip(*columns.values(), strict=True)), 1, markdown=markdown)


def _harm(card: ScoreCard) -> str:
    return ", ".join(card.does_harm)


def ranked(cards: Sequence[ScoreCard]) -> list[dict[str, Any]]:
    """The cards as rows of a file: score, change of the index in per cent, lost cases, where a controller helps."""
    return [
        {
            "controller": card.controller,
            "score": card.score,
            **card.change._asdict(),
            "lost": card.lost,
            "tripped": card.tripped,
            "helps_to": delays(card),
            "harm": _harm(card),
            **({} if card.hunted is None else {"worst": worst_text(card)}),
        }
        for card in cards
    ]


def write_ranking(cards: Sequence[ScoreCard], folder: Path) -> list[Path]:
    """Write `ranking.csv` and `ranking.png`; return the paths."""
    csv.write_csv(arrow(ranked(cards)), folder / "ranking.csv")
    return [folder / "ranking.csv", plot(cards, folder / "ranking.png")]


def plot(cards: Sequence[ScoreCard], path: Path) -> Path:
    """Change of the index in each kind of cases, with intervals: a colour for each card."""
    kinds = list(cards[0].kinds)
    figure = Figure(figsize=(6.5, 1.6 + 0.42 * len(kinds)), layout="constrained")
    axes = figure.subplots()
    step = min(0.16, 0.8 / len(cards))
    for i, (card, colour) in enumerate(zip(cards, COLOURS, strict=False)):
        changes = [card.kinds[kind].change for kind in kinds]
        at = [j + step * (i - (len(cards) - 1) / 2) for j in range(len(kinds))]
        low, high = [_ratio(change.low) for change in changes], [_ratio(change.high) for change in changes]
        axes.hlines(at, low, high, color=colour, lw=1.2)
        axes.plot([_ratio(change.percent) for change in changes], at, "o", ms=4, color=colour, label=_name(card))
    axes.axvline(1.0, color="black", lw=0.8)
    axes.set_yticks(range(len(kinds)), kinds)
    axes.invert_yaxis()
    axes.set(xscale="log", xlim=(0.08, 12.0), xlabel="index relative to no control [%]; left is better")
    axes.set_xticks([_ratio(percent) for percent in TICKS], [f"{percent:+d}" for percent in TICKS])
    axes.set_xticks([], minor=True)
    axes.grid(visible=True, axis="x", lw=0.3)
    figure.legend(fontsize="small", frameon=False, loc="outside lower center", ncols=2)
    return save_picture(figure, path)


def _name(card: ScoreCard) -> str:
    """A card's name in a picture, with what went wrong in its cases."""
    counts = {"lost": card.lost, "tripped": card.tripped}
    wrong = [f"{word} {count}" for word, count in counts.items() if count]
    return f"{card.controller} ({', '.join(wrong)} of {len(card.cases)})" if wrong else card.controller


def _ratio(percent: float) -> float:
    return max(1.0 + percent / 100.0, 0.01)


def write(case_set: Set, cards: Sequence[ScoreCard], folder: Path) -> list[Path]:
    """Write `card.json`, `card.md` and `card.png` of the first card beside the others; return the paths."""
    first = cards[0]
    picture = plot(cards, folder / "card.png")
    kinds = [f"- **{kind}**: {text}" for kind, text in case_set.content.kinds.items()]
    lines = [
        f"# {first.controller}",
        "",
        *(f"{line}  " for line in answer(first)),
        "",
        "![Index relative to no control in each kind of cases](card.png)",
        "",
        *kinds_table(first, markdown=True),
        "",
        *kinds,
        "",
        f"Cases: {first.set}, digest {first.set_digest}. The index is ITAE of the response to the events, or the",
        f"rms of the speed differences without an event. It is compared with that of {NONE} in the same case.",
    ]
    write_whole(folder / "card.md", "\n".join(lines) + "\n")
    write_whole(folder / "card.json", json.dumps(first.document(), indent=2) + "\n")
    return [folder / "card.md", folder / "card.json", picture]
