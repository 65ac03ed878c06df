"""The plant as its node has it: goes on tick by tick, under the setpoints that come, and is changed under way."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.link.transfer import merge
from facts_damping.plant.model import workspace
from facts_damping.plant.watchdog import initial_clock_state, late_by_clock, let_go, rearm
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT
from facts_damping.simulation.build import build_plant, build_pmus, grid_events
from facts_damping.simulation.changes import measured_otherwise, pending, reset_plant, with_event
from facts_damping.simulation.measured_plant import advance_with_pmus, entries, measure_with_pmus, tick_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case

DRAWS = 36_000  # frames after which the noise of a graph without end repeats itself: ten minutes


class LivePlant:
    """State of a plant, what was measured last, and its events."""

    def __init__(self, case: Case) -> None:
        """Build it, at its equilibrium, and compile what it needs."""
        self._begun = self._case = case  # as the run began; with the events that were asked for under way
        self.tick = -1  # the tick that is going on
        built = build_plant(case)
        self._plant, self.state = built.plant, built.state
        self._work = workspace(self._plant, self.state)
        self._pmus, self._pmu_state = build_pmus(case, DRAWS)
        self.frame = np.zeros((len(case.system.stations), len(CHANNELS)))
        self.measured_ns, self.status = (np.zeros(len(self.frame), np.int64) for _ in range(2))
        self.machines = np.zeros(len(self._plant.machines), MACHINE_TRUTH)
        self.devices = np.zeros(len(self._plant.devices), DEVICE_TRUTH)
        self.events, self.sound = grid_events(case), True
        self._heard = initial_clock_state(len(self.devices))

    def _parts(self) -> tuple[Any, ...]:
        return self._plant, self.state, self._pmus, self._pmu_state

    def _measured(self) -> tuple[Any, ...]:
        return self.frame, self.measured_ns, self.status, self.machines, self.devices, self._work

    def start(self, tick: int) -> int:
        """When a tick begins, ns."""
        return tick_ns(tick, self._case.run.frame_rate)

    def measure(self, tick: int) -> None:
        """Begin a tick: what PMUs report, and the truth; `sound` says whether there is synchronism."""
        self.tick = tick
        self.sound = bool(measure_with_pmus(*self._parts(), tick, *self._measured()))

    def entries(self) -> NDArray[Any]:
        """What PMUs report in the tick (DELIVERY)."""
        return entries(self.start(self.tick), self.frame, self.measured_ns, self.status)

    def due(self) -> list[dict[str, Any]]:
        """The events of the grid that have happened by now, and were not told yet."""
        count = sum(event["time_ns"] <= self.start(self.tick) for event in self.events)
        told, self.events = self.events[:count], self.events[count:]
        return told

    def advance(self, come: Sequence[NDArray[Any]]) -> None:
        """Go on to the next tick under the setpoints that have come, whichever link's came first."""
        table, count = np.zeros(sum(map(len, come)), SETPOINT), 0
        for rows in come:
            count = merge(table, count, rows, len(rows))
        advance_with_pmus(*self._parts(), self.tick, table, count, self._work)

    def change_measurement(self, name: str, value: float) -> Callable[[int], None]:
        """What has PMUs measure with a number changed, `noise.angle`, from the next tick on.

        Raises `InputError` for a value that is not allowed.
        """
        pmus, self._case = measured_otherwise(self._case, name, value, self._pmus)

        def act(_tick: int) -> None:
            self._pmus = pmus

        return act

    def ask_event(self, text: str) -> Callable[[int], None]:
        """What has an event happen at the next tick, after what was asked for before.

        Raises `InputError` where it cannot happen then.
        """
        asked = with_event(self._case, text, self.start(self.tick + 1))
        plant, self._case = build_plant(asked).plant, asked

        def act(tick: int) -> None:
            self._plant, self.events = plant, pending(asked, self.events, self.start(tick))

        return act

    def ask_reset(self) -> Callable[[int], None]:
        """What has the plant begin again at the next tick: at its equilibrium, with the scenario from there on."""
        built, asked = reset_plant(self._begun, self.start(self.tick + 1))
        self._case = replace(self._case, scenario=asked.scenario)

        def act(tick: int) -> None:
            self._plant, self.state = built.plant, built.state
            self.events = pending(asked, self.events, self.start(tick))
            self._heard = initial_clock_state(len(self.devices))

        return act

    def released(self) -> list[str]:
        """The devices that are released."""
        return [name for d, name in enumerate(self._case.run.devices) if self.state.watch["released"][d]]

    def rearm(self, tick: int) -> None:
        """Have all released devices take setpoints again, from the start of a tick."""
        rearm(self.state.watch, self.start(tick))

    def late(self) -> list[tuple[str, Callable[[int], None]]]:
        """Devices that have accepted nothing for a time-out by the wall clock, too, and what releases each."""
        watchdog = self._case.run.watchdog
        if watchdog is None:
            return []
        found = late_by_clock(self.state.watch, self._heard, time.monotonic(), watchdog.timeout)
        return [(self._case.run.devices[d], partial(self._let_go, d)) for d in found]

    def _let_go(self, device: int, _tick: int) -> None:
        let_go(self.state.watch, device)

    def excuse(self, seconds: float) -> None:
        """Have the wall time of a pause count for no time-out."""
        self._heard["at_s"] += seconds
