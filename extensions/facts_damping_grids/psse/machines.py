"""Records of machine models (DYR) as machines of a system.

References: PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError
from facts_damping_grids.psse.effects import of_record

if TYPE_CHECKING:
    from facts_damping_grids.notes import Note
    from facts_damping_grids.psse.generators import Unit
    from facts_damping_grids.psse.reading import Dynamic
    from facts_damping_grids.psse.records import Row

ROUND = "Td01 Td02 Tq01 Tq02 H D Xd Xq Xd1 Xq1 Xd2 Xl S10 S12"
SALIENT = "Td01 Td02 Tq02 H D Xd Xq Xd1 Xd2 Xl S10 S12"


UNEQUAL = 1e-3  # p.u., difference of reactances
UNSATURATED = "its field current and its angle are those of a machine without saturation"


class MachineModel(NamedTuple):
    """A machine model of the library: ours, the constants of its record in their order, the form of its saturation."""

    model: str
    order: str
    saturation: str = "quadratic"


MACHINES = {
    "GENROU": MachineModel("genrou", ROUND),
    "GENROE": MachineModel("genrou", ROUND, "exponential"),
    "GENSAL": MachineModel("gensal", SALIENT),
    "GENSAE": MachineModel("genrou", SALIENT, "exponential"),
    "GENCLS": MachineModel("classical", "H D"),
}


def is_source(record: Dynamic) -> bool:
    """Whether a record is an infinite source: a constant voltage behind ZSORCE, as PSS/E takes GENCLS with H = 0."""
    return record.model == "GENCLS" and record.values[:1] == (0.0,)


def machine_of(record: Dynamic, unit: Unit, file: str, notes: list[str | Note]) -> Row:
    """Constants of a machine by our names. Raises `InputError` if there are too few or the inertia is negative."""
    of_library = MACHINES[record.model]
    row: Row = {"model": of_library.model, "speed_torque": record.model != "GENCLS", "Ra": unit.row["ZR"]}
    row |= constants(record, of_library.order, file)
    if row["H"] <= 0.0:
        allowed = "above 0" if record.model != "GENCLS" else "above 0, or 0 for an infinite source"
        raise InputError(f"{record.where(file)}: H = {row['H']:g} given; allowed: {allowed}")
    if of_library.model == "classical":
        return row | {"Xd1": unit.row["ZX"]}
    row["Xq2"] = row["Xd2"]
    if abs(unit.row["ZX"] - row["Xd2"]) > UNEQUAL:
        text = "ZX of the RAW file is not X''d: X''d counts"
        notes.append(of_record(record, unit.name, file, text))
    if row["S10"] == 0.0 < row["S12"]:
        notes.append(of_record(record, unit.name, file, "S(1.0) is 0: without saturation, as in PSS/E"))
    elif row["S12"] <= row["S10"] != 0.0:
        text = "S(1.2) is not above S(1.0): without saturation"
        notes.append(of_record(record, unit.name, file, text, "replaced", UNSATURATED))
    if row["S10"] == 0.0 or row["S12"] <= row["S10"]:
        row["S10"] = row["S12"] = 0.0
    elif of_library.saturation != "quadratic":
        row["saturation"] = of_library.saturation
    return row


def constants(record: Dynamic, order: str, file: str, optional: str = "") -> dict[str, float]:
    """The constants of a record by their names; of `optional` ones those at its end may be missing: 0."""
    names = order.split()
    if record.unreadable:
        raise InputError(f"{record.where(file)}: {record.unreadable}")
    if is_short(record, order, optional):
        count = f"{len(record.values)} constants given; allowed: {len(names)}, {order}"
        raise InputError(f"{record.where(file)}: {count}")
    return dict.fromkeys(names, 0.0) | dict(zip(names, record.values, strict=False))


def is_short(record: Dynamic, order: str, optional: str = "") -> bool:
    """Whether a record lacks constants that are not `optional`."""
    return any(name not in optional.split() for name in order.split()[len(record.values) :])
