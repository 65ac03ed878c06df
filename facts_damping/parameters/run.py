"""A run as data: system, scenario, devices, controllers, link."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, field_validator

from facts_damping.fields import LawName, Name, ParameterModel, quantity
from facts_damping.parameters.faults import ControllerFault
from facts_damping.parameters.linear_law import LinearLaw
from facts_damping.parameters.plant.load_noise import LoadNoise
from facts_damping.parameters.plant.watchdog import Watchdog
from facts_damping.parameters.security import Security

# A ROS namespace below that of the graph: parts of letters, digits and underscores, joined by slashes.
_PART = "[A-Za-z][A-Za-z0-9_]*"
Namespace = Annotated[str, StringConstraints(max_length=64, pattern=f"^{_PART}(/{_PART})*$")]


class Weights(ParameterModel):
    """What a neuro-fuzzy controller and its identifier had learnt at the end of a run.

    Each list has the memberships first, input by input, then the consequents, rule by rule and output by output. The
    inputs of a controller are the error and its change, signal by signal; those of an identifier are the signals, then
    the setpoints.
    """

    name: LawName = Field(..., description="name of the controller")
    scheme: Literal["direct", "indirect"] = Field(..., description="scheme of the controller")
    controller: list[float] | None = Field(
        None, description="parameters of the controller's network; none: those that it starts with"
    )
    identifier: list[float] | None = Field(
        None, description="parameters of the identifier's network; none: those that it starts with, or a direct scheme"
    )


class Fmu(ParameterModel):
    """An FMU whose variables do not have the names of the controller's signals and devices."""

    file: str = Field(..., description="FMU of FMI 2 or 3 for co-simulation")
    inputs: dict[Name, str] = Field({}, description="signal: input, where its name is not that of the signal")
    outputs: dict[Name, str] = Field({}, description="device: output, where its name is not that of the device")


