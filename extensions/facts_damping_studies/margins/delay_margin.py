"""Delay margin of a linear control loop: its modes against delay, and the delays at which it is stable."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import brentq, linear_sum_assignment

from facts_damping.small_signal import eigenmodes
from facts_damping_studies.margins.linear_closed_loop import approximate, delayed_loop, eigen, link_delays, sampled
from facts_damping_studies.margins.linear_closed_loop import growth as growth_of
from facts_damping_studies.margins.unsupervised import unsupervised
from facts_damping_studies.parameters import DAMPING_RATIO

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping_studies.margins.linear_closed_loop import DelayedLoop, Eigen

STEP = 0.005  # s, spacing of the delays, in addition to whole frames; narrower unstable intervals may be missed
EXACT = 1e-6  # s, accuracy of a margin
DRIFT = 1e-3  # Hz, below which an eigenvalue counts as real
STILL = 1e-6  # 1/s: slower growth counts as zero, such as that of an integrator without feedback
FASTEST = 2.0 * np.pi * 10.0  # 1/s: modes above 10 Hz are not followed
LOST = 0.5  # largest relative change of eigenvalue, and of shape, between two delays for the same mode


class Track(NamedTuple):
    """A mode followed over the delays: its kind at the start, and the mode at each delay; None where it is absent."""

    label: str
    modes: list[eigenmodes.Eigenmode | None]


class Margin(NamedTuple):
    """Stability of the closed loop of a run against delay."""

    case: Case
    own: list[float]  # s, delays of the run's own links, which the swept delays replace
    delays: NDArray[np.float64]  # s
    worst: NDArray[np.complex128]  # 1/s, eigenvalue with the largest real part at each delay, imag >= 0
    tracks: list[Track]  # electromechanical modes, then others that become unstable
    stable: list[tuple[float, float]]  # s, intervals in which the loop is stable
    damped: list[tuple[float, float]]  # s, intervals in which all electromechanical modes have DAMPING_RATIO or more
    margin: float | None  # s, smallest delay with an unstable loop; None: stable at all delays considered
    critical: eigenmodes.Eigenmode | None  # the mode at the stability limit
    pade: dict[str, float | None]  # s, margin in continuous time with a Pade approximation; empty: not requested


def margin(case: Case, longest: float, order: int | None, progress: Callable[[int, int], None]) -> Margin:
    """Modes from zero delay to the longest (s), and the margin; with an order also by Pade terms of that order.

    Raises `InputError` if the loop has no linear model.
    """
    case = unsupervised(case)
    loop = delayed_loop(case)
    delays = looks(longest, loop.frame_rate)
    worst, lacks, listed = np.zeros(len(delays), complex), np.zeros(len(delays)), []
    for i, delay in enumerate(delays):
        progress(i, len(delays))
        now = eigen(loop, sampled(loop, float(delay)))
        listed.append(oscillations(loop, now, case))
        worst[i], lacks[i] = now.values[0].real + 1j * abs(now.values[0].imag), _lacking(now, listed[-1])
    progress(len(delays), len(delays))
    stable = intervals(lambda delay: growth_of(loop, sampled(loop, delay)), delays, worst.real)

    def lacking(delay: float) -> float:
        now = eigen(loop, sampled(loop, delay))
        return _lacking(now, oscillations(loop, now, case))

    damped = intervals(lacking, delays, lacks)
    limit = first_limit(stable, longest)
    critical = None if limit is None else _critical(loop, limit, case)
    holds = {} if order is None else {"held": 0.5 / loop.frame_rate, "continuous": 0.0}
    by_pade = {name: _pade_margin(loop, delays, order or 0, hold) for name, hold in holds.items()}
    return Margin(case, link_delays(case), delays, worst, follow(listed), stable, damped, limit, critical, by_pade)


def _lacking(spectrum: Eigen, modes: Sequence[eigenmodes.Eigenmode]) -> float:
    """Above zero where the loop grows or a mode has less than DAMPING_RATIO."""
    lowest = min((mode.damping_ratio for mode in modes if mode.swings), default=1.0)
    return max(spectrum.growth, DAMPING_RATIO - lowest)


class Around(NamedTuple):
    """The interval of stable delays around one delay."""

    low: float  # s; 0: stable from zero delay on
    high: float | None  # s; None: stable up to the longest delay considered
    critical: eigenmodes.Eigenmode  # the mode at the upper limit, or the one with the largest real part there


def stable_around(case: Case, delay: float, longest: float, progress: Callable[[int, int], None]) -> Around | None:
    """The interval of delays (s) around `delay` in which the loop is stable; None if it is unstable at `delay`."""
    case = unsupervised(case)
    loop = delayed_loop(case)
    looked = looks(longest, case.run.frame_rate)
    done = 0

    def growth(at: float) -> float:
        return growth_of(loop, sampled(loop, float(at))) - STILL

    def end(delays: NDArray[np.float64]) -> float | None:
        """The first delay of the sequence at which the loop is unstable, refined; None if there is none."""
        nonlocal done
        for before, at in pairwise([delay, *delays]):
            done += 1
            progress(done, len(looked))
            if growth(at) > 0.0:
                return float(brentq(growth, *sorted((before, at)), xtol=EXACT))
        return None

    stable = growth(delay) <= 0.0
    low, high = (end(looked[looked < delay][::-1]), end(looked[looked > delay])) if stable else (None, None)
    progress(1, 1)
    return Around(low or 0.0, high, _critical(loop, longest if high is None else high, case)) if stable else None


def looks(longest: float, frame_rate: int) -> NDArray[np.float64]:
    """Delays from zero to the longest, s: every 5 ms, and whole frames, where a fast controller may oscillate."""
    steps = np.arange(0.0, longest, STEP)
    frames = np.arange(0.0, longest, 1.0 / frame_rate) if STEP * frame_rate < 1.0 else steps
    return np.unique(np.round([*steps, *frames, longest], 9))


def oscillations(loop: DelayedLoop, spectrum: Eigen, case: Case) -> list[eigenmodes.Eigenmode]:
    """The modes up to 10 Hz that oscillate or grow."""
    shown = (spectrum.values.imag > 0.0) | ((spectrum.values.imag == 0.0) & (spectrum.values.real > STILL))
    return [
        eigenmodes.mode(complex(spectrum.values[i]), spectrum.right[:, i], spectrum.left[:, i], loop.names, case.system)
        for i in np.flatnonzero(shown & (np.abs(spectrum.values) < FASTEST))
    ]


def _critical(loop: DelayedLoop, delay: float, case: Case) -> eigenmodes.Eigenmode:
    spectrum = eigen(loop, sampled(loop, delay))
    i = int(np.argmax(spectrum.values.real + 1e-12 * (spectrum.values.imag >= 0.0)))
    return eigenmodes.mode(
        complex(spectrum.values[i]), spectrum.right[:, i], spectrum.left[:, i], loop.names, case.system
    )


def intervals(
    growth: Callable[[float], float], delays: NDArray[np.float64], values: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Intervals in which growth (1/s) is at most zero: from `values` at given delays (s), limits by Brent's method."""
    below, known = values <= STILL, dict(zip(delays.tolist(), values.tolist(), strict=True))

    def above(delay: float) -> float:
        return (known[delay] if delay in known else growth(delay)) - STILL

    def limit(low: float, high: float) -> float:
        before = high - EXACT  # at whole frames, where signals contain setpoints, growth may jump
        jumps = (above(before) > 0.0) == (above(low) > 0.0)
        return high if jumps else float(brentq(above, low, before, xtol=EXACT))

    limits = [limit(*delays[i : i + 2].tolist()) for i in np.flatnonzero(below[1:] != below[:-1])]
    ends = [*([float(delays[0])] if below[0] else []), *limits, *([float(delays[-1])] if below[-1] else [])]
    return list(zip(ends[::2], ends[1::2], strict=True))


