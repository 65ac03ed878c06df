"""Hypotheses about the actuators by innovations: each acts as sent (+1), not at all (0), or inverted (-1).

The observer is linear, so its innovations with signs h are e - F h: e without setpoints, F of the setpoint of each
device alone. The weighted sum of squares is then a quadratic function,

    R(h) = sum w (e - F h)^T S^-1 (e - F h) = E - 2 r^T h + h^T Q h,

of sums that forget exponentially, so that a hypothesis can come back. w limits what a frame counts, as of a fault. The
log of the likelihood ratio of two hypotheses is half the difference of R, over the variance of the innovations with the
better one relative to S, where that is more than 1: what the model does not explain is no evidence.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Bool1, Float1, Float2

MOST = 9.0  # weighted square of an innovation, relative to S, that a frame counts at most per signal


class Evidence(NamedTuple):
    """Sums of innovations up to a frame, and the signs that count."""

    E: float
    r: Float1  # (devices,)
    Q: Float2  # (devices, devices)
    count: float
    signs: Float1  # (devices,), +1, 0 or -1

    def squares(self, signs: Float2) -> Float1:
        """R of each row of signs."""
        squares: Float1 = self.E - 2.0 * signs @ self.r + np.einsum("hi,ij,hj->h", signs, self.Q, signs)
        return squares


def without_evidence(devices: int) -> Evidence:
    """All as sent."""
    return Evidence(0.0, np.zeros(devices), np.zeros((devices, devices)), 0.0, np.ones(devices))


def with_innovations(before: Evidence, innovations: Float2, S: Float2, fresh: Bool1, forgetting: float) -> Evidence:
    """With those of a frame: (signals, 1 + devices), the first column e, then those of -F; `forgetting`: of the sums."""
    whitened = np.linalg.solve(np.linalg.cholesky(S[np.ix_(fresh, fresh)]), innovations[fresh])
    e, F = whitened[:, 0], -whitened[:, 1:]
    now = e - F @ before.signs
    weight = len(e) / max(len(e), float(now @ now) / MOST)
    return before._replace(
        E=forgetting * before.E + weight * float(e @ e),
        r=forgetting * before.r + weight * F.T @ e,
        Q=forgetting * before.Q + weight * F.T @ F,
        count=forgetting * before.count + weight * len(e),
    )


def ratios(of: Evidence) -> tuple[Float2, Float1]:
    """All hypotheses, (hypotheses, devices), and the log of the likelihood of each over that of the signs that count."""
    every = np.array(list(product((1.0, 0.0, -1.0), repeat=len(of.signs))))
    squares = of.squares(np.vstack([every, of.signs]))
    variance = max(1.0, float(squares.min()) / max(of.count, 1.0))
    return every, (squares[-1] - squares[:-1]) / (2.0 * variance)


def decided(of: Evidence, margin: float) -> Evidence:
    """With the signs of the likeliest hypothesis, if it is likelier by a margin (log of the ratio)."""
    every, log_ratios = ratios(of)
    best = int(np.argmax(log_ratios))
    return of._replace(signs=every[best]) if log_ratios[best] > margin else of
