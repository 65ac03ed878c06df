"""Hypotheses about the actuators by innovations: each acts as sent (+1), not at all (0), or inverted (-1).

The observer is linear, so its innovations with signs h are e - F h: e without setpoints, F of the setpoint of each
device alone. The weighted sum of squares is then a quadratic function,

    R(h) = sum w (e - F h)^T S^-1 (e - F h) = E - 2 r^T h + h^T Q h,

of sums that forget exponentially, so that a hypothesis can come back. The variance relative to S is that of the
innovations with the best hypothesis, at least 1, so what the model does not explain is no evidence. w limits what a
frame counts, as of a fault. The log of the likelihood ratio of two hypotheses is half the difference of R over
this variance.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Bool1, Float1, Float2

MOST = 9.0  # square of an innovation, relative to the variance, that a frame counts at most per signal


class Evidence(NamedTuple):
    """Sums of innovations up to a frame, and the signs that count."""

    E: float
    r: Float1  # (devices,)
    Q: Float2  # (devices, devices)
    number: float  # of signals
    signs: Float1  # (devices,), what counts: +1, 0 or -1
    sent: Float1  # (devices,), by which setpoints are multiplied: +1 or -1

    def squares(self, signs: Float2) -> Float1:
        """The R of each row of signs."""
        squares: Float1 = self.E - 2.0 * signs @ self.r + np.einsum("hi,ij,hj->h", signs, self.Q, signs)
        return squares

    @property
    def variance(self) -> float:
        """Of the innovations relative to S, with the signs that count."""
        return max(1.0, float(self.squares(self.signs[None])[0]) / max(self.number, 1.0))


def without_evidence(devices: int) -> Evidence:
    """All as sent."""
    return Evidence(0.0, np.zeros(devices), np.zeros((devices, devices)), 0.0, np.ones(devices), np.ones(devices))


def with_innovations(before: Evidence, innovations: Float2, S: Float2, fresh: Bool1, forgetting: float) -> Evidence:
    """With those of a frame, (signals, 1 + devices): e, then the columns of -F; `forgetting`: factor of the sums."""
    whitened = np.linalg.solve(np.linalg.cholesky(S[np.ix_(fresh, fresh)]), innovations[fresh])
    e, F = whitened[:, 0], -whitened[:, 1:]
    now, weight = e - F @ before.signs, 1.0
    if before.number > 0.0:
        most = MOST * before.variance * len(e)
        weight = most / max(most, float(now @ now))
    return before._replace(
        E=forgetting * before.E + weight * float(e @ e),
        r=forgetting * before.r + weight * F.T @ e,
        Q=forgetting * before.Q + weight * F.T @ F,
        number=forgetting * before.number + weight * len(e),
    )


def ratios(of: Evidence) -> tuple[Float2, Float1]:
    """All hypotheses, (hypotheses, devices), and the log of the likelihood of each over that of the present one."""
    every = np.array(list(product((1.0, 0.0, -1.0), repeat=len(of.signs))))
    squares = of.squares(every)
    variance = max(1.0, float(squares.min()) / max(of.number, 1.0))
    return every, (of.squares(of.signs[None]) - squares) / (2.0 * variance)


def decided(of: Evidence, margin: float) -> Evidence:
    """With what is likelier by a margin (log of the ratio) for each device, whatever the others do.

    The two signs are compared first: errors of the model make effects look weaker, and so like none. A device without
    effect gets setpoints of the sign that it had last.
    """
    every, log_ratios = ratios(of)
    signs, sent = of.signs.copy(), of.sent.copy()
    for d, sign in enumerate(of.sent):
        likely, none, inverted = (float(log_ratios[every[:, d] == h].max()) for h in (sign, 0.0, -sign))
        if inverted - likely > margin:
            signs[d] = sent[d] = -sign
        elif none - max(likely, inverted) > margin:
            signs[d] = 0.0
        elif likely - none > margin:
            signs[d] = sign
    return of._replace(signs=signs, sent=sent)
