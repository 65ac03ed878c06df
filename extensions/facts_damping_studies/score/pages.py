"""A card as text, as a page with a picture and as a file, and a ranking of cards."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from pyarrow import csv

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping_studies.score.cases.kinds import KINDS
from facts_damping_studies.score.entries import NONE, document
from facts_damping_studies.sweeps.results import table as arrow

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping_studies.score.cases.sets import Set
    from facts_damping_studies.score.entries import Entry
    from facts_damping_studies.score.score_card import ScoreCard
    from facts_damping_studies.score.statistics import Estimate, Score

NOTICED = 1.0  # %; a smaller change is none
TICKS = (-96, -90, -75, -50, 0, 100, 300, 900)  # %
MARKERS = "os^D"  # for each round of colours


def change_text(change: Estimate) -> str:
    """A change with its interval, `-29 % [-39, -16]`."""
    percent, low, high = (f"{value:+.0f}" if abs(value) >= 0.5 else "0" for value in change)
    return f"{percent} % [{low}, {high}]"


def score_text(score: Score) -> str:
    """A score with its interval, `39.5 [35.1, 43.0]`."""
    return f"{score.value:.1f} [{score.low:.1f}, {score.high:.1f}]"


def answer(card: ScoreCard) -> list[str]:
    """The card in a few sentences."""
    against = [f"{other}: {change_text(change)}" for other, change in card.against.items()]
    knows = f"division {card.entry.division}, " if card.entry.division else ""
    lines = [
        f"{card.controller}: score {score_text(card.score)} ({card.set}, {knows}{len(card.entry.cases)} cases)",
        *([f"disqualified: {card.disqualified}"] if card.disqualified else []),
        *([] if card.score.low > 0.0 else ["It cannot be said to be better than no control."]),
        f"without its supervisor: score {score_text(card.unsupervised)}",
        f"index relative to no control: {change_text(card.change)}",
        *([f"relative to others: {'; '.join(against)}"] if against else []),
        f"in group {card.group} of {card.groups}; the best of all with a probability of {card.best:.2g}",
        f"worse than no control: {', '.join(card.does_harm) or 'in no kind of case'}",
        f"synchronism lost in {card.lost} cases, without control in {card.lost_without_control}",
        f"taken off by a supervisor in {card.tripped} of {len(card.entry.cases)} cases",
        *([f"better than no control up to {delays(card)} more delay"] if has_delays(card) else []),
        f"mean setpoint {100 * card.effort:.1f} % of the limit, at it {100 * card.saturated:.1f} % of the time",
        f"setpoints move {card.travel:.3g} times their limit a second",
        *_limits_text(card),
    ]
    if card.hunted is not None:
        lines.append(f"ITAE in the worst of {card.hunted.cases} hunted cases: {worst_text(card)}")
    return lines


def _limits_text(card: ScoreCard) -> list[str]:
    """The worst of voltage and frequency, and the computing time of users' programs."""
    lines = []
    if card.worst is not None:
        voltages = f"voltages {card.worst.lowest:.2f} to {card.worst.highest:.2f} p.u."
        beyond = f"{len(card.violations)} cases beyond limits only with it"
        lines.append(f"worst after the events: {card.worst.frequency_hz:.2g} Hz, {voltages}; {beyond}")
    if card.entry.confined:
        held = ", ".join(card.entry.confined)
        lines.append(f"computing time {100 * card.computing:.2g} % of real time; held apart by {held}")
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
        [
            _kind_name(card, kind),
            f"{row.cases}, {row.events}",
            change_text(row.change),
            str(row.lost),
            str(row.tripped),
        ]
        for kind, row in card.kinds.items()
    ]
    heads = ["cases", "number, events", "index relative to no control", "lost", "tripped"]
    return table(heads, rows, 1, markdown=markdown)


def _kind_name(card: ScoreCard, kind: str) -> str:
    return f"{kind} (beside)" if kind in card.beside else kind


WORST = "ITAE in the worst hunted case"  # the last column, if cases were hunted


def ranking_table(cards: Sequence[ScoreCard], *, markdown: bool = False) -> list[str]:
    """A row for each card, and one for no control."""
    columns: dict[str, list[Any]] = {
        "controller": [card.controller for card in cards],
        "group": [card.group or "" for card in cards],
        "score": [_score_of(card) for card in cards],
        "without supervisor": [f"{card.unsupervised.value:.1f}" for card in cards],
        "division": [card.entry.division for card in cards],
        "lost": [card.lost for card in cards],
        "tripped": [card.tripped for card in cards],
        "helps to a delay of": [delays(card) for card in cards],
        "harm": [_harm(card) or "-" for card in cards],
        WORST: [worst_text(card) for card in cards],
    }
    if not has_delays(cards[0]):
        del columns["helps to a delay of"]
    if all(card.hunted is None for card in cards):
        del columns[WORST]
    none = {"controller": NONE, "score": "0", "lost": cards[0].lost_without_control}
    at = next((i for i, card in enumerate(cards) if card.score.value < 0.0 or card.disqualified), len(cards))
    for name, values in columns.items():
        values.insert(at, none.get(name, ""))
    return table(list(columns), list(zip(*columns.values(), strict=True)), 1, markdown=markdown)


