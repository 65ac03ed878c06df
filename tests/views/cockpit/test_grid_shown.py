"""What the page and the warnings say of the grid is what the plant has, after any events, changes and resets."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.analysis.grid_state import islands
from facts_damping.analysis.run_warnings import limit_warnings
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.monitor_table import COMMANDS
from facts_damping.plant.events import topology_intervals
from facts_damping.record import Record, RunChange
from facts_damping.simulation import changes as of_runs
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import grid_events
from facts_damping.simulation.changes import pending, rerun, reset_plant
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping_views.cockpit import words

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.plant.events import TopologyInterval
    from facts_damping.record import GridEvent

RATE = 60
TICKS = 40
FOREIGN = [  # changes that are not the plant's, among them each supervisor's command
    *(("supervisor", kind, None) for kind in COMMANDS),
    ("link", "reset", None),
    ("controller", "reset", None),
    ("plant", "pause", None),
    ("plant", "rearm", None),
]


def drawn_event(draw: random.Random, case: Case) -> dict[str, Any]:
    """An event of any kind; it need not be possible."""
    system = case.system
    branches = [row.name for row in system.lines] + [row.name for row in system.transformers]
    bus, line = draw.choice(system.buses).name, draw.choice(system.lines).name
    place = draw.choice([{"bus": bus}, {"line": line}])
    kind = draw.choice(
        ["line_out", "line_out", "line_out", "line_in", "line_in", "fault", "clear", "brake", "load", "trip"]
    )
    rows: dict[str, dict[str, Any]] = {
        "fault": {"kind": "fault", **place, **draw.choice([{}, {"duration": 0.05}])},
        "clear": {"kind": "clear", **place},
        "brake": {"kind": "brake", "bus": bus, "power": 100.0, "duration": 0.1},
        "load": {"kind": "load_step", "load": draw.choice(system.loads).name, "change": 0.1},
        "trip": {"kind": "generator_trip", "machine": draw.choice(system.machines).name},
    }
    return rows.get(kind, {"kind": kind, "line": draw.choice(branches)})


class DrawnRun:
    """Random events, changes and resets of a plant without its equations: what it publishes, and its topology."""

    def __init__(self, case: Case, seed: int) -> None:
        self.start = self.now = case
        self.draw = random.Random(seed)
        self.changes: list[RunChange] = []
        self.passed: list[GridEvent] = []
        self.due = grid_events(case)
        self.topologies: list[TopologyInterval] = []  # of each tick
        self.listed: list[TopologyInterval] = []
        self.listed_of: Case | None = None  # the case of `listed`

    def tick(self, tick: int) -> list[RunChange | GridEvent]:
        """Changes at a tick, then what the plant publishes."""
        at, messages = tick_ns(tick, RATE), list[Any]()
        while self.draw.random() < 0.25:
            for change in self.change(tick, at):
                self.due = pending(self.now, self.due, at)
                messages.append(change)
        self.changes += messages
        happen = [event for event in self.due if event.time_ns <= at]
        self.due = self.due[len(happen) :]
        self.passed += happen
        if self.now is not self.listed_of:
            self.listed_of, self.listed = self.now, topology_intervals(self.now.system, self.now.scenario.events)
        self.topologies.append([interval for interval in self.listed if interval.start_ns <= at][-1])
        return [*messages, *happen]

    def change(self, tick: int, at: int) -> list[RunChange]:
        """A change that the nodes accept: it acts. One that they refuse is none."""
        if self.draw.random() < 0.2:
            _, self.now = reset_plant(self.start, at)
            return [RunChange(tick, "/plant_sim", "plant", 0, "reset", "", None)]
        if self.draw.random() < 0.3:
            role, kind, value = self.draw.choice(FOREIGN)
            return [RunChange(tick, f"/{role}", role, 0, kind, "", value)]
        event = {"time": at / 1e9, **drawn_event(self.draw, self.now)}
        try:
            content = self.now.scenario.model_dump()["events"]
            listed = type(self.now.scenario).model_validate({"name": "drawn", "events": [*content, event]})
            topology_intervals(self.now.system, listed.events)
        except InputError:
            return []
        self.now = replace(self.now, scenario=listed)
        return [RunChange(tick, "/plant_sim", "plant", 0, "event", "", json.dumps(event))]


@pytest.mark.parametrize(
    ("name", "line", "sequences"), [("two_area_deployment", "line_3", 40), ("new_england_39_fault", "line_16_17", 10)]
)
def test_page_shows_the_topology_of_the_plant_after_every_message(
    name: str, line: str, sequences: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Live, the messages of two topics come in any order within a tick; a recording is read by time."""
    monkeypatch.setattr(of_runs, "build_plant", lambda _: None)
    fault = f"{{time: 0.1, kind: fault, line: {line}}}, {{time: 0.2, kind: line_out, line: {line}}}"
    case = load_case(name, ["load_noise=null", f"scenario=[{fault}]"])
    system = case.system.model_dump(by_alias=True)
    splits = outages = 0
    for seed in range(sequences):
        run, story = DrawnRun(case, seed), words.Story(case)
        for tick in range(TICKS):
            messages = run.tick(tick)
            run.draw.shuffle(order := [isinstance(message, RunChange) for message in messages])
            topics = {of: iter([m for m in messages if isinstance(m, RunChange) is of]) for of in (True, False)}
            for of in order:  # each topic keeps its order
                message = next(topics[of])
                lines = story.on_change(message) if isinstance(message, RunChange) else story.on_event(message)
                assert all(row["text"] for row in lines)
            plant = run.topologies[-1]
            assert story.shown()["out"] == sorted(plant.topology.lines_out), (seed, tick)
            buses = {bus.name: plant.islands[bus.name] for bus in case.system.buses}
            parts = [[bus for bus in buses if buses[bus] == number] for number in dict.fromkeys(buses.values())]
            assert sorted(islands(system, plant.topology.lines_out)) == sorted(parts)
            assert ("the grid has split" in story.wrong()) == (len(parts) > 1)
            splits, outages = splits + (len(parts) > 1), outages + bool(plant.topology.lines_out)
            assert story.grid.machines_out == plant.topology.machines_out
            burning = {place.bus or place.line for place in plant.topology.faults}
            assert story.grid.faults == burning - plant.topology.lines_out
    assert splits > 5
    assert outages > 50


