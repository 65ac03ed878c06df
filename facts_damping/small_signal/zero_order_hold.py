"""Discretisation of the linear plant from frame to frame, and its rigid rotor motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.numerics.matrices import exponential, least_squares, product

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float2


SLIPS, ANGLES = (".slip",), (".angle", ".angle_order")  # states of inverters: speed, p.u., or angle, rad
NEAR = 1e-6  # relative to cancelling terms and to the largest derivative: smaller changes count as zero


def held_for(A: Float2, B: Float2, seconds: float) -> tuple[Float2, Float2]:
    """Phi = exp(A t) and Gamma = int_0^t exp(A s) ds B: state transition, and effect of held inputs."""
    n, inputs = B.shape
    rows = np.block([[A, B], [np.zeros((inputs, n + inputs))]])
    whole = exponential(rows * seconds)
    return whole[:n, :n], whole[:n, n:]


def rigid(A: Float2, C: Float2, names: Sequence[str]) -> Float2:
    """Common shifts of all angles of rotors and sources, and of all speeds, without effect on the plant or a signal.

    Other states may settle elsewhere, as those of washouts do. Such motions, (states, 0 to 2), orthonormal, have zero
    eigenvalues, which round-off moves to either side.
    """
    motions = np.zeros((len(A), 0))
    whole = np.vstack([A, C])
    turning = (".delta", ".theta", ".theta_w", *ANGLES)  # of rotors, in load models, of inverters
    speeds = (".omega", *SLIPS)
    beside = np.array([not name.endswith((*turning, *speeds)) for name in names])
    for end in (turning, speeds):
        for size in (np.ones(len(A)), np.abs(A).max(axis=1)):  # of rows: those of fast regulators hide the others
            motion = np.array([float(name.endswith(end)) for name in names])
            answer = product(A[beside], motion)
            if np.abs(answer).max(initial=0.0) > NEAR:
                scale = np.where(size > 0.0, size, 1.0)[beside]
                motion[beside] = least_squares(A[np.ix_(beside, beside)] / scale[:, None], -answer / scale)
            motion -= product(motions, motions.T, motion)
            answer = product(whole, motion)
            answer[: len(A)] -= product(motions, motions.T, answer[: len(A)])  # a common speed shift turns all rotors
            cancelled = product(np.abs(whole), np.abs(motion)) + np.abs(whole).max(axis=1)
            if motion.any() and (np.abs(answer) <= NEAR * cancelled).all():
                motions = np.column_stack([motions, motion / np.sqrt((motion * motion).sum())])
                break
    return motions
