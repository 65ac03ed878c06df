"""An observer with state feedback, stepped from frame to frame; compiled.

    x(k|k-1) = A x(k-1|k-1) + B u(k-1)                  u as followed by the devices, within limit and rate
    x(k|k) = x(k|k-1) + M (y(k) - C x(k|k-1))
    u(k) = -K x(k|k)

Filter form of the steady-state Kalman filter, which uses the newest frame at once; with L = A M it equals the
predictor x+ = A x + B u + L (y - C x) (G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems,
3rd ed. 1998, 8.2, 9.4). A, B and C include the delay: delayed setpoints are states.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Float1, Float2, Float3, Struct

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.control.neuro_fuzzy import Actuators

MAX_MISSED = 600  # frames: after a longer gap the estimate restarts


class StateSpace(NamedTuple):
    """Matrices from frame to frame."""

    A: Float2  # (states, states)
    B: Float2  # (states, devices)
    C: Float2  # (signals, states)
    M: Float2  # (states, signals)
    K: Float2  # (devices, states)


class Observer(Struct):
    """Matrices of `StateSpace` for compiled code."""

    A: Float2
    B: Float2
    C: Float2
    M: Float2
    K: Float2


class Observers(Observer, each=Observer):
    """Observers of several controllers, padded with zeros."""


class Commands(NamedTuple):
    """A controller's setpoints, (devices,), p.u."""

    issued: Float1  # of the frame before
    applied: Float1  # as followed by the devices
    unlimited: Float1  # before limits


def state_spaces(designs: Sequence[StateSpace | None], signals: int, devices: int) -> tuple[Observers, Float3]:
    """Matrices of several controllers (None: another kind), and their estimates with work space."""
    present = [state_space for state_space in designs if state_space is not None]
    n, states = len(designs), max([len(state_space.A) for state_space in present], default=0)
    shapes = ((states, states), (states, devices), (signals, states), (states, signals), (devices, states))
    observers = Observers(*(np.zeros((n, *shape)) for shape in shapes))
    for c, design in enumerate(designs):
        for whole, part in zip(observers, design or (), strict=False):
            whole[c, : part.shape[0], : part.shape[1]] = part
    return observers, np.zeros((n, 2, max(states, signals) if present else 0))


@compiled
def step(
    observer: Observer, x: Float2, signals: Float1, actuators: Actuators, commands: Commands, dt: float, frames: int
) -> None:
    """Update the estimate by `frames` predictions and the signals; compute setpoints before limits.

    `x[0]`: estimate; `x[1]`: work space; `dt`: s since the frame before; `frames` = 0 at the first frame.
    """
    n, count, unlimited = observer.A.shape[0], signals.size, commands.unlimited
    if frames == 0 or frames > MAX_MISSED:
        x[:] = 0.0
    else:
        for _ in range(frames):
            _predict(observer, x, actuators, commands, dt / frames)
    for i in range(count):
        x[1, i] = signals[i]
        for j in range(n):
            x[1, i] -= observer.C[i, j] * x[0, j]
    for j in range(n):
        for i in range(count):
            x[0, j] += observer.M[j, i] * x[1, i]
    for d in range(observer.K.shape[0]):
        unlimited[d] = 0.0
        for j in range(n):
            unlimited[d] -= observer.K[d, j] * x[0, j]


@compiled
def _predict(observer: Observer, x: Float2, actuators: Actuators, commands: Commands, dt: float) -> None:
    """Predict the estimate by one frame, while the devices follow the setpoints within their rates."""
    n, issued, applied = observer.A.shape[0], commands.issued, commands.applied
    for d in range(observer.K.shape[0]):
        reach = actuators.rate[d] * dt
        applied[d] = min(max(issued[d], applied[d] - reach), applied[d] + reach)
    for j in range(n):
        x[1, j] = 0.0
        for i in range(n):
            x[1, j] += observer.A[j, i] * x[0, i]
        for d in range(observer.K.shape[0]):
            x[1, j] += observer.B[j, d] * applied[d]
    for j in range(n):
        x[0, j] = x[1, j]
