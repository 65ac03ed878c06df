"""A run as data: system, scenario, devices, controllers, link; and the events of a scenario."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, field_validator, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity
from facts_damping.parameters.faults import ControllerFault
from facts_damping.parameters.linear_law import LinearLaw
from facts_damping.parameters.load_noise import LoadNoise
from facts_damping.parameters.security import Security
from facts_damping.parameters.watchdog import Watchdog

# A ROS namespace below that of the graph: parts of letters, digits and underscores, joined by slashes.
_PART = "[A-Za-z][A-Za-z0-9_]*"
Namespace = Annotated[str, StringConstraints(max_length=64, pattern=f"^{_PART}(/{_PART})*$")]


def _time() -> float:
    return quantity(..., "s", "when it happens, from the start of the run", ge=0, le=1e5)  # type: ignore[no-any-return]


class Fault(ParameterModel):
    """A balanced three-phase fault at a bus, or on a line at a fraction of its length from its first bus.

    With `duration` it clears itself; otherwise it lasts until a `clear` event or the end.
    """

    time: float = _time()
    kind: Literal["fault"]
    bus: Name | None = None
    line: Name | None = None
    location: float = quantity(0.5, "-", "place on the line, as fraction of its length", gt=0, lt=1)
    duration: float | None = quantity(None, "s", "time to self-clearing", gt=0, le=1e5)
    r: float = quantity(0.0, "p.u.", "fault resistance; 0 with x = 0: bolted", ge=0, le=1e3)
    x: float = quantity(0.0, "p.u.", "fault reactance", ge=0, le=1e3)

    @model_validator(mode="after")
    def _one_place(self) -> Fault:
        if (self.bus is None) == (self.line is None):
            raise ValueError("a fault needs either `bus` or `line`")
        return self


class Clear(ParameterModel):
    """The end of the fault at a bus or on a line."""

    time: float = _time()
    kind: Literal["clear"]
    bus: Name | None = None
    line: Name | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Clear:
        if (self.bus is None) == (self.line is None):
            raise ValueError("a clear event needs either `bus` or `line`")
        return self


class LineSwitch(ParameterModel):
    """A line or transformer taken out, or put back in."""

    time: float = _time()
    kind: Literal["line_out", "line_in"]
    line: Name


class LoadStep(ParameterModel):
    """A load that changes to (1 + change) times its value at the start."""

    time: float = _time()
    kind: Literal["load_step"]
    load: Name
    change: float = quantity(..., "-", "relative change, -0.1: ten per cent less", ge=-1, le=10)


class MechanicalPowerStep(ParameterModel):
    """A mechanical power that changes to (1 + change) times its value at the start."""

    time: float = _time()
    kind: Literal["mechanical_power_step"]
    machine: Name
    change: float = quantity(..., "-", "relative change, 0.1: ten per cent more", ge=-2, le=10)


class GeneratorTrip(ParameterModel):
    """A machine disconnected for good."""

    time: float = _time()
    kind: Literal["generator_trip"]
    machine: Name


Event = Annotated[
    Fault | Clear | LineSwitch | LoadStep | MechanicalPowerStep | GeneratorTrip, Field(discriminator="kind")
]


class Scenario(ParameterModel):
    """A list of events, with the duration that a run needs to show what they do."""

    name: Name
    description: str = ""
    duration: float = quantity(20.0, "s", "default duration of a run", gt=0, le=1e5)
    dispatch: dict[Name, float] = Field({}, description="machine: active power at the start in MW, where it differs")
    events: list[Event] = []


class Weights(ParameterModel):
    """Adapted parameters of a neuro-fuzzy controller and its identifier, as a run left them."""

    name: Name
    scheme: Literal["direct", "indirect"]
    controller: list[float] | None = Field(None, description="parameters of its network; none: as at the start")
    identifier: list[float] | None = Field(None, description="parameters of its identifier's network")


class Fmu(ParameterModel):
    """An FMU as a controller, whose variables are called otherwise than its signals and devices."""

    file: str = Field(..., description="an FMU of FMI 2 or 3, for co-simulation")
    inputs: dict[Name, str] = Field({}, description="signal: name of its input, where that differs")
    outputs: dict[Name, str] = Field({}, description="device: name of its output, where that differs")


class Controller(ParameterModel):
    """A controller node: which row of the table of controllers, what it is given, what it commands."""

    name: Name = Field(
        "LLC",
        description="a row of `facts-damping list controllers`, antecedent+consequent, or of the user's own any other",
    )
    linear: str | dict[str, Any] | None = Field(
        None, description="a law of the user's own: .yaml, .npz or .mat file, or inline; none: that of its name"
    )
    policy: str | None = Field(
        None, description="a class of the user's own: module:Class, path/to/file.py:Class, or an entry point"
    )
    fmu: str | Fmu | None = Field(None, description="an FMU of the user's own, FMI 2 or 3, for co-simulation")
    external: bool = Field(False, description="a node of the user's own, which the graph waits for")
    command: list[str] | None = Field(
        None, min_length=1, description="a node of the user's own: its command, started and stopped with the graph"
    )
    scheme: Literal["direct", "indirect"] | None = Field(None, description="neuro-fuzzy only; none: indirect")
    devices: list[Name] = Field(["sssc"], min_length=1, description="installed devices that it commands")
    signals: list[Name] = Field(["speed"], min_length=1, description="signals of the system that it is given")
    profile: Literal["deployed", "thesis"] = Field("deployed", description="guards of adaptation: on, or all off")
    parameters: dict[str, float | str | list[float]] = Field(
        {}, description="its parameters where they differ from the table's; a list has an entry a signal or device"
    )
    compensation: Literal["none", "lead", "phasor", "prediction", "smith"] = Field(
        "none", description="what is done about delay; prediction: indirect only; smith is refused, with the reason"
    )
    weights: str | Weights | None = Field(None, description="file of adapted weights to start from, or these inline")
    link: str | dict[str, Any] | None = Field(
        None, description="a link of its own: name under config/links, path, or a link inline; none: the run's"
    )
    fallback_of: int | None = quantity(
        None, "-", "place in the run of the controller that it stands in for; none: it is nobody's", ge=0, le=15
    )
    faults: list[ControllerFault] = Field([], description="what goes wrong with it: for campaigns")
    namespace: Namespace | None = Field(
        None, description="ROS namespace, below that of the graph, of its nodes and its own link; none: the graph's"
    )

    @field_validator("namespace")
    @classmethod
    def _no_node(cls, namespace: str | None) -> str | None:
        if re.search(r"(^|/)controller_\d", namespace or ""):  # those of own links (`case.names`)
            raise ValueError(f"'{namespace}' given; allowed: one that is not named as a controller, such as area_1")
        return namespace

    @property
    def law(self) -> LinearLaw:
        """Its linear law, where that has been read."""
        return LinearLaw.model_validate(self.linear)

    def number(self, name: str) -> float:
        """A parameter that is a number; of a list the first."""
        value = self.parameters[name]
        return float(value[0] if isinstance(value, list) else value)


class TunedController(ParameterModel):
    """Parameters that a search has chosen for a controller, and what they reached in training."""

    name: Name
    scheme: Literal["direct", "indirect"] | None = None
    compensation: Literal["none", "lead", "phasor", "prediction"] = Field("none", description="chosen with them")
    objective: float = Field(..., description="what the search made small (docs/controllers.md)")
    parameters: dict[str, float | str | list[float]]


class Tuned(ParameterModel):
    """What `facts-damping tune` or `search` chose for a system: how, and for which controllers."""

    system: Name
    profile: Name = Field("thesis", description="the profile that they were chosen in")
    scenario: Name = Field(..., description="the scenario of training")
    signals: list[Name] = Field(..., description="the signals that they were given")
    devices: list[Name] = Field(..., description="the devices that they commanded")
    measurement: Literal["ideal", "p_class", "m_class"] = Field("ideal", description="the filter behind the signals")
    command: str = Field(..., description="the command that chose them")
    controllers: list[TunedController]


class Run(ParameterModel):
    """One closed loop, as the user writes it; system, scenario, measurement and link name a file or stand inline."""

    system: str | dict[str, Any] = Field("two_area", description="name under config/systems, path, or a system inline")
    scenario: str | list[Any] = Field("small", description="name under config/scenarios, path, or a list of events")
    devices: list[Name] = Field(["sssc"], description="devices of the system that are installed")
    controllers: list[Controller] = Field([Controller()], max_length=16)
    link: str | dict[str, Any] = Field("ideal", description="name under config/links, path, or a link inline")
    measurement: str | dict[str, Any] = Field(
        "ideal", description="how its PMUs measure: name under config/measurement, path, or inline"
    )
    watchdog: Watchdog | None = Field(Watchdog(), description="of every device; `off`: none")
    supervision: str | dict[str, Any] | None = Field(
        None, description="of every controller: name under config/supervision, path, or inline; `off`: none"
    )
    arm_at: float | None = quantity(
        None, "s", "when supervised controllers are armed; none: when an operator says so", ge=0, le=1e5
    )
    security: Security | None = Field(None, description="of the messages of its graph; none: not signed")
    load_noise: LoadNoise | None = Field(None, description="random noise of all loads; `off`: none")
    frame_rate: int = quantity(60, "frames/s", "PMU frames per second", ge=1, le=1000)
    duration: float | None = quantity(None, "s", "simulated time; none: the scenario's", gt=0, le=1e5)
    seed: int = quantity(0, "-", "seed of all randomness", ge=0, le=2**31 - 1)
    profile: str | None = Field(None, description="name under config/profiles, or path: its fields, but for the run's")
    model: str | dict[str, Any] | None = Field(
        None, description="the system that controllers and supervisors are designed on; none: the plant as it is"
    )
    tuning: Name = Field("thesis", description="profile in which the parameters were chosen that controllers leave out")
    asked: dict[str, Any] | None = Field(None, description="in stored runs: the run as the user wrote it, by names")

    @field_validator("watchdog", "load_noise", "supervision", mode="before")
    @classmethod
    def _off(cls, value: Any) -> Any:
        return None if value == "off" or value is False else value
