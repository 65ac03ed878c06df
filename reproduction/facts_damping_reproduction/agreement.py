"""Our figures beside the printed ones: cell by cell, and how often the thesis's statements of better and worse hold.

A statement is an improvement with its sign: a printed one, or one that follows from two printed figures of roughness
(figures 5.11, 5.39, 6.22 and what is said beside them):

- `improvement`: an index against that of LLC or direct ANFTSC;
- `smoother than direct`: indirect against direct, the same controller (tables 5.2, 5.4);
- `smoother than MISO`: SSSC and STATCOM against the SSSC alone, both indirect, LLC against LLC (table 6.1);
- `smoother than LLC`: a network against LLC of the same architecture.

MISO columns of table 6.1 repeat table 5.4 and state nothing once more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.analysis.indices import improvement
from facts_damping.output import tables
from facts_damping_reproduction.printed import LLC, ControllerId

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from facts_damping_reproduction.printed import Cell

ALL = "all"
IMPROVEMENT, OVER_DIRECT, OVER_MISO, OVER_LLC = (
    "improvement",
    "smoother than direct",
    "smoother than MISO",
    "smoother than LLC",
)


class ComparedRun(NamedTuple):
    """What a run's figures are of."""

    system: str
    scenario: str
    who: ControllerId


Figures = Mapping[
    ComparedRun, Mapping[str, float] | None
]  # by ITAE ... ISE and `roughness`; none: the run was unstable


class Compared(NamedTuple):
    """A cell with ours; none where a run is without figures."""

    cell: Cell
    figure: float | None  # our index or roughness of the run itself
    ours: float | None  # what stands in the cell: improvement, %, or roughness
    difference: float | None  # ours - corrected
    converged: bool = True  # whether half the integration step leaves our figure as it is, as far as that was tried


class Statement(NamedTuple):
    """That one run is better than another, %, (4.109); negative: worse."""

    table: str
    scenario: str
    architecture: str
    controller: str
    scheme: str  # "" of LLC
    what: str
    quantity: str
    over: str  # name of the controller that it is compared with
    printed: float
    theirs: float  # as corrected
    ours: float | None
    agrees: bool  # ours has the sign of the corrected figure
    agrees_as_printed: bool


class Signs(NamedTuple):
    """How many statements of a table, and of a kind, hold; those without our figures do not."""

    table: str
    what: str
    statements: int
    agree: int
    agree_as_printed: int
    missing: int  # without our figures
    fraction: float
    fraction_as_printed: float


def compare(
    cells: Iterable[Cell], figures: Figures, not_converged: frozenset[ComparedRun] = frozenset()
) -> list[Compared]:
    """Ours of every cell; `not_converged`: runs whose figures depend on the integration step.

    Raises `KeyError` for a run that is not among the figures at all.
    """
    return [
        _compared(cell, figures)._replace(
            converged=not_converged.isdisjoint(
                ComparedRun(cell.system, cell.scenario, who) for who in (cell.who, cell.against) if who is not None
            )
        )
        for cell in cells
    ]


def statements(compared: Sequence[Compared]) -> list[Statement]:
    """What the tables state; of roughness what the cells given are enough for."""
    stated = [_improvement(c) for c in compared if c.cell.against is not None]
    smooth = {(c.cell.table, c.cell.scenario, c.cell.who): c for c in compared if c.cell.against is None}
    for (table, scenario, who), c in smooth.items():
        if table == "6.1" and who.architecture == "MISO":
            continue
        for what, over in _smoother(who):
            if (table, scenario, over) in smooth:
                stated.append(_roughness(what, c, smooth[table, scenario, over]))
    return stated


def contradictions(stated: Iterable[Statement]) -> list[Statement]:
    """The statements that our runs contradict: the sign differs, or a run has no figures."""
    return [s for s in stated if not s.agrees]


def signs(stated: Sequence[Statement]) -> list[Signs]:
    """Agreement of signs by table and kind of statement, then of each kind over all tables, then of everything."""
    pairs = dict.fromkeys((s.table, s.what) for s in stated)
    rows = [_signs(*pair, [s for s in stated if (s.table, s.what) == pair]) for pair in pairs]
    kinds = dict.fromkeys(s.what for s in stated)
    rows += [_signs(ALL, what, [s for s in stated if s.what == what]) for what in kinds]
    return [*rows, _signs(ALL, ALL, stated)] if stated else rows


