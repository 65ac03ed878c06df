"""All that the pages are made of: every run of the tables, of the ensembles, behind a link, of other set-ups."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping import files
from facts_damping.errors import check_known
from facts_damping.reproduction import explanations, pictures, runs
from facts_damping.reproduction.operations import complexity
from facts_damping.reproduction.printed import COMPLEXITY, LLC, SCENARIOS, TABLES, Who, cells
from facts_damping.studies.pool import run_all
from facts_damping.terminal import Progress

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping.reproduction.agreement import Run
    from facts_damping.reproduction.explanations import Told
    from facts_damping.reproduction.operations import Count
    from facts_damping.reproduction.printed import Cell

OPERATIONS = "3.1"
TITLES = {OPERATIONS: COMPLEXITY, **{number: table.title for number, table in TABLES.items()}}
LINK = "pdci_100ms"
# What the search found without and with delay (docs/search.md), as run files; lead-lags beside, by the same search.
FOUND = {
    system: tuple(
        Who(runs.FILE, f"{one}_{system}{link}", None) for one in ("best", "lead_lag") for link in ("", "_pdci")
    )
    for system in SCENARIOS
}
VARIANT_TABLES = ("4.1", "4.2", "5.1", "5.3")


class Results(NamedTuple):
    """What was computed; `ensembles` and `delayed` hold the rows of each system and scenario, draw by draw."""

    tables: tuple[str, ...]
    draws: int | None
    complexity: list[Count]
    cells: list[Cell]
    figures: dict[Run, dict[str, float] | None]
    ensembles: dict[tuple[str, str], list[dict[str, Any]]]
    delayed: dict[tuple[str, str], list[dict[str, Any]]]
    told: list[Told]
    pictures: list[Path]


def gather(tables: Sequence[str], draws: int | None, folder: Path, jobs: int) -> Results:
    """Compute tables (none: all) from scratch, in a folder that keeps what was run.

    `draws`: of each ensemble; none: as its file says. Raises `InputError` for an unknown table.
    """
    for table in tables:
        check_known("TABLE", table, TITLES)
    asked = tuple(one for one in TITLES if one in tables or not tables)
    own = cells([one for one in asked if one in TABLES])
    systems = list(dict.fromkeys(cell.system for cell in own))
    counted = complexity() if OPERATIONS in asked else []
    journals = files.new_folder(folder / "runs")
    figures: dict[Run, dict[str, float] | None] = {}
    ensembles, delayed = {}, {}
    for system in systems:
        whos = [*runs.whos(own, system), *FOUND[system]]
        rows = runs.carry_out(runs.nominal(system, whos), system, journals, jobs)
        figures |= runs.figures(rows, whos)
        few = [*runs.BASELINES[1:], *_rivals(whos), *FOUND[system]]
        for scenario in SCENARIOS[system].values():
            place, title = (system, scenario), f"{system}-{scenario}"
            ensembles[place] = runs.carry_out(runs.ensemble(system, scenario, whos, draws), title, journals, jobs)
            study = runs.ensemble(system, scenario, few, draws, link=LINK)
            delayed[place] = runs.carry_out(study, f"{title}-{LINK}", journals, jobs)
    told = _variants([one for one in asked if one in VARIANT_TABLES], figures, journals, jobs)
    drawn = _pictures(asked, folder, jobs)
    return Results(asked, draws, counted, own, figures, ensembles, delayed, told, drawn)


def _rivals(whos: Sequence[Who]) -> list[Who]:
    """Networks that the found ones are held against behind a link, of those that are there."""
    wanted = [Who("MISO", one, scheme) for one in ("ANFTSC", "HBsWC") for scheme in ("direct", "indirect")]
    return [one for one in wanted if one in whos]


def _variants(tables: Sequence[str], base: dict[Run, dict[str, float] | None], journals: Path, jobs: int) -> list[Told]:
    """The tables of improvements with other set-ups; `base`: figures of the set-up of the tables."""
    found = []
    own = cells(tables)
    for variant in explanations.TABLE if tables else ():
        kept = [cell for cell in own if cell.system in variant.systems]
        figures: dict[Run, dict[str, float] | None] = {}
        for system in dict.fromkeys(cell.system for cell in kept):
            whos = [who for who in runs.whos(kept, system) if who == LLC or who.scheme]
            more = None if variant.more is None else partial(variant.more, system)
            title = f"{system}-{variant.name.replace(' ', '-').replace('/', '-')}"
            rows = runs.carry_out(runs.nominal(system, whos, more, **variant.fields), title, journals, jobs)
            figures |= runs.figures(rows, whos)
        found += explanations.told(variant.name, kept, figures, base)
    return found


def _pictures(tables: Sequence[str], folder: Path, jobs: int) -> list[Path]:
    """Pictures of responses, distributions, and what is learnt, several at a time."""
    progress = Progress("pictures", "pictures")
    try:
        return run_all(partial(pictures.draw, folder), pictures.wanted(tables), jobs, progress)
    finally:
        progress.close()
