"""From a system, its installed devices and a scenario's events to a plant at its equilibrium."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from facts_damping.errors import InputError
from facts_damping.plant import excitation, machine, sssc
from facts_damping.plant.events import Stage, stages
from facts_damping.plant.model import MACHINE, Plant, PlantState
from facts_damping.plant.network import (
    Branch,
    Topology,
    admittance,
    branches,
    bus_names,
    grounded,
    shunts,
    two_port,
)
from facts_damping.plant.power_flow import PowerFlow, solve
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Event
    from facts_damping.parameters.system import Sssc, Station, System


STRAY = 1e-9j  # p.u., stray susceptance of a floating bus; no current flows there, so a device is blocked


class Built(NamedTuple):
    """A plant, its state at the start, and the names of what its arrays hold."""

    plant: Plant
    state: PlantState
    flow: PowerFlow
    state_names: list[str]


def build(system: System, installed: Sequence[str], listed: Sequence[Event]) -> Built:
    """Power flow, steady state of machines and devices, and the reduced network of every stage.

    Raises `InputError` for a power flow that does not converge, limits that do not admit the start, or an
    event that cannot happen.
    """
    steps = stages(system, listed)
    flow = solve(system, installed)
    devices = [d for d in system.devices if d.name in installed]
    rotating = _machines(system, flow)
    offset = len(rotating.x)
    converters = np.zeros(len(devices), sssc.SSSC)
    starts = [sssc.start(device, flow.currents[device.name]) for device in devices]
    for p, device in enumerate(devices):
        converters[p] = sssc.row(device, offset + sssc.STATES * p)
    voltage = {name: abs(v) for name, v in zip(flow.names, flow.voltage, strict=True)}
    stations = [next((g for g, m in enumerate(system.machines) if m.name == s.machine), -1) for s in system.stations]
    plant = Plant(
        omega_0=2 * math.pi * system.frequency,
        step_ns=to_ns(system.step),
        machines=rotating.rows,
        exciters=rotating.exciters,
        converters=converters,
        stage_start_ns=np.array([s.start_ns for s in steps], np.int64),
        mechanical_power=np.array([_mechanical_power(system, rotating.power, s) for s in steps]),
        online=np.array([[float(m.name not in s.topology.machines_out) for m in system.machines] for s in steps]),
        network=np.array([reduce_network(system, devices, s.topology, voltage) for s in steps]),
        station_machine=np.array(stations),
    )
    state = PlantState(np.concatenate([rotating.x, *starts]), np.zeros(len(devices)), np.zeros(len(devices)))
    names = rotating.names + [f"{d.name}.{state}" for d in devices for state in sssc.STATE_NAMES]
    return Built(plant, state, flow, names)


class _Rotating(NamedTuple):
    """All machines with their exciters: tables, air-gap powers (p.u. of the ratings), states, names of states."""

    rows: NDArray[Any]
    exciters: NDArray[Any]
    power: NDArray[np.float64]
    x: NDArray[np.float64]
    names: list[str]


def _machines(system: System, flow: PowerFlow) -> _Rotating:
    """Machines and exciters in the steady state of a power flow."""
    rows = np.zeros(len(system.machines), MACHINE)
    exciters = np.zeros(len(system.machines), excitation.EXCITER)
    power = np.zeros(len(system.machines))
    x, names, exciter_x, exciter_names = [], [], [], []
    offset = machine.ROTOR_STATES * len(system.machines)
    by_machine = {e.machine: e for e in system.exciters}
    for g, m in enumerate(system.machines):
        circuits = machine.MODELS[m.model](m)
        ratio = m.rating / system.base_power
        v = complex(flow.voltage[flow.names.index(m.bus)])
        start = machine.steady_state(m, circuits, v, (flow.generation[m.name] / v).conjugate() / ratio)
        exciter, started = excitation.row(by_machine.get(m.name), offset, abs(v), start.field_voltage)
        if not _within(exciter, start.field_voltage):
            raise InputError(
                f"exciters: {m.name} needs a field voltage of {start.field_voltage:.3f} p.u. at the start; "
                f"allowed by its limits: {exciter['minimum']:g} to {exciter['maximum']:g}"
            )
        rows[g] = (ratio, m.H, m.D, ratio / complex(m.Ra, m.Xd2), *circuits)
        exciters[g], power[g] = exciter, start.power
        offset += len(started)
        x.append(start.states)
        exciter_x.append(started)
        names += [f"{m.name}.{state}" for state in machine.STATE_NAMES[m.model]]
        exciter_names += [f"{m.name}.{state}" for state in excitation.STATE_NAMES[int(exciter["code"])]]
    return _Rotating(rows, exciters, power, np.concatenate([*x, *exciter_x]), names + exciter_names)


def _mechanical_power(system: System, power: NDArray[np.float64], stage: Stage) -> list[float]:
    """Mechanical powers of a stage, p.u. of the ratings; none for a machine that was tripped."""
    return [
        0.0 if m.name in stage.topology.machines_out else power[g] * stage.mechanical_scale.get(m.name, 1.0)
        for g, m in enumerate(system.machines)
    ]


def _within(row: NDArray[np.void], field_voltage: float) -> bool:
    """Whether an exciter's limits admit a field voltage at the start."""
    if row["code"] == excitation.CONSTANT:
        return True
    limited = field_voltage
    if row["code"] == excitation.DC:
        limited *= float(row["KE"] + row["AEX"] * math.exp(row["BEX"] * field_voltage))
    return bool(row["minimum"] <= limited <= row["maximum"])


