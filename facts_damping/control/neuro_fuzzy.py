"""A neuro-fuzzy controller's step, direct and indirect; compiled.

    e = y_d - y, y_d = 0;  x = [e_i / scale_i, de_i / change_scale_i];  u = u_max net(x)
    ec_p = sum_i e_i J_ip - hbar_p u_p                                                    (D.1), (6.20)
    V = (sum_i e_i^2 + sum_p hbar_p u_p^2) / 2                                                   (6.15)

e, u and J are normalised by scale and u_max. J is the constant sign of the plant's sensitivity (direct) or the
identifier's estimate of the tick before (indirect). The error of a frame adapts the network at the inputs that produced
the setpoint before it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Float1, Float2, Struct
from facts_damping.neurofuzzy.learning import Learner, Rule, infer, learn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.neurofuzzy.network import Network


class PlantPrior(NamedTuple):
    """Initial knowledge of a controller and its identifier about the plant, from its linearisation."""

    sign: Float2  # (signals, devices), of dy/du; 0: none, except for the first signal
    jacobian: Float2  # (signals, devices), p.u./p.u., over the identifier's horizon
    mode_shape: NDArray[
        np.complex128
    ]  # (signals,), p.u./p.u., at the least damped electromechanical mode, relative to the first
    z_pole: complex  # the mode's factor from one frame to the next


class Memory(Struct):
    """State of a controller besides its network."""

    before: Float1  # (signals,), p.u., signals of the frame before
    applied: Float1  # (devices,), p.u., setpoint as followed by the device
    error: Float1  # (devices,), adaptation errors ec
    curvature: Float1  # (devices,), sum_i J_ip^2 + hbar_p
    lyapunov: Float1  # (2,), V at the newest learning step, and its decrease by the step, to first order
    jacobian: Float2  # (signals, devices), dy/du, normalised: 1 = `scale` for the device's limit
    taught: Float1  # (1,), 1: the network learnt at the newest frame


class Memories(Memory, each=Memory):
    """Memories of several controllers."""


class Actuators(Struct):
    """Limits of the devices that a controller commands."""

    limit: Float1  # (devices,), p.u.
    rate: Float1  # (devices,), p.u./s


class AllActuators(Actuators, each=Actuators):
    """Limits for several controllers."""


class Adaptive(NamedTuple):
    """An adaptive controller."""

    net: Network
    learner: Learner
    memory: Memory
    settings: NDArray[Any]  # rows of SETTINGS
    actuators: Actuators


def memories(controllers: int, signals: int, devices: int) -> Memories:
    """Allocate the memories of several controllers."""
    sizes = ((signals,), (devices,), (devices,), (devices,), (2,), (signals, devices), (1,))
    return Memories(*(np.zeros((controllers, *size)) for size in sizes))


@compiled
def step(c: Adaptive, signals: Float1, unlimited: Float1, dt: float, frames: int, stale: bool) -> None:
    """Learn from the newest signals, then write the setpoints before limits, p.u., to `unlimited`.

    The Jacobian is in `memory.jacobian`. `dt` (s) and `frames` count from the frame before; 0 at the first frame.
    """
    net, learner, memory, s = c.net, c.learner, c.memory, c.settings
    memory.taught[0] = 0.0
    if frames > 0:
        _follow(c, unlimited, dt)
    if frames > 0 and not stale and _errors(c, signals, unlimited):
        g = s[0]
        rule = Rule(g.rate, g.eta, g.momentum, g.leakage, g.clip, g.projection)
        learn(net, learner, rule, memory.error, memory.curvature)
        _fall(c, signals)
        memory.taught[0] = 1.0
    for i in range(net.inputs // 2):
        change = 0.0 if frames == 0 else (signals[i] - memory.before[i]) / frames
        learner.x[2 * i] = min(max(-signals[i] / s[i].scale, -s[0].range), s[0].range)
        learner.x[2 * i + 1] = min(max(-change / s[i].change_scale, -s[0].range), s[0].range)
        memory.before[i] = signals[i]
    infer(net, learner)
    for o in range(net.outputs):
        unlimited[o] = c.actuators.limit[o] * learner.passed.output[o]


@compiled
def _follow(c: Adaptive, unlimited: Float1, dt: float) -> None:
    """Update `memory.applied`: with anti-windup the setpoint within the device's limit and rate, else before limits."""
    memory, actuators = c.memory, c.actuators
    for o in range(c.net.outputs):
        if c.settings[0].anti_windup > 0.0:
            limited = min(max(unlimited[o], -actuators.limit[o]), actuators.limit[o])
            reach = actuators.rate[o] * dt
            memory.applied[o] = min(max(limited, memory.applied[o] - reach), memory.applied[o] + reach)
        else:
            memory.applied[o] = unlimited[o]


@compiled
def _seen(s: NDArray[Any], i: int, signals: Float1) -> float:
    """Normalised error of signal i; zero within the dead zone."""
    e = -signals[i] / s[i].scale
    return 0.0 if abs(e) <= s[0].dead_zone else e


@compiled
def _fall(c: Adaptive, signals: Float1) -> None:
    """Compute the Lyapunov function, and its decrease by the step if the plant responds as the Jacobian predicts."""
    net, learner, memory, s = c.net, c.learner, c.memory, c.settings
    now = then = 0.0
    for i in range(net.inputs // 2):
        e = after = _seen(s, i, signals)
        for o in range(net.outputs):
            after -= memory.jacobian[i, o] * learner.moved[o]
        now += 0.5 * e * e
        then += 0.5 * after * after
    for o in range(net.outputs):
        u = memory.applied[o] / c.actuators.limit[o]
        after = u + learner.moved[o]
        now += 0.5 * s[o].hbar * u * u
        then += 0.5 * s[o].hbar * after * after
    memory.lyapunov[0], memory.lyapunov[1] = now, now - then


@compiled
def _errors(c: Adaptive, signals: Float1, unlimited: Float1) -> bool:
    """Compute adaptation errors and curvatures; returns False if the Jacobian is unknown.

    With anti-windup an error that would drive a setpoint further beyond its limit is set to zero.
    """
    net, memory, s, actuators = c.net, c.memory, c.settings, c.actuators
    for o in range(net.outputs):
        error, curvature = 0.0, s[o].hbar
        for i in range(net.inputs // 2):
            error += _seen(s, i, signals) * memory.jacobian[i, o]
            curvature += memory.jacobian[i, o] * memory.jacobian[i, o]
        error -= s[o].hbar * memory.applied[o] / actuators.limit[o]
        beyond = abs(unlimited[o]) > actuators.limit[o] and error * unlimited[o] > 0.0
        memory.error[o] = 0.0 if s[0].anti_windup > 0.0 and beyond else error
        memory.curvature[o] = curvature
        if not math.isfinite(error):
            return False
    return True
