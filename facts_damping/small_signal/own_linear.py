"""A user's linear controller from frame to frame, in the form of an observer with state feedback.

Signals are held between frames, so the discretisation is exact (G. F. Franklin, J. D. Powell, M. Workman,
Digital Control of Dynamic Systems, 3rd ed. 1998, 4.3): x(k+1) = A x(k) + B y(k), u(k) = C x(k) + D y(k). With y(k) as
an additional state, which the newest frame replaces, `control.state_space` steps it; after a lost frame it uses the
last signal. Device limits are not part of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.control.linear_law import matrices
from facts_damping.control.state_space import StateSpace
from facts_damping.small_signal.zero_order_hold import held_for

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float2
    from facts_damping.parameters.run import Controller


def design(controller: Controller, frame_rate: int) -> StateSpace:
    """The matrices of a controller given as a `linear` law."""
    law = controller.law
    A, B, C, D = matrices(law, len(controller.signals), len(controller.devices))
    return from_frames(A, B, C, D) if law.dt is not None else held(A, B, C, D, frame_rate)


def held(A: Float2, B: Float2, C: Float2, D: Float2, frame_rate: int) -> StateSpace:
    """A continuous law with signals held between frames."""
    return from_frames(*held_for(A, B, 1.0 / frame_rate), C, D)


def from_frames(A: Float2, B: Float2, C: Float2, D: Float2) -> StateSpace:
    """A discrete law from frame to frame."""
    (devices, signals), n, ones = D.shape, len(A), np.eye(D.shape[1])
    return StateSpace(
        A=np.block([[A, B], [np.zeros((signals, n)), ones]]),
        B=np.zeros((n + signals, devices)),
        C=np.hstack([np.zeros((signals, n)), ones]),
        M=np.vstack([np.zeros((n, signals)), ones]),
        K=-np.hstack([C, D]),
    )
