"""Units of a case as rows of a system, at their place in the solved power flow.

A machine or an inverter stands at its bus, or behind its step-up transformer. An infinite source is an infinite bus
behind its impedance ZSORCE: a transformer, as no line of the grid is there, at which a device could be placed. A
constant current is a load of negative power. A device gives its reactive power at the start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import MODELS
from facts_damping_grids.notes import Note
from facts_damping_grids.psse.devices import at_rest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping_grids.psse.dynamics import Dynamics
    from facts_damping_grids.psse.generators import Terminal, Unit
    from facts_damping_grids.psse.reading import RawCase
    from facts_damping_grids.psse.records import Row

LEAST_REACTANCE = 1e-6  # p.u. of the rating, of an infinite source without one
CURRENT = {"current": 1}
NOTHING = 1e-6  # MW
DIGITS = 9  # of a power in MW behind the point, which a power flow leaves


class Placed(NamedTuple):
    """Rows by table of a system."""

    buses: list[Row]
    transformers: list[Row]
    loads: list[Row]
    infinite_buses: list[Row]
    machines: list[Row]
    inverters: list[Row]
    devices: list[Row]


class _Place(NamedTuple):
    """A unit, the bus of its terminals, their voltage and power in the power flow; `behind`: a step-up transformer."""

    unit: Unit
    bus: str
    terminal: Terminal
    behind: bool


def placed(
    listed: Sequence[Unit],
    dynamics: Dynamics,
    terminals: Mapping[str, Terminal],
    voltages: Mapping[int, float],
    case: RawCase,
    buses: Mapping[int, Row],
    notes: list[str | Note],
) -> Placed:
    """Rows of all units, so that the power flow stays what it was with machines at their buses."""
    rows, machines, inverters = Placed([], [], [], [], [], [], []), list[_Place](), list[_Place]()
    for unit in listed:
        terminal, record = terminals[unit.name], unit.row
        if unit.name in dynamics.currents:
            rows.loads.append(_current(unit, f"B{unit.bus}", terminal.power * case.base_power))
            continue
        place = _Place(unit, f"B{unit.bus}", terminal, behind=False)
        if record["XT"] or record["RT"]:
            place = _step_up(place, case, rows)
        if unit.name in dynamics.sources:
            _add_source(place, case, rows, 1.0 if place.behind else buses[unit.bus]["BASKV"] or 1.0)
        elif unit.name in dynamics.inverters:
            inverters.append(place)
        elif unit.name in dynamics.devices:
            _add_device(place, dynamics, case, rows, notes)
        else:
            machines.append(place)
    forming = [place for place in inverters if _forms(dynamics.inverters[place.unit.name])]
    if not (machines or forming or rows.infinite_buses):
        others = [word for word, some in (("inverters", inverters), ("devices", rows.devices)) if some]
        count = f"{len(listed)} given that become {' or '.join([*others, 'constant currents'])}"
        raise InputError(f"generator: {count}; allowed: at least one machine or infinite source among them")
    slack = None if rows.infinite_buses else _slack(machines or forming, buses)
    for place in inverters:
        start = _start(place, case, is_slack=place is slack)
        rows.inverters.append(_named(place, buses) | start | dynamics.inverters[place.unit.name])
    together = [place.bus for place in machines]
    for place in machines:
        unit, base = place.unit, case.base_power
        V = abs(place.terminal.voltage) if place.behind else voltages[unit.bus]
        power = place.terminal.power * base
        dispatch = {"slack": True, "angle": place.terminal.angle} if place is slack else {"P": power.real}
        shared = {"Q": power.imag} if together.count(place.bus) > 1 else {}
        rows.machines.append(_named(place, buses) | {"V": V} | dispatch | shared | dynamics.machines[unit.name])
    return rows


def _forms(row: Row) -> bool:
    """Whether an inverter forms the grid."""
    source = MODELS[row["model"]].source
    return source is not None and source.forms_a_grid


def _named(place: _Place, buses: Mapping[int, Row]) -> Row:
    """Name, bus, area and rating of a machine or an inverter."""
    unit = place.unit
    bus = buses[unit.bus]
    area = bus.get("GROUP") or f"area_{int(bus['AREA'])}"
    return {"name": unit.name, "bus": place.bus, "area": area, "rating": unit.rating}


def _start(place: _Place, case: RawCase, *, is_slack: bool) -> Row:
    """The start of an inverter: the power that it gives in the power flow, or, of the slack, its voltage there."""
    if is_slack:
        return {"V": abs(place.terminal.voltage), "slack": True, "angle": place.terminal.angle}
    power = place.terminal.power * case.base_power
    return {"P": round(power.real, DIGITS), "Q": round(power.imag, DIGITS)}


def _current(unit: Unit, bus: str, power: complex) -> Row:
    """A constant current that gives a power, MVA."""
    row: Row = {"name": f"current_{unit.name}", "bus": bus, "P": -power.real, "Q": -power.imag}
    return row | {"P_fractions": CURRENT, "Q_fractions": CURRENT}


def _slack(places: Sequence[_Place], buses: Mapping[int, Row]) -> _Place:
    """The largest unit at a bus of type 3, or of all if there is none left there."""
    at_reference = [place for place in places if buses[place.unit.bus]["IDE"] == 3]
    return max(at_reference or places, key=lambda place: place.unit.rating)


def _step_up(place: _Place, case: RawCase, rows: Placed) -> _Place:
    """Add the step-up transformer of a unit's record; the unit stands behind it."""
    unit, record = place.unit, place.unit.row
    bus, tap = f"{unit.name}_terminal", record["GTAP"] or 1.0
    ends = {"name": f"T_{unit.name}", "from": place.bus, "to": bus, "rating": unit.rating}
    rows.buses.append({"name": bus, "nominal_voltage": 1.0})
    rows.transformers.append(ends | {"r": record["RT"], "x": record["XT"], "tap": tap})
    z = complex(record["RT"], record["XT"]) * case.base_power / unit.rating
    return _Place(unit, bus, place.terminal.behind(z, tap), behind=True)


