"""Build a plant at its equilibrium from a system, its installed devices and a scenario's events."""

from __future__ import annotations

import math
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling.structs import Table
from facts_damping.devices.base import AtInverter, AtMachine, Series
from facts_damping.devices.kind import Site
from facts_damping.devices.table import KINDS
from facts_damping.elementary import phase
from facts_damping.errors import ProblemsError
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.numerics.phasors import magnitudes
from facts_damping.plant import load_noise
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.site import DEVICE, LOAD, OTHER_END, PORT, SALIENT
from facts_damping.plant.dynamics import solve_network
from facts_damping.plant.events import oscillating_loads, oscillations, topology_intervals
from facts_damping.plant.grid import load
from facts_damping.plant.grid.power_flow import PowerFlow, solve
from facts_damping.plant.grid.reduction import Place, reduce_network, sparse_network
from facts_damping.plant.inverters.start import Inverters, input_signal, inverters_at_rest, power_input
from facts_damping.plant.machines import blocks
from facts_damping.plant.model import Plant, PlantState, workspace
from facts_damping.plant.rotating import machines_at_rest
from facts_damping.plant.tables import Ports, States
from facts_damping.plant.watchdog import initial_watch, line
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Float2
    from facts_damping.parameters.events import Event
    from facts_damping.parameters.plant.grid import Load
    from facts_damping.parameters.plant.system import Device, System
    from facts_damping.plant.grid.network import Topology
    from facts_damping.plant.rotating import Rotating

LARGE = 100  # machines, infinite buses and ports, above which factors are faster than a dense matrix
_last: list[tuple[Any, Any]] = [(None, None)]  # what units at rest were computed from last, and they
AT_REST = 5  # solutions of a large network at the start, each of which begins from the one before


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
    sparse: bool = False,
) -> Built:
    """Power flow, steady state of machines, controls and devices, and the reduced network of every interval.

    `watchdog`: a row of WATCHDOG; None: off. `noisy`: loads that `with_noise` gives noise. `sparse`: even if small,
    to be linearised fast. Raises `InputError` without a power flow, and for impossible limits or events.
    """
    steps = topology_intervals(system, listed)
    loads = _loads_at_ports(system, noisy, listed)
    flow, states, ports, rotating, inverters, every, load_rows, placed = _at_rest(system, installed, loads)
    if watchdog is not None:
        placed["watchdog"] = watchdog
    at: dict[str | None, int] = {None: -1} | {m.name: g for g, m in enumerate(system.machines)}
    online = np.array([[float(unit.name not in s.topology.machines_out) for unit in system.units] for s in steps])
    scales = [[s.mechanical_scale.get(m.name, 1.0) for m in system.machines] for s in steps]
    magnitude = dict(zip(flow.names, magnitudes(flow.voltage).tolist(), strict=True))
    sources = [u.bus for of_sort in (system.machines, system.infinite_buses, system.inverters) for u in of_sort]
    large = sparse or len(system.machines) + len(system.infinite_buses) + len(ports.rows) > LARGE
    parts = system, ports.places, rotating.rows["admittance"]
    networks = _networks(sparse_network if large else reduce_network, *parts, [s.topology for s in steps], magnitude)
    plant = Plant(
        omega_0=2 * math.pi * system.frequency,
        step_ns=math.ceil(longest_step(system, installed) * NANOSECONDS - 1e-3),
        machines=rotating.rows,
        exciters=rotating.exciters,
        stabilisers=rotating.stabilisers,
        governors=rotating.governors,
        blocks=every,
        controls=rotating.controls,
        inverters=inverters.rows,
        loads=load_rows,
        ports=np.array(ports.rows, PORT),
        placed=placed,
        devices=placed[: len(installed)],
        infinite=np.array([flow.by_bus[i.bus] for i in system.infinite_buses], np.complex128),
        interval_start_ns=np.array([s.start_ns for s in steps], np.int64),
        mechanical_power=np.where(online[:, : len(scales[0])] > 0.0, rotating.power * np.array(scales), 0.0),
        online=online,
        island=np.array([[s.islands[bus] for bus in sources] for s in steps], np.int64),
        load_scale=np.array([[s.topology.load_scale.get(x.name, 1.0) for x in loads] for s in steps]),
        load_noise=load_noise.table({}, loads, len(loads)),
        oscillations=_oscillations(system, listed, loads, inverters.rows, every),
        network=np.zeros((0, 0, 0), complex) if large else np.array(networks),
        sparse_networks=Table(networks if large else []),
        pmu_machine=np.array([at.get(pmu.machine, -1) for pmu in system.pmus]),
    )
    n, many = len(installed), len(ports.rows)
    source, motion = np.zeros(many, np.complex128), np.zeros((3, many), np.complex128)
    source[inverters.rows["port"]] = inverters.sources  # of several solutions that of the power flow
    at_rest = np.zeros(n), np.zeros(n), initial_watch(n), source, motion
    state = PlantState(np.array(states.values), *at_rest, *line([system.device(name).dead_time for name in installed]))
    if large:
        _settle(plant, state)
    return Built(plant, state, flow, states.names)


