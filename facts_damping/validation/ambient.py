"""Modes from the noise of runs without an event against the linear model."""

from __future__ import annotations

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.ambient import fit_ambient
from facts_damping.analysis.modes.ringdown import COVERED
from facts_damping.case.loading import load_case
from facts_damping.simulation import loop
from facts_damping.small_signal.modal_analysis import analyse
from facts_damping.validation.table import Row, ValidationTable, compare

SYSTEMS = ("kundur_12_6_dc", "wscc_9", "smib")
OPEN = ["devices=[]", "controllers=[]"]


def ambient() -> ValidationTable:
    """The strongest mode in ten minutes of noise: the linear one within the intervals of 95 %."""
    rows: list[Row] = []
    for system in SYSTEMS:
        case = load_case("two_area_ambient", [f"system={system}", *OPEN])
        record, swings = loop.run(case), analyse(case.system, []).swings
        fit = fit_ambient(record.time_s, columns(speed_differences(record)))
        heard = fit.modes[0] if fit else None
        mode = min(swings, key=lambda mode: abs(mode.frequency_hz - (heard.frequency_hz if heard else 0.0)))
        found = (heard.frequency_hz, heard.damping_ratio) if heard else (float("nan"), float("nan"))
        sure = (heard.frequency_error_hz, heard.damping_ratio_error) if heard else (0.0, 0.0)
        rows.append(compare(f"{system}: frequency", "Hz", found[0], mode.frequency_hz, COVERED * sure[0]))
        rows.append(compare(f"{system}: damping ratio", "-", found[1], mode.damping_ratio, COVERED * sure[1]))
    source = "the linearised plant; the tolerance is half the 95 % interval of the fit"
    command = "facts-damping simulate two_area_ambient --set system=wscc_9 --set devices=[] --set controllers=[]"
    return ValidationTable("Modes from ten minutes of load noise", source, command, rows)