def _add_source(place: _Place, case: RawCase, rows: Placed, nominal_voltage: float) -> None:
    """Add a constant voltage behind ZSORCE = ZR + j ZX, p.u. of MBASE: E = V + ZSORCE conj(S / V)."""
    unit, z = place.unit, complex(place.unit.row["ZR"], place.unit.row["ZX"] or LEAST_REACTANCE)
    inner, name = place.terminal.behind(z * case.base_power / unit.rating), f"{unit.name}_source"
    rows.buses.append({"name": name, "nominal_voltage": nominal_voltage})
    ends = {"name": f"ZSORCE_{unit.name}", "from": place.bus, "to": name, "rating": unit.rating}
    rows.transformers.append(ends | {"r": z.real, "x": z.imag})
    rows.infinite_buses.append({"name": unit.name, "bus": name, "V": abs(inner.voltage), "angle": inner.angle})


def _add_device(place: _Place, dynamics: Dynamics, case: RawCase, rows: Placed, notes: list[str | Note]) -> None:
    """Add a device that gives the unit's reactive power, and a constant current for active power."""
    unit, power = place.unit, place.terminal.power * case.base_power
    row = {"name": unit.name, "bus": place.bus, "Q": power.imag} | dynamics.devices[unit.name]
    origin = dynamics.origins["devices", unit.name]
    rows.devices.append(at_rest(row, abs(place.terminal.voltage), origin, notes))
    if abs(power.real) > NOTHING:
        rows.loads.append(_current(unit, place.bus, complex(power.real)))
        alone, common = f"gives {power.real:.4g} MW: a constant current", "generators of devices give active power"
        notes.append(Note(f"{origin}: {alone}", f"{common}: constant currents", "generators", unit.name))