def _networks(
    reduce: Callable[..., Any],
    system: System,
    places: Sequence[Place],
    norton: Complex1,
    topologies: Sequence[Topology],
    magnitude: dict[str, float],
) -> list[Any]:
    """The network of each interval; one that comes again, as after a fault, is computed once."""
    networks: list[Any] = []
    for i, topology in enumerate(topologies):
        first = topologies.index(topology)
        networks.append(networks[first] if first < i else reduce(system, places, norton, topology, magnitude))
    return networks


def _settle(plant: Plant, state: PlantState) -> None:
    """Solve the sources of the ports of a large network at rest, which takes several solutions."""
    work = workspace(plant, state)
    for _ in range(AT_REST):
        solve_network(plant, state.x, state.reference, state.source, 0, work)


def _oscillations(
    system: System, listed: Sequence[Event], loads: Sequence[Load], inverters: NDArray[Any], every: NDArray[Any]
) -> NDArray[Any]:
    """The forced oscillations; that of an inverter is one of its plant's setpoint of active power, if it has one."""
    rows = oscillations(listed, *([x.name for x in of] for of in (system.machines, loads, system.inverters)))
    for row in rows:
        if (i := row["inverter"]) >= 0:
            row["input"] = power_input(inverters[i], every, system.inverters[i].name)
    return rows


def _units_at_rest(system: System, installed: Sequence[str]) -> tuple[PowerFlow, States, Ports, Rotating, Inverters]:
    """Power flow, machines and inverters at rest; a run asks twice: with events, and without for its design."""
    key, last = (system.model_dump_json(), list(installed), dict(MODELS)), _last[0]
    if last[0] != key:
        flow, states = solve(system, installed), States()
        rotating = machines_at_rest(system, flow, states)
        ports = _salient_ports(system, rotating)
        inverters = inverters_at_rest(system, flow, states, ports, sum(map(len, rotating.blocks)))
        last = _last[0] = key, (flow, states, ports, rotating, inverters)
    return deepcopy(last[1])  # type: ignore[no-any-return]


def _at_rest(
    system: System, installed: Sequence[str], loads: Sequence[Load]
) -> tuple[PowerFlow, States, Ports, Rotating, Inverters, NDArray[Any], NDArray[Any], NDArray[Any]]:
    """The plant's parts at rest, `loads` at ports. Raises `InputError` with all limits that exclude the start."""
    flow, states, ports, rotating, inverters = _units_at_rest(system, installed)
    if problems := [*map(str, [*rotating.violations, *inverters.violations]), *inverters.failures]:
        raise ProblemsError(problems)
    every = np.concatenate([np.zeros(0, blocks.BLOCK), *rotating.blocks, *inverters.blocks])
    magnitude = dict(zip(flow.names, magnitudes(flow.voltage).tolist(), strict=True))
    load_rows = _loads(system, loads, flow, magnitude, states, ports)
    present = in_service(system, installed)
    placed = _devices(system, present, flow, magnitude, states, ports)
    for d, device in enumerate(present):
        if isinstance(device, AtInverter):
            placed[d]["input"] = input_signal(inverters.rows[placed[d]["inverter"]], every, device)
    outputs = len(system.machines) + len(ports.rows) + 2 * len(system.pmus)
    for field, more in (("bus", 0), ("branch", len(system.meters))):
        inverters.rows[field] += np.where(inverters.rows[field] < 0, 0, outputs + more)
    return flow, states, ports, rotating, inverters, every, load_rows, placed


def _salient_ports(system: System, rotating: Rotating) -> Ports:
    """Ports of machines whose subtransient reactances differ by axis; the columns of all machines are set."""
    ports = Ports()
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


def longest_step(system: System, installed: Sequence[str]) -> float:
    """Longest step of the integrator with the devices in service, s."""
    return min([system.step, *(KINDS[device.kind].step for device in in_service(system, installed))])


def _loads(
    system: System, loads: Sequence[Load], flow: PowerFlow, voltages: dict[str, float], states: States, ports: Ports
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
    system: System, devices: Sequence[Device], flow: PowerFlow, voltages: dict[str, float], states: States, ports: Ports
) -> NDArray[Any]:
    rows = np.zeros(len(devices), dispatch.DEVICE)
    for d, device in enumerate(devices):
        machine, inverter, places, sizes, angle = -1, -1, list[Place](), [math.nan], 0.0
        if isinstance(device, AtInverter):
            inverter = [i.name for i in system.inverters].index(device.inverter)
        elif isinstance(device, AtMachine):
            machine = [m.name for m in system.machines].index(device.machine)
        elif isinstance(device, Series):
            places, sizes = [Place(device=device)], [flow.currents[device.name]]
        else:
            places, sizes = [Place(bus) for bus in device.buses], [voltages[bus] for bus in device.buses]
            angle = phase(flow.by_bus[device.buses[-1]] * flow.by_bus[device.buses[0]].conjugate())
        omega_0, at_controls = 2 * math.pi * system.frequency, (machine, inverter)
        site = Site(states.offset, omega_0, sizes[0], sizes[-1], system.base_power, *at_controls, angle)
        start = dispatch.install(rows[d], device, site)
        rows[d]["port"] = ports.add(DEVICE, d, places[0], start.minimum, start.maximum) if places else -1
        for place in places[1:]:
            rows[d]["other"] = ports.add(OTHER_END, d, place)
        names = KINDS[device.kind].states[: len(start.states)]
        lag = ["reference"] if device.response_time > 0.0 else []
        states.add(device.name, [*names, *lag], [*start.states, *(0.0 for _ in lag)])
    return rows