def _score_of(card: ScoreCard) -> str:
    return "disqualified" if card.disqualified else score_text(card.score)


def _harm(card: ScoreCard) -> str:
    return ", ".join(card.does_harm)


def ranked(cards: Sequence[ScoreCard]) -> list[dict[str, Any]]:
    """The cards as rows of a file: score, change of the index in per cent, lost cases, where a controller helps."""
    return [
        {
            "controller": card.controller,
            "division": card.entry.division,
            "group": card.group,
            "score": card.score.value,
            "score_low": card.score.low,
            "score_high": card.score.high,
            "unsupervised": card.unsupervised.value,
            **card.change._asdict(),
            "best": card.best,
            "lost": card.lost,
            "tripped": card.tripped,
            "violations": len(card.violations),
            "travel": card.travel,
            "computing": card.computing,
            "helps_to": delays(card),
            "harm": _harm(card),
            "disqualified": card.disqualified,
            **({} if card.hunted is None else {"worst": worst_text(card)}),
        }
        for card in cards
    ]


def write_ranking(case_set: Set, entries: Mapping[str, Entry], cards: Sequence[ScoreCard], folder: Path) -> list[Path]:
    """Write `ranking.csv`, `ranking.png`, and a file of each entry, which `cards/` takes; return the paths."""
    csv.write_csv(arrow(ranked(cards)), folder / "ranking.csv")
    paths = [folder / "ranking.csv", plot(cards, folder / "ranking.png")]
    by_name = {card.controller: card.document() for card in cards}
    for name, entry in entries.items():
        paths.append(folder / f"{_file_name(name)}.json")
        write_whole(paths[-1], as_json(by_name.get(name) or document(entry, case_set)))
    return paths


def _file_name(name: str) -> str:
    """A name as that of a file."""
    return re.sub(r"[^A-Za-z0-9@.-]+", "_", name).strip("_.")


def as_json(content: Mapping[str, Any]) -> str:
    """A card as JSON, with a line for each case."""
    lines = [f"{json.dumps(name)}: {_value(value)}" for name, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _value(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n  " + ",\n  ".join(json.dumps(row, allow_nan=False) for row in value) + "\n]"
    return json.dumps(value, allow_nan=False)


def plot(cards: Sequence[ScoreCard], path: Path) -> Path:
    """Change of the index in each kind of cases, with intervals: a colour for each card."""
    kinds = list(cards[0].kinds)
    figure = Figure(figsize=(6.5, 1.6 + 0.42 * len(kinds)), layout="constrained")
    axes = figure.subplots()
    step = min(0.16, 0.8 / len(cards))
    for i, card in enumerate(cards):
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i // len(COLOURS) % len(MARKERS)]
        changes = [card.kinds[kind].change for kind in kinds]
        at = [j + step * (i - (len(cards) - 1) / 2) for j in range(len(kinds))]
        low, high = [_ratio(change.low) for change in changes], [_ratio(change.high) for change in changes]
        axes.hlines(at, low, high, color=colour, lw=1.2)
        axes.plot([_ratio(change.percent) for change in changes], at, marker, ms=4, color=colour, label=_name(card))
    axes.axvline(1.0, color="black", lw=0.8)
    axes.set_yticks(range(len(kinds)), [_kind_name(cards[0], kind) for kind in kinds])
    axes.invert_yaxis()
    axes.set(xscale="log", xlim=(0.025, 12.0), xlabel="index relative to no control [%]; left is better")
    axes.set_xticks([_ratio(percent) for percent in TICKS], [f"{percent:+d}" for percent in TICKS])
    axes.set_xticks([], minor=True)
    axes.grid(visible=True, axis="x", lw=0.3)
    figure.legend(fontsize="small", frameon=False, loc="outside lower center", ncols=2)
    return save_picture(figure, path)


def _name(card: ScoreCard) -> str:
    """A card's name in a picture, with what went wrong in its cases."""
    counts = {"lost": card.lost, "tripped": card.tripped}
    wrong = [f"{word} {count}" for word, count in counts.items() if count]
    return f"{card.controller} ({', '.join(wrong)} of {len(card.entry.cases)})" if wrong else card.controller


def _ratio(percent: float) -> float:
    return max(1.0 + percent / 100.0, 0.01)


def write(case_set: Set, first: ScoreCard, cards: Sequence[ScoreCard], folder: Path) -> list[Path]:
    """Write `card.json`, `card.md` and `card.png` of a card among others; return the paths."""
    picture = plot(cards, folder / "card.png")
    kinds = [f"- **{kind}**: {KINDS[kind].text}" for kind in case_set.content.kinds]
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
    write_whole(folder / "card.json", as_json(first.document()))
    return [folder / "card.md", folder / "card.json", picture]
