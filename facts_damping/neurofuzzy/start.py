"""What a network starts from: symmetric rules, bounds and groups of its parameters.

Two rules are each other's mirror image, F_2(x) = F_1(-x) and zeta_2(x) = -zeta_1(-x), so that the output is odd and
zero at x = 0. (Three rules and more spread evenly between the two.)
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.neurofuzzy.table import (
    ANTECEDENTS,
    CONSEQUENTS,
    DEGREE,
    LEGENDRE_WAVELET,
    MEXICAN_HAT,
    MORLET,
    POINTS,
    SAM,
    SPLINE,
    SPLINE_NEAREST,
    Slot,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.neurofuzzy.network import Network


class Start(NamedTuple):
    """Where the rules start: an entry an input, but for the weight."""

    weight: Sequence[float] | NDArray[np.float64]  # (outputs,), of the consequents: -weight to weight
    spread: Sequence[float] | NDArray[np.float64]  # centres h of the memberships: -spread to spread
    width: Sequence[float] | NDArray[np.float64]  # s of the memberships
    shift: Sequence[float] | NDArray[np.float64]  # tau of wavelets: -shift to shift
    dilation: Sequence[float] | NDArray[np.float64]  # nu of wavelets


def slots(net: Network) -> list[Slot]:
    """The slot of every parameter of a network, in their order."""
    antecedent = next(row for row in ANTECEDENTS.values() if row.code == net.antecedent)
    consequent = next(row for row in CONSEQUENTS.values() if row.code == net.consequent)
    return antecedent.slots * (net.inputs * net.rules) + consequent.slots(net.inputs) * (net.rules * net.outputs)


def groups(net: Network) -> list[str]:
    """Names of the groups of parameters, in order of appearance: h, s, w and so on."""
    return list(dict.fromkeys(slot.group for slot in slots(net)))


def initial(net: Network, start: Start) -> NDArray[np.float64]:
    """Parameters at the start, shape (net.size,), within their bounds."""
    sides = np.linspace(-1.0, 1.0, net.rules) if net.rules > 1 else np.zeros(1)
    members = [_membership(net, side * start.spread[i], start.width[i]) for i in range(net.inputs) for side in sides]
    rules = [_consequent(net, side, start, o) for side in sides for o in range(net.outputs)]
    theta = np.concatenate([*members, *rules])
    own = slots(net)
    return np.asarray(np.clip(theta, [slot.low for slot in own], [slot.high for slot in own]))


def _membership(net: Network, centre: float, width: float) -> NDArray[np.float64]:
    """Parameters of one membership; a spline's degrees start as those of a gaussian."""
    if net.antecedent in (SPLINE_NEAREST, SPLINE):
        degrees = [math.exp(-(((point - centre) / width) ** 2)) for point in np.linspace(-1.0, 1.0, POINTS).tolist()]
        return np.clip(degrees, DEGREE.low, DEGREE.high)
    return np.array([centre, width])


def _consequent(net: Network, side: float, start: Start, output: int) -> NDArray[np.float64]:
    """Parameters of one rule's consequent for one output."""
    weight = side * start.weight[output]
    made = np.zeros(net.width)
    made[0] = weight
    if net.consequent == SAM:
        made[1] = 1.0
    elif net.consequent in (MEXICAN_HAT, MORLET):
        made[1::2], made[2::2] = side * np.asarray(start.shift), start.dilation
    elif net.consequent == LEGENDRE_WAVELET:
        made[:2] = weight / np.sqrt(2.0)  # phi of degree 0 is sqrt(2) on its half
    return made
