"""A set of cases for a grid of the user's own: place of the device, signal, alignment of the link, lines, and draws.

The signal is by default the difference of frequencies (speeds, where PMUs report them) with the largest residue for the
least damped interarea mode. Where the link shifts frames further against each other than the supervisor allows, a
phasor data concentrator (a stage `wait`) aligns them.
"""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.supervision import supervision, trips
from facts_damping.case.loading import changed_case, read_system
from facts_damping.errors import InputError, check_known
from facts_damping.monitor_table import MONITORS
from facts_damping.parameters.supervision import watches
from facts_damping.signals import NANOSECONDS, NEVER
from facts_damping.simulation import loop
from facts_damping_studies.design import design, places
from facts_damping_studies.score.cases.drawing import meshed_lines
from facts_damping_studies.score.cases.kinds import KINDS
from facts_damping_studies.score.cases.sets import Set, drawn_again, set_of
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System
    from facts_damping.record import Record
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.design.places import Place

LINES = 4  # least number of lines that faults are drawn from, if there are so many
CALM_S = 60.0  # of a run that shows what the supervisor says of the link
MISALIGNED = "misaligned"  # the monitor of frames that are apart
ALIGNED = 0.99  # quantile of the time between a frame's first and last entry for which the concentrator waits
STEP_S = 0.005  # of its wait
KINDS_OF_A_SET = dict.fromkeys([kind for kind, row in KINDS.items() if row.links], 6)
BESIDE = ("delay 400 ms", "device lost", "wrong sign behind the supervisor")


class OwnGrid(NamedTuple):
    """What cases are drawn for: grid, place of the device, signal, link, profile, numbers of cases by kind, seed."""

    system: str
    kinds: Mapping[str, int]
    beside: Sequence[str] = ()
    sets: list[str] = []  # noqa: RUF012 (never changed)
    place: str | None = None  # a line, bus, unit or device of the system; None: its first device, or the best
    signal: str | None = None  # None: the best difference of frequencies
    link: str | None = None  # None: the profile's
    profile: str = "deployment"
    seed: int = 1


class Ground(NamedTuple):
    """What all controllers are compared on, and how it came about."""

    case_set: Set
    place: Place
    signal: str
    mode: Eigenmode  # for which place and signal were chosen
    residue: complex  # of the mode, 1/s
    wait_s: float  # of the data concentrator; 0: none
    tripped_by: str  # monitor that trips a controller over this link although it does nothing; empty: none


def ground(asked: OwnGrid, jobs: int, tell: design.Tell) -> Ground:
    """Choose place, signal and alignment, and draw the cases. Raises `InputError`."""
    system, place, signal, mode, residue, lines = _placed(asked, jobs, tell)
    content = system.model_dump(by_alias=True, exclude_defaults=True)
    run: dict[str, Any] = {"system": content, "scenario": [], "devices": [place.device.name], "controllers": []}
    fields: dict[str, Any] = {"profile": asked.profile}
    fields |= {} if asked.link is None else {"link": asked.link}
    fields["link"] = changed_case(run, system.name, fields).link.model_dump()
    ports = {"devices": run["devices"], "signals": [signal]}
    idle = {"name": "LLC", **ports, "parameters": {"gain": 0.0}}
    fields["link"], wait_s, tripped_by = _aligned({**run, "controllers": [idle]}, fields)
    described = {
        "description": f"{system.name} with {place.label}, drawn for it",
        "version": str(asked.seed),
        "run": {name: value for name, value in run.items() if name != "controllers"},
        "set": fields,
        **ports,
        "lines": lines,
        "seed": f"{system.name} {asked.seed}",
        "kinds": dict(asked.kinds),
        "beside": list(asked.beside),
    }
    undrawn = set_of(f"{system.name}, seed", described, "--system")
    case_set = drawn_again(undrawn, undrawn.content.seed, undrawn.name, jobs, tell("grid", "cases"))
    return Ground(case_set, place, signal, mode, residue, wait_s, tripped_by)


def ground_text(ground: Ground) -> list[str]:
    """Lines: place, signal and link."""
    aligned = f", a data concentrator waits up to {1e3 * ground.wait_s:.0f} ms" if ground.wait_s else ""
    name = ground.case_set.name.partition(",")[0]
    lines = [f"{name}: {ground.place.label}, controllers receive {ground.signal}{aligned}"]
    if ground.tripped_by:
        text = "even if it does nothing; a profile of your own may allow more"
        lines.append(f"warning: over this link the supervisor trips a controller by `{ground.tripped_by}` {text}")
    return lines


class Placed(NamedTuple):
    """A system with a device and a signal."""

    system: System
    place: Place
    signal: str
    mode: Eigenmode
    residue: complex
    lines: list[str]  # those whose flow swings most in the mode, or near inverters, and whose trip splits nothing


