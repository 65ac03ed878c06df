"""Events of a run in words, and what they leave out of service or released: of a record, and while a run goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from facts_damping.analysis.grid_state import GridState, grid_states, islands, plant_reset_ns
from facts_damping.analysis.run_warnings import FREQUENCY
from facts_damping.control.table import kind_of
from facts_damping.monitor_table import STATES, cause_name
from facts_damping.parameters.link import Link
from facts_damping.record import group_by
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from facts_damping.case.model import Case
    from facts_damping.record import GridEvent, Record, RunChange

Event = dict[str, Any]

LEVELS = {"tripped": "error", "fallback": "warn", "disarmed": "warn"}  # of a supervisor's state; others: info
LONGEST = 160  # characters of a value
REPEATED = ("link", "parameter")  # kinds of changes that a slider makes again and again
CUT = "cut"  # a link over which nothing comes
DRAWN_S = 2.0  # between two changes of one thing that count as one: a slider is drawn
REARM = "re-arm released devices"  # label of the button
PLAINLY = {  # changes by role and kind; None: an event of the grid or of a device tells of it
    ("plant", "event"): None,
    ("plant", "rearm"): None,
    ("plant", "release"): None,
    ("plant", "reset"): "the plant is as at the start, and the scenario begins again",
    ("plant", "pause"): "paused",
    ("plant", "resume"): "goes on",
}


def event(t: float, text: str, level: str = "info", of: str = "") -> Event:
    """An event as the page gets it; `of`: what changed, if a newer value soon replaces this one."""
    return {"type": "event", "t": round(float(t), 3), "level": level, "text": text, **({"of": of} if of else {})}


def replaces(new: Mapping[str, Any], last: Mapping[str, Any]) -> bool:
    """Whether an event is the newer value of the same thing while a slider is drawn, and takes the line of the last."""
    return bool(new.get("of")) and new.get("of") == last.get("of") and 0.0 <= new["t"] - last["t"] < DRAWN_S


def grid_event(kind: str, element: str, value: float) -> str:
    """An event of the grid."""
    much = "" if np.isnan(value) else f", {value:g}"
    return f"{kind.replace('_', ' ')}: {element}{much}"


def link(run: Link, content: Any) -> str:
    """What a link has beyond that of the run; all of its stages if it is another."""
    try:
        now, before = Link.model_validate(content).model_dump(), run.model_dump()
    except ValidationError:
        return f"another link: {content}"
    added = {way: now[way][len(before[way]) :] for way in ("up", "down")}
    if any(now[way] != before[way] + stages for way, stages in added.items()):
        ways = (f"{way} {' + '.join(map(_stage, now[way])) or 'no delay'}" for way in added)
        return f"another link: {'; '.join(ways)}"
    cut = {"model": "bernoulli", "loss": 1.0, "channels": None}
    losing = {way: [stage for stage in stages if cut.items() <= stage.items()] for way, stages in added.items()}
    texts = [CUT] if all(losing.values()) else []
    for way, stages in added.items():
        for stage in stages:
            if CUT not in texts or stage not in losing[way]:
                on = ", ".join(stage["channels"] or ["down"] * (way == "down"))
                texts.append(f"{_added(stage)}{f' ({on})' if on else ''}")
    return ", ".join(texts) or "link as in the run again"


def _added(stage: Mapping[str, Any]) -> str:
    if stage["model"] == "constant":
        return f"added delay {1e3 * stage['delay']:g} ms"
    if stage["model"] == "uniform":
        low, width = 1e3 * stage["low"], 1e3 * (stage["high"] - stage["low"])
        return f"{f'added delay {low:g} ms, ' if low else ''}added jitter {width:g} ms"
    return f"loss {100 * stage['loss']:g} %" if stage["model"] == "bernoulli" else f"added {_stage(stage)}"


def _stage(stage: Mapping[str, Any]) -> str:
    numbers = {k: v for k, v in stage.items() if isinstance(v, (int, float)) and k != "start"}
    return " ".join([str(stage.get("model")), *(f"{k} {v:g}" for k, v in numbers.items())])


def _unit(case: Case, change: RunChange) -> str:
    """Unit of the parameter that a change sets; empty: none, or unknown."""
    if change.role in ("controller", "identifier"):
        table = kind_of(case.controllers[change.index]).parameters
        return table[change.name].unit if change.name in table else ""
    model: Any = case.links[change.index] if change.role == "link" else case.measurement
    *path, name = change.name.split(".")
    for part in path:
        rows = isinstance(model, (list, dict))
        model = model[int(part) if isinstance(model, list) else part] if rows else getattr(model, part)
    field = getattr(type(model), "model_fields", {}).get(name)
    extra = field.json_schema_extra if field is not None else None
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


def change(case: Case, run_change: RunChange) -> str | None:
    """A change during a run; None: an event of the grid or of a device tells of it."""
    text = PLAINLY.get((run_change.role, run_change.kind), "")
    if text is None:
        return None
    value = run_change.value
    if run_change.kind == "link" and run_change.index < len(case.links):
        text = link(case.links[run_change.index], value)
    elif run_change.kind == "parameter":
        try:
            unit = _unit(case, run_change)
        except (LookupError, AttributeError, ValueError):  # of another program
            unit = ""
        number = f"{value:g}" if isinstance(value, float) else str(value)
        text = f"{run_change.name} is {number}{f' {unit}' if unit not in ('', '-') else ''} now"
    text = text or " ".join(str(part) for part in (run_change.kind, run_change.name, value) if part not in ("", None))
    return f"{run_change.node.lstrip('/')}: {text if len(text) <= LONGEST else f'{text[:LONGEST]}...'}"


def supervisor(controller: str, state: str, cause: str) -> str:
    """A new state of a supervisor."""
    return f"{controller}: {state}{f', {cause}' if cause else ''}"


class Story:
    """The events of a run as the page shows them, as they come, and what they leave out, released or dead."""

    def __init__(self, case: Case) -> None:
        self._case, self._system = case, case.system.model_dump(by_alias=True)
        self._events: list[GridEvent] = []
        self._resets: list[int] = []
        self.grid = GridState()
        self._whole = self._parts = islands(self._system, self.grid.lines_out)
        self.released: tuple[str, ...] = ()
        self.states = dict[str, str]()  # of supervisors, by controller
        self.dead: set[str] = set()
        self._frequencies = self._forced = ""

    def on_event(self, grid_change: GridEvent) -> list[Event]:
        """An event of the grid."""
        self._events.append(grid_change)
        text = grid_event(grid_change.kind, grid_change.element, grid_change.value)
        return [event(grid_change.time_ns / NANOSECONDS, text, "warn"), *self._topology(grid_change.time_ns)]

    def on_change(self, run_change: RunChange) -> list[Event]:
        """A change; only a reset of the plant itself changes what is in service."""
        rate = self._case.run.frame_rate
        text, events = change(self._case, run_change), list[Event]()
        if text is not None:
            level, of = "info", ""
            if run_change.kind in REPEATED:
                level = "warn" if text.partition(": ")[2].startswith(CUT) else "info"
                of = f"{run_change.node} {run_change.name} {level}"
            events = [event(run_change.tick / rate, text, level, of)]
        reset_ns = plant_reset_ns(run_change, rate)
        if reset_ns is not None:
            self._resets.append(reset_ns)
            events += self._topology(reset_ns)
        return events

    def _topology(self, time_ns: int) -> list[Event]:
        self.grid, before = grid_states(self._events, self._resets)[-1], self._parts
        self._parts = islands(self._system, self.grid.lines_out)
        if len(self._parts) > len(before):
            text = f"the grid has split: {'; '.join(', '.join(part) for part in self._parts)}"
            return [event(time_ns / NANOSECONDS, text, "error")]
        joined = len(self._parts) < len(before)
        return [event(time_ns / NANOSECONDS, "parts of the grid are connected again")] if joined else []

    def on_supervision(self, t: float, controller: str, state: str, cause: str) -> list[Event]:
        """The state of a supervisor; only a new one is an event."""
        if self.states.get(controller) == state:
            return []
        self.states[controller] = state
        return [event(t, supervisor(controller, state, cause), LEVELS.get(state, "info"))]

    def on_devices(self, t: float, released: Iterable[str]) -> list[Event]:
        """Names of the devices that their watchdogs have released now."""
        now, before = tuple(released), self.released
        self.released = now
        good = getattr(self._case.run.watchdog, "good", 0)
        until = f'"{REARM}" is pressed{f", or {good} good setpoints come" if good else ""}'
        text = f"is released: it takes no setpoints until {until}"
        events = [event(t, f"{name} {text}", "warn") for name in now if name not in before]
        return events + [event(t, f"{name} takes setpoints again") for name in before if name not in now]

    def on_nodes(self, t: float, dead: Iterable[str]) -> list[Event]:
        """Names of the nodes that are dead now."""
        now, before = set(dead), self.dead
        self.dead = now
        events = [event(t, f"{name} is dead: nothing comes from it", "error") for name in sorted(now - before)]
        return events + [event(t, f"{name} is alive again") for name in sorted(before - now)]

    def on_frequencies(self, t: float, at: Mapping[str, float]) -> list[Event]:
        """Frequencies of buses, Hz; an event if they part, or leave the range in which the model holds."""
        known = {name: value for name, value in at.items() if np.isfinite(value)}
        before, self._frequencies = self._frequencies, ""
        if known:
            low, high = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
            nominal = self._case.system.frequency
            ends = known[low], known[high]
            if ends[1] - ends[0] > FREQUENCY or max(abs(value - nominal) for value in ends) > FREQUENCY:
                self._frequencies = f"{ends[0]:.1f} Hz at {low}, {ends[1]:.1f} Hz at {high}"
        return [event(t, f"frequencies: {self._frequencies}", "error")] if self._frequencies and not before else []

    def on_forced(self, t: float, text: str) -> list[Event]:
        """A forced oscillation in words; empty: there is none any more, or it cannot be told."""
        before, self._forced = self._forced, text
        return [event(t, f"forced oscillation: {text}", "warn")] if text and not before else []

    def shown(self) -> dict[str, list[str]]:
        """Names of the branches out of service, and of the released devices."""
        return {"out": sorted(self.grid.lines_out), "released": sorted(self.released)}

    def wrong(self) -> list[str]:
        """What is not well with the run now; empty: it is well."""
        split = len(self._parts) > len(self._whole)
        tripped = [f"{name} {state}" for name, state in self.states.items() if LEVELS.get(state) == "error"]
        return [
            *(["the grid has split"] if split else []),
            *([self._frequencies] if self._frequencies else []),
            *(["forced oscillation"] if self._forced else []),
            *(f"{name} dead" for name in sorted(self.dead)),
            *(f"{name} released" for name in self.released),
            *tripped,
        ]


def of_record(case: Case, record: Record) -> list[Event]:
    """All events of a record by time, each with what is out of service and released from then on."""
    story, rate, log = Story(case), record.frame_rate, list[Event]()
    steps: list[tuple[int, int, Callable[[], list[Event]]]] = []  # time, order at that time, what happens

    def add(time_ns: int, order: int, take: Callable[..., list[Event]], *arguments: Any) -> None:
        steps.append((int(time_ns), order, lambda: take(*arguments)))

    for run_change in record.changes:
        add(run_change.tick * NANOSECONDS // rate, 0, story.on_change, run_change)
    for grid_change in record.events:
        add(grid_change.time_ns, 1, story.on_event, grid_change)
    flags = record.devices["released"] == 1.0
    for k in np.flatnonzero(np.any(np.diff(flags, axis=0, prepend=False), axis=1)):
        names = [name for name, on in zip(record.device_names, flags[k], strict=True) if on]
        add(record.time_ns[k], 2, story.on_devices, record.time_s[k], names)
    for (c,), statuses in group_by(record.supervision, "controller"):
        for row in statuses[np.flatnonzero(np.diff(statuses["state"], prepend=-1))]:
            what = record.controller_names[c], STATES[int(row["state"])], cause_name(int(row["cause"]))
            add(row["tick"] * NANOSECONDS // rate, 3, story.on_supervision, row["tick"] / rate, *what)
    for _, _, happens in sorted(steps, key=lambda step: step[:2]):
        for new in happens():
            if log and replaces(new, log[-1]):
                log.pop()
            log.append(new | story.shown())
    return log
