"""All that the pages are made of: every run of the tables, of the ensembles, behind a link, of other set-ups."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import check_known
from facts_damping.output.terminal import Progress
from facts_damping.parameters import files
from facts_damping_reproduction import explanations, pictures, runs
from facts_damping_reproduction.operations import complexity
from facts_damping_reproduction.printed import COMPLEXITY, LLC, SCENARIOS, TABLES, ControllerId, cells
from facts_damping_studies.sweeps.enumerated_axes import every_scheme
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from facts_damping_reproduction.agreement import ComparedRun
    from facts_damping_reproduction.explanations import Told
    from facts_damping_reproduction.operations import Count
    from facts_damping_reproduction.printed import Cell
    from facts_damping_studies.parameters import Study

    Row = dict[str, Any]

OPERATIONS = "3.1"
TITLES = {OPERATIONS: COMPLEXITY, **{number: table.title for number, table in TABLES.items()}}
LINK = "pdci_100ms"
# What the search found without and with delay (docs/search.md), as run files; lead-lags beside, by the same search.
FOUND: dict[str, list[ControllerId]] = {
    system: [
        ControllerId(runs.FILE, f"{tuning}_{system}{link}", None)
        for tuning in ("best", "lead_lag")
        for link in ("", "_pdci")
    ]
    for system in SCENARIOS
}
# Networks that they are held against behind the link.
RIVALS = tuple(ControllerId("MISO", *network_and_scheme) for network_and_scheme in every_scheme(["ANFTSC", "HBsWC"]))
VARIANT_TABLES = ("4.1", "4.2", "5.1", "5.3")


class Results(NamedTuple):
    """What was computed; `ensembles` and `delayed` hold the rows of each system and scenario, draw by draw."""

    tables: tuple[str, ...]
    draws: int | None
    complexity: list[Count]
    cells: list[Cell]
    figures: dict[ComparedRun, dict[str, float] | None]
    ensembles: dict[tuple[str, str], list[Row]]
    delayed: dict[tuple[str, str], list[Row]]
    told: list[Told]
    pictures: list[Path]
    not_converged: frozenset[ComparedRun] = frozenset()  # of the runs of the tables


def gather(tables: Sequence[str], draws: int | None, folder: Path, jobs: int) -> Results:
    """Compute tables (none: all) from scratch, in a folder that keeps what was run.

    `draws`: of each ensemble; none: as its file says. Raises `InputError` for an unknown table.
    """
    for table in tables:
        check_known("TABLE", table, TITLES)
    asked = tuple(number for number in TITLES if number in tables or not tables)
    printed_cells = cells([number for number in asked if number in TABLES])
    systems = list(dict.fromkeys(cell.system for cell in printed_cells))
    counted = complexity() if OPERATIONS in asked else []
    figures: dict[ComparedRun, dict[str, float] | None] = {}
    ensembles: dict[tuple[str, str], list[Row]] = {}
    delayed: dict[tuple[str, str], list[Row]] = {}
    unsure: set[ComparedRun] = set()
    rows = partial(_rows, files.new_folder(folder / "runs"), jobs)
    for system in systems:
        whos, best_found = runs.whos(printed_cells, system), FOUND[system]
        few = [*runs.LINEAR, *(rival for rival in RIVALS if rival in whos)]
        plain = rows(system, {"": whos, "-found": best_found}, partial(runs.nominal, system, check_step=True))
        figures |= runs.figures(plain, [*whos, *best_found])
        unsure |= runs.not_converged(plain, [*whos, *best_found])
        for scenario in SCENARIOS[system].values():
            place, title = (system, scenario), f"{system}-{scenario}"
            make = partial(runs.ensemble, system, scenario, draws=draws)
            ensembles[place] = rows(title, {"": whos, "-found": best_found}, make)
            delayed[place] = rows(f"{title}-{LINK}", {"": few, "-found": best_found}, partial(make, link=LINK))
    told_rows = _variants([number for number in asked if number in VARIANT_TABLES], figures, rows)
    drawn = _pictures(asked, folder, jobs)
    return Results(
        asked, draws, counted, printed_cells, figures, ensembles, delayed, told_rows, drawn, frozenset(unsure)
    )


def _rows(
    journals: Path,
    jobs: int,
    title: str,
    groups: dict[str, list[ControllerId]],
    make: Callable[[list[ControllerId]], Study],
) -> list[Row]:
    """The rows of groups of controllers by the ends of their titles: a study each, so that one may change alone."""
    return [
        row
        for end, controllers in groups.items()
        for row in runs.carry_out(make(controllers), title + end, journals, jobs)
    ]


def _variants(
    tables: Sequence[str], base: dict[ComparedRun, dict[str, float] | None], rows: Callable[..., list[Row]]
) -> list[Told]:
    """The tables of improvements with other set-ups; `base`: figures of the set-up of the tables."""
    agreement = []
    printed_cells = cells(tables)
    for variant in explanations.TABLE if tables else ():
        variant_cells = [cell for cell in printed_cells if cell.system in variant.systems]
        figures: dict[ComparedRun, dict[str, float] | None] = {}
        for system in dict.fromkeys(cell.system for cell in variant_cells):
            whos = [who for who in runs.whos(variant_cells, system) if who == LLC or who.scheme]
            more = None if variant.more is None else partial(variant.more, system)
            make = partial(runs.nominal, system, more=more, **variant.fields)
            title = f"{system}-{variant.name.replace(' ', '-').replace('/', '-')}"
            figures |= runs.figures(rows(title, {"": whos}, make), whos)
        agreement += explanations.told(variant.name, variant_cells, figures, base)
    return agreement


def _pictures(tables: Sequence[str], folder: Path, jobs: int) -> list[Path]:
    """Pictures of responses, distributions, and what is learnt, several at a time."""
    progress = Progress("pictures", "pictures")
    try:
        return run_all(partial(pictures.plot, folder), pictures.wanted(tables), jobs, progress)
    finally:
        progress.close()
