"""The plant as its node uses it: advanced tick by tick with the received setpoints, and changed during the run."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.link.transfer import merge
from facts_damping.nodes import clock
from facts_damping.plant.model import fitted
from facts_damping.plant.watchdog import initial_clock_state, late_by_clock, let_go, rearm
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT
from facts_damping.simulation.assembly import build_plant, build_pmus, grid_events
from facts_damping.simulation.changes import measured_otherwise, pending, reset_plant, with_event
from facts_damping.simulation.measured_plant import (
    advance_with_pmus,
    entries,
    measure_with_pmus,
    tick_ns,
    with_pmus,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.plant.model import Plant, PlantState
    from facts_damping.record import GridEvent


class LivePlant:
    """State of a plant, which starts at equilibrium, its latest measurement, and its events."""

    def __init__(self, case: Case, draws: int = 0) -> None:
        """`draws`: as for `build_pmus`."""
        self._begun = self._case = case  # case at the start; case with the changes made during the run
        self.tick = -1  # current tick
        built = build_plant(case)
        self._measured = with_pmus(built.plant, built.state, *build_pmus(case, draws))
        self.frame = np.zeros((len(case.system.pmus), len(CHANNELS)))
        self.measured_ns, self.status = (np.zeros(len(self.frame), np.int64) for _ in range(2))
        self.machines = np.zeros(len(built.plant.machines), MACHINE_TRUTH)
        self.devices = np.zeros(len(built.plant.devices), DEVICE_TRUTH)
        self.events, self.sound = grid_events(case), True
        self._accepted = initial_clock_state(len(self.devices))

    @property
    def state(self) -> PlantState:
        """The plant's state."""
        return self._measured.plant_state

    def start(self, tick: int) -> int:
        """Start of a tick, ns."""
        return tick_ns(tick, self._case.run.frame_rate)

    def measure(self, tick: int) -> None:
        """Begin a tick: compute PMU reports and truth; `sound` is false once synchronism is lost."""
        self.tick = tick
        results = self.frame, self.measured_ns, self.status, self.machines, self.devices
        self.sound = bool(measure_with_pmus(self._measured, tick, *results))

    def entries(self) -> NDArray[Any]:
        """PMU reports of the current tick (DELIVERY)."""
        return entries(self.start(self.tick), self.frame, self.measured_ns, self.status)

    def due(self) -> list[GridEvent]:
        """Grid events that have happened and were not returned before."""
        count = sum(event.time_ns <= self.start(self.tick) for event in self.events)
        due, self.events = self.events[:count], self.events[count:]
        return due

    def advance(self, received: Sequence[NDArray[Any]]) -> None:
        """Advance to the next tick with the received setpoints (SETPOINT), whatever the order of the links."""
        table, count = np.zeros(sum(map(len, received)), SETPOINT), 0
        for rows in received:
            count = merge(table, count, rows, len(rows))
        advance_with_pmus(self._measured, self.tick, table, count)

    def change_measurement(self, name: str, value: float) -> Callable[[int], None]:
        """Prepare a change of a measurement's number, such as `noise.angle`. Returns the function that applies it.

        Raises `InputError` for a value that is not allowed.
        """
        pmus, self._case = measured_otherwise(self._case, name, value, self._measured.pmus)

        def act(_tick: int) -> None:
            self._measured.pmus = pmus

        return act

    def _exchange(self, plant: Plant, state: PlantState) -> None:
        self._measured = with_pmus(plant, state, self._measured.pmus, self._measured.pmu_state)

    def ask_event(self, text: str) -> Callable[[int], None]:
        """Prepare an event at the next tick, after those requested before. Returns the function that applies it.

        Raises `InputError` if the event cannot happen then.
        """
        changed = with_event(self._case, text, self.start(self.tick + 1))
        plant, self._case = build_plant(changed).plant, changed

        def act(tick: int) -> None:
            self._exchange(plant, fitted(self.state, plant))
            self.events = pending(changed, self.events, self.start(tick))

        return act

    def ask_reset(self) -> Callable[[int], None]:
        """Prepare a reset at the next tick: equilibrium, and the scenario from its start. Returns what applies it."""
        built, changed = reset_plant(self._begun, self.start(self.tick + 1))
        self._case = replace(self._case, scenario=changed.scenario)

        def act(tick: int) -> None:
            self._exchange(built.plant, built.state)
            self.events = pending(changed, self.events, self.start(tick))
            self._accepted = initial_clock_state(len(self.devices))

        return act

    def released(self) -> list[str]:
        """Names of the released devices."""
        return [name for d, name in enumerate(self._case.run.devices) if self.state.watch["released"][d]]

    def rearm(self, tick: int) -> None:
        """Let all released devices take setpoints again from the start of a tick."""
        rearm(self.state.watch, self.start(tick))

    def late(self) -> list[tuple[str, Callable[[int], None]]]:
        """Devices that have accepted no setpoint for the time-out in wall time, and the function that releases each."""
        watchdog = self._case.run.watchdog
        if watchdog is None:
            return []
        silent = late_by_clock(self.state.watch, self._accepted, clock.monotonic(), watchdog.timeout)
        return [(self._case.run.devices[d], partial(self._let_go, d)) for d in silent]

    def _let_go(self, device: int, _tick: int) -> None:
        let_go(self.state.watch, device)

    def excuse(self, seconds: float) -> None:
        """Exclude the wall time of a pause from the time-outs."""
        self._accepted["at_s"] += seconds