def name(who: ControllerId) -> str:
    """A controller as text: `MISO ANFTSC direct`, `MISO LLC`."""
    return " ".join(part for part in who if part)


def flat(row: Any) -> dict[str, Any]:
    """A named tuple as a row of scalars, for CSV and JSON: the fields of tuples in it beside its own."""
    fields: dict[str, Any] = {}
    for field, value in row._asdict().items():
        if isinstance(value, ControllerId):
            fields[field] = name(value)
        elif hasattr(value, "_asdict"):
            fields |= flat(value)
        else:
            fields[field] = value
    return fields


def markdown(rows: Sequence[Any], left: Sequence[str], right: Sequence[str], form: str = ".4g") -> list[str]:
    """A table in Markdown of fields of named tuples, aligned to the left and to the right (`text`)."""
    fields = [*left, *right]
    cells = [[value_text(flat(row)[field], form) for field in fields] for row in rows]
    return tables.table([field.replace("_", " ") for field in fields], cells, len(left), markdown=True)


def value_text(value: Any, form: str = ".4g") -> str:
    """A field as text, for Markdown and CSV: names side by side; nothing: `-`."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return format(value, form) if isinstance(value, float) else str(value)


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


def _compared(cell: Cell, figures: Figures) -> Compared:
    figure = _figure(figures[ComparedRun(cell.system, cell.scenario, cell.who)], cell.quantity)
    ours = figure
    if cell.against is not None:
        reference = _figure(figures[ComparedRun(cell.system, cell.scenario, cell.against)], cell.quantity)
        ours = _better(reference, figure)
    return Compared(cell, figure, ours, None if ours is None else ours - cell.corrected)


def _figure(figures: Mapping[str, float] | None, quantity: str) -> float | None:
    """A figure of a run, where there is one and it is a number."""
    value = None if figures is None else figures.get(quantity)
    return value if value is not None and math.isfinite(value) else None


def _better(reference: float | None, other: float | None) -> float | None:
    """Improvement over the reference, %; none where one of them is missing."""
    if reference is None or other is None:
        return None
    return improvement({"": reference}, {"": other})[""]


def _improvement(c: Compared) -> Statement:
    return _statement(c.cell, IMPROVEMENT, c.cell.against or LLC, c.cell.printed, c.cell.corrected, c.ours)


def _roughness(what: str, c: Compared, over: Compared) -> Statement:
    """The improvement that follows from two figures of roughness, printed ones never 0."""
    printed = _better(over.cell.printed, c.cell.printed) or 0.0
    theirs = _better(over.cell.corrected, c.cell.corrected) or 0.0
    return _statement(c.cell, what, over.cell.who, printed, theirs, _better(over.ours, c.ours))


def _statement(
    cell: Cell, what: str, over: ControllerId, printed: float, theirs: float, ours: float | None
) -> Statement:
    place = (cell.table, cell.scenario, cell.architecture, cell.controller, cell.scheme or "")
    agrees, as_printed = (ours is not None and _sign(ours) == _sign(x) for x in (theirs, printed))
    return Statement(*place, what, cell.quantity, name(over), printed, theirs, ours, agrees, as_printed)


def _smoother(who: ControllerId) -> list[tuple[str, ControllerId]]:
    """Whom a run is stated to be smoother than, or not."""
    smoother_than = []
    if who.architecture == "MIMO":
        smoother_than.append((OVER_MISO, who._replace(architecture="MISO")))
    elif who.scheme == "indirect":
        smoother_than.append((OVER_DIRECT, who._replace(scheme="direct")))
    if who.controller != "LLC":
        smoother_than.append((OVER_LLC, ControllerId(who.architecture, "LLC", None)))
    return smoother_than


def _signs(table: str, what: str, stated: Sequence[Statement]) -> Signs:
    agree, printed = sum(s.agrees for s in stated), sum(s.agrees_as_printed for s in stated)
    missing = sum(s.ours is None for s in stated)
    return Signs(table, what, len(stated), agree, printed, missing, agree / len(stated), printed / len(stated))
