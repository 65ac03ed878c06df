"""A damping controller for a system that has none: which mode, where the device, which signal, which lead-lag.

The residues of all places and signals (`small_signal.places`) rank them for each mode; among the best for one mode a
pair is passed over that moves another mode to the right. The lead-lag is for a damping ratio and a delay (`lead_lag`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import make_case, read_system
from facts_damping.errors import InputError, check_known
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.build import build
from facts_damping.small_signal import linearisation, places
from facts_damping.studies.design import lead_lag, scenario_generation
from facts_damping.studies.margins import linear_margin
from facts_damping.studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.parameters.plant.system import System
    from facts_damping.small_signal.linearisation import Eigenmode
    from facts_damping.small_signal.places import Tried
    from facts_damping.studies.design.lead_lag import Tuned
    from facts_damping.studies.margins.linear_margin import Around

    Tell = Callable[[str, str], Callable[[int, int], None]]  # what is done, in what: shows progress

BAND_HZ = (0.1, 2.0)  # swings of machines against each other
NEARBY = 0.1  # of a frequency: a mode that was asked for lies so near
MODES, PLACES, SIGNALS, PAIRS = 4, 5, 5, 8  # shown, and looked at for the pair, of each mode
CONFLICT = 0.25  # of what the mode gains in damping ratio: so much another one may lose at most
FRAME_RATE = 60
LONGEST_S = 1.0  # delay up to which the margin is looked for


class Task(NamedTuple):
    """What is asked for."""

    system: str
    sets: list[str]
    damping: float  # wanted damping ratio
    delay: float  # s, from measurement to device
    mode_hz: float | None = None  # of the mode; none: the least damped interarea mode, or of all
    place: str | None = None  # a line, a bus, or a device of the system; none: the best
    signal: str | None = None  # none: the best difference of speeds


class Pair(NamedTuple):
    """A device at a place, and a signal, for the mode that is to be damped."""

    tried: int  # index of the place
    signal: str
    residue: complex  # 1/s
    law: lead_lag.LeadLag
    others: list[float]  # by mode: change of its damping ratio for one of the mode's own; NaN: it is not found again

    def conflicts(self) -> bool:
        """Whether another mode loses too much."""
        return any(value < -CONFLICT for value in self.others)


class Design(NamedTuple):
    """What was found."""

    task: Task
    system: System  # with all signals that were looked at
    modes: list[Eigenmode]  # those in the band, the least damped first
    target: int  # which is to be damped
    observability: np.ndarray[Any, np.dtype[np.complex128]]  # (modes, signals of the system)
    tried: list[Tried]
    pairs: list[Pair]  # the largest residue first
    chosen: Pair
    content: dict[str, Any]  # of the system's file, with device, signal and its PMUs
    run: dict[str, Any]  # of the run's file, but for system and scenario
    tuned: Tuned
    stable: Around | None  # delays in which the loop is stable; none: not even with its own
    scenarios: dict[str, dict[str, Any]]


def design(task: Task, jobs: int, tell: Tell) -> Design:
    """Rank, choose, tune. Raises `InputError` where there is nothing to damp, or what was named is not there."""
    own = read_system(task.system, task.sets)
    modes, target = listed_modes(task, own)
    system = places.with_signals(own, modes)
    observability = places.seen(system, modes)
    narrow = places.only(system, _worth_a_look(task, system, observability), own)
    candidates = places.places(own)
    if task.place is not None:
        check_known("--place", task.place, sorted({name for one in candidates for name in one.names}))
    trials = [places.Trial(narrow, one, modes) for one in candidates]
    tried = run_all(places.tried, trials, jobs, tell("design", "places"))
    pairs = _pairs(task, narrow, tried, modes, target)
    if not pairs:
        raise InputError(_nothing(task, tried))
    chosen = next((pair for pair in pairs if not pair.conflicts()), pairs[0])
    content, run = _written(task, system, own, tried[chosen.tried], chosen)
    plain = {**run, "system": content, "scenario": []}
    wanted = modes[target], task.damping, task.delay
    tuned = lead_lag.tune(plain, chosen.law, chosen.residue, *wanted, tell("design", "gains"))
    run["controllers"][0]["parameters"] = chosen.law.parameters(tuned.gain)
    loop = make_case({**run, "system": content, "scenario": []}, "design")
    stable = linear_margin.stable_around(loop, task.delay, LONGEST_S, tell("design", "delays"))
    scenarios = scenario_generation.training_cases(
        plain, tried, tried[chosen.tried].place, target, tell("design", "scenarios")
    )
    return Design(
        task=task,
        system=system,
        modes=modes,
        target=target,
        observability=observability,
        tried=tried,
        pairs=pairs,
        chosen=chosen,
        content=content,
        run=run,
        tuned=tuned,
        stable=stable,
        scenarios=scenarios,
    )


def listed_modes(task: Task, system: System) -> tuple[list[Eigenmode], int]:
    """The least damped swing modes in the band without devices, and which of them is to be damped.

    The one that was asked for is among them, else the least damped interarea mode, if there is one.
    """
    placed = place(system)
    built = build(placed, [], [])
    matrix, _ = linearisation.linearise(built)
    found = linearisation.modes(matrix, built.state_names, placed)
    low, high = BAND_HZ
    swings = [m for m in found if m.swings and low <= m.frequency_hz <= high]
    if not swings:
        raise InputError(f"SYSTEM: {system.name} has no swing mode from {low:g} to {high:g} Hz; allowed: one that has")
    swings.sort(key=lambda m: m.damping_ratio)
    wanted = _wanted(task, swings)
    kept = swings[:MODES]
    modes = kept if wanted in kept else [*kept[:-1], wanted]
    if wanted.damping_ratio >= task.damping:
        raise InputError(
            f"--damping {task.damping:g}: the mode of {wanted.frequency_hz:.3f} Hz has {wanted.damping_ratio:.3f} "
            "already; allowed: a higher ratio, or another --mode"
        )
    return modes, modes.index(wanted)


def _wanted(task: Task, swings: Sequence[Eigenmode]) -> Eigenmode:
    """The mode that is to be damped, of those in the band, the least damped first."""
    hertz = task.mode_hz
    if hertz is None:
        return next((m for m in swings if m.label == "interarea"), swings[0])
    nearest = min(swings, key=lambda m: abs(m.frequency_hz - hertz))
    if abs(nearest.frequency_hz - hertz) > NEARBY * hertz:
        known = ", ".join(f"{m.frequency_hz:.3f}" for m in sorted(swings, key=lambda m: m.frequency_hz))
        raise InputError(f"--mode {hertz:g}: no swing mode is near; allowed: {known} Hz")
    return nearest


def _worth_a_look(task: Task, system: System, observability: np.ndarray[Any, Any]) -> list[str]:
    """The signals in which the modes show most, of speeds and of flows, and the one that was asked for."""
    names = list(system.signals)
    if task.signal is not None:
        check_known("--signal", task.signal, names)
    kept = {task.signal} if task.signal is not None else set[str]()
    for row in np.abs(observability):
        for channel in (places.SPEED, places.FLOW):
            kept |= set(most(names, row, channel, system)[:SIGNALS])
    return [name for name in names if name in kept]


def most(names: Sequence[str], values: Any, channel: str, system: System) -> list[str]:
    """Signals of a channel, the largest value first."""
    own = [(float(value), name) for name, value in zip(names, values, strict=True)]
    own = [one for one in own if system.signals[one[1]].channel == channel]
    return [name for _, name in sorted(own, key=lambda one: -one[0])]


def _nothing(task: Task, tried: Sequence[Tried]) -> str:
    """Why there is no pair."""
    reasons = {one.why_not for one in tried if one.why_not}
    why = f" ({next(iter(reasons))})" if reasons else ""
    return (
        f"--place: with no device at {task.place or 'any place'} the mode is found again{why}; allowed: another place"
    )


def _pairs(task: Task, system: System, tried: Sequence[Tried], modes: Sequence[Eigenmode], target: int) -> list[Pair]:
    """The pairs with the largest residues for the mode, of a device's whole setpoint; those asked for alone."""
    names = list(system.signals)
    wanted = (
        [task.signal] if task.signal is not None else [n for n in names if system.signals[n].channel == places.SPEED]
    )
    worth = [
        (abs(one.residue[target, s]) * float(one.place.device.setpoint_max), i, s)
        for i, one in enumerate(tried)
        if task.place is None or task.place in one.place.names
        for s, name in enumerate(names)
        if name in wanted and np.isfinite(one.residue[target, s])
    ]
    best = sorted(worth, reverse=True)[:PAIRS]
    return [_pair(task, tried[i], i, s, names[s], modes, target) for _, i, s in best]


