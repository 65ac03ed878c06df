"""The page of a fault campaign, and its tables as files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.input_files import share_folder
from facts_damping.output.writing import write_whole
from facts_damping_studies.campaigns.campaign_tables import (
    WORDS,
    Table,
    cause,
    controller_table,
    cost_table,
    fault_table,
    grid_table,
    healthy_table,
    invariant_table,
    limit_table,
    missed_table,
    most_frequent,
    outcome_table,
    place_table,
    taken_off,
)
from facts_damping_studies.campaigns.faults import NOTHING
from facts_damping_studies.pages import as_csv

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_studies.campaigns.campaign import CampaignPlan
    from facts_damping_studies.campaigns.draw_rows import DrawRow

    Rows = Sequence[DrawRow]


def page(plan: CampaignPlan, rows: Rows, graphs: Rows, command: str) -> str:
    """The page of a campaign: the text beside its file, or a default one, with the tables inserted."""
    folder = share_folder() / "config" / "campaigns"
    page_path = folder / f"{plan.name}.md"
    text = (page_path if page_path.is_file() else folder / "any.md").read_text(encoding="utf-8")
    about = {"name": [plan.name], "description": [plan.campaign.description], "command": [f"    {command}"]}
    tables = {key: table.markdown() for key, table in sections(rows, graphs).items()}
    for key, lines in {**about, **tables, "counts": [f"{counts(rows)}."]}.items():
        text = text.replace(f"{{{{{key}}}}}", "\n".join(lines) or "None was made.")
    return text


def write_tables(rows: Rows, graphs: Rows, folder: Path) -> list[Path]:
    """Every table that has a row, as CSV: `table_faults.csv` and so on (docs/supervision_results.md)."""
    paths = []
    for name, table in sections(rows, graphs).items():
        if table.rows:
            paths.append(folder / f"table_{name}.csv")
            write_whole(paths[-1], as_csv(table.titles, table.rows))
    return paths


def overview(rows: Rows, graphs: Rows) -> list[str]:
    """Summary for a terminal."""
    tables = sections(rows, graphs)
    shown = [counts(rows), *interventions(rows), ""]
    for name in ("invariants", "outcomes", "healthy"):
        shown += [*tables[name].markdown(), ""]
    return [*shown, f"{len(graphs)} graphs", *tables["graphs"].markdown()] if graphs else shown[:-1]


def sections(rows: Rows, graphs: Rows) -> dict[str, Table]:
    """All tables of a campaign, by name."""
    good = [row for row in rows if row.error is None]
    wrong = [row for row in good if row.drawn.wrong]
    tables = {
        "invariants": invariant_table(good),
        "outcomes": outcome_table(good),
        "healthy": healthy_table(good),
        "missed": missed_table(good),
        "limits": limit_table(good if all("limit" in row.drawn.labels for row in good) else []),
        "wrong": invariant_table(wrong, ("does_no_harm",)),
        "faults": fault_table(good),
        "controllers": controller_table(good),
        "places": place_table(good),
        "cost": cost_table(good),
        "grid": grid_table(good if any(row.unsupervised is not None for row in good) else []),
    }
    sound = [row for row in graphs if row.error is None]
    return tables | {"graphs": invariant_table(sound, tuple(WORDS) if sound else ())}


def interventions(rows: Rows) -> list[str]:
    """How many controllers supervisors took off or never armed, and the violations, one line each."""
    good = [row for row in rows if row.error is None]
    off, never = [row for row in good if taken_off(row)], [row for row in good if row.actions.armed_s is None]
    broken = sum(not row.holds for row in good)
    lines = [f"{len(off)} fell back or were tripped: {most_frequent(off, cause)}"] if off else []
    if never:
        lines.append(f"{len(never)} never armed: {most_frequent(never, lambda row: row.actions.not_armed or '-')}")
    return [*lines, f"{broken} with a requirement violated" if broken else "no requirement violated"]


def counts(rows: Rows) -> str:
    """The numbers of cases as a sentence."""
    errors = sum(row.error is not None for row in rows)
    horizons = " or ".join(f"{each:g}" for each in sorted({row.horizon_s or 0.0 for row in rows if row.error is None}))
    kinds = len({row.drawn.fault for row in rows if row.error is None} - {NOTHING})
    faults = {0: "without a fault", 1: "with one fault"}.get(kinds, f"with {kinds} faults")
    return f"{len(rows)} cases {faults}, of {horizons} s each" + (f", {errors} with an error" if errors else "")
