"""Records of devices that stand where the case has a generator (DYR): static var compensators.

References: PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.errors import InputError
from facts_damping_grids.control_limits import EFFECT, WIDER
from facts_damping_grids.notes import Note
from facts_damping_grids.psse.controls import NOT_SEEN
from facts_damping_grids.psse.effects import of_record
from facts_damping_grids.psse.machines import constants
from facts_damping_library.devices.csvgn1 import ROUND_OFF, SHORTEST, Csvgn1, rest

if TYPE_CHECKING:
    from facts_damping_grids.psse.generators import Unit
    from facts_damping_grids.psse.reading import Dynamic
    from facts_damping_grids.psse.records import Row

DEVICES = {"CSVGN1": "K T1 T2 T3 T4 T5 RMIN VMAX VMIN CBASE"}  # constants of a record in their order
SECTIONS = ("T1", "T3"), ("T2", "T4")
NEAR = "the voltage behind the step-up transformer sags by what the transformer drops"


def device_of(record: Dynamic, unit: Unit, file: str, notes: list[str | Note]) -> Row:
    """Fields of a device but for its place and start. Raises `InputError` if there are too few constants."""
    row: Row = {"kind": record.model.lower(), "MBASE": unit.rating, **constants(record, DEVICES[record.model], file)}
    least = {below: SHORTEST if row[above] else 0.0 for above, below in SECTIONS} | {"T5": SHORTEST}
    short = [name for name, limit in least.items() if row[name] < limit or 0.0 < row[name] < SHORTEST]
    for name in short:
        row[name] = least[name]
    if short:
        text = f"{', '.join(short)} below {SHORTEST:g} s: taken as {' and '.join(f'{row[name]:g}' for name in short)}"
        notes.append(of_record(record, unit.name, file, text, "replaced", NOT_SEEN))
    if unit.row["XT"] or unit.row["RT"]:
        text = "controls the voltage at its terminals, not that behind its step-up transformer"
        notes.append(of_record(record, unit.name, file, text, "replaced", NEAR))
    return row


def at_rest(row: Row, voltage: float, origin: str, notes: list[str | Note]) -> Row:
    """A device with the limits that its Q at a voltage (p.u.) needs; `origin`: file, line and model, for notes.

    Raises `InputError` if its reactor is too small.
    """
    reactor, square = row["MBASE"], voltage * voltage
    y = rest(Csvgn1.model_construct(**row), voltage).y
    if y > 1.0 + ROUND_OFF:
        allowed = f"at least {square * (row['CBASE'] - reactor):.4g}, by CBASE and MBASE"
        start = f"Q = {row['Q']:.4g} Mvar given at {voltage:.4g} p.u. of voltage"
        raise InputError(f"{origin}: {start}; allowed: {allowed}")
    fitting = dict(row)
    for field, unit, sign in (("RMIN", reactor, -1.0), ("VMIN", 1.0, -1.0), ("VMAX", 1.0, 1.0)):
        if sign * (y - row[field] / unit) > ROUND_OFF:
            fitting[field] = (y + sign * WIDER * abs(y)) * unit
            text = f"{field} excludes the start: {row[field]:g} is set to {fitting[field]:.4g}"
            common = f"devices: CSVGN1: {field} excludes the start: widened"
            notes.append(Note(f"{origin}: {text}", common, "generators", row["name"], "CSVGN1", "replaced", EFFECT))
    return fitting
