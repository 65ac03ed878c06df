"""Build a plant at its equilibrium from a system, its installed devices and a scenario's events."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling.structs import Table
from facts_damping.devices.base import AtMachine, Series
from facts_damping.devices.kind import Site
from facts_damping.devices.table import KINDS
from facts_damping.elementary import magnitude, phase, rect
from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.numerics.phasors import magnitudes, over, times
from facts_damping.plant import load_noise
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.site import DEVICE, LOAD, OTHER_END, PORT, SALIENT
from facts_damping.plant.events import oscillating_loads, oscillations, topology_intervals
from facts_damping.plant.grid import load
from facts_damping.plant.grid.power_flow import PowerFlow, solve
from facts_damping.plant.grid.reduction import Place, reduce_network, sparse_network
from facts_damping.plant.machines import block_controls, blocks, excitation, governor, machine, stabiliser
from facts_damping.plant.model import Plant, PlantState
from facts_damping.plant.watchdog import initial_watch, line
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1, Float2
    from facts_damping.parameters.events import Event
    from facts_damping.parameters.plant.grid import Load
    from facts_damping.parameters.plant.system import Device, System

LARGE = 100  # machines, infinite buses and ports, above which factors are faster than a dense matrix


class Built(NamedTuple):
    """A plant, its initial state, and the names of the entries of its arrays."""

    plant: Plant
    state: PlantState
    flow: PowerFlow
    state_names: list[str]


def build(
    system: System,
    installed: Sequence[str],
    listed: Sequence[Event],
    watchdog: NDArray[Any] | None = None,
    noisy: Collection[str] = (),
) -> Built:
    """Power flow, steady state of machines, controls and devices, and the reduced network of every interval.

    `watchdog`: a row of WATCHDOG for all devices; None: off. `noisy`: names of loads that `with_noise` gives noise.
    Raises `InputError` if the power flow does not converge, if limits exclude the initial state, or if an event is
    impossible.
    """
    steps, flow, states = topology_intervals(system, listed), solve(system, installed), _States()
    rotating = _machines(system, flow, states)
    if rotating.violations:
        raise InputError(str(rotating.violations[0]))
    ports = _salient_ports(system, rotating)
    magnitude = dict(zip(flow.names, magnitudes(flow.voltage).tolist(), strict=True))
    loads = _loads_at_ports(system, noisy, listed)
    load_rows = _loads(system, loads, flow, magnitude, states, ports)
    placed = _devices(system, in_service(system, installed), flow, magnitude, states, ports)
    if watchdog is not None:
        placed["watchdog"] = watchdog
    at: dict[str | None, int] = {None: -1} | {m.name: g for g, m in enumerate(system.machines)}
    online = np.array([[float(m.name not in s.topology.machines_out) for m in system.machines] for s in steps])
    scales = [[s.mechanical_scale.get(m.name, 1.0) for m in system.machines] for s in steps]
    intervals = [(system, ports.places, rotating.rows["admittance"], s.topology, magnitude) for s in steps]
    sources = [*(m.bus for m in system.machines), *(i.bus for i in system.infinite_buses)]
    large = len(sources) + len(ports.rows) > LARGE
    plant = Plant(
        omega_0=2 * math.pi * system.frequency,
        step_ns=to_ns(system.step),
        machines=rotating.rows,
        exciters=rotating.exciters,
        stabilisers=rotating.stabilisers,
        governors=rotating.governors,
        blocks=np.concatenate([np.zeros(0, blocks.BLOCK), *rotating.blocks]),
        controls=rotating.controls,
        loads=load_rows,
        ports=np.array(ports.rows, PORT),
        placed=placed,
        devices=placed[: len(installed)],
        infinite=np.array([flow.by_bus[i.bus] for i in system.infinite_buses], np.complex128),
        interval_start_ns=np.array([s.start_ns for s in steps], np.int64),
        mechanical_power=np.where(online > 0.0, rotating.power * np.array(scales), 0.0),
        online=online,
        island=np.array([[s.islands[bus] for bus in sources] for s in steps], np.int64),
        load_scale=np.array([[s.topology.load_scale.get(x.name, 1.0) for x in loads] for s in steps]),
        load_noise=load_noise.table({}, loads, len(loads)),
        oscillations=oscillations(listed, [m.name for m in system.machines], [x.name for x in loads]),
        network=np.zeros((0, 0, 0), complex) if large else np.array([reduce_network(*part) for part in intervals]),
        sparse_networks=Table([sparse_network(*part) for part in intervals] if large else []),
        pmu_machine=np.array([at[pmu.machine] for pmu in system.pmus]),
    )
    n, none = len(installed), np.zeros(len(ports.rows), np.complex128)
    lines = line([system.device(name).dead_time for name in installed])
    at_rest = np.zeros(n), np.zeros(n), initial_watch(n), none, none.copy()
    return Built(plant, PlantState(np.array(states.values), *at_rest, *lines), flow, states.names)


def _salient_ports(system: System, rotating: _Rotating) -> _Ports:
    """Ports of machines whose subtransient reactances differ by axis; the columns of all machines are set."""
    ports = _Ports()
    for g, m in enumerate(system.machines):
        rotating.rows[g]["column"] = g
        if rotating.rows[g]["saliency"].any():
            port = ports.add(SALIENT, g, Place(m.bus, machine=m.name))
            rotating.rows[g]["column"] = len(system.machines) + len(system.infinite_buses) + port
            rotating.rows[g]["salient"] = 1.0
    return ports


def _loads_at_ports(system: System, noisy: Collection[str], listed: Sequence[Event]) -> list[Load]:
    """The loads that have ports: those of `port_loads`, then those that oscillate."""
    loads = port_loads(system, noisy)
    names, oscillating = {load.name for load in loads}, oscillating_loads(listed)
    return loads + [load for load in system.loads if load.name in oscillating and load.name not in names]


def port_loads(system: System, noisy: Collection[str]) -> list[Load]:
    """The loads that are ports: those that are no constant impedance, and those with noise."""
    return [bus_load for bus_load in system.loads if not load.is_impedance(bus_load) or bus_load.name in noisy]


def with_noise(built: Built, system: System, noise: Mapping[str, Float2]) -> Built:
    """A built plant with the noise of loads by name, from `load_noise.draw`; it was built with their names."""
    table = load_noise.table(noise, port_loads(system, noise), len(built.plant.loads))
    return built._replace(plant=built.plant._replace(load_noise=table))


def in_service(system: System, installed: Sequence[str]) -> list[Device]:
    """The installed devices in their order, then permanent ones, which are uncommanded, without lag or dead time."""
    others = [d for d in system.devices if d.permanent and d.name not in installed]
    still = {"response_time": 0.0, "dead_time": 0.0}
    return [*(system.device(name) for name in installed), *(d.model_copy(update=still) for d in others)]


class _States:
    """Values and names of all states in their order in the state vector."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self.names: list[str] = []

    def add(self, owner: str, names: Sequence[str], values: Sequence[float] | Float1) -> None:
        self.names += [f"{owner}.{name}" for name in names]
        self.values += [float(value) for value in values]

    @property
    def offset(self) -> int:
        return len(self.values)


