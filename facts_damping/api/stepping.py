"""A closed loop by hand, a tick at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.api.cases import case_of, short_traceback
from facts_damping.api.results import Result, of
from facts_damping.case.names import label
from facts_damping.errors import InputError
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation import loop
from facts_damping.simulation.stepping import Stepper

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import ArrayLike


class Simulation:
    """A run that is stepped by hand: `while sim.step(): ...`, or with setpoints of one's own, `sim.step(u)`.

    It begins with the first tick measured, and what its links have delivered in it. `run`, `fields`: as of `simulate`.
    """

    @short_traceback
    def __init__(self, run: str | PathLike[str] | None = None, **fields: Any) -> None:
        """Build it. Raises `InputError`."""
        self._case = case_of(run, fields)
        self._stepper = Stepper(self._case, loop.build_loop(self._case))

    @property
    def tick(self) -> int:
        """The tick that was measured last."""
        return self._stepper.tick

    @property
    def time_s(self) -> float:
        """Its time, s."""
        return float(self._stepper.loop.signals.time_ns[self.tick]) / NANOSECONDS

    @property
    def devices(self) -> list[str]:
        """The devices that setpoints are for, in the order of `step`: those of all controllers, one after the other.

        A fallback has those of another controller, and speaks for itself.
        """
        return [name for row in self._case.controllers if row.fallback_of is None for name in row.devices]

    @property
    def signals(self) -> dict[str, float]:
        """What the links have delivered of the controllers' signals by now, p.u.; NaN before the first frame."""
        return {name: float(signal.y) for name, signal in self._stepper.delivered().items()}

    @property
    def ages_s(self) -> dict[str, float]:
        """How old these are, s."""
        return {name: float(signal.age_s) for name, signal in self._stepper.delivered().items()}

    @property
    def state(self) -> dict[str, float]:
        """Everything at this tick, named as in `arrays` of a result: what PMUs report, and the truth."""
        part = loop.record(self._case, self._stepper.loop)
        last = replace(
            part,
            **{name: getattr(part, name)[-1:] for name in ("time_ns", "frames", "measured_ns", "status")},
            **{name: getattr(part, name)[-1:] for name in ("machines", "devices", "in_synchronism")},
        )
        return {name: float(values[0]) for name, values in last.arrays.items()}

    @short_traceback
    def step(self, u: ArrayLike | None = None) -> bool:
        """Go on to the next tick; False: there is none, as the run is over or the plant has lost synchronism.

        `u`: setpoints of `devices`, p.u., which are issued in the place of the controllers' at the last arrival of this
        tick, if something has arrived; None: the controllers act. Raises `InputError` for a wrong shape, `RunError`
        where a controller of the user's own fails.
        """
        setpoints = None if u is None else np.atleast_1d(np.asarray(u, np.float64))
        if setpoints is not None and setpoints.shape != (len(self.devices),):
            allowed = f"({len(self.devices)},): {', '.join(self.devices)}"
            raise InputError(f"u: shape {setpoints.shape} given; allowed: {allowed}")
        return self._stepper.step(setpoints)

    def record(self) -> Result:
        """What there is so far."""
        return of(loop.record(self._case, self._stepper.loop))

    def __repr__(self) -> str:
        """In a line."""
        name = label(self._case.summary())
        return f"<Simulation {name}: tick {self.tick} of {self._case.ticks}, {self.time_s:.3f} s>"