def first_limit(stable: Sequence[tuple[float, float]], longest: float) -> float | None:
    """The smallest delay (s) at which a loop is unstable; None if it is stable up to the longest."""
    if not stable or stable[0][0] > 0.0:
        return 0.0
    return stable[0][1] if stable[0][1] < longest else None


def _pade_margin(loop: DelayedLoop, delays: NDArray[np.float64], order: int, hold: float) -> float | None:
    """The margin of the loop in continuous time, s."""

    def growth(delay: float) -> float:
        return eigen(loop, approximate(loop, delay, order, hold), discrete=False).growth

    values: list[float] = []
    for delay in delays:
        values.append(growth(float(delay)))
        if values[-1] > STILL:
            break
    return first_limit(intervals(growth, delays[: len(values)], np.array(values)), float(delays[-1]))


def follow(listed: Sequence[Sequence[eigenmodes.Eigenmode]]) -> list[Track]:
    """Tracks of modes over the delays (s): electromechanical modes at zero delay, then others that become unstable."""
    swings = [mode for mode in listed[0] if mode.swings]
    columns = followed(swings, listed[1:])
    tracks = [Track(mode.label, [mode, *column]) for mode, column in zip(swings, columns, strict=True)]
    for i, modes in enumerate(listed):
        for mode in modes:
            if mode.eigenvalue.real > STILL and not any(track.modes[i] is mode for track in tracks):
                after, before = followed([mode], listed[i + 1 :])[0], followed([mode], listed[:i][::-1])[0]
                tracks.append(Track(mode.label, [*before[::-1], mode, *after]))
    return tracks


def followed(
    first: Sequence[eigenmodes.Eigenmode], listed: Sequence[Sequence[eigenmodes.Eigenmode]]
) -> list[list[eigenmodes.Eigenmode | None]]:
    """The continuation of each first mode in the following lists, each mode used once; None after it is lost."""
    columns: list[list[eigenmodes.Eigenmode | None]] = [[] for _ in first]
    now: list[eigenmodes.Eigenmode | None] = list(first)
    for modes in listed:
        there = [(i, mode) for i, mode in enumerate(now) if mode is not None]
        cost = eigenmodes.unlike([mode for _, mode in there], modes)
        now = [None] * len(first)
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] < LOST:
                now[there[row][0]] = modes[column]
        for column, mode in zip(columns, now, strict=True):
            column.append(mode)
    return columns
