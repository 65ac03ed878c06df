"""Output of a search: the winner's run file, and the ranking as rows, a table and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.output.tables import table
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Tuned, TunedController
from facts_damping.parameters.yaml_text import dump
from facts_damping_studies.search.scoring import REFERENCE, trained_on
from facts_damping_studies.sweeps.enumerated_axes import NONE, SCENARIO

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_studies.search.scoring import Score
    from facts_damping_studies.search.search import Entry, SearchTask

REFERENCES = {REFERENCE: "LLC-tuned as shipped", NONE: "no control"}


def run_file(task: SearchTask, command: str, entry: Entry) -> str:
    """A run file of an entry on the training scenario, with the command and the scores as a heading."""
    fields = ("name", "scheme", "devices", "signals", "compensation", "parameters")
    controller_row = entry.controller.model_dump() if entry.controller else {}
    link = task.link or ("ideal" if task.profile == DEFAULT_PROFILE else None)
    name = f"{entry.structure.name} {entry.structure.scheme or ''}".strip()
    content = {
        "description": f"{task.system}: {name}, as a search chose it",
        "profile": None if task.profile == DEFAULT_PROFILE else task.profile,
        "system": task.system,
        "scenario": trained_on(task.system, task.study, task.profile),
        "devices": list(entry.structure.devices),
        "controllers": [{key: controller_row[key] for key in fields if controller_row.get(key) is not None}],
        "link": link,
        "seed": 0,
    }
    content = {name: value for name, value in content.items() if value is not None}
    reached, fresh = entry.scores[-2:]
    head = [
        f"# {command}",
        f"# On the training cases that chose its parameters: score {reached.value:.4f}; {_percent(reached)}.",
        f"# On training cases that no search had seen: score {fresh.value:.4f}; {_percent(fresh)}.",
        f"# Percent: geometric mean of the index over that of {REFERENCES[task.against]}, less 1 (docs/search.md).",
    ]
    return "\n".join([*head, dump(content)])


def tuned(task: SearchTask, command: str, entries: Sequence[Entry]) -> Tuned:
    """All structures searched to the end, the best first, as a parameter file; all command the same devices."""
    maximum = max(len(entry.scores) for entry in entries)
    last = [(e.structure, e.controller, e.scores[-1]) for e in entries if e.controller and len(e.scores) == maximum]
    signals = max((structure.signals for structure, _, _ in last), key=len)
    return Tuned(
        system=task.system,
        profile=task.profile,
        scenario=SCENARIO,
        signals=signals,
        devices=list(task.devices),
        command=command,
        controllers=[
            TunedController(
                name=structure.name,
                scheme=structure.scheme,
                compensation=controller.compensation,  # type: ignore[arg-type]
                objective=float(f"{score.value:.5g}"),
                parameters=controller.parameters,
            )
            for structure, controller, score in last
        ],
    )


def _percent(score: Score) -> str:
    changes = ", ".join(f"{name} {100 * (r - 1):+.1f} %" for name, r in score.ratios.items()) or "synchronism lost"
    return changes + (f"; tripped in {100 * score.tripped:.0f} % of the cases" if score.tripped else "")


def rows(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """The ranking for JSON, the best first."""
    return [
        {
            "rank": i,
            "controller": entry.structure.name,
            "scheme": entry.structure.scheme,
            "devices": list(entry.structure.devices),
            "signals": entry.structure.signals,
            "compensation": entry.controller.compensation if entry.controller else None,
            "scores": [score.value for score in entry.scores],
            "ratios": [score.ratios for score in entry.scores],
            "undamped": [score.undamped for score in entry.scores],
            "tripped": [score.tripped for score in entry.scores],
            "parameters": entry.controller.parameters if entry.controller else {},
        }
        for i, entry in enumerate(entries, 1)
    ]


def search_table(entries: Sequence[Entry]) -> list[str]:
    """The ranking in Markdown: scores, the last on fresh draws, and what went wrong on the draws of an entry's last."""
    maximum = max(len(entry.scores) for entry in entries)
    titles = ["controller", "scheme", "devices", "compensation", *(f"rung {i}" for i in range(maximum - 1)), "fresh"]
    wrong = any(_wrong(entry.scores[-1]) != "-" for entry in entries)
    titles += ["draws of the last score"] if wrong else []
    cells = []
    for entry in entries:
        structure = entry.structure
        compensation = entry.controller.compensation if entry.controller else None
        scores = [f"{score.value:.3f}" for score in entry.scores] + [""] * (maximum - len(entry.scores))
        scores += [_wrong(entry.scores[-1])] if wrong else []
        cells.append([structure.name, structure.scheme or "-", "+".join(structure.devices), compensation, *scores])
    return table(titles, cells, left=4, markdown=True)


def _wrong(score: Score) -> str:
    """What went wrong on the draws of a score."""
    if not score.ratios:
        return "synchronism lost" + (f", {100 * score.tripped:.0f} % tripped" if score.tripped else "")
    fractions = {"not damped": score.undamped, "tripped": score.tripped}
    return ", ".join(f"{100 * part:.0f} % {word}" for word, part in fractions.items() if part) or "-"
