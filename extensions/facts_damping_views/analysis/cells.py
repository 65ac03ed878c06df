"""Parts of a grid between PMUs: what the energy that is measured at them comes out of.

Nodes of a graph are buses, branches, machines and inverters; its edges are the ends of branches and the terminals of
units. Each PMU measures what flows over some edges, which are taken out. What hangs together then is a cell, and the
sum of the flows out of it is what is produced within. A PMU that measures the sum of several branches cannot tell their
other ends apart: these are one cell; if one of them is that of its own bus, it tells nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.devices.base import Series
from facts_damping.numerics.matrices import parts
from facts_damping_views.bus_places import reactances

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    import networkx as nx

    from facts_damping.compiling.structs import Float2
    from facts_damping.parameters.plant.pmus import Pmu
    from facts_damping.parameters.plant.system import System

    Node = tuple[str, str]  # bus, branch or unit; and its name


class Cell(NamedTuple):
    """What lies between PMUs, by name; `areas`: of its units, and of those nearest to its buses."""

    units: list[str]
    loads: list[str]
    buses: list[str]  # without those of single units that a PMU separates from their bus
    bus: str  # of the first unit, else of the first load, else the first of all, else one at the branch
    areas: list[str]


class Cells(NamedTuple):
    """Cells, and the matrix (cells, PMUs) that gives what they produce from the flows that the PMUs measure."""

    cells: list[Cell]
    balance: Float2


def ends(system: System, out: Collection[str] = ()) -> dict[str, tuple[str, str]]:
    """Buses of each branch in service: line, transformer, device in series; `out`: names of those out of service."""
    return {name: pair for name, pair in system.branch_ends() if name not in out}


def cells(system: System, measuring: Sequence[bool], out: Collection[str] = ()) -> Cells:
    """The cells of a grid; `measuring`: whether each PMU of the system has data; `out`: branches and units out."""
    branches = ends(system, out)
    units = {unit.name: unit.bus for unit in system.units if unit.name not in out}
    edges = {(("bus", bus), ("branch", name)) for name, pair in branches.items() for bus in pair}
    edges |= {(("bus", bus), ("unit", name)) for name, bus in units.items()}
    cuts: dict[int, list[tuple[Node, Node]]] = {}
    for s, pmu in enumerate(system.pmus):
        cut = _edges(pmu, units)
        if measuring[s] and cut and edges.issuperset(cut):
            edges -= set(cut)
            cuts[s] = cut
    nodes: list[Node] = [("bus", bus.name) for bus in system.buses]
    nodes += [("branch", name) for name in branches] + [("unit", name) for name in units]
    index = {node: k for k, node in enumerate(nodes)}
    links = [(index[a], index[b]) for a, b in sorted(edges)]
    labels = _told_apart(len(nodes), links, [[(index[a], index[b]) for a, b in cut] for cut in cuts.values()])
    balance = np.zeros((max(labels) + 1, len(system.pmus)))
    for s, cut in cuts.items():
        near, far = (labels[index[node]] for node in cut[0])
        if near != far:
            sign = -1.0 if system.pmus[s].machine is not None else 1.0  # a PMU at a machine: into the bus
            balance[near, s] += sign
            balance[far, s] -= sign
    area = areas(system)
    members: list[list[Node]] = [[] for _ in balance]
    for node, label in zip(nodes, labels, strict=True):
        members[label].append(node)
    return Cells([_cell(system, group, units, branches, area) for group in members], balance)


def _edges(pmu: Pmu, units: dict[str, str]) -> list[tuple[Node, Node]]:
    """What a PMU measures: from a bus into branches, or from a unit into its bus."""
    if pmu.machine is not None:
        return [(("bus", units[pmu.machine]), ("unit", pmu.machine))] if pmu.machine in units else []
    return [(("bus", str(pmu.bus)), ("branch", name)) for name in pmu.branches]


def _told_apart(count: int, links: list[tuple[int, int]], cuts: list[list[tuple[int, int]]]) -> list[int]:
    """Number of the cell of each node, with cells together that the sums of a PMU do not tell apart."""
    while True:
        labels = parts(count, links)
        more = []
        for cut in cuts:
            near, far = labels[cut[0][0]], {labels[b] for _, b in cut}
            if near in far and len(far) > 1:
                more += cut
            elif len(far) > 1:
                more += [(cut[0][1], b) for _, b in cut[1:]]
        if not more:
            return labels
        links = [*links, *more]


def areas(system: System) -> dict[str, str]:
    """Area of each bus: that of the unit at the least reactance from it; empty without areas."""
    import networkx as nx  # noqa: PLC0415 (it takes longer to load than the rest)

    graph: nx.Graph[str] = nx.Graph()
    graph.add_nodes_from(bus.name for bus in system.buses)
    edges = [*reactances(system), *((*d.ends, d.xs) for d in system.devices if isinstance(d, Series))]
    for a, b, x in edges:
        graph.add_edge(a, b, x=x)
    of_bus = {unit.bus: unit.area for unit in system.units if unit.area}
    if not of_bus:
        return {}
    paths = nx.multi_source_dijkstra_path(graph, set(of_bus), weight="x")
    return {bus: of_bus[path[0]] for bus, path in paths.items()}


def _cell(
    system: System, group: list[Node], at: dict[str, str], branches: dict[str, tuple[str, str]], area: dict[str, str]
) -> Cell:
    """A cell of some nodes."""
    units, buses, lines = ([name for kind, name in group if kind == sort] for sort in ("unit", "bus", "branch"))
    there = set(buses)
    loads = {load.name: load.bus for load in system.loads if load.bus in there}
    stands = [*(at[name] for name in units), *loads.values(), *buses] or [branches[lines[0]][0]]
    return Cell(units, list(loads), buses, stands[0], sorted({area[bus] for bus in stands if bus in area}))
