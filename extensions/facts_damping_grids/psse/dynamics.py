"""Records of a DYR file as what stands for each generator: machine, inverter, device, source, or constant current."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.machine_controls.blocks import TABLES
from facts_damping_grids.control_limits import control_key
from facts_damping_grids.matpower_conversion import TYPICAL
from facts_damping_grids.notes import Note
from facts_damping_grids.psse import controls
from facts_damping_grids.psse.devices import DEVICES, device_of
from facts_damping_grids.psse.effects import EFFECTS, effect_of, of_record
from facts_damping_grids.psse.generators import identifier
from facts_damping_grids.psse.inverters import as_current, inverter_of
from facts_damping_grids.psse.machines import MACHINES, is_source, machine_of
from facts_damping_grids.psse.reading import Dynamic
from facts_damping_grids.psse.report import OTHER

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_grids.problems import Problems
    from facts_damping_grids.psse.generators import Unit
    from facts_damping_grids.psse.network import Network
    from facts_damping_grids.psse.reading import Dyr, RawCase
    from facts_damping_grids.psse.records import Row

    Records = dict[str, list[Dynamic]]  # by the name of their unit


class Dynamics(NamedTuple):
    """By names of units: constants of machines and inverters, fields of devices, infinite sources, constant currents.

    And which have typical data, controls by table, and by table and key where a row comes from: file, line, model.
    """

    machines: dict[str, Row]
    inverters: dict[str, Row]
    devices: dict[str, Row]
    sources: list[str]
    currents: list[str]
    typical: list[str]
    controls: dict[str, list[Row]]
    origins: dict[tuple[str, str], str]


def typical_dynamics(listed: Sequence[Unit]) -> Dynamics:
    """A case without DYR file: machines with typical data."""
    names = [unit.name for unit in listed]
    return Dynamics({name: dict(TYPICAL) for name in names}, {}, {}, [], [], names, {}, {})


def dynamics_of(
    case: RawCase,
    grid: Network,
    listed: Sequence[Unit],
    dyr: Dyr,
    file: str,
    notes: list[str | Note],
    problems: Problems,
) -> Dynamics:
    """What the records of a DYR file make of the units; `file`: its name."""
    tables: dict[str, list[Row]] = {table: [] for table in TABLES.values() if table != "inverters"}
    dynamics = Dynamics({}, {}, {}, [], [], [], tables, {})
    for line, text in dyr.unread:
        alone = f"{file}: line {line}: {text} ... is no record of a machine: left out"
        common = f"{file}: no records of machines: left out"
        notes.append(Note(alone, common, "lines", str(line), OTHER, "left out", EFFECTS["other"]))
    models, others = _by_unit(case, listed, dyr, file, notes, problems)
    for unit in listed:
        record, more = models.get(unit.name), others.get(unit.name, [])
        if record is None:
            dynamics.currents.append(unit.name)
            notes += as_current(unit, more, file)
        elif is_source(record):
            dynamics.sources.append(unit.name)
            text = "acts on an infinite source, which stays as it is: left out"
            notes += [of_record(other, unit.name, file, text, "idle") for other in more]
        elif controls.role_of(record.model) == "inverter":
            _add_inverter(dynamics, record, more, unit, grid, file, notes, problems)
        elif record.model in DEVICES:
            dynamics.origins["devices", unit.name] = f"{record.where(file)}: of {unit.name}"
            with problems.collected():
                dynamics.devices[unit.name] = device_of(record, unit, file, notes)
            text = f"does not act on {record.model}: left out"
            notes += [of_record(other, unit.name, file, text, "left out", effect_of(other.model)) for other in more]
        else:
            dynamics.origins["machines", unit.name] = f"{record.where(file)}: of {unit.name}"
            with problems.collected():
                dynamics.machines[unit.name] = machine_of(record, unit, file, notes)
            classical = record.model == "GENCLS"
            for other in controls.with_effect(more, unit, file, notes, classical=classical):
                with problems.collected():
                    table = controls.add_control(other, unit, file, dynamics.controls, notes)
                    dynamics.origins[table, unit.name] = f"{other.where(file)}: of {unit.name}"
    return dynamics


def _add_inverter(
    dynamics: Dynamics,
    record: Dynamic,
    others: Sequence[Dynamic],
    unit: Unit,
    grid: Network,
    file: str,
    notes: list[str | Note],
    problems: Problems,
) -> None:
    """Add an inverter with its controls, or the constant current that stands for it."""
    inverter = inverter_of(record, others, unit, grid, file, notes, problems)
    if inverter is None:
        dynamics.currents.append(unit.name)
        return
    dynamics.inverters[unit.name] = inverter.converter
    dynamics.controls["inverter_controls"] += [row for row, _ in inverter.controls]
    dynamics.origins["inverters", unit.name] = f"{record.where(file)}: of {unit.name}"
    for row, other in inverter.controls:
        dynamics.origins["inverter_controls", control_key(row)] = f"{other.where(file)}: of {unit.name}"


def _by_unit(
    case: RawCase, listed: Sequence[Unit], dyr: Dyr, file: str, notes: list[str | Note], problems: Problems
) -> tuple[dict[str, Dynamic], Records]:
    """The record of each unit that is a machine's, an inverter's or a device's, and its other records."""
    by_place = {(unit.bus, unit.machine): unit for unit in listed}
    in_case = {(int(row["I"]), identifier(row["ID"])) for row in case.tables["generator"]}
    models, others = dict[str, Dynamic](), dict[str, list[Dynamic]]()
    for record in dyr.records:
        place = record.bus, identifier(record.machine)
        unit = by_place.get(place)
        if unit is None:
            notes.append(_without_machine(record, file, out_of_service=place in in_case))
        elif not _is_unit(record.model):
            others.setdefault(unit.name, []).append(record)
        elif unit.name in models:
            which = f"machine {record.machine} at bus {record.bus}"
            problems.add(f"{record.where(file)}: a second model of {which} given; allowed: one")
        else:
            models[unit.name] = record
    return models, others


def _is_unit(model: str) -> bool:
    """Whether a model is that of a unit, not of a control."""
    return model in MACHINES or model in DEVICES or controls.role_of(model) == "inverter"


def _without_machine(record: Dynamic, file: str, *, out_of_service: bool) -> Note:
    """The note on a record whose machine is out of service, or not in the case."""
    state = "in service" if out_of_service else "in the case"
    alone = f"{record.where(file)}: no machine {record.machine} at bus {record.bus} {state}: left out"
    common, element = f"{file}: {record.model}: no machine {state}: left out", f"{record.machine} at bus {record.bus}"
    if out_of_service:
        return Note(alone, common, "records", element, record.model, "idle")
    return Note(alone, common, "records", element, record.model, "left out", "nothing: its machine is not there")
