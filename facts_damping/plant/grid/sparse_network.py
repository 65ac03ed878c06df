"""The network of an interval of a large grid: factors of its admittance matrix, instead of a dense matrix; compiled.

A dense matrix of N outputs and N inputs costs N^2 at each evaluation. The voltages of all buses for given inputs cost
some ten operations a bus; outputs depend on the voltages of one or two buses.
"""

from __future__ import annotations

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Complex1, Struct
from facts_damping.plant.grid.sparse import ComplexEntries


class SparseNetwork(Struct):
    """Factors of the admittance matrix of the buses whose voltage is unknown, and what goes in and out.

    `inputs`: by columns, an entry for each bus that an input of `model.Plant.network` feeds, at its place in the
    elimination; `outputs`: by rows of `model.Plant.network`, factors of the inputs and, behind them, of the voltages in
    their order of elimination. `own`: the response of each port to its own source, p.u.
    """

    lower: ComplexEntries
    upper: ComplexEntries
    inputs: ComplexEntries
    outputs: ComplexEntries
    own: Complex1


@compiled
def solve_voltages(net: SparseNetwork, inputs: Complex1, voltage: Complex1) -> None:
    """Write the voltages for the inputs, p.u., in their order of elimination."""
    n = net.lower.begin.size - 1
    for k in range(n):
        voltage[k] = 0.0
    for c in range(inputs.size):
        for i in range(net.inputs.begin[c], net.inputs.begin[c + 1]):
            voltage[net.inputs.row[i]] += net.inputs.value[i] * inputs[c]
    lower, upper = net.lower, net.upper
    for k in range(n):
        known = voltage[k]
        for i in range(lower.begin[k] + 1, lower.begin[k + 1]):
            voltage[lower.row[i]] -= lower.value[i] * known
    for k in range(n - 1, -1, -1):
        last = upper.begin[k + 1] - 1
        known = voltage[k] * upper.value[last]
        voltage[k] = known
        for i in range(upper.begin[k], last):
            voltage[upper.row[i]] -= upper.value[i] * known


@compiled
def output(net: SparseNetwork, row: int, inputs: Complex1, voltage: Complex1) -> complex:
    """One output, p.u."""
    total, many = 0j, inputs.size
    for i in range(net.outputs.begin[row], net.outputs.begin[row + 1]):
        at = net.outputs.row[i]
        total += net.outputs.value[i] * (inputs[at] if at < many else voltage[at - many])
    return total


@entry_point
def own_responses(net: SparseNetwork, inputs: Complex1, voltage: Complex1, machines: int) -> None:
    """Write the response of each port to its own source into `net.own`, p.u.; `inputs` are zero before and after."""
    first = inputs.size - net.own.size
    for p in range(net.own.size):
        inputs[first + p] = 1.0
        solve_voltages(net, inputs, voltage)
        net.own[p] = output(net, machines + p, inputs, voltage)
        inputs[first + p] = 0.0
