"""What the linear network answers to its inputs, from a dense matrix or, of a large grid, from factors; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.plant.grid.sparse_network import output, solve_voltages

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Complex1
    from facts_damping.plant.model import Plant, Work


@compiled
def respond(plant: Plant, interval: int, work: Work) -> None:
    """Of a large grid, find the voltages of all buses for `work.inputs`; `row_times` needs them."""
    if len(plant.sparse_networks) > 0:
        solve_voltages(plant.sparse_networks[interval], work.inputs, work.voltage)


@compiled
def several_solutions(plant: Plant) -> bool:
    """Whether the last solution decides on the next one, to the bit: inverters in a small, weak grid."""
    return plant.inverters.size > 0 and len(plant.sparse_networks) == 0


@compiled
def row_times(plant: Plant, interval: int, row: int, inputs: Complex1, work: Work) -> complex:
    """One row of the network times its inputs, p.u."""
    if len(plant.sparse_networks) > 0:
        return output(plant.sparse_networks[interval], row, inputs, work.voltage)
    total = 0j
    for column in range(inputs.size):
        total += plant.network[interval, row, column] * inputs[column]
    return total


@compiled
def own_response(plant: Plant, interval: int, p: int) -> complex:
    """Response of a port to its own source, p.u."""
    if len(plant.sparse_networks) > 0:
        return plant.sparse_networks[interval].own[p]  # type: ignore[no-any-return]
    return plant.network[interval, plant.machines.size + p, plant.machines.size + plant.infinite.size + p]  # type: ignore[no-any-return]


@compiled
def set_sources(plant: Plant, source: Complex1, work: Work) -> None:
    """Write the ports' sources into the inputs."""
    first = plant.machines.size + plant.infinite.size
    for p in range(source.size):
        work.inputs[first + p] = source[p]