class Controller(ParameterModel):
    """A [controller](controllers.md): its type, the signals that it receives, the devices that it commands.

    Only one controller commands a device, apart from its fallback. Several controllers may receive the same signal.
    """

    name: LawName = Field(
        "LLC",
        description="name in `facts-damping list controllers`, also of a tuned law, `LLC-tuned@two_area`; a pair "
        "`antecedent+consequent`; or any other name for a controller of your own",
    )
    linear: str | dict[str, Any] | None = Field(
        None, description="linear law of your own: a .yaml, .npz or .mat file, or inline"
    )
    policy: str | None = Field(
        None, description="Python class of your own: `file.py:Class`, `module:Class`, or an entry point"
    )
    fmu: str | Fmu | None = Field(
        None, description="FMU of your own: its file, or a mapping if names of variables differ"
    )
    external: bool = Field(False, description="true: a node of your own that you start; the graph waits for it")
    command: list[str] | None = Field(
        None, min_length=1, description="command of a node of your own, which is started and stopped with the graph"
    )
    scheme: Literal["direct", "indirect"] | None = Field(
        None, description="scheme of a neuro-fuzzy controller; none: `indirect`"
    )
    devices: list[Name] = Field(["sssc"], min_length=1, description="installed devices that it commands")
    signals: list[Name] = Field(
        ["speed"],
        min_length=1,
        description="signals of the system that it receives, each once: one for a lead-lag, up to 16 for others",
    )
    profile: Literal["deployed", "thesis"] = Field(
        "deployed", description="guards of a neuro-fuzzy controller's adaptation: on (`deployed`) or off (`thesis`)"
    )
    parameters: dict[str, float | str | list[float]] = Field(
        {},
        description="parameters that differ from the tuned or default ones; a list has one entry per signal or device",
    )
    compensation: Literal["none", "lead", "phasor", "prediction", "smith"] = Field(
        "none",
        description="method of delay compensation; `prediction` is for indirect controllers, `smith` is always refused",
    )
    weights: str | Weights | None = Field(
        None, description="weights that a neuro-fuzzy controller starts from: the path of a file, or inline"
    )
    link: str | dict[str, Any] | None = Field(
        None, description="link of its own: name under config/links, path, or inline; none: the link of the run"
    )
    fallback_of: int | None = quantity(
        None, "-", "index in the run of the controller that it is the fallback of; none: it is no fallback", ge=0, le=15
    )
    faults: list[ControllerFault] = Field([], description="faults of the controller, for tests of supervision")
    untuned: bool = Field(False, description="in stored runs: whether it has defaults that are of other systems")
    namespace: Namespace | None = Field(
        None,
        description="ROS namespace of its nodes and of its own link, below that of the graph; none: that of the graph",
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
    """Parameters that a search has chosen for one controller and scheme."""

    name: Name = Field(..., description="name of the kind, as in a run")
    scheme: Literal["direct", "indirect"] | None = Field(None, description="scheme of a neuro-fuzzy controller")
    row: Name | None = Field(None, description="name among several rows of its controller, such as the search's seed")
    policy: str | None = Field(None, description="Python class, if the law is one")
    compensation: Literal["none", "lead", "phasor", "prediction"] = Field(
        "none", description="delay compensation with which the parameters were chosen"
    )
    objective: float = Field(
        ..., description="value reached: of `tune` the objective in p.u. s², of `search` the score on fresh cases"
    )
    parameters: dict[str, float | str | list[float]] = Field(
        ..., description="chosen parameters; a list has one entry per signal or device"
    )


class Tuned(ParameterModel):
    """Parameters of controllers that `facts-damping tune` or `search` has chosen for a system."""

    system: Name = Field(..., description="name of the system")
    profile: Name = Field("thesis", description="profile in which the parameters were chosen")
    scenario: Name = Field(..., description="training scenario")
    signals: list[Name] = Field(..., description="signals that the controllers received")
    devices: list[Name] = Field(..., description="devices that were installed, and that the controllers commanded")
    measurement: Literal["ideal", "p_class", "m_class"] = Field("ideal", description="filter of the PMUs")
    command: str = Field(..., description="command that chose the parameters")
    controllers: list[TunedController] = Field(
        ..., description="chosen parameters, one entry per controller and scheme"
    )


class Run(ParameterModel):
    """One closed loop: a system, a scenario, PMUs, a link, devices and controllers.

    Fields that name a file also take its content inline; `scenario` then takes a list of events. The defaults fit the
    system `two_area`. See [run files](running.md).
    """

    description: str = Field("", description="text that `facts-damping list runs` shows")
    system: str | dict[str, Any] = Field("two_area", description="system: name under config/systems, path, or inline")
    scenario: str | list[Any] = Field(
        "small", description="scenario: name under config/scenarios, path, or a list of events"
    )
    devices: list[Name] = Field(
        ["sssc"], description="devices of the system that are installed, each once; an empty list installs none"
    )
    controllers: list[Controller] = Field(
        [Controller()], max_length=16, description="controllers, at most 16; an empty list is the open loop"
    )
    link: str | dict[str, Any] = Field("ideal", description="link: name under config/links, path, or inline")
    measurement: str | dict[str, Any] = Field(
        "ideal", description="how the PMUs measure: name under config/measurement, path, or inline"
    )
    watchdog: Watchdog | None = Field(
        Watchdog(), description="watchdog of every device; `off`: a device holds its last setpoint for ever"
    )
    supervision: str | dict[str, Any] | None = Field(
        None, description="supervision of all controllers: name under config/supervision, path, or inline; `off`: none"
    )
    arm_at: float | None = quantity(
        None, "s", "time at which supervised controllers are armed; none: an operator arms them", ge=0, le=1e5
    )
    security: Security | None = Field(None, description="keys that sign the messages of the graph; none: not signed")
    load_noise: LoadNoise | None = Field(None, description="random noise of all loads; `off`: none")
    frame_rate: int = quantity(60, "frames/s", "PMU frames per second", ge=1, le=1000)
    duration: float | None = quantity(
        None, "s", "simulated time, at most 2,000,000 frames; none: the duration of the scenario", gt=0, le=1e5
    )
    seed: int = quantity(
        0, "-", "seed of everything random: jitter, loss, noise of links, PMUs and loads", ge=0, le=2**31 - 1
    )
    profile: str | None = Field(
        None, description="profile: name under config/profiles, or path; it sets fields that the run does not set"
    )
    model: str | dict[str, Any] | None = Field(
        None,
        description="system on which controllers and supervisors are designed: name, path or inline, with the devices, "
        "PMUs and signals of the plant; none: the plant itself",
    )
    tuning: str = Field(
        "thesis", description="profile, or file, of the tuned parameters that apply where a controller gives none"
    )
    system_file: str | None = Field(None, description="in stored runs: the file of a system that was changed")
    asked: dict[str, Any] | None = Field(None, description="in stored runs: the run with the names that were given")

    @field_validator("watchdog", "load_noise", "supervision", mode="before")
    @classmethod
    def _off(cls, value: Any) -> Any:
        return None if value == "off" or value is False else value
