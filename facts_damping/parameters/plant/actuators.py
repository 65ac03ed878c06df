"""Actuators beside FACTS and HVDC as data: loads that are modulated."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from facts_damping.parameters.base import quantity
from facts_damping.parameters.plant.devices import DeviceModel, Parallel


def _kind() -> Any:
    return Field(..., description="kind of device")


class LoadModulation(Parallel):
    """[Load modulation](facts_devices.md): active power drawn at a bus beside its loads.

    Its setpoint is the power, positive for more load, in p.u. of the system base: with a base of 100 MVA a
    `setpoint_max` of 0.5 is 50 MW. One that is not installed does nothing.
    """

    kind: Literal["load_modulation"] = _kind()
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, power drawn; as much less must be drawn too", usual=0.5, gt=0, le=1000
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1e4)
    pf: float = quantity(1.0, "-", "power factor of what is modulated, which draws reactive power", ge=0.5, le=1)
    V_min: float = quantity(0.7, "p.u.", "voltage of its bus below which the power falls with its square", ge=0.1, le=1)


ACTUATORS: list[type[DeviceModel]] = [LoadModulation]
