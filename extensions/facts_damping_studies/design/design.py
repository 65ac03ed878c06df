"""Design a damping controller for a system without one: the mode, the device's place, the signal and the lead-lag.

The residues of all places and signals (`places`) rank the pairs for each mode. A pair is skipped if it
moves another mode to the right. The lead-lag is tuned for a damping ratio and a delay (`lead_lag`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.changes import apply_profile, read_profile
from facts_damping.case.loading import make_case, read_system
from facts_damping.case.named_files import checked, read_source
from facts_damping.errors import InputError, check_known
from facts_damping.measurement.filters import reference_filter
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.measurement import Measurement
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.plant.build import build
from facts_damping.small_signal import eigenmodes, linearisation
from facts_damping_studies.design import lead_lag, place_ranking, places, scenario_generation
from facts_damping_studies.margins import delay_margin

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.parameters.plant.pmus import Channel
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
DELAY_S = 0.1  # of the loop, if none is asked for
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
    profile: str = DEFAULT_PROFILE  # of the run: its PMUs and fields of the system

    @property
    def measurement(self) -> Any:
        """How the PMUs of the profile measure: a name or content."""
        return read_profile(self.profile).set.get("measurement", "ideal")

    @property
    def measured(self) -> Measurement:
        """The same, read."""
        return checked(Measurement, read_source("measurement", self.measurement, "measurement"))

    def channel(self, system: System) -> Channel:
        """What is usual as a signal: speeds, or frequencies where the PMUs report no speeds, as at inverters."""
        turning = not any(inverter.forming for inverter in system.inverters)
        return places.SPEED if self.measured.filter == "ideal" and turning else places.FREQUENCY

    def delay_with_filter(self, nominal: float) -> float:
        """s, from the instant of a measurement to the device; `nominal`: frequency, Hz."""
        return self.delay + reference_filter(self.measured, nominal, FRAME_RATE).delay / FRAME_RATE


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


@dataclass(frozen=True)
class Ranking:
    """Modes, places and signals, ranked, and the pair that would be taken."""

    task: Task
    bare: System  # as it was given, with the profile's fields
    system: System  # with equal machines at one bus as one, and all signals that were considered
    modes: list[Eigenmode]  # modes in the band, the least damped first
    target: int  # index of the mode to be damped
    observability: np.ndarray[Any, np.dtype[np.complex128]]  # (modes, signals of the system)
    tried: list[Tried]
    pairs: list[Pair]  # the largest residue first
    chosen: Pair

    @property
    def channel(self) -> Channel:
        """What is usual as a signal of this system."""
        return self.task.channel(self.system)


@dataclass(frozen=True)
class Design(Ranking):
    """Result of a design."""

    content: dict[str, Any]  # content of the system's file, with device, signal and its PMUs
    run: dict[str, Any]  # content of the run's file, without system and scenario
    tuned: Tuned
    stable: Around | None  # interval of delays in which the loop is stable; None: unstable even at its own delay
    scenarios: dict[str, dict[str, Any]]


def design(task: Task, jobs: int, tell: Tell) -> Design:
    """Rank, choose and tune. Raises `InputError` if there is no mode to damp, or for unknown names."""
    return completed(ranked(task, jobs, tell), tell)


def ranked(task: Task, jobs: int, tell: Tell) -> Ranking:
    """Rank places and signals for each mode, and pairs for the target. Raises `InputError`."""
    bare_system = read(task)
    grid = places.merged(bare_system) if "exciter_input" not in task.kinds else bare_system
    modes, target = listed_modes(task, grid)
    system = places.with_signals(grid, modes, task.channel(grid))
    observability = places.seen(system, modes)
    narrow = places.only(system, _worth_a_look(task, system, observability), grid)
    for kind in task.kinds:
        check_known("--kinds", kind, places.NEW_DEVICES)
    candidates = places.places(grid, task.kinds)
    places.check_place(task.place, candidates)

    def paired(tried: Sequence[Tried]) -> set[int]:
        return {i for i, _ in best_pairs(task, narrow, tried, target)}

    observed = observability[:, [list(system.signals).index(name) for name in narrow.signals]]
    ranked_by = candidates, modes, target, paired, jobs, tell("design", "places")
    tried = place_ranking.ranked(narrow, observed, *ranked_by)
    pairs = ranked_pairs(task, narrow, tried, modes, target)
    chosen = next((pair for pair in pairs if not pair.conflicts()), pairs[0])
    return Ranking(task, bare_system, system, modes, target, observability, tried, pairs, chosen)


def completed(ranking: Ranking, tell: Tell) -> Design:
    """The design of a ranking's pair. Raises `InputError` if the mode has the wanted damping ratio already."""
    task, mode, chosen = ranking.task, ranking.modes[ranking.target], ranking.chosen
    if mode.damping_ratio >= task.damping:
        has = f"the mode of {mode.frequency_hz:.3f} Hz has {mode.damping_ratio:.3f} already"
        raise InputError(f"--damping {task.damping:g}: {has}; allowed: a higher ratio, or another --mode")
    place = ranking.tried[chosen.tried].place
    content, run = _written(ranking)
    grid = places.merged(System.model_validate(content)) if ranking.system.machines != ranking.bare.machines else None
    plain = {**run, "system": grid.model_dump(by_alias=True) if grid else content, "scenario": []}
    wanted = mode, task.damping, task.delay
    tuned = lead_lag.tune(plain, chosen.law, chosen.residue, *wanted, tell("design", "gains"))
    run["controllers"][0]["parameters"] = chosen.law.parameters(tuned.gain)
    loop = make_case({**plain, "controllers": run["controllers"]}, "design")
    stable = delay_margin.stable_around(loop, task.delay, LONGEST_S, tell("design", "delays"))
    scenarios = scenario_generation.training_cases(
        plain, ranking.tried, place, ranking.target, tell("design", "scenarios")
    )
    return Design(**vars(ranking), content=content, run=run, tuned=tuned, stable=stable, scenarios=scenarios)