def test_islands_that_are_warned_of_are_the_plants() -> None:
    """The same read from records: the log of a replay, and the warnings."""
    case = load_case("two_area_deployment", ["duration=1", "load_noise=null", "scenario=[]", "watchdog=null"])
    empty = loop.run(case)
    splits = 0
    for seed in range(12):
        run = DrawnRun(case, seed)
        for tick in range(TICKS):
            run.tick(tick)
        record = replace(empty, events=run.passed, changes=run.changes)
        numbers = [len(set(interval.islands.values())) for interval in run.topologies]
        later = [tick for tick in range(1, TICKS) if numbers[tick] > numbers[tick - 1]]
        warned = [line for line in limit_warnings(record) if line.startswith("the grid has split")]
        assert len(warned) >= len(later)
        assert bool(warned) == bool(later) or numbers[0] > 1
        splits += len(later)
        check_log(case, record, run)
    assert splits > 3


def check_log(case: Case, record: Record, run: DrawnRun) -> None:
    """The state that the log of a replay has at each tick is the plant's."""
    log = words.of_record(case, record)
    for tick, interval in enumerate(run.topologies):
        shown = [row for row in log if row["t"] <= round(tick / RATE, 3)]
        assert (shown[-1]["out"] if shown else []) == sorted(interval.topology.lines_out)


def test_line_that_trips_again_after_a_reset_splits_nothing() -> None:
    """The tie keeps one line: line_4 is back by the reset when line_3 trips again. A supervisor resets no line."""
    case = load_case("two_area_deployment", ["duration=6", "load_noise=null"])
    asked = [
        RunChange(150, "/plant_sim", "plant", 0, "reset", "", None),
        RunChange(160, "/plant_sim", "plant", 0, "event", "", "{kind: line_out, line: line_4}"),
        RunChange(170, "/supervisor", "supervisor", 0, "reset", "", None),
        RunChange(200, "/plant_sim", "plant", 0, "reset", "", None),
    ]
    record = rerun(case, asked)
    assert not [line for line in limit_warnings(record) if "split" in line]
    outs = {round(row["t"] * RATE): row["out"] for row in words.of_record(case, record)}
    assert [outs[tick] for tick in (126, 150, 160, 170, 200)] == [["line_3"], [], ["line_4"], ["line_4"], []]
