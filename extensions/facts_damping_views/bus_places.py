"""Where buses stand in a one-line diagram.

Buses stand at their positions. Where one has none, those connected by a small reactance are drawn close together (T.
Kamada, S. Kawai, An algorithm for drawing general undirected graphs, Information Processing Letters 31, 1989).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.devices.base import Series, Transmission

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System

    Places = dict[str, NDArray[np.float64]]

NEAR, FAR = 0.4, 2.5  # of the median reactance: limits of the drawn branch lengths
EXACT = 300  # buses, up to which the layout by all distances takes seconds


def reactances(system: System) -> list[tuple[str, str, float]]:
    """Both buses and the size of the reactance of each line and transformer, p.u."""
    edges = [(row.from_bus, row.to_bus, abs(row.x) * row.length) for row in system.lines]
    return edges + [(t.from_bus, t.to_bus, abs(t.x) * system.base_power / t.rating) for t in system.transformers]


def places(system: System) -> Places:
    """Positions of buses by name, within a unit square about the origin."""
    fixed = {bus.name: bus.position for bus in system.buses if bus.position is not None}
    if len(fixed) == len(system.buses):
        given_places = np.array(list(fixed.values()))
        low, high = given_places.min(axis=0), given_places.max(axis=0)
        extent = float((high - low).max()) or 1.0
        return dict(zip(fixed, (2.0 * given_places - low - high) / extent, strict=True))
    import networkx as nx  # noqa: PLC0415 (it takes longer to load than the rest)

    graph: nx.Graph[str] = nx.Graph()
    graph.add_nodes_from(bus.name for bus in system.buses)
    edges = reactances(system)
    edges += [(*d.ends, 0.0) for d in system.devices if isinstance(d, Series)]
    edges += [(d.from_bus, d.to_bus, FAR) for d in system.devices if isinstance(d, Transmission)]
    usual = float(np.median([x for _, _, x in edges])) or 1.0
    for a, b, x in edges:
        distance = float(np.clip(x / usual, NEAR, FAR))
        graph.add_edge(a, b, distance=distance, weight=1.0 / distance)
    if len(graph) <= EXACT:
        return dict(nx.kamada_kawai_layout(graph, weight="distance"))
    return dict(nx.spring_layout(graph, seed=0, iterations=100))
