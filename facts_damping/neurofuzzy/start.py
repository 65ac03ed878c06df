"""Initial parameters of a network (symmetric rules), their bounds and groups.

Two rules are mirror images, F_2(x) = F_1(-x) and zeta_2(x) = -zeta_1(-x), so that the output is odd and
zero at x = 0. (Three or more rules are spaced evenly between the two.)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1
    from facts_damping.neurofuzzy.network import Network
    from facts_damping.neurofuzzy.table import Antecedent, Consequent, Slot


class Start(NamedTuple):
    """Initial values of the rules: one entry per input, except for the weight."""

    weight: Sequence[float] | NDArray[np.float64]  # (outputs,), consequents from -weight to weight
    spread: Sequence[float] | NDArray[np.float64]  # centres h of memberships from -spread to spread
    width: Sequence[float] | NDArray[np.float64]  # widths s of memberships
    shift: Sequence[float] | NDArray[np.float64]  # tau of wavelets from -shift to shift
    dilation: Sequence[float] | NDArray[np.float64]  # nu of wavelets


def rows(net: Network) -> tuple[Antecedent, Consequent]:
    """The rows of the tables for a network's memberships and consequents."""
    return list(ANTECEDENTS.values())[net.antecedent_row], list(CONSEQUENTS.values())[net.consequent_row]


def slots(net: Network) -> list[Slot]:
    """The slots of all parameters of a network, in order."""
    antecedent, consequent = rows(net)
    return antecedent.slots * (net.inputs * net.rules) + consequent.slots(net.inputs) * (net.rules * net.outputs)


def groups(net: Network) -> list[str]:
    """Names of the groups of parameters, in order of appearance: h, s, w and so on."""
    return list(dict.fromkeys(slot.group for slot in slots(net)))


def initial(net: Network, start: Start) -> Float1:
    """Initial parameters, (net.size,), within their bounds."""
    sides = np.linspace(-1.0, 1.0, net.rules) if net.rules > 1 else np.zeros(1)
    antecedent, consequent = rows(net)
    members = [antecedent.start(side * start.spread[i], start.width[i]) for i in range(net.inputs) for side in sides]
    rules = np.zeros((net.rules, net.outputs, net.width))
    for j, side in enumerate(sides.tolist()):
        for o in range(net.outputs):
            parameters = consequent.start(side * start.weight[o], side, start.shift, start.dilation)
            rules[j, o, : len(parameters)] = parameters
    theta = np.concatenate([np.ravel(members), np.ravel(rules)])
    parameter_slots = slots(net)
    return np.asarray(np.clip(theta, [slot.low for slot in parameter_slots], [slot.high for slot in parameter_slots]))
