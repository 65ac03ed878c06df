"""Discretisation over parts of a frame, from that over halves of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.small_signal.zero_order_hold import held_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float2

TERMS = 16  # of a series with terms below 2^-k / k!


def halvings(A: Float2, B: Float2, seconds: float) -> list[tuple[Float2, Float2]]:
    """Phi and Gamma over t, t/2, t/4 ... down to where Taylor's series of A t converges at once; see `effect`."""
    size = float(np.abs(A).sum(axis=1).max(initial=0.0)) * seconds
    times = max(0, int(np.ceil(np.log2(max(2.0 * size, 1.0)))))
    steps = [held_for(A, B, seconds / 2**times)]
    for _ in range(times):
        Phi, Gamma = steps[-1]
        steps.append((Phi @ Phi, Phi @ Gamma + Gamma))
    return steps[::-1]


def effect(halved: Sequence[tuple[Float2, Float2]], A: Float2, B: Float2, seconds: float, part: float) -> Float2:
    """Gamma over `part` of the time that was halved (s), from its binary digits and the series of the rest."""
    used, rest = [], part
    for i, step in enumerate(halved):
        if rest >= seconds / 2**i:
            used.append(step)
            rest -= seconds / 2**i
    term = gamma = B * rest
    for k in range(2, TERMS):
        term = A @ term * (rest / k)
        gamma = gamma + term
    for Phi, Gamma in reversed(used):
        gamma = Phi @ gamma + Gamma
    return gamma
