"""Supervision as data: monitors, when a controller is armed, its authority, the probe before that."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

from pydantic import Field, field_validator

from facts_damping.monitors import MONITORS
from facts_damping.parameters.base import ParameterModel, quantity


class Threshold(ParameterModel):
    """Where a monitor differs from its row of the table (docs/supervision.md)."""

    limit: float | None = Field(None, description="more is too much, in the monitor's unit; none: the table's")
    lasts: float | None = quantity(None, "s, or cycles", "how long it must last; none: the table's", ge=0, le=1e4)
    follows: Literal["warn", "fall_back", "trip"] | None = Field(None, description="what follows; none: the table's")


class Arming(ParameterModel):
    """When a controller's setpoints begin to act, and how softly."""

    probe: bool = Field(False, description="true: only after a probe that says that the plant answers as known")
    ramp: float = quantity(1.0, "s", "time in which the output's share goes from 0 to 1", ge=0, le=1e3)
    trip_ramp: float = quantity(0.3, "s", "time in which the output goes to zero", ge=0, le=1e3)
    fall_back_ramp: float = quantity(0.5, "s", "time in which one controller takes over from another", ge=0, le=1e3)
    recovery: float = quantity(3.0, "s", "time that data must be sound until the fallback gives back", ge=0, le=1e4)


class Authority(ParameterModel):
    """How much of a device a controller may use; the default is all of it."""

    share: float = quantity(1.0, "-", "of the device's limit", gt=0, le=1)
    rate: float | None = quantity(None, "p.u./s", "largest rate of a setpoint; none: any", gt=0, le=1e6)
    energy: float | None = quantity(
        None, "s", "full output, squared, that may be used in a minute, half of it at once; none: any", gt=0, le=60
    )


class Probe(ParameterModel):
    """Two tones beside the mode on one device after the other, in shadow: does the plant answer as known?"""

    start: float | None = quantity(None, "s", "when it begins; none: when an operator asks", ge=0, le=1e5)
    amplitude: float = quantity(0.1, "-", "of a tone, as share of the device's limit", gt=0, le=0.5)
    cycles: float = quantity(8.0, "-", "how long it takes a device, in cycles of the mode", ge=2, le=1e3)
    apart: float = quantity(0.18, "-", "the tones' distance from the mode, as share of its frequency", gt=0, lt=0.9)
    coherence: float = quantity(0.5, "-", "least coherence of the answer", ge=0, lt=1)
    gain: float = quantity(3.0, "-", "largest ratio of the answer and the known one, either way", ge=1, le=1e3)
    phase: float = quantity(60.0, "deg", "largest difference of phase", ge=0, le=180)


class Absence(ParameterModel):
    """A supervisor that fails for a time: the campaign's."""

    kind: Literal["dead", "hung"] = Field(..., description="dead: it begins again knowing nothing; hung: where it was")
    start: float = quantity(..., "s", "from then on", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "for so long; none: to the end", gt=0, le=1e5)


class Supervision(ParameterModel):
    """The supervisor of each controller (docs/supervision.md)."""

    description: str = ""
    monitors: dict[str, Threshold | None] = Field(
        {}, description="monitor: where it differs from the table; `off`: it is not watched"
    )
    arming: Arming = Arming()
    authority: Authority = Authority()
    probe: Probe = Probe()
    fault: Absence | None = Field(None, description="when it fails: for campaigns; none: never")

    @field_validator("monitors", mode="before")
    @classmethod
    def _off(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {name: None if one == "off" or one is False else one for name, one in value.items()}


class Watch(NamedTuple):
    """What a monitor is set to in a run."""

    limit: float  # in its unit; inf: it is not watched
    lasts: float  # in the row's `lasts_unit`
    follows: str  # empty: nothing, as it is not watched


def watches(given: Supervision) -> dict[str, Watch]:
    """What each monitor is set to: where the run says nothing of it, as in the table."""
    found = {}
    for name, row in MONITORS.items():
        own = given.monitors.get(name, Threshold())
        if own is None:
            found[name] = Watch(math.inf, 0.0, "")
            continue
        limit = row.limit if own.limit is None else own.limit
        found[name] = Watch(limit, row.lasts if own.lasts is None else own.lasts, own.follows or row.follows)
    return found
