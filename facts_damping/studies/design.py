"""A damping controller for a system that has none: which mode, where the device, which signal, which lead-lag.

The residues of all places and signals (`small_signal.places`) rank them for each mode; among the best for one mode a
pair is passed over that moves another mode to the right. The lead-lag is for a damping ratio and a delay (`lead_lag`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import make_case, read_system
from facts_damping.errors import InputError, check_known
from facts_damping.parameters.placement import place
from facts_damping.plant.build import build
from facts_damping.small_signal import linearisation, places
from facts_damping.studies import lead_lag, linear_margin, made_scenarios
from facts_damping.studies.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.parameters.system import System
    from facts_damping.small_signal.linearisation import Eigenmode
    from facts_damping.small_signal.places import Tried
    from facts_damping.studies.lead_lag import Tuned

    Tell = Callable[[str, str], Callable[[int, int], None]]  # what is done, in what: shows progress

BAND_HZ = (0.1, 2.0)  # swings of machines against each other
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
    mode_hz: float | None = None  # the mode next to it; none: the least damped interarea mode, or of all
    place: str | None = None  # a line, a bus, or a device of the system; none: the best
    signal: str | None = None  # none: the best difference of speeds


class Pair(NamedTuple):
    """A device at a place, and a signal, for the mode that is to be damped."""

    tried: int  # index of the place
    signal: str
    residue: complex  # 1/s
    law: lead_lag.LeadLag
    others: list[float]  # by mode: change of its damping ratio for one of the mode's own

    def conflicts(self) -> bool:
        """Whether another mode loses too much."""
        return min(self.others) < -CONFLICT


class Design(NamedTuple):
    """What was found."""

    task: Task
    system: System  # with all signals that were looked at
    modes: list[Eigenmode]  # those in the band, the least damped first
    target: int  # which is to be damped
    observability: np.ndarray[Any, np.dtype[np.complex128]]  # (modes, signals of the system)
    tried: list[Tried]
    signals: list[str]  # of the columns of what was tried
    pairs: list[Pair]  # the largest residue first
    chosen: Pair
    content: dict[str, Any]  # of the system's file, with device, signal and its PMUs
    run: dict[str, Any]  # of the run's file, but for system and scenario
    tuned: Tuned
    margin: float | None  # s, the delay margin; none: above LONGEST_S
    critical: Eigenmode | None  # the mode that is at the limit there
    scenarios: dict[str, dict[str, Any]]


def design(task: Task, jobs: int, tell: Tell) -> Design:
    """Rank, choose, tune. Raises `InputError` where there is nothing to damp, or what was named is not there."""
    own = read_system(task.system, task.sets)
    modes = listed_modes(own)
    target = _target(task, modes)
    system = places.with_signals(own, modes)
    observability = places.seen(system, modes)
    signals = _worth_a_look(task, system, observability)
    narrow = places.only(system, signals, own)
    candidates = _candidates(task, own)
    progress = tell("design", "places")
    tried = run_all(places.tried, [places.Trial(narrow, one, modes) for one in candidates], jobs, progress)
    pairs = _pairs(task, narrow, tried, modes, target)
    if not pairs:
        raise InputError(_nothing(task, tried))
    chosen = next((pair for pair in pairs if not pair.conflicts()), pairs[0])
    content, run = _written(task, system, own, tried[chosen.tried], chosen)
    tuned = lead_lag.tune(
        {**run, "system": content, "scenario": []},
        chosen.law,
        chosen.residue,
        modes[target],
        task.damping,
        task.delay,
        tell("design", "gains"),
    )
    run["controllers"][0]["parameters"] = chosen.law.parameters(tuned.gain)
    inline = {**run, "system": content, "scenario": []}
    margin, critical = linear_margin.first_margin(make_case(inline, "design"), LONGEST_S, tell("design", "delays"))
    scenarios = made_scenarios.made(inline, tried, target, tell("design", "scenarios"))
    seen = system, modes, target, observability, tried, list(narrow.signals)
    return Design(task, *seen, pairs, chosen, content, run, tuned, margin, critical, scenarios)


def listed_modes(system: System) -> list[Eigenmode]:
    """The least damped swing modes in the band without devices, and the least damped interarea mode among them."""
    built = build(place(system), [], [])
    matrix, _ = linearisation.linearise(built)
    found = linearisation.modes(matrix, built.state_names, place(system))
    low, high = BAND_HZ
    swings = [m for m in found if m.label not in ("common", "control") and low <= m.frequency_hz <= high]
    if not swings:
        raise InputError(f"SYSTEM: {system.name} has no swing mode from {low:g} to {high:g} Hz; allowed: one that has")
    swings.sort(key=lambda m: m.damping_ratio)
    interarea = next((m for m in swings if m.label == "interarea"), None)
    kept = swings[:MODES]
    return kept if interarea is None or interarea in kept else [*kept[:-1], interarea]


def _target(task: Task, modes: Sequence[Eigenmode]) -> int:
    """Index of the mode that is to be damped."""
    if task.mode_hz is not None:
        wanted = task.mode_hz
        index = min(range(len(modes)), key=lambda i: abs(modes[i].frequency_hz - wanted))
    else:
        index = next((i for i, m in enumerate(modes) if m.label == "interarea"), 0)
    ratio = modes[index].damping_ratio
    if ratio >= task.damping:
        raise InputError(
            f"--damping {task.damping:g}: the mode of {modes[index].frequency_hz:.3f} Hz has {ratio:.3f} already; "
            "allowed: a higher ratio, or another --mode"
        )
    return index


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


def _candidates(task: Task, system: System) -> list[places.Place]:
    found = places.places(system)
    if task.place is None:
        return found
    names = {p.device.name for p in found if p.own} | {p.at for p in found}
    check_known("--place", task.place, sorted(names))
    return [p for p in found if task.place in (p.at, p.device.name if p.own else None)]


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
        (abs(one.residue[target, s]) * float(one.place.device.v_max), i, s)
        for i, one in enumerate(tried)
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
        return float(-moved.real / abs(s)) if np.isfinite(moved) else 0.0

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
