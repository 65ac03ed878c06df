"""What a controller of the user's own is told of the run that it is made for."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.small_signal import linear_plant, modal_analysis

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System


@dataclass(frozen=True)
class Spec:
    """What a controller of the user's own is made for.

    `limits`: (devices,), p.u., of setpoints; `rates`: (devices,), p.u./s, at which the devices follow; `frame_rate`:
    frames/s; `seed`: of its own randomness, made of the run's and its place; `parameters`: as the run gives them.
    """

    name: str
    signals: list[str]
    devices: list[str]
    limits: NDArray[np.float64]
    rates: NDArray[np.float64]
    frame_rate: int
    seed: int
    parameters: dict[str, Any]
    system: System = field(repr=False)
    installed: list[str] = field(repr=False)  # devices of the run, those of other controllers too

    @cached_property
    def plant(self) -> linear_plant.LinearPlant:
        """The linearised plant at the start, of all signals and installed devices (docs/own_linear.md)."""
        return linear_plant.of(modal_analysis.analyse(self.system, self.installed))


def spec_of(case: Case, c: int) -> Spec:
    """What controller c is made for."""
    controller = case.controllers[c]
    own = [case.system.device(name) for name in controller.devices]
    return Spec(
        controller.name,
        list(controller.signals),
        list(controller.devices),
        np.array([device.setpoint_max for device in own]),
        np.array([device.rate_max for device in own]),
        case.run.frame_rate,
        int(np.random.SeedSequence([case.run.seed, c]).generate_state(1)[0]),
        dict(controller.parameters),
        case.system,
        list(case.run.devices),
    )
