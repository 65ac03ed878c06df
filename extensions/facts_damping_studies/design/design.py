"""Design a damping controller for a system without one: the mode, the device's place, the signal and the lead-lag.

The residues of all places and signals (`places`) rank the pairs for each mode. A pair is skipped if it
moves another mode to the right. The lead-lag is tuned for a damping ratio and a delay (`lead_lag`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import make_case, read_system
from facts_damping.errors import InputError, check_known
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.build import build
from facts_damping.small_signal import eigenmodes, linearisation
from facts_damping_studies.design import lead_lag, places, scenario_generation
from facts_damping_studies.margins import delay_margin
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.parameters.plant.system import System
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.design.lead_lag import Tuned
    from facts_damping_studies.design.places import Tried
    from facts_damping_studies.margins.delay_margin import Around

    Tell = Callable[[str, str], Callable[[int, int], None]]  # what is done, in what: shows progress

BAND_HZ = (0.1, 2.0)  # band of electromechanical modes
NEARBY = 0.1  # relative frequency error within which a mode matches the requested one
MODES, PLACES, SIGNALS, PAIRS = 4, 5, 5, 8  # numbers shown per mode, and numbers of candidates for a pair
CONFLICT = 0.25  # largest loss of another mode's damping ratio, relative to the gain of the target mode's
FRAME_RATE = 60
LONGEST_S = 1.0  # longest delay in the search for the margin


class Task(NamedTuple):
    """Specification of a design."""

    system: str
    sets: list[str]
    damping: float  # wanted damping ratio
    delay: float  # s, from measurement to device
    mode_hz: float | None = None  # of the mode; None: the least damped interarea mode, if any, or of all modes
    place: str | None = None  # a line, a bus, or a device of the system; None: the best
    signal: str | None = None  # None: the best difference of speeds
    kinds: Sequence[str] = places.USUAL  # of new devices, of `places.NEW_DEVICES`


class Pair(NamedTuple):
    """A device at a place and a signal, as a candidate for damping the target mode."""

    tried: int  # index of the place
    signal: str
    residue: complex  # 1/s
    law: lead_lag.LeadLag
    others: list[float]  # by mode: change of its damping ratio over the target's; NaN: the mode is not found again

    def conflicts(self) -> bool:
        """Whether another mode loses more damping than `CONFLICT` allows."""
        return any(value < -CONFLICT for value in self.others)


class Design(NamedTuple):
    """Result of a design."""

    task: Task
    system: System  # with all signals that were considered
    modes: list[Eigenmode]  # modes in the band, the least damped first
    target: int  # index of the mode to be damped
    observability: np.ndarray[Any, np.dtype[np.complex128]]  # (modes, signals of the system)
    tried: list[Tried]
    pairs: list[Pair]  # the largest residue first
    chosen: Pair
    content: dict[str, Any]  # content of the system's file, with device, signal and its PMUs
    run: dict[str, Any]  # content of the run's file, without system and scenario
    tuned: Tuned
    stable: Around | None  # interval of delays in which the loop is stable; None: unstable even at its own delay
    scenarios: dict[str, dict[str, Any]]


def design(task: Task, jobs: int, tell: Tell) -> Design:
    """Rank, choose and tune. Raises `InputError` if there is no mode to damp, or for unknown names."""
    bare_system = read_system(task.system, task.sets)
    modes, target = listed_modes(task, bare_system)
    system = places.with_signals(bare_system, modes)
    observability = places.seen(system, modes)
    narrow = places.only(system, _worth_a_look(task, system, observability), bare_system)
    for kind in task.kinds:
        check_known("--kinds", kind, places.NEW_DEVICES)
    candidates = places.places(bare_system, task.kinds)
    if task.place is not None:
        check_known("--place", task.place, sorted({name for candidate in candidates for name in candidate.names}))
    trials = [places.Trial(narrow, candidate, modes) for candidate in candidates]
    tried = run_all(places.tried, trials, jobs, tell("design", "places"))
    pairs = _pairs(task, narrow, tried, modes, target)
    if not pairs:
        reason = next((f" ({attempt.why_not})" for attempt in tried if attempt.why_not), "")
        problem = f"with a device at {task.place or 'any place'} the mode is not found again{reason}"
        raise InputError(f"--place: {problem}; allowed: another place")
    chosen = next((pair for pair in pairs if not pair.conflicts()), pairs[0])
    content, run = _written(task, system, bare_system, tried[chosen.tried], chosen)
    plain = {**run, "system": content, "scenario": []}
    wanted = modes[target], task.damping, task.delay
    tuned = lead_lag.tune(plain, chosen.law, chosen.residue, *wanted, tell("design", "gains"))
    run["controllers"][0]["parameters"] = chosen.law.parameters(tuned.gain)
    loop = make_case({**run, "system": content, "scenario": []}, "design")
    stable = delay_margin.stable_around(loop, task.delay, LONGEST_S, tell("design", "delays"))
    scenarios = scenario_generation.training_cases(
        plain, tried, tried[chosen.tried].place, target, tell("design", "scenarios")
    )
    ranked = task, system, modes, target, observability, tried, pairs
    return Design(*ranked, chosen, content, run, tuned, stable, scenarios)


def listed_modes(task: Task, system: System) -> tuple[list[Eigenmode], int]:
    """The least damped electromechanical modes in the band without devices, and the index of the mode to be damped.

    The target is the requested mode, else the least damped interarea mode if there is one.
    """
    placed = place(system)
    built = build(placed, [], [])
    all_modes = eigenmodes.modes(linearisation.state_matrix(built)[0], built.state_names, placed)
    low, high = BAND_HZ
    swings = [m for m in all_modes if m.swings and low <= m.frequency_hz <= high]
    if not swings:
        lacks = f"no electromechanical mode from {low:g} to {high:g} Hz"
        raise InputError(f"SYSTEM: {system.name} has {lacks}; allowed: one that has")
    swings.sort(key=lambda m: m.damping_ratio)
    wanted = _wanted(task, swings)
    least_damped = swings[:MODES]
    modes = least_damped if wanted in least_damped else [*least_damped[:-1], wanted]
    if wanted.damping_ratio >= task.damping:
        has = f"the mode of {wanted.frequency_hz:.3f} Hz has {wanted.damping_ratio:.3f} already"
        raise InputError(f"--damping {task.damping:g}: {has}; allowed: a higher ratio, or another --mode")
    return modes, modes.index(wanted)


def _wanted(task: Task, swings: Sequence[Eigenmode]) -> Eigenmode:
    """The target mode among the modes in the band, which are sorted by damping, the least damped first."""
    hertz = task.mode_hz
    if hertz is None:
        return next((m for m in swings if m.label == "interarea"), swings[0])
    nearest = min(swings, key=lambda m: abs(m.frequency_hz - hertz))
    if abs(nearest.frequency_hz - hertz) > NEARBY * hertz:
        known = ", ".join(f"{m.frequency_hz:.3f}" for m in sorted(swings, key=lambda m: m.frequency_hz))
        raise InputError(f"--mode {hertz:g}: no electromechanical mode is near; allowed: {known} Hz")
    return nearest


def _worth_a_look(task: Task, system: System, observability: np.ndarray[Any, Any]) -> list[str]:
    """The speed and flow signals with the highest observability of the modes, and the requested signal."""
    names = list(system.signals)
    if task.signal is not None:
        check_known("--signal", task.signal, names)
    best_names = {task.signal} if task.signal is not None else set[str]()
    for row in np.abs(observability):
        for channel in (places.SPEED, places.FLOW):
            best_names |= set(maximum(names, row, channel, system)[:SIGNALS])
    return [name for name in names if name in best_names]


def maximum(names: Sequence[str], values: Any, channel: str, system: System) -> list[str]:
    """Signals of a channel, sorted by value, the largest first."""
    by_name = dict(zip(names, values, strict=True))
    return sorted((n for n in names if system.signals[n].channel == channel), key=lambda name: -float(by_name[name]))


def _pairs(task: Task, system: System, tried: Sequence[Tried], modes: Sequence[Eigenmode], target: int) -> list[Pair]:
    """The pairs with the largest residue times device limit for the mode, at the requested place or signal if named."""
    names = list(system.signals)
    speeds = [name for name in names if system.signals[name].channel == places.SPEED]
    wanted = speeds if task.signal is None else [task.signal]
    worth = [
        (abs(attempt.residue[target, s]) * float(attempt.place.device.setpoint_max), i, s)
        for i, attempt in enumerate(tried)
        if task.place is None or task.place in attempt.place.names
        for s, name in enumerate(names)
        if name in wanted and np.isfinite(attempt.residue[target, s])
    ]
    best = sorted(worth, reverse=True)[:PAIRS]
    return [_pair(task, tried[i], i, s, names[s], modes, target) for _, i, s in best]


def _pair(
    task: Task, tried: Tried, index: int, signal: int, name: str, modes: Sequence[Eigenmode], target: int
) -> Pair:
    residues = tried.residue[:, signal]
    at = modes[target].eigenvalue
    law = lead_lag.lead_lag(complex(residues[target]), at, task.delay, FRAME_RATE)

    def gained(i: int) -> float:
        s = modes[i].eigenvalue
        moved = residues[i] * law.response(s) * lead_lag.late(s, task.delay, FRAME_RATE)
        return float(-moved.real / abs(s))

    return Pair(index, name, complex(residues[target]), law, [gained(i) / gained(target) for i in range(len(modes))])


def _written(
    task: Task, system: System, original: System, tried: Tried, chosen: Pair
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Content of the system's file with the device and the signal, and content of the run's file."""
    device = tried.place.device.name
    wide = places.only(system, list(dict.fromkeys([*original.signals, chosen.signal])), original)
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