class _Ports:
    """Rows of PORT for all ports, and their places."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, int, float, float]] = []
        self.places: list[Place] = []

    def add(self, kind: int, row: int, place: Place, minimum: float = 0.0, maximum: float = math.inf) -> int:
        self.rows.append((kind, row, minimum, maximum))
        self.places.append(place)
        return len(self.rows) - 1


class _Rotating(NamedTuple):
    """All machines with their controls: tables, and air-gap powers (p.u. of the ratings)."""

    rows: NDArray[Any]
    exciters: NDArray[Any]
    stabilisers: NDArray[Any]
    governors: NDArray[Any]
    controls: NDArray[Any]
    power: NDArray[np.float64]
    blocks: list[NDArray[Any]]
    violations: list[block_controls.LimitViolation]


def _machines(system: System, flow: PowerFlow, states: _States) -> _Rotating:
    n = len(system.machines)
    rotating = _Rotating(
        np.zeros(n, machine.MACHINE),
        np.zeros(n, excitation.EXCITER),
        np.zeros(n, stabiliser.STABILISER),
        np.zeros(n, governor.GOVERNOR),
        np.zeros(n, blocks.CONTROLS),
        np.zeros(n),
        [],
        [],
    )
    every = [c for c in (*system.exciters, *system.stabilisers, *system.governors) if getattr(c, "enabled", True)]
    tables: dict[tuple[str, str], Any] = {(MODELS[c.model].role, c.machine): c for c in every if c.model in MODELS}
    exciters = {e.machine: e for e in system.exciters if e.model not in MODELS}
    stabilisers = {s.machine: s for s in system.stabilisers if s.enabled and s.model not in MODELS}
    governors = {t.machine: t for t in system.governors if t.enabled and t.model not in MODELS}
    voltage = flow.by_bus
    for g, m in enumerate(system.machines):
        v = voltage[m.bus]
        current = complex(over(flow.generation[m.name], v)).conjugate() * (system.base_power / m.rating)
        start = machine.steady_state(m, system.base_power, states.offset, v, current)
        rotating.rows[g], rotating.power[g] = start.row, start.power
        states.add(m.name, [*machine.SWING, *machine.rotor_circuits(m).names], start.states)
        excited = excitation.steady_state(exciters.get(m.name), states.offset, magnitude(v), start.field_voltage)
        rotating.exciters[g] = excited.row
        states.add(m.name, excited.names, excited.states)
        rotating.stabilisers[g] = stabiliser.row(stabilisers.get(m.name), states.offset)
        if m.name in stabilisers:
            states.add(m.name, stabiliser.STATE_NAMES, [0.0] * len(stabiliser.STATE_NAMES))
        rotating.governors[g] = governor.row(governors.get(m.name), states.offset)
        if m.name in governors:
            turbine, beyond = governor.start(governors[m.name], start.power)
            states.add(m.name, governor.STATE_NAMES, turbine)
            rotating.violations.extend(beyond)
        seen = _sensed(v, current, start)
        for data in [tables[role, m.name] for role in blocks.ROLES if (role, m.name) in tables]:
            rotating.violations.extend(_add_blocks(rotating, g, data, seen, states))
    return rotating


def _sensed(voltage: complex, current: complex, start: machine.MachineStart) -> dict[str, float]:
    """The inputs of block controls at the start, p.u. of the machine's rating."""
    v, i = (complex(phasor) for phasor in times([voltage, current], rect(1.0, math.pi / 2 - float(start.states[0]))))
    power = v.real * i.real + v.imag * i.imag
    sensed = {"Vt": magnitude(v), "Pe": power, "Pa": start.power - power, "Ifd": start.field_voltage, "Pm": start.power}
    return sensed | {"Vd": v.real, "Vq": v.imag, "Id": i.real, "Iq": i.imag, "Vt0": magnitude(v)}


