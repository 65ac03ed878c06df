"""The network between machines, infinite buses, ports and PMUs: by Kron reduction, or by factors if it is large."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.matrices import parts, product
from facts_damping.phasors import over, times
from facts_damping.plant.grid import network
from facts_damping.plant.grid.sparse import ComplexEntries, as_needed, factors, solve_network
from facts_damping.plant.grid.sparse_network import SparseNetwork, own_responses

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Bool1, Complex1, Complex2, Int1
    from facts_damping.parameters.plant.devices import Series
    from facts_damping.parameters.plant.pmus import Pmu
    from facts_damping.parameters.plant.system import System


STRAY = 1e-9j  # p.u., small susceptance at buses without a path to ground


class Place(NamedTuple):
    """Location of a port: in parallel at a bus (of a machine, load or device), or a series device."""

    bus: str = ""
    machine: str | None = None
    device: Series | None = None


class _Equations(NamedTuple):
    """A stage's network: `matrix @ voltage = sources @ inputs` for the buses of unknown voltage, `live`."""

    at: dict[str, int]  # index of each bus
    present: list[network.Branch]
    norton: Complex1  # (machines,), admittances, 0 if out of service
    matrix: Any  # (live, live), p.u., sparse if the network is large
    sources: Complex2  # (live, inputs)
    live: list[int]
    fixed: Complex2  # (buses, inputs): voltages of the others for unit inputs


class _Outputs(NamedTuple):
    """What outputs follow from: of a stage, the voltage of a bus as a row."""

    equations: _Equations
    voltage: Callable[[str], Complex1]


def reduce_network(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> Complex2:
    """Outputs of the network for unit inputs, (machines + ports + 2 PMUs, machines + infinite + ports), p.u.

    `norton`: admittances of the machines; `voltage`: magnitudes from the power flow. For inputs and outputs see
    `model.Plant`. Raises `InputError` if the network equations are singular.
    """
    net = _equations(system, places, norton, topology, voltage)
    found = net.fixed
    with _singular(system):
        found[net.live] = solve_network(net.matrix, net.sources)
    return np.array(list(_rows(system, places, _Outputs(net, lambda bus: found[net.at[bus]]))))


def sparse_network(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> SparseNetwork:
    """The same without the dense matrix, for large networks."""
    net = _equations(system, places, norton, topology, voltage)
    with _singular(system):
        found = factors(net.matrix, complex)
    inputs = net.sources.shape[1]
    behind = dict(zip((net.live[i] for i in found.order), range(inputs, inputs + len(net.live)), strict=True))

    def unit(bus: str) -> Complex1:
        row = np.zeros(inputs + len(net.live), np.complex128)
        if (column := behind.get(net.at[bus])) is None:
            row[:inputs] = net.fixed[net.at[bus]]
        else:
            row[column] = 1.0
        return row

    upper = found.upper.value.copy()
    upper[found.upper.begin[1:] - 1] = over(1.0, upper[found.upper.begin[1:] - 1])
    fed = [np.flatnonzero(column) for column in net.sources.T]
    made = SparseNetwork(
        lower=_cut(found.lower),
        upper=_cut(found.upper._replace(value=upper)),
        inputs=_entries(((found.place[at], net.sources[at, c]) for c, at in enumerate(fed))),
        outputs=_entries((np.flatnonzero(row), row[row != 0]) for row in _rows(system, places, _Outputs(net, unit))),
        own=np.zeros(len(places), np.complex128),
    )
    own_responses(made, np.zeros(inputs, np.complex128), np.zeros(len(net.live), np.complex128), len(norton))
    return made


def _entries(columns: Iterable[tuple[Int1, Complex1]]) -> ComplexEntries:
    found = list(columns)
    begin = np.cumsum([0, *(len(at) for at, _ in found)])
    joined = [np.concatenate([part[i] for part in found]) if found else np.zeros(0) for i in range(2)]
    return ComplexEntries(begin.astype(np.int64), joined[0].astype(np.int64), joined[1].astype(np.complex128))


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


def _rows(system: System, places: Sequence[Place], net: _Outputs) -> Iterator[Complex1]:
    """The outputs: voltages of machines, responses of ports, voltages and currents of PMUs."""
    for m in system.machines:
        yield net.voltage(m.bus)
    for place in places:
        yield _series_current(system, net, places, place.device) if place.device else net.voltage(place.bus)
    for bus in system.pmu_buses().values():
        yield net.voltage(bus)
    for pmu in system.pmus:
        yield _pmu_current(system, pmu, net, places)


def _equations(
    system: System, places: Sequence[Place], norton: Complex1, topology: network.Topology, voltage: dict[str, float]
) -> _Equations:
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
    rest = sources[live] - product(matrix[np.ix_(live, known)], given[known])
    return _Equations(index, present, norton, as_needed(matrix[np.ix_(live, live)], len(names)), rest, live, given)


def floating(matrix: Complex2, fixed: set[int]) -> Bool1:
    """Buses without a path to a shunt or a bus of fixed voltage, whose voltage is therefore undefined."""
    label = parts(matrix != 0)
    shunt = np.abs(matrix.sum(axis=1)) > 1e-9 * np.abs(matrix).max(axis=1)  # rows of lossless parts sum to zero
    shunt[list(fixed)] = True
    fed = set(label[shunt])
    return np.array([part not in fed for part in label])


def _series_current(system: System, net: _Outputs, places: Sequence[Place], device: Series) -> Complex1:
    """Matrix row of the current through a device from its first to its second bus: (V1 - V2 - v) / (rs + j xs)."""
    first, second = device.ends
    row: NDArray[np.complex128] = net.voltage(first) - net.voltage(second)
    own = [place.device.name if place.device else None for place in places].index(device.name)
    row[len(net.equations.norton) + len(system.infinite_buses) + own] -= 1.0
    return over(row, complex(device.rs, device.xs))


def _pmu_current(system: System, pmu: Pmu, net: _Outputs, places: Sequence[Place]) -> Complex1:
    """Matrix row of a PMU's current: out of its machine, or from its bus into its branches."""
    row = np.zeros_like(net.voltage(system.buses[0].name))
    if pmu.machine is not None:
        g = [m.name for m in system.machines].index(pmu.machine)
        if net.equations.norton[g] != 0:
            row[g] = 1.0
            for p, place in enumerate(places):
                row[len(net.equations.norton) + len(system.infinite_buses) + p] = float(place.machine == pmu.machine)
        row -= times(net.equations.norton[g], net.voltage(system.pmu_buses()[pmu.name]))
        return row
    installed = {place.device.name: place.device for place in places if place.device}
    for branch in net.equations.present:
        if branch.name not in pmu.branches or pmu.bus not in (branch.from_bus, branch.to_bus):
            continue  # the far section of a faulted line
        own = 0 if branch.from_bus == pmu.bus else 1
        if branch.name in installed:
            through = _series_current(system, net, places, installed[branch.name])
            row += through if own == 0 else -through
            continue
        ends = np.array([net.voltage(branch.from_bus), net.voltage(branch.to_bus)])
        row += product(branch.admittance[own], ends)
    return row
