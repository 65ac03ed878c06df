"""Files of PSS/E, imported as a user does it, against the traces that PSS/E computed of them.

The cases, their events and the columns of their traces are in `config/references/psse/cases.yaml`. Of each column the
greatest deviation counts, relative to the swing: maximum less minimum of PSS/E's column from the event on.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.input_files import read_text, share_folder
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import read_yaml
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.signals import CHANNELS, MACHINE_TRUTH
from facts_damping_grids.psse.controls import role_of
from facts_damping_grids.psse.conversion import import_case
from facts_damping_grids.psse.devices import DEVICES
from facts_damping_grids.psse.loads import load_model
from facts_damping_grids.psse.machines import MACHINES
from facts_damping_grids.psse.reading import read_dyr
from facts_damping_validation.psse_steps import follow_in_steps
from facts_damping_validation.table import Row, ValidationTable
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from facts_damping_validation.time_domain import Followed

SOURCE = "PSS/E (PowerSimulationsDynamics.jl)"
TOLERANCE = 0.01  # of the swing
INSTANT = 1e-4  # s, within which a sample is at an instant: PSS/E counts time in single precision
COMMAND = "facts-damping import CASE.raw CASE.dyr"
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
    """A known deviation of a column: what it may be at most, why it is more than `TOLERANCE`; from when on it counts.

    `after`: that time after the event, s.
    """

    tolerance: float
    cause: str
    after: float = 0.0


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
    loads: str = "P: impedance, Q: impedance"
    steps: float | None = None
    active: str = ""
    open: str = ""
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
    names = dict.fromkeys(record.model for record in read_dyr(dyr, []).records)
    return [name for name in names if name not in MACHINES and name not in DEVICES and not role_of(name)]


def imported(case: Case) -> System:
    """The system of a case, with a PMU for each measured bus, branch and machine. Raises `InputError`."""
    place = folder() / case.folder
    content = import_case(place / case.raw, place / case.dyr, load_model(case.loads)).content
    if case.active:
        content["loads"] = [part for row in content["loads"] for part in _parts(row, row["name"] == case.active)]
    content |= {"pmus": list(_pmus(case, content).values()), "signals": {}, "measures": {}}
    if case.event["kind"] == "reference":
        content["devices"] = [*content.get("devices", []), REFERENCE_STEP | {"machine": case.event["machine"]}]
    return check(System, content, case.case)


def _parts(row: dict[str, Any], apart: bool) -> list[dict[str, Any]]:
    """A load; apart: one of its active power, one of its reactive power."""
    return [row | {"Q": 0.0}, row | {"name": f"{row['name']}_Q", "P": 0.0}] if apart else [row]


def _pmus(case: Case, content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """A PMU for each element that one measures; one at all events, as a system needs it.

    An inverter's power is that in the branches of its bus.
    """
    pmus: dict[str, dict[str, Any]] = {}
    inverters = {row["name"]: row["bus"] for row in content.get("inverters", ())}
    machines = {row["name"] for row in content.get("machines", ())}
    for column in case.columns:
        bus, _, branch = column.element.partition("-")
        at: dict[str, Any] = {"bus": inverters.get(bus, bus)}
        if bus in inverters:
            at["branches"] = [
                row["name"] for row in (*content["lines"], *content.get("transformers", ())) if at["bus"] in _ends(row)
            ]
        elif branch:
            at["branches"] = [branch]
        pmus[column.element] = {"name": column.element} | ({"machine": bus} if bus in machines else at)
    return pmus


def _ends(branch: dict[str, Any]) -> tuple[str, str]:
    return branch["from"], branch["to"]


def trace(case: Case) -> NDArray[np.float64]:
    """Times, s, and columns of PSS/E."""
    lines = read_text(folder() / case.folder / case.trace).splitlines()
    return np.array([line.split(",") for line in lines[1:]], float)


def run(case: Case, times: NDArray[np.float64], *, steps: bool = False) -> NDArray[np.float64]:
    """Our columns of a case at instants, in the units of the trace; `steps`: by PSS/E's steps. Raises `InputError`."""
    system, change = imported(case), 0.0
    if case.event["kind"] == "reference":
        g = [m.name for m in system.machines].index(case.event["machine"])
        change = case.event["to"] - float(build(system, [], []).plant.controls[g]["Vref"])
    event = None if change else case.event
    if steps:
        ours = follow_in_steps(system, times, event, case.at, change)
    elif event is None:
        ours = follow(system, ["reference"], times, setpoints={"reference": change}, asked_at=case.at)
    else:
        ours = follow(system, [], times, [event | {"time": case.at}])
    return np.column_stack([_values(ours, system, column) for column in case.columns])