def limit_violations(system: System) -> list[block_controls.LimitViolation]:
    """Limits of block controls that exclude the initial state, for a system without devices."""
    return _machines(system, solve(system, []), _States()).violations


def _add_blocks(
    rotating: _Rotating, g: int, data: Any, seen: dict[str, float], states: _States
) -> list[block_controls.LimitViolation]:
    """Add a block control at rest; return the limits that exclude this state."""
    role, control = MODELS[data.model].role, block_controls.control(data)
    wanted, reference = {"exciter": ("Ifd", "Vref"), "governor": ("Pm", "Pref")}.get(role, (None, None))
    sensed, row = {name: value for name, value in seen.items() if name in blocks.SENSED}, rotating.controls[g]
    if role == "exciter":
        control = block_controls.self_excited(control, data, seen["Ifd"])
        row["compensation"] = complex(data.RC, data.XC)
        added = times(row["compensation"], complex(seen["Id"], seen["Iq"]))
        sensed["Vc"] = magnitude(complex(seen["Vd"], seen["Vq"]) + complex(added))
    rest = block_controls.at_rest(control, data, sensed, None if wanted is None else seen[wanted], reference)
    first = sum(map(len, rotating.blocks))
    rows = control.rows.copy()
    rows["state"][rows["state"] >= 0] += states.offset
    row[f"{role}_first"], row[f"{role}_end"] = first, first + len(rows)
    row[f"{role}_gives"], row["Vt0"] = control.gives.index(block_controls.GIVES[role]), seen["Vt0"]
    if role == "exciter":
        row["Vref"] = rest.reference
    elif role == "governor":
        row["power_offset"] = rest.reference - seen["Pm"]
    else:  # an unwashed input gives an output at rest, too
        seen["Vs"] = rest.gives
        rotating.exciters[g]["Vref"] -= rest.gives
    rotating.blocks.append(rows)
    states.add(data.machine, control.states, rest.states)
    return rest.violations


def _loads(
    system: System, loads: Sequence[Load], flow: PowerFlow, voltages: dict[str, float], states: _States, ports: _Ports
) -> NDArray[Any]:
    """Loads that are not constant impedances; frequency-dependent ones at rest."""
    rows, voltage = [], flow.by_bus
    for i, x in enumerate(loads):
        reference = 1.0 if x.at == "nominal" else voltages[x.bus]
        rows.append(load.row(x, system.base_power, reference, ports.add(LOAD, i, Place(x.bus)), states.offset))
        if load.depends_on_frequency(x):
            angle = phase(voltage[x.bus])
            states.add(x.name, load.STATE_NAMES, [angle, angle])
    return np.array(rows, load.LOAD)


def _devices(
    system: System,
    installed: Sequence[Device],
    flow: PowerFlow,
    voltages: dict[str, float],
    states: _States,
    ports: _Ports,
) -> NDArray[Any]:
    rows = np.zeros(len(installed), dispatch.DEVICE)
    for d, device in enumerate(installed):
        machine, places, sizes = -1, list[Place](), [math.nan]
        if isinstance(device, AtMachine):
            machine = [m.name for m in system.machines].index(device.machine)
        elif isinstance(device, Series):
            places, sizes = [Place(device=device)], [flow.currents[device.name]]
        else:
            places, sizes = [Place(bus) for bus in device.buses], [voltages[bus] for bus in device.buses]
        site = Site(states.offset, 2 * math.pi * system.frequency, sizes[0], sizes[-1], system.base_power, machine)
        start = dispatch.install(rows[d], device, site)
        rows[d]["port"] = ports.add(DEVICE, d, places[0], start.minimum, start.maximum) if places else -1
        for place in places[1:]:
            rows[d]["other"] = ports.add(OTHER_END, d, place)
        names = [*KINDS[device.kind].states, *(["reference"] if device.response_time > 0.0 else [])]
        states.add(device.name, names, [*start.states, *([0.0] * (len(names) - len(start.states)))])
    return rows
