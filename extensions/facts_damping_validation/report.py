"""All tables of the validation, and the page made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.input_files import read_text, share_folder
from facts_damping_validation import (
    devices,
    inverters,
    minniwecc,
    pmus,
    psse,
    small_signal,
    start,
    time_domain,
    two_areas,
    wecc240,
)
from facts_damping_validation.table import summary

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_validation.table import ValidationTable

TABLES: dict[str, Callable[[], ValidationTable]] = {
    "power-flow-two-area": start.two_area,
    "power-flow-kundur": start.kundur,
    "power-flow-smib": start.smib,
    "power-flow-wscc": start.wscc,
    "power-flow-new-england": start.new_england,
    "power-flow-minniwecc": minniwecc.power_flow,
    "equilibrium": start.rest,
    "eigenvalues-kundur": small_signal.kundur,
    "excitation": small_signal.excitation,
    "excitation-book": small_signal.book,
    "eigenvalues-others": small_signal.others,
    "modes-nets-nyps": small_signal.nets_nyps,
    "eigenvalues-minniwecc": minniwecc.eigenvalues,
    "eigenvalues-two-areas": two_areas.eigenvalues,
    "transfer-minniwecc": minniwecc.transfer,
    "closed-loops-minniwecc": minniwecc.closed_loops,
    "interarea": small_signal.two_area,
    "ringdown": small_signal.ringdown,
    "ambient": small_signal.ambient,
    "converters": devices.converters,
    "balance": devices.balance,
    "pmus": pmus.standard,
    "hvdc-power": devices.powers,
    "hvdc-modulation": devices.modulation,
    "actuators": devices.actuators,
    "time-domain": time_domain.andes,
    "disturbances-minniwecc": minniwecc.disturbances,
    "inverters": inverters.andes,
    "wecc-240": wecc240.andes,
    "disturbances-two-areas": two_areas.disturbances,
    "psse": psse.traces,
    "psse-steps": psse.traces_in_steps,
    "psse-files": psse.accepted,
    "step": time_domain.steps,
}


def page(tables: Sequence[ValidationTable]) -> str:
    """The page docs/validation.md: its text with a row per table, the one that comes nearest to its tolerance."""
    rows = [row for table in tables for row in table.rows]
    passed = f"{sum(row.passed for row in rows)} of {sum(not row.open for row in rows)}"
    text = read_text(share_folder() / "config" / "references" / "validation.md")
    return text.replace("{{passed}}", passed).replace("{{tables}}", "\n".join(summary(tables)))
