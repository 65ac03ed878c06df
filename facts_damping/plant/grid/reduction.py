"""Kron reduction of the network to machines, infinite buses, ports and PMUs."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.matrices import parts, product
from facts_damping.phasors import over, times
from facts_damping.plant.grid import network
from facts_damping.plant.grid.sparse import as_needed, solve_network

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Bool1, Complex1, Complex2
    from facts_damping.parameters.plant.devices import Series
    from facts_damping.parameters.plant.pmus import Pmu
    from facts_damping.parameters.plant.system import System


STRAY = 1e-9j  # p.u., small susceptance at buses without a path to ground


class Place(NamedTuple):
    """Location of a port: in parallel at a bus (of a machine, load or device), or a series device."""

    bus: str = ""
    machine: str | None = None
    device: Series | None = None


class ReducedNetwork(NamedTuple):
    """A stage's network without sources: index of each bus, all branches, voltages for unit inputs."""

    at: dict[str, int]
    present: list[network.Branch]
    norton: Complex1  # (machines,), admittances, 0 if out of service
    voltage: Complex2  # (buses, inputs), p.u.


def reduce_network(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> Complex2:
    """Outputs of the network for unit inputs, (machines + ports + 2 PMUs, machines + infinite + ports), p.u.

    `norton`: admittances of the machines; `voltage`: magnitudes from the power flow. For inputs and outputs see
    `model.Plant`. Raises `InputError` if the network equations are singular.
    """
    net = _solve(system, places, norton, topology, voltage)
    machine_rows = net.voltage[[net.at[m.bus] for m in system.machines]]
    port_rows = [
        _series_current(system, net, places, place.device) if place.device else net.voltage[net.at[place.bus]]
        for place in places
    ]
    at = [net.at[bus] for bus in system.pmu_buses().values()]
    currents = [_pmu_current(system, s, net, places) for s in system.pmus]
    return np.array([*machine_rows, *port_rows, *net.voltage[at], *currents])


def _solve(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> ReducedNetwork:
    """Voltages of all buses for unit inputs."""
    names = network.bus_names(system, topology)
    index = {name: i for i, name in enumerate(names)}
    installed = {place.device.name: place.device for place in places if place.device}
    present = network.branches(system, topology)
    present += [
        network.device_section(d, complex(d.rs, d.xs) if d.name in installed else network.at_rest(d))
        for d in network.series_devices(system)
    ]
    matrix = network.admittance(names, present)
    for bus, shunt in network.shunts(system, topology, voltage).items():
        matrix[index[bus], index[bus]] += shunt
    online = np.array([m.name not in topology.machines_out for m in system.machines])
    norton = norton * online
    for g, m in enumerate(system.machines):
        matrix[index[m.bus], index[m.bus]] += norton[g]
    machines, infinite = len(norton), len(system.infinite_buses)
    sources = np.zeros((len(names), machines + infinite + len(places)), np.complex128)
    for g, m in enumerate(system.machines):
        sources[index[m.bus], g] = 1.0
    for p, place in enumerate(places):
        column = machines + infinite + p
        if place.device is None:
            sources[index[place.bus], column] = 1.0
        else:
            first, second = place.device.ends
            behind = complex(over(1.0, complex(place.device.rs, place.device.xs)))
            sources[index[first], column], sources[index[second], column] = behind, -behind
    dead = network.grounded(topology)
    fixed = {index[name] for name in (*dead, *(i.bus for i in system.infinite_buses))}
    matrix[np.diag_indices(len(names))] += floating(matrix, fixed) * STRAY
    given = np.zeros_like(sources)
    for i, source in enumerate(system.infinite_buses):
        if source.bus not in dead:
            given[index[source.bus], machines + i] = 1.0
    live, known = [i for i in range(len(names)) if i not in fixed], sorted(fixed)
    try:
        own = as_needed(matrix[np.ix_(live, live)], len(names))
        given[live] = solve_network(own, sources[live] - product(matrix[np.ix_(live, known)], given[known]))
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"system {system.name}: network equations are singular: {error}; allowed: a regular network"
        ) from error
    return ReducedNetwork(index, present, norton, given)


def floating(matrix: Complex2, fixed: set[int]) -> Bool1:
    """Buses without a path to a shunt or a bus of fixed voltage, whose voltage is therefore undefined."""
    label = parts(matrix != 0)
    shunt = np.abs(matrix.sum(axis=1)) > 1e-9 * np.abs(matrix).max(axis=1)  # rows of lossless parts sum to zero
    shunt[list(fixed)] = True
    fed = set(label[shunt])
    return np.array([part not in fed for part in label])


def _series_current(system: System, net: ReducedNetwork, places: Sequence[Place], device: Series) -> Complex1:
    """Matrix row of the current through a device from its first to its second bus: (V1 - V2 - v) / (rs + j xs)."""
    first, second = device.ends
    row: NDArray[np.complex128] = net.voltage[net.at[first]] - net.voltage[net.at[second]]
    own = [place.device.name if place.device else None for place in places].index(device.name)
    row[len(net.norton) + len(system.infinite_buses) + own] -= 1.0
    return over(row, complex(device.rs, device.xs))


def _pmu_current(system: System, pmu: Pmu, net: ReducedNetwork, places: Sequence[Place]) -> Complex1:
    """Matrix row of a PMU's current: out of its machine, or from its bus into its branches."""
    row = np.zeros(net.voltage.shape[1], np.complex128)
    if pmu.machine is not None:
        g = [m.name for m in system.machines].index(pmu.machine)
        if net.norton[g] != 0:
            row[g] = 1.0
            for p, place in enumerate(places):
                row[len(net.norton) + len(system.infinite_buses) + p] = float(place.machine == pmu.machine)
        row -= times(net.norton[g], net.voltage[net.at[system.pmu_buses()[pmu.name]]])
        return row
    installed = {place.device.name: place.device for place in places if place.device}
    for branch in net.present:
        if branch.name not in pmu.branches or pmu.bus not in (branch.from_bus, branch.to_bus):
            continue  # the far section of a faulted line
        own = 0 if branch.from_bus == pmu.bus else 1
        if branch.name in installed:
            through = _series_current(system, net, places, installed[branch.name])
            row += through if own == 0 else -through
            continue
        ends = net.voltage[[net.at[branch.from_bus], net.at[branch.to_bus]]]
        row += product(branch.admittance[own], ends)
    return row
