"""Files of PSS/E, imported as a user does it, against the traces that PSS/E computed of them.

The cases, their events and the columns of their traces are in `config/references/psse/cases.yaml`. Of each column the
greatest deviation counts, relative to the swing: maximum less minimum of PSS/E's column from the event on.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.input_files import share_folder
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.files import read_yaml
from facts_damping.plant.build import build
from facts_damping.signals import CHANNELS, MACHINE_TRUTH
from facts_damping_grids.psse_conversion import import_case
from facts_damping_grids.psse_machines import MACHINES
from facts_damping_grids.psse_reading import read_dyr
from facts_damping_validation.table import Row, ValidationTable
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from facts_damping_validation.time_domain import Followed

SOURCE = "PSS/E (PowerSimulationsDynamics.jl)"
TOLERANCE = 0.01  # of the swing
POWERS = ("electrical_power", "mechanical_power")  # of a machine, p.u. of the system base
REFERENCE_STEP = {"kind": "exciter_input", "name": "reference", "setpoint_max": 1.0, "rate_max": 1000.0}


class Unit(NamedTuple):
    """A unit of a trace: how many of it are one of ours (rad, p.u. of the system base), and where it begins."""

    scale: float
    zero: float


UNITS = {"deg": Unit(180.0 / math.pi, 0.0), "pu": Unit(1.0, 0.0), "pu+1": Unit(1.0, 1.0), "MW": Unit(100.0, 0.0)}


class Column(NamedTuple):
    """A column of a trace: its number in the original file; a machine, bus or `bus-branch` of the import."""

    number: int
    quantity: str
    element: str
    unit: Unit


class Deviation(NamedTuple):
    """A known deviation of a column: what it may be at most, and why it is more than `TOLERANCE`."""

    tolerance: float
    cause: str


class Case(NamedTuple):
    """A case; see the head of `cases.yaml`."""

    case: str
    folder: str
    raw: str
    dyr: str
    trace: str
    event: dict[str, Any]
    at: float
    columns: list[Column]
    loads: str = "impedance"
    deviations: dict[str, Deviation] = {}  # noqa: RUF012 (never changed)


def folder() -> Path:
    """Where the cases are."""
    return share_folder() / "config" / "references" / "psse"


def cases() -> list[Case]:
    """All cases."""
    return [_case(row) for row in read_yaml(folder() / "cases.yaml")["cases"]]


def _case(row: dict[str, Any]) -> Case:
    columns = [text.split() for text in row["columns"]]
    known = {name: Deviation(*deviation) for name, deviation in row.get("deviations", {}).items()}
    named = [Column(int(number), quantity, element, UNITS[unit]) for number, quantity, element, unit in columns]
    return Case(**{**row, "columns": named, "deviations": known})


def not_modelled(dyr: Path) -> list[str]:
    """Models of a DYR file for which there is no equation, in their order."""
    names = dict.fromkeys(record.model for record in read_dyr(dyr).records)
    return [n for n in names if n not in MACHINES and n != "HYGOV" and not (n in MODELS and MODELS[n].record)]


def imported(case: Case) -> System:
    """The system of a case, with a PMU for each measured bus, branch and machine. Raises `InputError`."""
    content = import_case(folder() / case.folder / case.raw, folder() / case.folder / case.dyr).content
    if case.loads != "impedance":
        parts = {name: {case.loads: 1} for name in ("P_fractions", "Q_fractions")}
        content["loads"] = [load | parts for load in content["loads"]]
    content |= {"pmus": list(_pmus(case, content).values()), "signals": {}, "measures": {}}
    if case.event["kind"] == "reference":
        content["devices"] = [REFERENCE_STEP | {"machine": case.event["machine"]}]
    return check(System, content, case.case)


def _pmus(case: Case, content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """A PMU for each element that one measures; one at all events, as a system needs it."""
    pmus: dict[str, dict[str, Any]] = {}
    for column in case.columns:
        bus, _, branch = column.element.partition("-")
        at = {"bus": bus, "branches": [branch]} if branch else {"bus": bus}
        machine = any(row["name"] == column.element for row in content["machines"])
        pmus[column.element] = {"name": column.element} | ({"machine": bus} if machine else at)
    return pmus


def trace(case: Case) -> NDArray[np.float64]:
    """Times, s, and columns of PSS/E."""
    return np.loadtxt(folder() / case.folder / case.trace, delimiter=",", skiprows=1)


def run(case: Case, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Our columns of a case at instants, in the units of the trace. Raises `InputError`."""
    system = imported(case)
    if case.event["kind"] == "reference":
        g = [m.name for m in system.machines].index(case.event["machine"])
        step = case.event["to"] - float(build(system, [], []).plant.controls[g]["Vref"])
        ours = follow(system, ["reference"], times, [], {"reference": step}, asked_at=case.at)
    else:
        ours = follow(system, [], times, [case.event | {"time": case.at}])
    return np.array([_values(ours, system, column) for column in case.columns]).T


