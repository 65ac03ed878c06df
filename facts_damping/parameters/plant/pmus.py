"""What is measured, as data: PMUs, the signals that controllers may receive, the measures of performance indices."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity

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


class Pmu(ParameterModel):
    """A PMU at the terminals of a machine or inverter, or at a bus.

    It reports voltage, its frequency, current and power: at a machine or inverter the power out of it, at a bus that
    into the `branches`. A PMU at a machine also reports the rotor speed if PMUs are [ideal](measurement.md).
    """

    name: Name = Field(..., description="name, unique among the PMUs")
    machine: Name | None = Field(
        None, description="machine or inverter at whose terminals it measures; give either this or `bus`"
    )
    bus: Name | None = Field(None, description="bus at which it measures; give either this or `machine`")
    branches: list[Name] = Field(
        [], description="lines, transformers or series devices at the bus, whose flows out of the bus are added"
    )

    @model_validator(mode="after")
    def _one_place(self) -> Pmu:
        if (self.machine is None) == (self.bus is None) or (self.machine is not None and self.branches):
            raise ValueError("a PMU needs either `machine`, or `bus` and `branches`")
        return self


class Signal(ParameterModel):
    """A signal that controllers may receive: a weighted sum of one measured quantity over PMUs.

    Magnitudes, powers and speeds are in p.u., angles in rad. A frequency counts as its deviation in p.u. of the nominal
    frequency, so the weights of a speed serve it too; ROCOF, its rate of change, counts in p.u./s. Angles count only
    against each other: their weights must be whole numbers that sum to zero, and the sum is between -pi and pi.

    A PMU may have backups, for example a second one at its bus. Its data are bad if the channel is not available, the
    status says so (data error, test mode, not synchronised), its values repeat for 0.1 s though the frequency is not
    nominal, or its newest frame is 0.1 s older than that of another PMU. A backup stays until its own data are bad.

    The washout `s T/(1 + s T)` removes constant parts. With T far below the period of a swing it gives T times the rate
    of change. A controller computes it from its frames by the bilinear transform, starting at rest.
    """

    channel: Channel = Field(..., description="measured quantity")
    weights: dict[Name, float] = Field(..., min_length=1, description="PMU: weight")
    backups: dict[Name, list[Name]] = Field(
        {}, description="PMU: those that take its place, in this order, while its data are bad"
    )
    deviation: bool = Field(False, description="true: the first value that the controller receives is subtracted")
    washout: float = quantity(0.0, "s", "time constant T of the washout; 0: none", ge=0, le=1e3)

    @model_validator(mode="after")
    def _backups_of_its_pmus(self) -> Signal:
        if other := set(self.backups) - set(self.weights):
            raise ValueError(f"backups: {', '.join(sorted(other))} given; allowed: {', '.join(self.weights)}, its PMUs")
        return self

    @model_validator(mode="after")
    def _angles_differ(self) -> Signal:
        whole = all(weight == round(weight) for weight in self.weights.values())
        if self.channel in ("voltage_angle", "current_angle") and not (whole and sum(self.weights.values()) == 0.0):
            raise ValueError("angles count against each other, by whole turns: weights must be whole and sum to zero")
        return self


class Measures(ParameterModel):
    """The speed differences from which [performance indices](measures.md) are computed.

    Both lists name signals of the channels `speed_deviation` or `frequency`. If both are empty, the speed of each PMU
    at a machine (with fewer than two also at an inverter) counts against that of the first one, or beside an infinite
    bus against synchronous speed. Where there is no rotor, the frequency counts that the PMU reports.
    """

    local: list[Name] = Field([], description="signals that are local speed differences")
    interarea: list[Name] = Field([], description="signals that are interarea speed differences")
