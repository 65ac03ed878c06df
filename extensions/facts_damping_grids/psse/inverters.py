"""Records of inverters (DYR): a converter, and the controls that act on it, as rows of a system.

References: PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.machine_controls.block_models import MODELS, active_blocks
from facts_damping.machine_controls.blocks import terms
from facts_damping.output.tables import some_of
from facts_damping.plant.inverters.inverter import KNOWN, MEASURED, STAND_INS
from facts_damping_grids.notes import Note
from facts_damping_grids.psse.controls import adapted, constants_of, lack, role_of
from facts_damping_grids.psse.effects import INVERTERS, SOURCE, effect_of, family, of_record
from facts_damping_grids.psse.network import branch_between

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_grids.problems import Problems
    from facts_damping_grids.psse.generators import Unit
    from facts_damping_grids.psse.network import Network
    from facts_damping_grids.psse.reading import Dynamic
    from facts_damping_grids.psse.records import Row

PLACES = ("BUSR", "BUSF", "BUST", "CKT")  # fields that say where a plant control measures
SIGNALS = {*KNOWN, *MEASURED, *STAND_INS}
AT_TERMINALS = "it sees the voltage of the inverter, not that at BUSR"
ELSEWHERE = "it regulates the voltage at the bus of its branch, not at BUSR"


class Inverter(NamedTuple):
    """A converter's model and constants, its controls with the records that they come from."""

    converter: Row
    controls: list[tuple[Row, Dynamic]]


def inverter_of(
    record: Dynamic,
    others: Sequence[Dynamic],
    unit: Unit,
    grid: Network,
    file: str,
    notes: list[str | Note],
    problems: Problems,
) -> Inverter | None:
    """The rows of an inverter, whose model is `record`; None where a constant current stands for it."""
    rows: dict[Dynamic, Row] = {}
    reasons: dict[Dynamic, str] = {}  # of records that make no row
    for each in [record, *others]:
        with problems.collected():
            if reason := _left_out(_with_source(each, unit)):
                reasons[each] = reason
            else:
                rows[each] = {"model": each.model, **constants_of(_with_source(each, unit), file)}
    _check_sorts(rows, unit, file, problems)
    for each, missing in _without_effect(rows):
        reasons[each] = f"needs {some_of(missing)}, which no control that is modelled gives"
        del rows[each]
    if record in reasons:
        notes += as_current(unit, [record, *others], file, reasons[record])
    if record not in rows:  # or its constants are a problem
        return None
    for each, reason in reasons.items():
        notes.append(of_record(each, unit.name, file, f"{reason}: left out", "left out", effect_of(each.model)))
    for each, row in rows.items():
        _on_its_base(row, unit)
        notes += adapted(row, each, unit, file)
        _place(row, each, unit, grid, file, notes, problems)
    controls = [({"inverter": unit.name, **row}, each) for each, row in rows.items() if each is not record]
    return Inverter(rows[record], controls)


def _with_source(record: Dynamic, unit: Unit) -> Dynamic:
    """A record with the impedance ZSORCE of its generator, if its model has that behind the record's constants."""
    fields = MODELS[record.model].fields.split() if record.model in MODELS else []
    if "Xe" in fields and len(record.values) == fields.index("Xe") - 1:
        return record._replace(values=(*record.values, unit.row["ZR"], unit.row["ZX"]))
    return record


def _left_out(record: Dynamic) -> str:
    """Why a record makes no row; empty: it makes one."""
    if role_of(record.model) not in ("inverter", "inverter_control"):
        return "is not modelled" if not role_of(record.model) else "does not act on an inverter"
    return lack(record)


