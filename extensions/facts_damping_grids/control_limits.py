"""Widens control limits of an imported system that exclude the start from its power flow, so that it has a rest."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.machine_controls.blocks import TABLES
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import limit_violations

WIDER = 0.1  # fraction of the initial value by which the limit is moved beyond it
MAXIMUM = 5  # iterations, as one limit may depend on another


def widened(content: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Content of a system with limits widened as its initial state needs, and a note for each.

    Raises `InputError` if that does not help.
    """
    wider_content, notes = deepcopy(content), list[str]()
    for _ in range(MAXIMUM):
        violations = limit_violations(check(System, wider_content, "import"))
        if not violations:
            return wider_content, notes
        for strain in violations:
            if strain.field is None:
                raise InputError(str(strain))
            c = strain.control
            beyond = WIDER * abs(strain.wanted)
            limit = strain.wanted + (beyond if strain.value > strain.high else -beyond)
            table = wider_content[TABLES[MODELS[c.model].role]]
            row = next(row for row in table if row["machine"] == c.machine)
            notes.append(f"{strain}; {strain.field}: {row[strain.field]:g} is set to {limit:.4g}")
            row[strain.field] = limit
    raise InputError(str(violations[0]))
