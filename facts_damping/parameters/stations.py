"""What is measured as data: PMUs, the signals that controllers may be given, the measures of performance indices."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity

# What a PMU reports (signals.CHANNELS).
Channel = Literal[
    "voltage_magnitude",
    "voltage_angle",
    "speed_deviation",
    "active_power",
    "reactive_power",
    "frequency",
    "rocof",
    "current_magnitude",
    "current_angle",
]


class Station(ParameterModel):
    """A PMU: at a machine's terminals, or at a bus with the branches whose flow out of the bus it measures."""

    name: Name
    machine: Name | None = None
    bus: Name | None = None
    branches: list[Name] = []

    @model_validator(mode="after")
    def _one_place(self) -> Station:
        if (self.machine is None) == (self.bus is None) or (self.machine is not None and self.branches):
            raise ValueError("a station needs either `machine`, or `bus` and `branches`")
        return self


class Signal(ParameterModel):
    """A measured signal: a weighted sum of one channel over stations, or its deviation from the start.

    Frequencies count as speeds do, by their deviation in p.u. of the nominal one; ROCOF in p.u./s of it.

    A washout s T / (1 + s T) takes away what stays; with T far below the period of a swing it is its rate of change.
    """

    channel: Channel
    weights: dict[Name, float] = Field(..., min_length=1, description="station: weight")
    deviation: bool = Field(False, description="true: minus the first value that is received")
    washout: float = quantity(0.0, "s", "time constant of the washout; 0: none", ge=0, le=1e3)

    @model_validator(mode="after")
    def _angles_differ(self) -> Signal:
        whole = all(weight == round(weight) for weight in self.weights.values())
        if self.channel in ("voltage_angle", "current_angle") and not (whole and sum(self.weights.values()) == 0.0):
            raise ValueError("angles count against each other, by whole turns: weights must be whole and sum to zero")
        return self


class Measures(ParameterModel):
    """The speed differences that the performance indices (4.108) sum up: names of signals."""

    local: list[Name] = []
    interarea: list[Name] = []
