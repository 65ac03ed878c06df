"""The network between machines, infinite buses, ports and PMUs: by Kron reduction, or by factors if it is large."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.numerics.matrices import parts
from facts_damping.numerics.phasors import over, times
from facts_damping.plant.grid import network
from facts_damping.plant.grid.sparse import ComplexEntries, Triplets, factors, filled, solve_network, summed
from facts_damping.plant.grid.sparse_network import SparseNetwork, own_responses

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from facts_damping.compiling.structs import Bool1, Complex1, Complex2, Int1
    from facts_damping.devices.base import Series
    from facts_damping.parameters.plant.inverters import Meter
    from facts_damping.parameters.plant.pmus import Pmu
    from facts_damping.parameters.plant.system import System


STRAY = 1e-9j  # p.u., small susceptance at buses without a path to ground


class Place(NamedTuple):
    """Location of a port: in parallel at a bus (of a machine, load, device or inverter), or a series device.

    `admittance` (p.u.) of an inverter is in the network while it is in service.
    """

    bus: str = ""
    machine: str | None = None
    device: Series | None = None
    inverter: str | None = None
    admittance: complex = 0j


class _Equations(NamedTuple):
    """An interval's network: `matrix @ voltage = sources @ inputs` for the buses of unknown voltage, `live`."""

    at: dict[str, int]  # index of each bus
    present: list[network.Branch]
    norton: Complex1  # (machines,), admittances, 0 if out of service
    matrix: Any  # (live, live), p.u., sparse if the network is large
    sources: Triplets  # (live, inputs)
    inputs: int
    live: Int1
    out: frozenset[str]  # machines and inverters out of service
    fixed: dict[int, int]  # input that is the voltage of an infinite bus


# A part of an output: factors of voltages (by their bus) and inputs (from the number of buses on), and their divisor.
Part = tuple[list[tuple[complex, int]], complex]