def _values(ours: Followed, system: System, column: Column) -> NDArray[np.float64]:
    """A column of ours in the trace's unit."""
    machines, pmus = [m.name for m in system.machines], [pmu.name for pmu in system.pmus]
    if column.quantity in MACHINE_TRUTH.names and column.element in machines:
        values = ours.machines[column.quantity][:, machines.index(column.element)]
    else:
        values = ours.frames[:, pmus.index(column.element), list(CHANNELS).index(column.quantity)]
    if column.quantity.endswith("angle"):
        values = np.unwrap(values)
    return np.asarray(values * column.unit.scale)


def traces() -> ValidationTable:
    """Every column of every trace."""
    rows = [row for case in cases() for row in _rows(case)]
    command = "facts-damping import CASE.raw CASE.dyr"
    return ValidationTable("Runs of files of PSS/E", SOURCE, command, rows)


def _rows(case: Case) -> list[Row]:
    missing = not_modelled(folder() / case.folder / case.dyr)
    if missing:
        cause = f"not modelled: {' '.join(missing)}"
        return [Row(_what(case, column), "", "", "", math.nan, math.nan, cause) for column in case.columns]
    theirs = trace(case)
    apart = np.abs(run(case, theirs[:, 0]) - theirs[:, 1:]).max(axis=0)
    swing = np.ptp(theirs[theirs[:, 0] >= case.at - 1e-6, 1:], axis=0)
    rows = []
    for column, relative in zip(case.columns, apart / swing, strict=True):
        known = case.deviations.get(f"{column.quantity} {column.element}", Deviation(TOLERANCE, ""))
        rows.append(Row(_what(case, column), "of the swing", "", "", float(relative), *known))
    return rows


def _what(case: Case, column: Column) -> str:
    bus, _, branch = column.element.partition("-")
    place = f"{branch} at {bus}" if branch else bus
    return f"{case.case}: {column.quantity.replace('_', ' ')} of {place}"


def accepted() -> ValidationTable:
    """Every pair of files: whether it is imported and has a start."""
    rows = []
    for name in read_yaml(folder() / "cases.yaml")["pairs"]:
        rows.append(_accepted(*name.split(" ")))
    return ValidationTable("Files of PSS/E that are accepted", SOURCE, "facts-damping import CASE.raw CASE.dyr", rows)


def _accepted(raw: str, dyr: str) -> Row:
    try:
        content = import_case(folder() / raw, (folder() / raw).parent / dyr).content
        build(check(System, content, raw), [], [])
    except InputError as error:
        missing = not_modelled((folder() / raw).parent / dyr)
        refused = str(error).replace(f"{folder()}/", "")
        return Row(f"{raw} with {dyr}", "", "refused", "accepted", 1.0, 0.5, refused if not missing else f"{missing}")
    return Row(f"{raw} with {dyr}", "", "accepted", "accepted", 0.0, 0.5, "")
