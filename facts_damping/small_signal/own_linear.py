"""A linear controller of a user's own, from frame to frame, in the form of an observer with state feedback.

Its signals are held between frames, so that it is discretised exactly (G. F. Franklin, J. D. Powell, M. Workman,
Digital Control of Dynamic Systems, 3rd ed. 1998, 4.3): x(k+1) = A x(k) + B y(k), u(k) = C x(k) + D y(k). With y(k) as a
state beside x(k), which the newest frame replaces, `control.state_space` steps it: after a lost frame with the signal
before. It does not know the device's limits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.control.linear_law import matrices
from facts_damping.control.state_space import StateSpace
from facts_damping.small_signal.zero_order_hold import held_for

if TYPE_CHECKING:
    from facts_damping.parameters.run import Controller


def design(controller: Controller, frame_rate: int) -> StateSpace:
    """The matrices of a controller that is given as a `linear` law."""
    law, signals, devices = controller.law, len(controller.signals), len(controller.devices)
    A, B, C, D = matrices(law, signals, devices)
    if law.dt is None:
        A, B = held_for(A, B, 1.0 / frame_rate)
    n, ones = len(A), np.eye(signals)
    return StateSpace(
        A=np.block([[A, B], [np.zeros((signals, n)), ones]]),
        B=np.zeros((n + signals, devices)),
        C=np.hstack([np.zeros((signals, n)), ones]),
        M=np.vstack([np.zeros((n, signals)), ones]),
        K=-np.hstack([C, D]),
    )