def reduce_network(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> Complex2:
    """Outputs of the network for unit inputs, (machines + ports + 2 PMUs, machines + infinite + ports), p.u.

    `norton`: admittances of the machines; `voltage`: magnitudes from the power flow. For inputs and outputs see
    `model.Plant`. Raises `InputError` if the network equations are singular.
    """
    net = _equations(system, places, norton, topology, voltage)
    buses = len(net.at)
    sources, solution = (np.zeros((n, net.inputs), np.complex128) for n in (len(net.live), buses + net.inputs))
    sources[net.sources.row, net.sources.column] = net.sources.value
    with _singular(system):
        solution[net.live] = solve_network(net.matrix, sources)
    for bus, column in net.fixed.items():
        solution[bus, column] = 1.0
    solution[buses:] = np.eye(net.inputs)
    outputs = list(_outputs(system, places, net))
    parts_of = [(o, terms, divisor) for o, added in enumerate(outputs) for terms, divisor in added if terms]
    factor, at = (np.array([term[i] for _, terms, _ in parts_of for term in terms]) for i in range(2))
    length = np.array([len(terms) for _, terms, _ in parts_of])
    products, begin = times(factor[:, None], solution[at]), np.cumsum(length) - length
    sums, responses = (np.zeros((n, net.inputs), np.complex128) for n in (len(parts_of), len(outputs)))
    for k in range(length.max(initial=0)):  # in the order of the terms
        sums[length > k] += products[begin[length > k] + k]
    np.add.at(responses, [o for o, _, _ in parts_of], over(sums, np.array([[divisor] for _, _, divisor in parts_of])))
    return responses


def sparse_network(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> SparseNetwork:
    """The same without the dense matrix, for large networks."""
    net = _equations(system, places, norton, topology, voltage)
    with _singular(system):
        lu = factors(net.matrix, complex)
    inputs, buses, live = net.inputs, len(net.at), len(net.live)
    column = dict(zip(net.live[lu.order].tolist(), range(inputs, inputs + live), strict=True)) | net.fixed
    column |= {buses + i: i for i in range(inputs)}
    upper = lu.upper.value.copy()
    upper[lu.upper.begin[1:] - 1] = over(1.0, upper[lu.upper.begin[1:] - 1])
    outputs = (
        (o, column[at], complex(over(factor, divisor)))
        for o, added in enumerate(_outputs(system, places, net))
        for terms, divisor in added
        for factor, at in terms
        if at in column  # not at a bus with a bolted fault
    )
    reduced = SparseNetwork(
        lower=_cut(lu.lower),
        upper=_cut(lu.upper._replace(value=upper)),
        inputs=_entries(inputs, net.sources.column, lu.place[net.sources.row], net.sources.value),
        outputs=_entries(
            len(norton) + len(places) + 2 * (len(system.pmus) + len(system.meters)), *summed(inputs + live, outputs)
        ),
        own=np.zeros(len(places), np.complex128),
    )
    own_responses(reduced, np.zeros(inputs, np.complex128), np.zeros(live, np.complex128), len(norton))
    return reduced


def _entries(columns: int, column: Int1, row: Int1, value: Complex1) -> ComplexEntries:
    """Entries by columns, in the given order within a column."""
    order = np.argsort(column, kind="stable")
    begin = np.searchsorted(column[order], np.arange(columns + 1)).astype(np.int64)
    return ComplexEntries(begin, row[order].astype(np.int64), value[order])


def _cut(entries: ComplexEntries) -> ComplexEntries:
    """Without the room behind the last entry."""
    end = entries.begin[-1]
    return ComplexEntries(entries.begin, entries.row[:end].copy(), entries.value[:end].copy())


@contextmanager
def _singular(system: System) -> Iterator[None]:
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"system {system.name}: network equations are singular: {error}; allowed: a regular network"
        ) from error


def _outputs(system: System, places: Sequence[Place], net: _Equations) -> Iterator[list[Part]]:
    """The outputs: voltages of machines, responses of ports, voltages and currents of PMUs and of plants' meters."""
    first = len(net.at) + len(net.norton) + len(system.infinite_buses)
    series = {device.name: _series_current(net, device, first + p) for p, device in _in_series(places)}
    machines = {m.name: g for g, m in enumerate(system.machines)}
    salient: dict[str | None, list[int]] = {}
    for p, place in enumerate(places):
        salient.setdefault(place.machine, []).append(first + p)
    branches: dict[str, list[int]] = {}
    for i, branch in enumerate(net.present):
        branches.setdefault(branch.name, []).append(i)

    inverters = {place.inverter: (p, place) for p, place in enumerate(places) if place.inverter}

    def of_machine(name: str) -> list[Part]:
        if name in inverters:
            p, place = inverters[name]
            return [([(1.0, first + p), (-place.admittance * (name not in net.out), net.at[place.bus])], 1.0)]
        g = machines[name]
        terms = [] if net.norton[g] == 0 else [len(net.at) + g, *salient.get(name, [])]
        return [([*((1.0, at) for at in terms), (-net.norton[g], net.at[system.machines[g].bus])], 1.0)]

    def into_branches(pmu: Pmu | Meter) -> Iterator[Part]:
        for i in sorted(i for name in pmu.branches for i in branches.get(name, [])):
            branch = net.present[i]
            if pmu.bus not in (branch.from_bus, branch.to_bus):
                continue  # the far section of a faulted line
            end = 0 if branch.from_bus == pmu.bus else 1
            if branch.name in series:
                terms, divisor = series[branch.name]
                yield terms, divisor if end == 0 else -divisor
            else:
                ends = net.at[branch.from_bus], net.at[branch.to_bus]
                yield list(zip(branch.admittance[end].tolist(), ends, strict=True)), 1.0

    for bus in (m.bus for m in system.machines):
        yield [([(1.0, net.at[bus])], 1.0)]
    for place in places:
        yield [series[place.device.name] if place.device else ([(1.0, net.at[place.bus])], 1.0)]
    for bus in system.pmu_buses().values():
        yield [([(1.0, net.at[bus])], 1.0)]
    for pmu in system.pmus:
        yield of_machine(pmu.machine) if pmu.machine is not None else list(into_branches(pmu))
    for meter in system.meters:
        yield [([(1.0, net.at[meter.bus])], 1.0)]
    for meter in system.meters:
        yield list(into_branches(meter))


def _in_series(places: Sequence[Place]) -> list[tuple[int, Series]]:
    """Ports of series devices."""
    return [(p, place.device) for p, place in enumerate(places) if place.device]


def _series_current(net: _Equations, device: Series, port: int) -> Part:
    """The current through a device from its first to its second bus: (V1 - V2 - v) / (rs + j xs)."""
    first, second = device.ends
    return [(1.0, net.at[first]), (-1.0, net.at[second]), (-1.0, port)], complex(device.rs, device.xs)


def _equations(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> _Equations:
    names = network.bus_names(system, topology)
    index = {name: i for i, name in enumerate(names)}
    in_series = _in_series(places)
    installed = {device.name for _, device in in_series}
    present = network.branches(system, topology)
    present += [
        network.device_section(d, complex(d.rs, d.xs) if d.name in installed else network.at_rest(d))
        for d in network.series_devices(system)
    ]
    norton = norton * np.array([m.name not in topology.machines_out for m in system.machines])
    at_machines = [(m.bus, norton[g]) for g, m in enumerate(system.machines)]
    machines, infinite = len(norton), len(system.infinite_buses)
    dead = network.grounded(topology)
    fixed = {index[inf.bus]: machines + i for i, inf in enumerate(system.infinite_buses) if inf.bus not in dead}
    known = np.isin(np.arange(len(names)), [*fixed, *(index[bus] for bus in dead)])
    behind_ports = [(p.bus, p.admittance) for p in places if p.admittance and p.inverter not in topology.machines_out]
    shunts = [*network.shunts(system, topology, voltage).items(), *at_machines, *behind_ports]
    matrix = network.admittance(index, present, shunts)
    stray = [(names[i], STRAY) for i in np.flatnonzero(floating(matrix, known))]
    if stray:
        matrix = network.admittance(index, present, [*shunts, *stray])
    entries = [(index[m.bus], g, 1.0 + 0j) for g, m in enumerate(system.machines)]
    for p, place in enumerate(places, machines + infinite):
        if place.device is None:
            entries.append((index[place.bus], p, 1.0 + 0j))
        else:
            first, second = place.device.ends
            behind = complex(over(1.0, complex(place.device.rs, place.device.xs)))
            entries += [(index[first], p, behind), (index[second], p, -behind)]
    entries += [(i, fixed[j], -value) for i, j, value in zip(*matrix, strict=True) if j in fixed]
    live = np.flatnonzero(~known)
    place_of = np.cumsum(~known) - 1
    inner = ~known[matrix.row] & ~known[matrix.column]
    at = place_of[matrix.row[inner]], place_of[matrix.column[inner]]
    inputs = machines + infinite + len(places)
    sources = summed(inputs, ((place_of[i], c, value) for i, c, value in entries if not known[i]))
    matrix_of_live = filled(len(names), at, matrix.value[inner], len(live))
    out = frozenset(topology.machines_out)
    return _Equations(index, present, norton, matrix_of_live, sources, inputs, live, out, fixed)


def floating(matrix: Triplets, fixed: Bool1) -> Bool1:
    """Buses without a path to a shunt or a bus of fixed voltage, whose voltage is therefore undefined."""
    sums, largest = np.zeros(len(fixed), complex), np.zeros(len(fixed))
    np.add.at(sums, matrix.row, matrix.value)
    np.maximum.at(largest, matrix.row, np.abs(matrix.value))
    label = np.array(parts(len(fixed), zip(matrix.row, matrix.column, strict=True)), int)
    fed = label[(np.abs(sums) > 1e-9 * largest) | fixed]  # rows of lossless parts sum to zero
    return np.isin(label, fed, invert=True)
