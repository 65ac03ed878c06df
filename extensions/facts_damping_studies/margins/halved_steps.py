"""Discretisation over parts of a frame, from that over halves of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.small_signal.zero_order_hold import held_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float2, Float3
    from facts_damping.small_signal.sampled_output import Filtered

    Halvings = Sequence[tuple[Float2, Float2]]

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


def effect(halved: Halvings, A: Float2, B: Float2, seconds: float, part: float) -> Float2:
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


def samples(
    filters: Filtered,
    A: Float2,
    B: Float2,
    halved: Halvings,
    onward: Float2,
    x: Float2,
    inputs: Sequence[tuple[list[int], Float2, Float2, float]],
) -> Float3:
    """As `sampled_output.samples`, without an exponential of the whole plant for each sample.

    C Phi(t_i) grows from sample to sample, and Phi(t - s) Gamma(s) = Gamma(t) - Gamma(t - s). `halved`: of a frame;
    `onward`: Phi over the time between two samples.
    """
    seconds, rows, sampled = filters.per_frame / filters.rate, filters.C, []
    for i in range(filters.per_frame):
        at, seen = i / filters.rate, rows @ x
        whole = filters.C @ effect(halved, A, B, seconds, at)
        for columns, old, new, switch in inputs:
            late = at > switch
            after = filters.C @ effect(halved, A, B, seconds, at - switch) if late else np.zeros_like(whole)
            through = filters.D[:, columns] @ (new if late else old)
            seen = seen + (whole - after)[:, columns] @ old + after[:, columns] @ new + through
        sampled.append(seen)
        rows = rows @ onward
    return np.array(sampled)
