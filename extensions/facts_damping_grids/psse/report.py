"""The report of an import: by section and model how many records were read, and what became of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.output.tables import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from facts_damping_grids.notes import Note
    from facts_damping_grids.psse.reading import Dyr, RawCase

# Sections whose records affect the grid and are not read; the others do not affect it.
ACTING = ("VSC dc", "multi-terminal dc", "FACTS device", "GNE device", "induction machine", "impedance correction")
ISOLATED = 4.0  # type of a bus
STATUS = {  # columns that say whether an element is in service
    "bus": "IDE",
    "load": "STATUS",
    "fixed shunt": "STATUS",
    "generator": "STAT",
    "branch": "ST",
    "transformer": "STAT",
    "switched shunt": "ST",
    "switching device": "ST",
    "two-terminal dc": "MDC",
}
OTHER = "no machine's"  # records of a DYR file that belong to no machine
GRAVITY = ("idle", "replaced", "left out")  # outcomes from the least grave one on
TITLES = ("records", "read", "exact", "replaced", "left out", "idle")


class Records(NamedTuple):
    """Numbers of records of a section or model: read; replaced; left out; idle, as in PSS/E. And what that changes."""

    name: str
    read: int
    replaced: int
    left_out: int
    idle: int
    effects: tuple[str, ...] = ()

    @property
    def exact(self) -> int:
        """Number of those that act as in PSS/E."""
        return self.read - self.replaced - self.left_out - self.idle


def of_case(case: RawCase, dyr: Dyr | None, notes: Iterable[str | Note]) -> list[Records]:
    """What became of the records of a case; one with several notes counts once, by the gravest."""
    outcomes: dict[str, dict[str, str]] = {}
    effects: dict[str, dict[str, None]] = {}
    for note in notes:
        if not isinstance(note, str) and note.outcome:
            of_record = outcomes.setdefault(note.record, {})
            of_record[note.element] = max(note.outcome, of_record.get(note.element, GRAVITY[0]), key=GRAVITY.index)
            effects.setdefault(note.record, {}).update({note.effect: None} if note.effect else {})
    rows = []
    for name, read in _read(case, dyr).items():
        of_name = list(outcomes.get(name, {}).values())
        off = ISOLATED if name == "bus" else 0.0
        out = [row for row in case.tables[name] if row.get(STATUS[name]) == off] if name in STATUS else []
        idle = of_name.count("idle") + len(out)
        numbers = read, of_name.count("replaced"), of_name.count("left out"), idle
        rows.append(Records(name, *numbers, tuple(effects.get(name, ()))))
    return rows


def _read(case: RawCase, dyr: Dyr | None) -> dict[str, int]:
    """Numbers of records by section and model, as far as they may affect the grid."""
    read = {section: len(rows) for section, rows in case.tables.items()}
    read |= {section: len(case.unread.get(section, ())) for section in ACTING}
    for record in dyr.records if dyr else ():
        read[record.model] = read.get(record.model, 0) + 1
    read[OTHER] = len(dyr.unread) if dyr else 0
    return {name: count for name, count in read.items() if count}


def lines(rows: Sequence[Records]) -> list[str]:
    """The report as a table, and what can be otherwise for the records that are replaced or left out."""
    if not rows:
        return []
    numbers = [(row.name, row.read, row.exact, row.replaced, row.left_out, row.idle) for row in rows]
    names: dict[str, list[str]] = {}
    for row in rows:
        for effect in row.effects:
            names.setdefault(effect, []).append(row.name)
    return [*table(TITLES, numbers), *(f"{', '.join(of_effect)}: {effect}" for effect, of_effect in names.items())]