def reduce_network(
    system: System, devices: Sequence[Sssc], topology: Topology, voltage: dict[str, float]
) -> NDArray[np.complex128]:
    """The network as the dynamics need it: Kron reduction to machines, device ports and stations.

    `V = Z I` with Z the inverse of the bus admittance matrix that includes loads and the machines' 1 / (Ra + j X'').
    Columns: unit Norton current of each machine, unit current of each port (out of its first bus, into its
    second). Rows: machine voltages, open-circuit voltages of ports (with -Z_th in a port's own column), station
    voltages, station currents. Shape (machines + ports + 2 stations, machines + ports), p.u.
    """
    names = bus_names(system, topology)
    index = {name: i for i, name in enumerate(names)}
    ported = {d.name for d in devices}
    present = branches(system, topology)
    present += [
        Branch(d.name, d.from_bus, d.to_bus, two_port(d.rs, 0, 0)) for d in system.devices if d.name not in ported
    ]
    matrix = admittance(names, present)
    for bus, shunt in shunts(system, topology, voltage).items():
        matrix[index[bus], index[bus]] += shunt
    norton = np.zeros(len(system.machines), np.complex128)
    for g, m in enumerate(system.machines):
        if m.name not in topology.machines_out:
            norton[g] = m.rating / system.base_power / complex(m.Ra, m.Xd2)
            matrix[index[m.bus], index[m.bus]] += norton[g]
    ends = [(index[d.from_bus], index[d.to_bus]) for d in devices]
    sources = np.zeros((len(names), len(norton) + len(ends)), np.complex128)
    for g, m in enumerate(system.machines):
        sources[index[m.bus], g] = 1.0
    for p, (first, second) in enumerate(ends):
        sources[first, len(norton) + p], sources[second, len(norton) + p] = -1.0, 1.0
    matrix[np.diag_indices(len(names))] += floating(matrix) * STRAY
    live = [i for i, name in enumerate(names) if name not in grounded(topology)]
    bus_voltage = np.zeros_like(sources)
    try:
        bus_voltage[live] = np.linalg.solve(matrix[np.ix_(live, live)], sources[live])
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"system {system.name}: network equations are singular: {error}; allowed: a regular network"
        ) from error
    machine_rows = bus_voltage[[index[m.bus] for m in system.machines]]
    port_rows = [bus_voltage[first] - bus_voltage[second] for first, second in ends]
    places = [index[_station_bus(system, s)] for s in system.stations]
    currents = [_station_current(system, s, present, devices, bus_voltage, index, norton) for s in system.stations]
    return np.array([*machine_rows, *port_rows, *bus_voltage[places], *currents])


def floating(matrix: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Which buses hang on nothing but a device's port: no path to any shunt, so that their voltage is not given."""
    _, label = connected_components(matrix != 0, directed=False)
    shunt = np.abs(matrix.sum(axis=1)) > 1e-9 * np.abs(matrix).max(axis=1)  # rows of lossless parts sum to zero
    fed = set(label[shunt])
    return np.array([part not in fed for part in label])


def _station_bus(system: System, station: Station) -> str:
    """The bus a station stands at."""
    if station.bus is not None:
        return station.bus
    return next(m.bus for m in system.machines if m.name == station.machine)


def _station_current(
    system: System,
    station: Station,
    present: Sequence[Branch],
    devices: Sequence[Sssc],
    bus_voltage: NDArray[np.complex128],
    index: dict[str, int],
    norton: NDArray[np.complex128],
) -> NDArray[np.complex128]:
    """Row that gives a station's current from the sources: out of its machine, or out of its bus into its branches."""
    machines, columns = len(norton), bus_voltage.shape[1]
    row = np.zeros(columns, np.complex128)
    if station.machine is not None:
        g = [m.name for m in system.machines].index(station.machine)
        if norton[g] != 0:
            row[g] = 1.0
        row -= norton[g] * bus_voltage[index[_station_bus(system, station)]]
        return row
    for p, device in enumerate(devices):
        if device.name in station.branches:
            row[machines + p] += 1.0 if device.from_bus == station.bus else -1.0
    for branch in present:
        if branch.name not in station.branches or station.bus not in (branch.from_bus, branch.to_bus):
            continue  # the far section of a line with a fault on it
        own = 0 if branch.from_bus == station.bus else 1
        ends = bus_voltage[[index[branch.from_bus], index[branch.to_bus]]]
        row += branch.admittance[own] @ ends
    return row
