"""Forced oscillations of machines' mechanical powers, loads' active powers, and setpoints of controls; compiled.

Relative to the power, or of a setpoint in p.u., an oscillation of amplitude A, ramp T and frequency f is

    a(t) = A min(1, t / T) sin(2 pi f t)

from its start on, or A min(1, t / T) times the sign of the sine. A machine's mechanical power is that of its governor
plus a times its reference; a load draws 1 + a times its active power; a is added where an exciter has its stabiliser's
output, and to an inverter's setpoint of active power. Several at one element add up. They depend on time only, not on
how a plant is advanced: starts, ends, ends of ramps and edges of squares split the steps of the integration, and within
a step the intervals of the integrator have the values of their own times.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary import sin
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from facts_damping.plant.model import Plant, Work

TURN = 2.0 * math.pi


@compiled
def _edge_ns(frequency: float, k: int) -> int:
    """Start of half period k after the start of a square wave, rounded down to ns."""
    return int(k * (0.5 * NANOSECONDS) / frequency)


@compiled
def begin_oscillations(plant: Plant, work: Work, time_ns: int, end_ns: int) -> int:
    """Write the oscillations at a time into `work`; return when one has its next kink or edge, or `end_ns`."""
    for i in range(plant.oscillations.size):
        o = plant.oscillations[i]
        for border in (o.start_ns, o.full_ns, o.end_ns):
            if border > time_ns:
                end_ns = min(end_ns, border)
        work.since[i] = -1.0
        if o.start_ns <= time_ns < o.end_ns:
            elapsed = time_ns - o.start_ns
            work.since[i] = elapsed * 1e-9
            if o.square == 1:
                k = int(elapsed * o.frequency / (0.5 * NANOSECONDS))
                k += 1 if _edge_ns(o.frequency, k + 1) <= elapsed else 0
                k -= 1 if _edge_ns(o.frequency, k) > elapsed else 0
                work.level[i] = 1.0 if k % 2 == 0 else -1.0
                end_ns = min(end_ns, o.start_ns + _edge_ns(o.frequency, k + 1))
    move_oscillations(plant, work, 0.0)
    return end_ns


@compiled
def move_oscillations(plant: Plant, work: Work, seconds: float) -> None:
    """Update all oscillations for a time (s) after `begin_oscillations`; after `begin_noise` or `move_noise`."""
    if plant.oscillations.size == 0:
        return
    for g in range(work.forced.size):
        work.forced[g] = 0.0
    if plant.load_noise.shape[0] < 2:  # else noise has been written anew
        for i in range(work.noise.shape[0]):
            work.noise[i, 0] = 0.0
    for i in range(plant.oscillations.size):
        work.value[i] = 0.0
        if work.since[i] < 0.0:
            continue
        o = plant.oscillations[i]
        t = work.since[i] + seconds
        turns = o.frequency * t
        value = o.amplitude * (work.level[i] if o.square == 1 else sin(TURN * (turns - math.floor(turns))))
        if t < o.ramp:
            value *= t / o.ramp
        work.value[i] = value
        if o.machine >= 0:
            work.forced[o.machine] += value
        elif o.load >= 0:
            work.noise[o.load, 0] += value