def _values(ours: Followed, system: System, column: Column) -> NDArray[np.float64]:
    """A column of ours in the trace's unit."""
    machines, pmus = [str(m.name) for m in system.machines], [str(pmu.name) for pmu in system.pmus]
    values: NDArray[np.float64]
    if column.element in machines and column.quantity in set(MACHINE_TRUTH.names or ()):
        values = ours.machines[column.quantity][:, machines.index(column.element)]
    else:
        values = ours.frames[:, pmus.index(column.element), list(CHANNELS).index(column.quantity)]
    if column.quantity.endswith("angle"):
        values = np.unwrap(values)
    return values * column.unit.scale


def traces() -> ValidationTable:
    """Every column of every trace."""
    rows = [row for case in cases() for row in _rows(case)]
    return ValidationTable("Runs of files of PSS/E", SOURCE, COMMAND, rows)


def traces_in_steps() -> ValidationTable:
    """The columns of the traces whose cases have no lag near PSS/E's step, by its steps."""
    rows = [
        Row(_what(case, column), "of the swing", "", "", relative, case.steps)
        for case in cases()
        if case.steps is not None
        for column, relative in zip(case.columns, _apart(case, steps=True), strict=True)
    ]
    return ValidationTable("Runs of files of PSS/E by its steps", SOURCE, COMMAND, rows)


def _rows(case: Case) -> list[Row]:
    missing = not_modelled(folder() / case.folder / case.dyr)
    if case.open or missing:
        cause = case.open or f"not modelled: {' '.join(missing)}"
        return [Row(_what(case, column), "", "", "", math.nan, math.nan, cause) for column in case.columns]
    rows = []
    for column, relative in zip(case.columns, _apart(case), strict=True):
        known = _known(case, column)
        rows.append(Row(_what(case, column), "of the swing", "", "", relative, known.tolerance, known.cause))
    return rows


def _apart(case: Case, *, steps: bool = False) -> list[float]:
    """The greatest deviation of each column, relative to its swing."""
    theirs = trace(case)
    times, apart = theirs[:, 0], np.abs(run(case, theirs[:, 0], steps=steps) - theirs[:, 1:])
    for i, column in enumerate(case.columns):
        since = times - case.at
        apart[(since > -INSTANT) & (since < _known(case, column).after - INSTANT), i] = 0.0
    swing = np.ptp(theirs[times >= case.at, 1:], axis=0)
    return [float(relative) for relative in apart.max(axis=0) / swing]


def _known(case: Case, column: Column) -> Deviation:
    """The deviation that is known of a column, or that which any may have."""
    return case.deviations.get(f"{column.quantity} {column.element}", Deviation(TOLERANCE, ""))


def _what(case: Case, column: Column) -> str:
    bus, _, branch = column.element.partition("-")
    place = f"{branch} at {bus}" if branch else bus
    return f"{case.case}: {column.quantity.replace('_', ' ')} of {place}"


def accepted() -> ValidationTable:
    """Every pair of files: whether it is imported and has a start."""
    rows = [_accepted(raw, dyr) for raw, dyr in pairs()]
    return ValidationTable("Files of PSS/E that are accepted", SOURCE, COMMAND, rows)


def pairs() -> list[tuple[Path, Path]]:
    """RAW and DYR files of every case that PSS/E accepts."""
    files = []
    for pair in read_yaml(folder() / "cases.yaml")["pairs"]:
        place, _, names = pair.partition("/")
        raw, dyr = names.split(" ")
        files.append((folder() / place / raw, folder() / place / dyr))
    return files


def _accepted(raw: Path, dyr: Path) -> Row:
    """A pair of files; `cause`: what is replaced or left out, or why it is refused."""
    what = f"{raw.parent.name}/{raw.name} with {dyr.name}"
    try:
        of_pair = import_case(raw, dyr)
        build(check(System, of_pair.content, what), [], [])
    except InputError as error:
        reason = " ".join(str(error).replace(f"{folder()}/", "").split("\n"))
        return Row(what, "-", "refused", "accepted", 1.0, 0.5, reason)
    inexact = [row.name for row in of_pair.records if row.replaced or row.left_out]
    cause = f"replaced or left out: {', '.join(inexact)}" if inexact else ""
    return Row(what, "-", "accepted", "accepted", 0.0, 0.5, cause)
