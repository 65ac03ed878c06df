"""Records of controls (DYR) as rows of a system's exciters, stabilisers and governors.

References: PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import INPUTS, MODELS, quantity_of
from facts_damping.machine_controls.blocks import SHORTEST, TABLES
from facts_damping_grids.psse.effects import effect_of, of_record
from facts_damping_grids.psse.machines import constants, is_short

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_grids.notes import Note, Outcome
    from facts_damping_grids.psse.generators import Unit
    from facts_damping_grids.psse.reading import Dynamic
    from facts_damping_grids.psse.records import Row

HYGOV = "R r Tr Tf Tg rate_max gate_max gate_min Tw At Dt q_nl"
NOT_SEEN = "what is faster than 2 ms, which no swing is"
# Load compensators: their constants, and RC and XC of the exciter, which controls |V + (RC + j XC) I|.
COMPENSATORS: dict[str, tuple[str, Callable[[Row], Row]]] = {
    "IEEEVC": ("RC XC", lambda row: row),
    "COMP": ("XE", lambda row: {"XC": -row["XE"]}),
}


def role_of(model: str) -> str:
    """What a control that is modelled is for; empty: it is not modelled."""
    if model in COMPENSATORS or model == "HYGOV":
        return "compensator" if model in COMPENSATORS else "governor"
    return MODELS[model].role if model in MODELS and MODELS[model].record else ""


def unknown_inputs(record: Dynamic) -> list[str]:
    """The codes of a stabiliser's inputs that are not modelled."""
    fields = MODELS[record.model].fields.split() if record.model in MODELS else []
    codes = {name: code for name, code in zip(fields, record.values, strict=False) if name in ("IC", "IC2")}
    return [f"{name} {code:g}" for name, code in codes.items() if code not in INPUTS]


def fields_of(model: str) -> tuple[str, str]:
    """The constants of a control that is modelled, in the order of its record, and those that may be missing: 0."""
    if model in COMPENSATORS or model == "HYGOV":
        return COMPENSATORS[model][0] if model in COMPENSATORS else HYGOV, ""
    return MODELS[model].fields, MODELS[model].optional


def with_effect(
    records: Sequence[Dynamic], unit: Unit, file: str, notes: list[str | Note], *, classical: bool
) -> list[Dynamic]:
    """The controls of a machine that act on it, its exciter first; notes of the others.

    These are not modelled, have nothing to act on, or lack constants.
    """
    acting = []
    excited = not classical and any(role_of(record.model) == "exciter" and not lack(record) for record in records)
    for record in records:
        role, reason = role_of(record.model), ""
        outcome: Outcome = "left out"
        if not role:
            reason = "is not modelled"
        elif unknown_inputs(record):
            reason = f"has an input that is not modelled, {', '.join(unknown_inputs(record))}"
        elif classical and role != "governor":
            reason, outcome = "has no effect on GENCLS, whose field is constant", "idle"
        elif role in ("stabiliser", "compensator") and not excited:
            reason = "has no exciter to act on"
        else:
            reason = lack(record)
        if not reason:
            acting.append(record)
            continue
        effect = effect_of(record.model) if outcome == "left out" else ""
        notes.append(of_record(record, unit.name, file, f"{reason}: left out", outcome, effect))
    return sorted(acting, key=lambda record: role_of(record.model) != "exciter")


def lack(record: Dynamic) -> str:
    """What a control that is modelled lacks in its record; empty: nothing."""
    order, optional = fields_of(record.model)
    return f"has {len(record.values)} of {len(order.split())} constants" if is_short(record, order, optional) else ""


def constants_of(record: Dynamic, file: str) -> Row:
    """The constants of a control that is modelled by their names. Raises `InputError` if one is no number."""
    order, optional = fields_of(record.model)
    return constants(record, order, file, optional)


def add_control(record: Dynamic, unit: Unit, file: str, controls: dict[str, list[Row]], notes: list[str | Note]) -> str:
    """Add the record of a control that is modelled to its table, which is returned; a compensator to its exciter.

    Raises `InputError` if a constant is no number, or the machine has such a control already.
    """
    fields = constants_of(record, file)
    if record.model in COMPENSATORS:
        for row in controls["exciters"]:
            if row["machine"] == unit.name:
                row.update(COMPENSATORS[record.model][1](fields))
        return "compensators"
    table = "governors" if record.model == "HYGOV" else TABLES[MODELS[record.model].role]
    if any(row["machine"] == unit.name for row in controls[table]):
        raise InputError(f"{record.where(file)}: {unit.name} has one of the {table} already; allowed: one")
    row = {"machine": unit.name, "model": record.model, **fields}
    if record.model == "HYGOV":
        if row["gate_min"] < 0.001:
            row["gate_min"] = 0.001
            text = "GMIN is raised to 0.001: the flow is divided by the gate"
            notes.append(of_record(record, unit.name, file, text))
    else:
        notes += adapted(row, record, unit, file)
    controls[table].append(row)
    return table


def adapted(row: Row, record: Dynamic, unit: Unit, file: str) -> list[Note]:
    """Change constants that PSS/E or our blocks take otherwise than as they stand; notes of what acts otherwise."""
    asked = MODELS[record.model].approximations.items()
    texts = [text for text, by_fields in asked if by_fields(SimpleNamespace(**row))]
    notes = [of_record(record, unit.name, file, text, "replaced", text) for text in texts]
    short = [
        name for name in MODELS[record.model].fields.split() if 0.0 < row[name] < SHORTEST and quantity_of(name).time
    ]
    for name in short:
        row[name] = 0.0
    if short:
        text = f"{', '.join(short)} below {SHORTEST:g} s: taken as 0"
        notes.append(of_record(record, unit.name, file, text, "replaced", NOT_SEEN))
    if "E2" in row and row.get("VRMAX") == 0.0:  # of a rotating exciter: the value for the field voltage E2
        row["VRMAX"] = (max(row["KE"], 0.0) + row["SE2"]) * row["E2"] or 1.0
        row["VRMIN"] = -row["VRMAX"]
        text = f"VRMAX is 0: taken as {row['VRMAX']:.4g}, VRMIN as its negative"
        notes.append(of_record(record, unit.name, file, text))
    return notes