def as_current(unit: Unit, records: Sequence[Dynamic], file: str, reason: str = "") -> list[Note]:
    """Notes on a unit that becomes a constant current, by models of an inverter, or for want of a machine.

    `reason`: why the first one's model, which is a converter's, gives no inverter.
    """
    notes = []
    for record in records:
        if family(record.model) in INVERTERS:
            text = "a constant current stands for the inverter"
            text = f"{reason}: {text}" if reason and record is records[0] else text
            notes.append(of_record(record, unit.name, file, text, "replaced", SOURCE))
            continue
        text = "is left out with its machine, for which a constant current stands"
        text = text if role_of(record.model) else "is no machine model that is known: left out"
        notes.append(of_record(record, unit.name, file, text, "left out", effect_of(record.model)))
    if not any(family(record.model) in INVERTERS for record in records):
        models = f"only {some_of([record.model for record in records])}" if records else "no record"
        text = f"{models} in {file}: a constant current of its P and Q"
        common = f"generator: no model of a machine in {file}: constant currents of their P and Q"
        alone = f"line {unit.row['line']}: generator: {unit.name} has {text}"
        notes.append(Note(alone, common, "generators", unit.name, "generator", "replaced", SOURCE))
    return notes


def _check_sorts(rows: dict[Dynamic, Row], unit: Unit, file: str, problems: Problems) -> None:
    """Problems: two controls of a sort, which give the same signals."""
    by_signal: dict[str, Dynamic] = {}
    for record, row in rows.items():
        first = next((by_signal[name] for name in _gives(row) if name in by_signal), None)
        if first is not None:
            allowed = "one control of a sort"
            problems.add(f"{record.where(file)}: given beside {first.model} of {unit.name}; allowed: {allowed}")
        by_signal |= dict.fromkeys(_gives(row), record)


def _blocks(row: Row) -> list[tuple[str, set[str]]]:
    """Of the blocks that a row's constants ask for: the signal that each gives, and those that it uses."""
    return [
        (block.name, {*(term.signal for term in terms(block.inputs)), block.low_of, block.high_of, block.hold})
        for block in active_blocks(SimpleNamespace(**row))
    ]


def _gives(row: Row) -> set[str]:
    return {name for name, _ in _blocks(row)}


def _without_effect(rows: dict[Dynamic, Row]) -> list[tuple[Dynamic, list[str]]]:
    """Records that need a signal that none of the others gives, with such signals, one after the other."""
    left, without = dict(rows), []
    while True:
        present = SIGNALS.union(*(_gives(row) for row in left.values()))
        for record, row in left.items():
            missing = sorted(set[str]().union(*(used for _, used in _blocks(row))) - present)
            if missing:
                without.append((record, missing))
                del left[record]
                break
        else:
            return without


def _on_its_base(row: Row, unit: Unit) -> None:
    """Take what names the inverter's own bus or rating as what is not given."""
    for name, usual in (("BUSR", unit.bus), ("TRATE", unit.rating)):
        if row.get(name) == usual:
            row[name] = 0.0


def _place(
    row: Row, record: Dynamic, unit: Unit, grid: Network, file: str, notes: list[str | Note], problems: Problems
) -> None:
    """Turn the buses and the branch of a plant control to names. Problems: those that are not in service."""
    at = {name: row.pop(name, 0.0) for name in PLACES}
    regulated, first, second = (int(at[name]) for name in PLACES[:3])
    unknown = [f"{name} = {at[name]:g}" for name in PLACES[:3] if at[name] and int(at[name]) not in grid.buses]
    if "BUSF" not in MODELS[record.model].fields.split():
        if regulated:
            notes.append(of_record(record, unit.name, file, AT_TERMINALS, "replaced", AT_TERMINALS))
        return
    if unknown:
        problems.add(f"{record.where(file)}: {', '.join(unknown)} given; allowed: 0, or a bus in service")
    elif first and second:
        branch = branch_between(grid, first, second, record.circuit)
        if branch is None:
            between = f"from bus {first} to bus {second}, circuit {record.circuit}"
            problems.add(f"{record.where(file)}: a branch {between} given; allowed: one in service, with two ends")
            return
        row |= {"bus": f"B{first}", "branch": branch}
        if (regulated or unit.bus) != first:
            notes.append(of_record(record, unit.name, file, ELSEWHERE, "replaced", ELSEWHERE))
    elif regulated:
        row["bus"] = f"B{regulated}"