def _pair(
    task: Task, tried: Tried, index: int, signal: int, name: str, modes: Sequence[Eigenmode], target: int
) -> Pair:
    """A pair with its lead-lag, and what that does to other modes."""
    residues = tried.residue[:, signal]
    at = modes[target].eigenvalue
    law = lead_lag.lead_lag(complex(residues[target]), at, task.delay, FRAME_RATE)

    def gained(i: int) -> float:
        s = modes[i].eigenvalue
        moved = residues[i] * law.response(s) * lead_lag.late(s, task.delay, FRAME_RATE)
        return float(-moved.real / abs(s))

    return Pair(index, name, complex(residues[target]), law, [gained(i) / gained(target) for i in range(len(modes))])


def _written(
    task: Task, system: System, own: System, tried: Tried, chosen: Pair
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The content of the system's file with the device and the signal, and of the run's."""
    device = tried.place.device.name
    wide = places.only(system, list(dict.fromkeys([*own.signals, chosen.signal])), own)
    content = places.with_place(wide, tried.place).model_dump(by_alias=True, exclude_defaults=True)
    half = {"stage": "network", "model": "constant", "delay": task.delay / 2}
    run = {
        "description": f"{system.name}, lead-lag by facts-damping design",
        "devices": [device],
        "controllers": [{"name": "LLC", "devices": [device], "signals": [chosen.signal]}],
        "link": {"up": [half], "down": [dict(half)]} if task.delay > 0.0 else "ideal",
        "frame_rate": FRAME_RATE,
    }
    return content, run