def read(task: Task) -> System:
    """The system of a task, with the fields of its profile."""
    system = read_system(task.system, task.sets)
    if task.profile == DEFAULT_PROFILE:
        return system
    content = {"system": system.model_dump(by_alias=True)}
    apply_profile(content, task.profile, "--profile")
    return check(System, content["system"], f"--profile {task.profile}")


def listed_modes(task: Task, system: System) -> tuple[list[Eigenmode], int]:
    """The least damped electromechanical modes in the band without devices, and the index of the mode to be damped.

    The target is the requested mode; else of the modes below the wanted damping ratio the least damped interarea mode,
    or the least damped; if none is below, of all.
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
    return modes, modes.index(wanted)


def _wanted(task: Task, swings: Sequence[Eigenmode]) -> Eigenmode:
    """The target mode among the modes in the band, which are sorted by damping, the least damped first."""
    hertz = task.mode_hz
    if hertz is None:
        wanting = [m for m in swings if m.damping_ratio < task.damping] or swings
        return next((m for m in wanting if m.label == "interarea"), wanting[0])
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
        for channel in (task.channel(system), places.FLOW):
            best_names |= set(maximum(names, row, channel, system)[:SIGNALS])
    return [name for name in names if name in best_names]


def maximum(names: Sequence[str], values: Any, channel: str, system: System) -> list[str]:
    """Signals of a channel, sorted by value, the largest first."""
    by_name = dict(zip(names, values, strict=True))
    return sorted((n for n in names if system.signals[n].channel == channel), key=lambda name: -float(by_name[name]))


def ranked_pairs(
    task: Task, system: System, tried: Sequence[Tried], modes: Sequence[Eigenmode], target: int
) -> list[Pair]:
    """The pairs with the largest residue times device limit for the mode, at the requested place or signal if named.

    Raises `InputError` if there is none.
    """
    best = best_pairs(task, system, tried, target)
    if not best:
        reason = next((f" ({attempt.why_not})" for attempt in tried if attempt.why_not), "")
        problem = f"with a device at {task.place or 'any place'} the mode is not found again{reason}"
        raise InputError(f"--place: {problem}; allowed: another place")
    delay, names = task.delay_with_filter(system.frequency), list(system.signals)
    return [_pair(delay, tried[i], i, s, names[s], modes, target) for i, s in best]


def best_pairs(task: Task, system: System, tried: Sequence[Tried], target: int) -> list[tuple[int, int]]:
    """Indices of place and signal of the pairs of `ranked_pairs`, the best first; without any: none."""
    names = list(system.signals)
    speeds = [name for name in names if system.signals[name].channel == task.channel(system)]
    wanted = speeds if task.signal is None else [task.signal]
    worth = [
        (abs(attempt.residue[target, s]) * float(attempt.place.device.setpoint_max), i, s)
        for i, attempt in enumerate(tried)
        if task.place is None or task.place in attempt.place.names
        for s, name in enumerate(names)
        if name in wanted and np.isfinite(attempt.residue[target, s])
    ]
    return [(i, s) for _, i, s in sorted(worth, reverse=True)[:PAIRS]]


def _pair(
    delay: float, tried: Tried, index: int, signal: int, name: str, modes: Sequence[Eigenmode], target: int
) -> Pair:
    residues = tried.residue[:, signal]
    at = modes[target].eigenvalue
    law = lead_lag.lead_lag(complex(residues[target]), at, delay, FRAME_RATE)

    def gained(i: int) -> float:
        s = modes[i].eigenvalue
        moved = residues[i] * law.response(s) * lead_lag.late(s, delay, FRAME_RATE)
        return float(-moved.real / abs(s))

    return Pair(index, name, complex(residues[target]), law, [gained(i) / gained(target) for i in range(len(modes))])


def with_choice(ranking: Ranking, signals: Sequence[str]) -> tuple[System, str]:
    """The system with the device that was chosen and some signals of the ranking, and the device's name."""
    original, location = ranking.bare, ranking.tried[ranking.chosen.tried].place
    names = {pmu.name for pmu in original.pmus}
    more = [pmu for pmu in ranking.system.pmus if pmu.name not in names]
    whole = original.model_copy(update={"pmus": [*original.pmus, *more], "signals": ranking.system.signals})
    wide = places.only(whole, list(dict.fromkeys([*original.signals, *signals])), original)
    return places.with_place(wide, location), location.device.name


def link_of(delay: float) -> Any:
    """Content of a run's `link` with a constant delay, s, half of it each way."""
    half = {"stage": "network", "model": "constant", "delay": delay / 2}
    return {"up": [half], "down": [dict(half)]} if delay > 0.0 else "ideal"


def _written(ranking: Ranking) -> tuple[dict[str, Any], dict[str, Any]]:
    """Content of the system's file with the device and the signal, and content of the run's file."""
    task, chosen, original = ranking.task, ranking.chosen, ranking.bare
    location = ranking.tried[chosen.tried].place
    content = with_choice(ranking, [chosen.signal])[0].model_dump(by_alias=True, exclude_defaults=True)
    run = {
        "description": f"{original.name}, lead-lag by facts-damping design",
        **({} if task.profile == DEFAULT_PROFILE else {"profile": task.profile, "measurement": task.measurement}),
        "devices": [location.device.name],
        "controllers": [{"name": "LLC", "devices": [location.device.name], "signals": [chosen.signal]}],
        "link": link_of(task.delay),
        "frame_rate": FRAME_RATE,
    }
    return content, run
