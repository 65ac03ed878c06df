"""A loop stepped from outside: it pauses in each tick between delivery and control."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.control.called import sense, sensed
from facts_damping.control.inputs import inputs
from facts_damping.control.table import GIVEN
from facts_damping.link.transfer import RING_DELIVERED
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.programs.policies import check
from facts_damping.simulation.restarts import Restarts
from facts_damping.simulation.tick import run_half_ticks

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.simulation.tick import Loop


class Delivered(NamedTuple):
    """A signal as delivered by the link."""

    y: float  # p.u.; NaN: none yet
    age_s: float  # age of the signal's newest frame


class Stepper:
    """A loop paused in `tick`: measured and delivered, but control has not acted yet."""

    def __init__(self, case: Case, loop: Loop) -> None:
        """Measure the first tick of a loop at its start."""
        self.loop, self.tick, self._case = loop, -1, case
        self._goes_on, self._own = True, loop.control.bank.code.copy()
        names = [list(controller.signals) for controller in case.controllers]
        pmus = [pmu.name for pmu in case.system.pmus]
        self._names, maximum = names, max(map(len, names), default=0)
        self._eyes = (*inputs(names, case.system.signals, pmus, case.system.frequency),)
        self._sensed = sensed(len(names), maximum, len(pmus))
        self._restarts = Restarts(loop.control.bank, loop.control.bank_state)
        self.step(None)

    def step(self, asked: NDArray[np.float64] | None) -> bool:
        """Go to the next tick; returns False at the end. `asked`: setpoints of all controllers' devices in order, p.u.

        They replace the controllers' own. Fallbacks, which share the devices of other controllers, keep theirs.
        """
        if not self._goes_on:
            return False
        bank, state = self.loop.control.bank, self.loop.control.bank_state
        if asked is not None:
            at = 0
            for c, controller in enumerate(self._case.controllers):
                if controller.fallback_of is not None:
                    continue
                bank.code[c] = GIVEN
                state.unlimited[c, : len(controller.devices)] = asked[at : at + len(controller.devices)]
                at += len(controller.devices)
        self._restarts.begin(self.tick)
        here = 2 * self.tick + 1  # half ticks: runs the second of this tick and the first of the next
        last = 2 * self._case.ticks
        self._goes_on = bool(run_half_ticks(self.loop, max(0, here), min(here + 2, last))) and here + 2 <= last
        bank.code[:] = self._own
        check(self.loop.programs)
        if self._goes_on:
            self.tick += 1
            self._look()
        return self._goes_on

    def _look(self) -> None:
        """Process the entries that the links delivered in this tick."""
        up, end_ns = self.loop.links.up, tick_ns(self.tick + 1, self._case.run.frame_rate)
        for c, link in enumerate(self._case.used_links):
            sense(*self._eyes, self._sensed, c, up.out[link], up.ring[link, RING_DELIVERED], end_ns)

    def delivered(self) -> dict[str, Delivered]:
        """The signals of all controllers by name; a signal used by several is taken from the first."""
        signals: dict[str, Delivered] = {}
        for c, names in enumerate(self._names):
            for i, name in enumerate(names):
                signals.setdefault(name, Delivered(self._eyes[1].signal[c, i], self._sensed.age[c, i]))
        return signals
