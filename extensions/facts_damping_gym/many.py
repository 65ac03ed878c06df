"""A step of many episodes, in one compiled call: what the agents observe, and speed differences for their rewards."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Array, Bool1, Float1, Float2, Float3, Int1, Struct, Table
from facts_damping.control.called import Sensed, sense
from facts_damping.control.inputs import Inputs, LatestSamples
from facts_damping.link.transfer import RING_DELIVERED
from facts_damping.monitor_table import TRIPPED
from facts_damping.signals import CHANNELS
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.tick import Loop, run_half_ticks

SIGNAL, AGE, MISSING = range(3)  # indices of a window's last axis
FREQUENCY = list(CHANNELS).index("frequency")
MAX_SIGNAL, MAX_AGE = 100.0, 10.0  # in scales, and s: values are clipped to these


class AgentInputs(Struct):
    """Received signals of an agent's controller."""

    inputs: Inputs
    held: LatestSamples
    sensed: Sensed


@compiled
def append_to_window(
    window: NDArray[Any], y: NDArray[Any], age: NDArray[Any], fresh: NDArray[Any], scale: NDArray[Any]
) -> None:
    """Append the signals of a tick, (signals,), to a window, (ticks, signals, 3)."""
    for k in range(window.shape[0] - 1):
        for i in range(window.shape[1]):
            for part in range(window.shape[2]):
                window[k, i, part] = window[k + 1, i, part]
    last = window.shape[0] - 1
    for i in range(window.shape[1]):
        value = y[i] / scale[i]
        window[last, i, SIGNAL] = min(max(value, -MAX_SIGNAL), MAX_SIGNAL) if math.isfinite(value) else 0.0
        window[last, i, AGE] = min(age[i], MAX_AGE)
        window[last, i, MISSING] = 0.0 if fresh[i] else 1.0


@compiled
def observe(
    eyes: AgentInputs,
    delivered: NDArray[Any],
    end_ns: int,
    window: NDArray[np.float32],
    scale: NDArray[np.float64],
) -> None:
    """Write a tick's delivered signals into the window."""
    sense(eyes.inputs, eyes.held, eyes.sensed, 0, delivered, delivered.size, end_ns)
    append_to_window(window, eyes.held.signal[0], eyes.sensed.age[0], eyes.sensed.fresh[0], scale)


@compiled
def compare_speeds(
    weights: NDArray[np.float64], loop: Loop, tick: int, nominal: float, deviations: NDArray[np.float64]
) -> None:
    """Write a tick's speed differences, p.u.: of true speeds, or of reported frequencies where there is no rotor.

    `weights`: (differences, machines + PMUs); `nominal`: frequency, Hz.
    """
    machines, frame = loop.signals.machines[tick], loop.signals.frames[tick]
    for d in range(weights.shape[0]):
        deviations[d] = 0.0
        for m in range(machines.size):
            deviations[d] += weights[d, m] * machines[m].speed_deviation
        for s in range(weights.shape[1] - machines.size):
            hertz, weight = frame[s, FREQUENCY], weights[d, machines.size + s]
            if weight != 0.0 and math.isfinite(hertz):
                deviations[d] += weight * (hertz / nominal - 1.0)


class Information(Struct):
    """What the information of a step tells; the first axis of all but `places` is the episode."""

    places: Int1  # indices of the agent's devices
    supervisors: Int1  # index of the agent's supervisor; -1: none
    itae: Float1  # p.u. s^2, so far
    integrand: Float1  # of the newest tick
    setpoints: Float2  # (episodes, devices), p.u., in force
    tripped: Bool1  # whether the supervisor has tripped the agent


class Episodes(Struct):
    """Episodes side by side; the first axis is the episode."""

    loops: Table[Loop]
    eyes: Table[AgentInputs]
    waits: Bool1
    ticks: Int1  # the newest
    time_ns: Int1  # its time
    lost: Bool1  # whether synchronism is lost
    agent: int  # index of its controller
    setpoints: Float2  # (episodes, devices), p.u., of that controller
    windows: Annotated[NDArray[Any], Array(np.float32, 4)]  # (episodes, ticks, signals, 3)
    scale: Float1
    weights: Float3  # (episodes, differences, machines + PMUs)
    deviations: Float2  # (episodes, differences)
    information: Information


@compiled
def tell(information: Information, e: int, loop: Loop, tick: int, deviations: NDArray[np.float64]) -> None:
    """Write what the information of a tick tells; ITAE by the trapezoidal rule."""
    time_ns, devices = loop.signals.time_ns, loop.signals.devices
    before, integrand = information.integrand[e], 0.0
    for deviation in deviations:
        integrand += abs(deviation)
    information.integrand[e] = integrand * (time_ns[tick] / 1e9)
    if tick > 0:
        information.itae[e] += (time_ns[tick] - time_ns[tick - 1]) / 1e9 * (before + information.integrand[e]) / 2
    for d in range(information.places.size):
        information.setpoints[e, d] = devices[tick, information.places[d]].setpoint
    s = information.supervisors[e]
    information.tripped[e] = s >= 0 and loop.control.supervisor_state.rows[s].state == TRIPPED


@entry_point
def step_many(all_of: Episodes, first: int, stride: int) -> None:
    """A step of the episodes first, first + stride and so on, except those that wait."""
    for e in range(first, len(all_of.loops), stride):
        if all_of.waits[e]:
            continue
        loop, tick, agent = all_of.loops[e], all_of.ticks[e], all_of.agent
        for d in range(all_of.setpoints.shape[1]):
            loop.control.bank_state.unlimited[agent, d] = all_of.setpoints[e, d]
        run_half_ticks(loop, max(0, 2 * tick + 1), 2 * tick + 3)  # second half of this tick, first half of the next
        tick += 1
        signals, links = loop.signals, loop.links
        all_of.ticks[e], all_of.time_ns[e] = tick, signals.time_ns[tick]
        all_of.lost[e] = not signals.in_synchronism[tick]
        eyes, link, end_ns = all_of.eyes[e], links.used[agent], tick_ns(tick + 1, loop.measured.pmus.frame_rate)
        rows = links.up.out[link, : links.up.ring[link, RING_DELIVERED]]
        window, weights, deviations = all_of.windows[e], all_of.weights[e], all_of.deviations[e]
        observe(eyes, rows, end_ns, window, all_of.scale)
        nominal = loop.measured.plant.omega_0 / (2.0 * math.pi)
        compare_speeds(weights, loop, tick, nominal, deviations)
        tell(all_of.information, e, loop, tick, deviations)
