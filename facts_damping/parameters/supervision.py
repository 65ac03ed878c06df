"""Supervision as data: monitors, when a controller is armed, its authority, the probe before that."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

from pydantic import Field, field_validator

from facts_damping.fields import ParameterModel, quantity
from facts_damping.monitor_table import MONITORS


class Threshold(ParameterModel):
    """Settings of one monitor; a field that is not given has the value in `facts-damping list monitors`."""

    limit: float | None = Field(None, description="limit in the unit of the monitor")
    lasts: float | None = quantity(
        None, "s, or cycles", "time for which the limit must be exceeded, in the unit of the monitor", ge=0, le=1e4
    )
    follows: Literal["warn", "fall_back", "trip"] | None = Field(
        None, description="consequence: a warning, the fallback takes over, or the controller is tripped"
    )


class Arming(ParameterModel):
    """When the setpoints of a controller begin and cease to act, and by which ramps."""

    probe: bool = Field(
        False, description="true: the controller is armed only after a probe in which the plant responds as expected"
    )
    ramp: float = quantity(
        1.0, "s", "time in which the fraction of the controller's output rises from 0 to 1 after arming", ge=0, le=1e3
    )
    trip_ramp: float = quantity(0.05, "s", "time in which the output goes to zero after a trip", ge=0, le=1e3)
    fall_back_ramp: float = quantity(
        0.5, "s", "time in which the fallback takes over from the controller, or gives back", ge=0, le=1e3
    )
    recovery: float = quantity(
        3.0, "s", "time for which data must be sound before the fallback gives back to the controller", ge=0, le=1e4
    )


class Authority(ParameterModel):
    """How much of a device a controller may use; by default all of it."""

    fraction: float = quantity(1.0, "-", "largest setpoint, as a fraction of the device's limit", gt=0, le=1)
    rate: float | None = quantity(None, "p.u./s", "largest rate of change of a setpoint; none: any", gt=0, le=1e6)
    energy: float | None = quantity(
        None, "s", "seconds of squared full output per minute, half of them at once; none: any number", gt=0, le=60
    )


class Probe(ParameterModel):
    """A test, before arming, of whether the plant responds as its model predicts.

    Each device in turn gets two small tones, one below and one above the frequency of the mode.
    """

    start: float | None = quantity(
        None, "s", "time at which the probe begins; none: when an operator starts it", ge=0, le=1e5
    )
    amplitude: float = quantity(0.1, "-", "amplitude of a tone, as a fraction of the device's limit", gt=0, le=0.5)
    cycles: float = quantity(8.0, "-", "duration for each device, in cycles of the mode", ge=2, le=1e3)
    apart: float = quantity(
        0.18, "-", "distance of the tones from the mode, as a fraction of its frequency", gt=0, lt=0.9
    )
    coherence: float = quantity(0.5, "-", "smallest coherence of the response that passes", ge=0, lt=1)
    gain: float = quantity(
        3.0, "-", "largest ratio of the response to that of the model, or the inverse, that passes", ge=1, le=1e3
    )
    phase: float = quantity(60.0, "deg", "largest difference in phase from the model that passes", ge=0, le=180)


class Absence(ParameterModel):
    """A failure of the supervisor, for campaigns."""

    kind: Literal["dead", "hung"] = Field(
        ..., description="afterwards the supervisor starts anew (`dead`) or continues where it was (`hung`)"
    )
    start: float = quantity(..., "s", "time at which the supervisor fails", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "how long the failure lasts; none: to the end", gt=0, le=1e5)


class Supervision(ParameterModel):
    """Settings of the [supervisor](supervision.md) beside each controller."""

    description: str = Field("", description="text that `facts-damping list supervision` shows")
    monitors: dict[str, Threshold | None] = Field(
        {}, description="monitor: settings that differ from `facts-damping list monitors`, or `off`"
    )
    arming: Arming = Field(Arming(), description="when a controller begins and ceases to act")
    authority: Authority = Field(Authority(), description="how much of a device a controller may use")
    probe: Probe = Field(Probe(), description="test of the plant before arming")
    fault: Absence | None = Field(None, description="failure of the supervisor itself; none: it does not fail")

    @field_validator("monitors", mode="before")
    @classmethod
    def _off(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {name: None if limit == "off" or limit is False else limit for name, limit in value.items()}


class Watch(NamedTuple):
    """What a monitor is set to in a run."""

    limit: float  # in its unit; inf: it is not watched
    lasts: float  # in the row's `lasts_unit`
    follows: str  # empty: nothing, as it is not watched


def watches(supervision: Supervision) -> dict[str, Watch]:
    """What each monitor is set to: where the run says nothing of it, as in the table."""
    table = {}
    for name, row in MONITORS.items():
        asked = supervision.monitors.get(name, Threshold())
        if asked is None:
            table[name] = Watch(math.inf, 0.0, "")
            continue
        limit = row.limit if asked.limit is None else asked.limit
        table[name] = Watch(limit, row.lasts if asked.lasts is None else asked.lasts, asked.follows or row.follows)
    return table
