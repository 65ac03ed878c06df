"""Events of a scenario."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity


def _time() -> float:
    return quantity(..., "s", "from the run's start", ge=0, le=1e5)  # type: ignore[no-any-return]


def _kind() -> Any:
    return Field(..., description="kind")


class Fault(ParameterModel):
    """A balanced three-phase fault at a bus or on a line."""

    time: float = _time()
    kind: Literal["fault"] = _kind()
    bus: Name | None = Field(None, description="either this or `line`")
    line: Name | None = Field(None, description="either this or `bus`")
    location: float = quantity(0.5, "-", "fraction of the line's length from its first bus", gt=0, lt=1)
    duration: float | None = quantity(None, "s", "none: until a `clear` or the end of the run", gt=0, le=1e5)
    r: float = quantity(0.0, "p.u.", "resistance; with r = x = 0 the fault is bolted", ge=0, le=1e3)
    x: float = quantity(0.0, "p.u.", "reactance", ge=0, le=1e3)

    @model_validator(mode="after")
    def _one_place(self) -> Fault:
        if (self.bus is None) == (self.line is None):
            raise ValueError("a fault needs either `bus` or `line`")
        return self


class Clear(ParameterModel):
    """The end of a fault at a bus or on a line."""

    time: float = _time()
    kind: Literal["clear"] = _kind()
    bus: Name | None = Field(None, description="either this or `line`")
    line: Name | None = Field(None, description="either this or `bus`")

    @model_validator(mode="after")
    def _one_place(self) -> Clear:
        if (self.bus is None) == (self.line is None):
            raise ValueError("a clear event needs either `bus` or `line`")
        return self


class Brake(ParameterModel):
    """A braking resistor is inserted at a bus (`brake`) or removed (`brake_out`)."""

    time: float = _time()
    kind: Literal["brake", "brake_out"] = _kind()
    bus: Name = Field(..., description="its bus")
    power: float | None = quantity(None, "MW", "of `brake`: power at 1 p.u. voltage", gt=0, le=1e6)
    duration: float | None = quantity(None, "s", "none: until a `brake_out` or the end of the run", gt=0, le=1e5)

    @model_validator(mode="after")
    def _what_it_needs(self) -> Brake:
        if self.kind == "brake" and self.power is None:
            raise ValueError("a brake needs `power`")
        if self.kind == "brake_out" and (self.power, self.duration) != (None, None):
            raise ValueError("a brake_out needs `bus` alone")
        return self


class LineSwitch(ParameterModel):
    """A line or transformer goes out of service (`line_out`) or back into service (`line_in`)."""

    time: float = _time()
    kind: Literal["line_out", "line_in"] = _kind()
    line: Name = Field(..., description="line or transformer")


class LoadStep(ParameterModel):
    """A load changes to (1 + change) times its value at the start of the run.

    A second step replaces the first.
    """

    time: float = _time()
    kind: Literal["load_step"] = _kind()
    load: Name = Field(..., description="load")
    change: float = quantity(..., "-", "relative change; -0.1 is ten per cent less", ge=-1, le=10)


class MechanicalPowerStep(ParameterModel):
    """The mechanical power of a machine changes to (1 + change) times its value at the start of the run.

    A second step replaces the first. With a governor, the step is in its reference, and the turbine follows.
    """

    time: float = _time()
    kind: Literal["mechanical_power_step"] = _kind()
    machine: Name = Field(..., description="machine")
    change: float = quantity(..., "-", "relative change; 0.1 is ten per cent more", ge=-2, le=10)


class ForcedOscillation(ParameterModel):
    """A power, or the setpoint of a control, oscillates from phase 0 on; several add up."""

    time: float = _time()
    kind: Literal["forced_oscillation"] = _kind()
    machine: Name | None = Field(None, description="machine whose mechanical power oscillates, behind its governor")
    load: Name | None = Field(None, description="load whose active power oscillates")
    exciter: Name | None = Field(None, description="machine whose voltage setpoint oscillates, p.u.")
    inverter: Name | None = Field(
        None, description="inverter whose setpoint of active power oscillates, p.u. of its rating"
    )
    frequency: float = quantity(..., "Hz", "at most half the rate of integration steps", usual=0.5, gt=0, le=1e3)
    amplitude: float = quantity(
        ..., "-", "of machine and load relative to the power after steps; of a load at most 1", ge=0, le=10
    )
    ramp: float = quantity(0.0, "s", "linear rise of the amplitude", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "none: to the end of the run", gt=0, le=1e5)
    waveform: Literal["sine", "square"] = Field("sine", description="`square`: sign of the sine")

    @model_validator(mode="after")
    def _one_place(self) -> ForcedOscillation:
        if [self.machine, self.load, self.exciter, self.inverter].count(None) != 3:
            raise ValueError("a forced oscillation needs one of `machine`, `load`, `exciter` and `inverter`")
        return self


class GeneratorTrip(ParameterModel):
    """A machine or an inverter is disconnected for good."""

    time: float = _time()
    kind: Literal["generator_trip"] = _kind()
    machine: Name = Field(..., description="machine or inverter that is disconnected")


Event = Annotated[
    Fault | Clear | Brake | LineSwitch | LoadStep | MechanicalPowerStep | ForcedOscillation | GeneratorTrip,
    Field(discriminator="kind"),
]


ELEMENTS = ("line", "bus", "load", "machine", "exciter", "inverter")  # fields of events that name what they change


class Scenario(ParameterModel):
    """Events that disturb a system, and the duration of a run that shows their effect."""

    name: Name = Field(..., description="name of the scenario")
    description: str = Field("", description="text that `facts-damping list scenarios` shows")
    duration: float = quantity(20.0, "s", "duration of runs that do not set their own", gt=0, le=1e5)
    dispatch: dict[Name, float] = Field(
        {},
        description="machine or inverter: active power at the start in MW, where it differs from the system's; the "
        "slack has none",
    )
    events: list[Event] = Field([], description="events, in any order; those at the same time act together")
