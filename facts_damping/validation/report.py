"""All tables of the validation, and the page made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.validation import devices, pmus, small_signal, start, time_domain
from facts_damping.validation.table import markdown

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.validation.table import ValidationTable

TABLES: dict[str, Callable[[], ValidationTable]] = {
    "power-flow-two-area": start.two_area,
    "power-flow-kundur": start.kundur,
    "power-flow-smib": start.smib,
    "power-flow-wscc": start.wscc,
    "power-flow-new-england": start.new_england,
    "equilibrium": start.rest,
    "eigenvalues-kundur": small_signal.kundur,
    "excitation": small_signal.excitation,
    "excitation-book": small_signal.book,
    "eigenvalues-others": small_signal.others,
    "modes-nets-nyps": small_signal.nets_nyps,
    "interarea": small_signal.two_area,
    "ringdown": small_signal.ringdown,
    "ambient": small_signal.ambient,
    "converters": devices.converters,
    "balance": devices.balance,
    "pmus": pmus.standard,
    "hvdc-power": devices.powers,
    "hvdc-modulation": devices.modulation,
    "time-domain": time_domain.andes,
    "step": time_domain.steps,
}

HEAD = """# Validation

Written by `facts-damping validate --out docs/validation.md`; do not edit. Each row: ours, the reference, the absolute
difference, the tolerance. Where whole curves or lists are compared, the difference is the largest. Values of other
programs are in `config/references`, with their origin; what the tests check beyond this page
is in [tests](testing.md).

"""


def page(tables: Sequence[ValidationTable]) -> str:
    """The page docs/validation.md."""
    rows = [row for table in tables for row in table.rows]
    passed = sum(row.passed for row in rows)
    return f"{HEAD}{passed} of {len(rows)} rows pass.\n\n" + "\n".join(markdown(table) for table in tables)