def _placed(asked: OwnGrid, jobs: int, tell: design.Tell) -> Placed:
    """The device and the signal with the largest effect on the mode, among those that are allowed."""
    bare = read_system(asked.system, asked.sets)
    task = design.Task(
        asked.system,
        asked.sets,
        damping=1.0,
        delay=0.0,
        place=asked.place,
        signal=asked.signal,
        profile=asked.profile,
    )
    modes, target = design.listed_modes(task, bare)
    system = places.with_signals(bare, modes, task.channel(bare))
    candidates = places.places(bare, (*places.USUAL, "inverter_input"))
    places.check_place(task.place, candidates)
    if task.place is not None:
        candidates = [candidate for candidate in candidates if task.place in candidate.names]
    elif any(candidate.own for candidate in candidates):
        candidates = [candidate for candidate in candidates if candidate.own][:1]
    if task.signal is not None:
        check_known("--signal", task.signal, list(system.signals))
    usual = task.channel(bare)
    names = [name for name, signal in system.signals.items() if signal.channel == usual or name == task.signal]
    narrow = places.only(system, list(dict.fromkeys([*names, *bare.signals])), bare)
    trials = [places.Trial(narrow, candidate, modes) for candidate in candidates]
    tried = run_all(places.tried, trials, jobs, tell("grid", "places"))
    best, *_ = design.ranked_pairs(task, narrow, tried, modes, target)
    place, wanted = candidates[best.tried], list(dict.fromkeys([*bare.signals, best.signal]))
    meshed = meshed_lines(system, place.at)
    lines = list(dict.fromkeys([*_swinging(system, modes[target], meshed), *_near_inverters(system, meshed)]))
    if not lines:
        raise InputError(f"--system: {system.name} given, where each trip splits the grid; allowed: one with a mesh")
    placed = places.with_place(places.only(system, wanted, bare), place)
    return Placed(placed, place, best.signal, modes[target], best.residue, lines)


def _swinging(system: System, mode: Eigenmode, lines: Sequence[str]) -> list[str]:
    """A quarter of some lines, at least `LINES`: those whose active power swings most in a mode."""
    swing = dict(zip(system.signals, np.abs(places.seen(system, [mode])[0]), strict=True))
    line_of_pmu = {pmu.name: pmu.branches[0] for pmu in system.pmus if len(pmu.branches) == 1}
    flows = {
        line_of_pmu.get(next(iter(signal.weights)), ""): swing[name]
        for name, signal in system.signals.items()
        if signal.channel == places.FLOW and len(signal.weights) == 1
    }
    return sorted(lines, key=lambda line: -flows.get(line, 0.0))[: max(LINES, len(lines) // 4)]


def _near_inverters(system: System, lines: Sequence[str]) -> list[str]:
    """Those of some lines that end at an inverter's bus, or behind a transformer there."""
    at = {inverter.bus for inverter in system.inverters}
    behind = {bus for t in system.transformers if {t.from_bus, t.to_bus} & at for bus in (t.from_bus, t.to_bus)}
    near = [line.name for line in system.lines if {line.from_bus, line.to_bus} & (at | behind)]
    return [name for name in lines if name in near]


def _aligned(run: dict[str, Any], fields: Mapping[str, Any]) -> tuple[dict[str, Any], float, str]:
    """The link, with a concentrator if the supervisor needs one; its wait, s (0: none); a monitor that trips even so.

    Found in calm runs, in which nothing is controlled. The wait is the `ALIGNED` quantile of the time between a frame's
    first and last entry, or, if the supervisor trips with it, the longest time.
    """
    link, wait_s = deepcopy(fields["link"]), 0.0
    record, tripped = _calm(run, {**fields, "link": link})
    case = changed_case(run, "compare", fields)
    watch = None if case.supervision is None else watches(case.supervision).get(MISALIGNED)
    if watch is None or not watch.follows:
        return link, 0.0, ""
    apart = record.supervision["values"][:, list(MONITORS).index(MISALIGNED)]
    if not tripped and not (apart > watch.limit).any():
        return link, 0.0, ""
    spread_s = _spread_s(record, case)
    for wait_s in (_up(float(np.quantile(spread_s, ALIGNED))), _up(float(spread_s.max()))):
        link["up"] = [*fields["link"]["up"], {"stage": "alignment", "model": "wait", "wait": wait_s}]
        _, tripped = _calm(run, {**fields, "link": link})
        if not tripped:
            break
    return link, wait_s, tripped


def _calm(run: dict[str, Any], fields: Mapping[str, Any]) -> tuple[Record, str]:
    """A run without events, and the monitor that trips its controller; empty: none."""
    record = loop.run(changed_case(run, "compare", {**fields, "duration": CALM_S}))
    return record, next((cause for _, _, cause in trips(supervision(record, None))), "")


def _spread_s(record: Record, case: Case) -> NDArray[np.float64]:
    """Time from the first arrival of a frame's entries to the last, s, (frames,); of the PMUs of the signal."""
    weights = case.system.signals[case.controllers[0].signals[0]].weights
    used = [i for i, pmu in enumerate(record.pmus) if pmu in weights]
    rows = record.delivered[np.isin(record.delivered["pmu"], used)]
    measured_ns, frame = np.unique(rows["measured_ns"], return_inverse=True)
    first, last = np.full(len(measured_ns), NEVER), np.zeros(len(measured_ns), np.int64)
    np.minimum.at(first, frame, rows["arrival_ns"])
    np.maximum.at(last, frame, rows["arrival_ns"])
    return np.asarray((last - first) / NANOSECONDS)


def _up(wait_s: float) -> float:
    """A wait, rounded up to `STEP_S`."""
    return float(round(STEP_S * np.ceil(wait_s / STEP_S), 3))
