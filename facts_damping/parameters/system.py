"""A power system as data: the tables of a file under `config/systems`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Union

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity
from facts_damping.parameters.devices import DEVICES, Parallel, Series
from facts_damping.parameters.grid import Bus, InfiniteBus, Line, Load, Shunt, Transformer
from facts_damping.parameters.machines import Exciter, Governor, Machine, Stabiliser
from facts_damping.parameters.references import check_references

if TYPE_CHECKING:
    Device = Series | Parallel
else:
    Device = Annotated[Union[tuple(DEVICES)], Field(discriminator="kind")]  # noqa: UP007 (made from the list)


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

    A washout s T / (1 + s T) takes away what stays; with T far below the period of a swing it is its rate of change.
    """

    channel: Literal["voltage_magnitude", "voltage_angle", "speed_deviation", "active_power", "reactive_power"]
    weights: dict[Name, float] = Field(..., min_length=1, description="station: weight")
    deviation: bool = Field(False, description="true: minus the first value that is received")
    washout: float = quantity(0.0, "s", "time constant of the washout; 0: none", ge=0, le=1e3)

    @model_validator(mode="after")
    def _angles_differ(self) -> Signal:
        whole = all(weight == round(weight) for weight in self.weights.values())
        if self.channel == "voltage_angle" and not (whole and sum(self.weights.values()) == 0.0):
            raise ValueError("angles count against each other, by whole turns: weights must be whole and sum to zero")
        return self


class Measures(ParameterModel):
    """The speed differences that the performance indices (4.108) sum up: names of signals."""

    local: list[Name] = []
    interarea: list[Name] = []


class System(ParameterModel):
    """A power system: everything that does not change from run to run."""

    name: Name
    description: str = ""
    base_power: float = quantity(100.0, "MVA", "system base", gt=0, le=1e5)
    frequency: float = quantity(60.0, "Hz", "nominal frequency", ge=10, le=400)
    line_model: Literal["pi", "distributed"] = Field("pi", description="distributed: long-line correction")
    step: float = quantity(1 / 480, "s", "longest step of the integrator", ge=1e-5, le=0.02)
    buses: list[Bus] = Field(..., min_length=1)
    lines: list[Line] = []
    transformers: list[Transformer] = []
    loads: list[Load] = []
    shunts: list[Shunt] = []
    infinite_buses: list[InfiniteBus] = []
    machines: list[Machine] = Field(..., min_length=1)
    exciters: list[Exciter] = []
    stabilisers: list[Stabiliser] = []
    governors: list[Governor] = []
    devices: list[Device] = []
    stations: list[Station] = Field(..., min_length=1)
    signals: dict[Name, Signal] = {}
    measures: Measures = Measures()

    @model_validator(mode="after")
    def _consistent(self) -> System:
        check_references(self)
        return self

    def device(self, name: str) -> Device:
        """The device of a name."""
        return next(device for device in self.devices if device.name == name)
