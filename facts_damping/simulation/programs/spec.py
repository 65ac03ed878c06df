"""The description of the run that a user's own controller receives."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.small_signal import linear_plant, modal_tables

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System


@dataclass(frozen=True)
class Spec:
    """Signals, devices and settings of a user's own controller.

    `limits`: setpoint limits, (devices,), p.u.; `rates`: rate limits of the devices, (devices,), p.u./s; `frame_rate`:
    frames/s; `seed`: for its random numbers, from the run's seed and its index; `parameters`: as given in the run.
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
    installed: list[str] = field(repr=False)  # all devices of the run

    @cached_property
    def plant(self) -> linear_plant.LinearPlant:
        """The linearised plant at the start, with all signals and installed devices (docs/own_controllers.md)."""
        return linear_plant.of(modal_tables.analyse(self.system, self.installed))


def spec_of(case: Case, c: int) -> Spec:
    """The spec of controller c."""
    controller = case.controllers[c]
    devices = [case.designed_on.device(name) for name in controller.devices]
    return Spec(
        controller.name,
        list(controller.signals),
        list(controller.devices),
        np.array([device.setpoint_max for device in devices]),
        np.array([device.rate_max for device in devices]),
        case.run.frame_rate,
        int(np.random.SeedSequence([case.run.seed, c]).generate_state(1)[0]),
        dict(controller.parameters),
        case.designed_on,
        list(case.run.devices),
    )
