"""Widens control limits of an imported system that exclude the start from its power flow, so that it has a rest."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError, ProblemsError
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.plant.grid.power_flow import solve
from facts_damping.plant.inverters.start import inverters_at_rest
from facts_damping.plant.machines.block_controls import owner
from facts_damping.plant.rotating import machines_at_rest
from facts_damping.plant.tables import Ports, States
from facts_damping_grids.notes import Note
from facts_damping_grids.problems import Problems

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.plant.machines.block_rest import LimitViolation

WIDER = 0.1  # fraction of the initial value by which the limit is moved beyond it
MAXIMUM = 5  # iterations, as one limit may depend on another
EFFECT = "the limit acts later than in the case"


def limit_violations(system: System) -> list[LimitViolation]:
    """Limits of block controls that exclude the initial state, for a system without devices."""
    flow, states = solve(system, []), States()
    machines = machines_at_rest(system, flow, states)
    inverters = inverters_at_rest(system, flow, states, Ports(), 0)
    if inverters.failures:
        raise ProblemsError(inverters.failures)
    return [*machines.violations, *inverters.violations]


def control_key(row: Mapping[str, Any]) -> str:
    """What a row is known by in its table: its name, its machine, or its inverter and model."""
    if "inverter" in row:
        return f"{row['inverter']} {row['model']}"
    return str(row.get("name", row.get("machine")))


def widened(content: dict[str, Any], origins: Mapping[tuple[str, str], str]) -> tuple[dict[str, Any], list[Note]]:
    """Content of a system with limits widened as its initial state needs, and a note for each.

    `origins`: where a control comes from, by its table and key. Raises `InputError` if that does not help.
    """
    wider_content, notes, problems = deepcopy(content), list[Note](), Problems()
    for _ in range(MAXIMUM):
        try:
            violations = limit_violations(check(System, wider_content, "import"))
        except InputError as error:
            raise InputError(_placed(str(error), origins)) from error
        if not violations:
            return wider_content, notes
        for violation in violations:
            c, field = violation.control, violation.field
            table = violation.table
            key = control_key(c.model_dump())
            place = origins.get((table, key), f"{table}: {owner(c)}: {c.model}")
            limits = f"allowed by its limits: {violation.low:.4g} to {violation.high:.4g}"
            text = f"{place}: {violation.name} is {violation.value:.4g} p.u. at the start; {limits}"
            if field is None:
                problems.add(text)
                continue
            beyond = WIDER * abs(violation.wanted)
            limit = violation.wanted + (beyond if violation.value > violation.high else -beyond)
            row = next(row for row in wider_content[table] if control_key(row) == key)
            text += f"; {field}: {row[field]:g} is set to {limit:.4g}"
            common = f"{table}: {c.model}: {field} excludes the start: widened"
            notes.append(Note(text, common, "machines", owner(c), c.model, "replaced", EFFECT))
            row[field] = limit
        problems.check()
    raise InputError(str(violations[0]))


def _placed(text: str, origins: Mapping[tuple[str, str], str]) -> str:
    """An error of a machine or a control with where that comes from."""
    for (table, machine), place in origins.items():
        for head in (f"{table}: {machine}: ", f"{place.split(': ')[-2]} of {machine}: "):
            if text.startswith(head):
                return f"{place}: {text.removeprefix(head)}"
    return text
