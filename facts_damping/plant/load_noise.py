"""Random noise of loads: Ornstein-Uhlenbeck processes, drawn before a run; compiled.

The process

    dx = -x / T dt + s sqrt(2 / T) dW

has the standard deviation s and the autocorrelation exp(-|t| / T). It is exact at the points of its own grid, RATE per
second, `x(k+1) = a x(k) + s sqrt(1 - a^2) n(k)`, `a = exp(-1 / (RATE T))`, n normal (D. T. Gillespie, Exact numerical
simulation of the Ornstein-Uhlenbeck process and its integral, Phys. Rev. E 54 (1996) 2084-2091), and linear between
them, so the load has no jumps. It depends on time only, not on how a plant is advanced.

It starts from 0, so that a run starts at its equilibrium. After the last point it runs backwards, then forwards again,
and so on. This is statistically the same process, since it is reversible in time, and it has no jump.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from facts_damping import random_numbers
from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Float2, Float3
from facts_damping.elementary import exp
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.parameters.plant.grid import Load
    from facts_damping.parameters.plant.load_noise import LoadNoise
    from facts_damping.plant.model import Plant, Work

RATE = 120  # points/s: with 60, 30 or 120 frames/s the integrator's steps stay as without noise
LONGEST = 3600.0  # s, longest series
STREAM = int.from_bytes(b"LOAD", "big")  # first of the spawn keys, unique to load noise


def noisy_loads(noise: LoadNoise | None, loads: Sequence[Load]) -> list[str]:
    """Names of the loads with noise."""
    return [load.name for load in loads if noise is not None and noise.of(load.name)[0] > 0.0]


def draw(noise: LoadNoise | None, loads: Sequence[Load], duration: float, seed: int) -> dict[str, Float2]:
    """Relative deviations of P and Q of each noisy load at all points of the grid, (points, 2).

    Each load has its own random stream, from the run's seed and its index; a longer series begins with the shorter one.
    """
    if noise is None:
        return {}
    points, drawn = math.ceil(min(duration, LONGEST) * RATE) + 1, {}
    for i, load in enumerate(loads):
        std, time, correlation = noise.of(load.name)
        if std == 0.0:
            continue
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, i)))
        n = random_numbers.standard_normal(random, (points, 2))
        n[:, 1] = correlation * n[:, 0] + math.sqrt(1.0 - correlation * correlation) * n[:, 1]
        drawn[load.name] = np.zeros((points, 2))
        _follow(std, exp(-1.0 / (RATE * time)), n, drawn[load.name])
    return drawn


def table(drawn: Mapping[str, Float2], loads: Sequence[Load], count: int) -> Float3:
    """Noise of a plant's loads, (points, count, 2): zeros for loads without noise; no points if all are without."""
    points = len(next(iter(drawn.values()))) if drawn else 0
    noise = np.zeros((points, count, 2))
    for i, load in enumerate(loads):
        if load.name in drawn:
            noise[:, i] = drawn[load.name]
    return noise


def fitted(noise: Float3, count: int) -> Float3:
    """A table for a plant with another number of loads, of which those with noise are the first."""
    resized = np.zeros((len(noise), count, 2))
    common = min(count, noise.shape[1])
    resized[:, :common] = noise[:, :common]
    return resized


@entry_point
def _follow(std: float, a: float, n: Float2, x: Float2) -> None:
    """x(k+1) = a x(k) + s sqrt(1 - a^2) n(k), (points, 2), from 0."""
    size = std * math.sqrt(1.0 - a * a)
    for k in range(1, x.shape[0]):
        for j in range(2):
            x[k, j] = a * x[k - 1, j] + size * n[k, j]


@compiled
def _place(time_ns: int) -> int:
    """The last grid point at or before a time; point k is at k / RATE, rounded down to ns."""
    k = time_ns * RATE // NANOSECONDS
    return k + 1 if (k + 1) * NANOSECONDS // RATE <= time_ns else k


@compiled
def _folded(k: int, last: int) -> int:
    """Index of point k in a series that runs to `last`, backwards, then forwards again."""
    k %= 2 * last
    return k if k <= last else 2 * last - k


@compiled
def begin_noise(plant: Plant, work: Work, time_ns: int, end_ns: int) -> int:
    """Write deviations and slopes of all loads into `work`; return when the slopes change next, or `end_ns`."""
    last = plant.load_noise.shape[0] - 1
    if last < 1:
        return end_ns
    k = _place(time_ns)
    here, following = k * NANOSECONDS // RATE, (k + 1) * NANOSECONDS // RATE
    before, other = _folded(k, last), _folded(k + 1, last)
    for i in range(plant.load_noise.shape[1]):
        for j in range(2):
            work.noise_slope[i, j] = (plant.load_noise[other, i, j] - plant.load_noise[before, i, j]) / (
                (following - here) * 1e-9
            )
            work.noise_start[i, j] = plant.load_noise[before, i, j] + work.noise_slope[i, j] * ((time_ns - here) * 1e-9)
            work.noise[i, j] = work.noise_start[i, j]
    return min(end_ns, following)


@compiled
def move_noise(plant: Plant, work: Work, seconds: float) -> None:
    """Update the deviations of all loads for a time (s) after `begin_noise`."""
    if plant.load_noise.shape[0] > 1:
        for i in range(work.noise.shape[0]):
            for j in range(2):
                work.noise[i, j] = work.noise_start[i, j] + work.noise_slope[i, j] * seconds
