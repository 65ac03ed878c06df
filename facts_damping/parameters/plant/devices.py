"""FACTS devices as data, in series or in parallel; impedances, voltages and currents on the system base."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from facts_damping.extensions import rows
from facts_damping.parameters.base import Name, ParameterModel, quantity


class DeviceModel(ParameterModel):
    """A device that a run can install. The sections that follow have its kinds."""

    if TYPE_CHECKING:
        setpoint_max: float
        rate_max: float

    name: Name = Field(..., description="name, unique among lines, transformers and devices")
    kind: str
    response_time: float = quantity(
        0.0, "s", "time constant of the first-order lag behind the reference; 0: none", ge=0, le=10
    )
    dead_time: float = quantity(0.0, "s", "time after which an accepted setpoint acts; 0: at once", ge=0, le=0.5)

    @model_validator(mode="before")
    @classmethod
    def _former(cls, given: Any) -> Any:
        if isinstance(given, dict) and "hold" in given:
            raise ValueError("'hold' given; allowed: 'watchdog.timeout' of the run, its new name")
        return given


class Series(DeviceModel):
    """What all kinds in series have: two buses, or a line in which it stands next to its `from` or `to` bus.

    It acts behind an impedance. If it is not installed, only its resistance remains, and its reactance at rest.
    """

    from_bus: Name | None = Field(None, alias="from", description="first bus; give `from` and `to`, or `line`")
    to_bus: Name | None = Field(None, alias="to", description="second bus")
    line: Name | None = Field(None, description="line in which it stands, instead of `from` and `to`")
    end: Literal["from", "to"] = Field("from", description="end of that line next to which it stands")
    rs: float = quantity(..., "p.u.", "resistance of the coupling transformer", ge=1e-6, le=1)
    xs: float = quantity(..., "p.u.", "reactance of the coupling transformer", gt=0, le=1)

    @model_validator(mode="after")
    def _one_place(self) -> Series:
        buses = [bus for bus in (self.from_bus, self.to_bus) if bus is not None]
        if len(buses) != (0 if self.line is not None else 2):
            raise ValueError("a device in series needs either `line`, or `from` and `to`")
        return self

    @property
    def reactance(self) -> float:
        """Its reactance at rest, p.u., also if it is not installed."""
        return 0.0

    @property
    def ends(self) -> tuple[str, str]:
        """The two buses it stands between; empty while it is placed by its line."""
        return self.from_bus or "", self.to_bus or ""

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return self.line or "-".join(self.ends)


class Parallel(DeviceModel):
    """What all kinds in parallel have: a bus. One that is not installed does nothing."""

    bus: Name = Field(..., description="bus to which it is connected")

    @property
    def buses(self) -> list[str]:
        """The buses of its ports."""
        return [self.bus]

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return self.bus


class Transmission(DeviceModel):
    """What all kinds have that carry power between two buses: they are in service whether installed or not."""

    from_bus: Name = Field(..., alias="from", description="bus of the rectifier")
    to_bus: Name = Field(..., alias="to", description="bus of the inverter")

    @property
    def buses(self) -> list[str]:
        """The buses of its ports, that to which it carries power first."""
        return [self.to_bus, self.from_bus]

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return f"{self.from_bus}-{self.to_bus}"


class AtMachine(DeviceModel):
    """What all kinds have that act on a machine's controls and not on the network. One not installed does nothing."""

    machine: Name = Field(..., description="machine on whose exciter it acts")

    @property
    def buses(self) -> list[str]:
        """The buses of its ports: it has none."""
        return []

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return self.machine


def _kind() -> Any:
    return Field(..., description="kind of device")


class Sssc(Series):
    """A static synchronous series compensator ([SSSC](facts_devices.md)); data on the system base.

    Its setpoint is a voltage in quadrature to its current. It stands between two buses, or in a line next to one of its
    ends. In a line it has a bus of its own, `<line>.<device>`; its current counts in the direction of the line, and a
    PMU that lists the line at this end measures the flow of the device. A line or a pair of buses has room for one
    device. If it is not installed, only its resistance `rs` remains.
    """

    kind: Literal["sssc"] = _kind()
    rs: float = quantity(0.000053, "p.u.", "resistance of the coupling transformer", ge=1e-6, le=1)
    xs: float = quantity(0.0016, "p.u.", "reactance of the coupling transformer", gt=0, le=1)
    setpoint_max: float = quantity(0.1, "p.u.", "limit of the setpoint, the quadrature voltage", gt=0, le=1)
    rate_max: float = quantity(5.0, "p.u./s", "rate limit of the quadrature voltage reference", gt=0, le=1000)
    vp_max: float = quantity(0.1, "p.u.", "limit of the active converter voltage, below `vc_max`", gt=0, le=1)
    vc_max: float = quantity(0.11, "p.u.", "limit of the whole converter voltage", gt=0, le=1)
    Kp: float = quantity(0.00375, "-", "proportional gain of the regulator of the injected voltage", ge=0, le=10)
    Ki: float = quantity(0.1875, "1/s", "integral gain of the regulator of the injected voltage", ge=0, le=1000)
    Kd: float = quantity(0.4, "p.u.", "proportional gain of the DC voltage regulator", ge=0, le=100)
    Kdi: float = quantity(8.0, "p.u./s", "integral gain of the DC voltage regulator", ge=0, le=1e4)
    tau: float = quantity(0.006, "s", "time constant of the DC link, C V^2 / S on the system base", ge=0.001, le=10)
    g: float = quantity(0.0, "p.u.", "conductance of the DC link, for losses", ge=0, le=10)
    I_rated: float = quantity(10.0, "p.u.", "rated current; above it the DC regulator keeps its power", gt=0, le=1000)
    enforce_rating: bool = Field(False, description="true: the converter is bypassed above `I_rated`")
    I_min: float = quantity(0.02, "p.u.", "current below which the converter is blocked", gt=0, le=1)

    @model_validator(mode="after")
    def _consistent(self) -> Sssc:
        if self.vp_max >= self.vc_max:
            raise ValueError(f"vp_max must be below vc_max, given {self.vp_max} and {self.vc_max}")
        return self


class Statcom(Parallel):
    """A static synchronous compensator ([STATCOM](facts_devices.md)) at a bus; data on the system base.

    Its setpoint is an offset of its voltage reference. With the default data the integration step must be at most 3.6
    ms. One that is not installed does nothing.
    """

    kind: Literal["statcom"] = _kind()
    R: float = quantity(0.0073, "p.u.", "resistance of the coupling transformer", ge=0, le=10)
    L: float = quantity(0.22, "p.u.", "reactance of the coupling transformer", gt=0, le=10)
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, an offset of the voltage reference", usual=0.1, gt=0, le=1
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1000)
    I_max: float = quantity(..., "p.u.", "limit of the active and of the reactive current", usual=1, gt=0, le=1000)
    Kp: float = quantity(
        5.0, "p.u.", "proportional gain of the AC voltage regulator: current per voltage", ge=0, le=1000
    )
    Ki: float = quantity(1000.0, "p.u./s", "integral gain of the AC voltage regulator", ge=0, le=1e5)
    droop: float = quantity(0.0, "p.u.", "slope of the voltage: voltage per reactive current", ge=0, le=1)
    Kd: float = quantity(
        4.0, "p.u.", "proportional gain of the DC voltage regulator: current per voltage", ge=0, le=1000
    )
    Kdi: float = quantity(80.0, "p.u./s", "integral gain of the DC voltage regulator", ge=0, le=1e5)
    Kc: float = quantity(0.3, "p.u.", "proportional gain of the current regulator", ge=0, le=100)
    Kci: float = quantity(10.0, "p.u./s", "integral gain of the current regulator", ge=0, le=1e4)
    Kf: float = quantity(0.22, "p.u.", "current regulator: feed-forward of the transformer's voltage", ge=0, le=10)
    tau: float = quantity(0.006, "s", "time constant of the DC link, C V^2 / S on the system base", ge=0.001, le=10)
    g: float = quantity(0.0, "p.u.", "conductance of the DC link, for losses", ge=0, le=10)
    enforce_rating: bool = Field(
        False, description="true: `I_max` limits the whole current, with priority for the active part"
    )
    V_min: float = quantity(0.05, "p.u.", "voltage of its bus below which the converter is blocked", gt=0, le=0.9)


class Svc(Parallel):
    """A static var compensator ([SVC](facts_devices.md)) at a bus; data on the system base.

    Its setpoint is an offset of its voltage reference. The integration step must be below about 2.8 T/(1 + K X), with
    the reactance X of the network behind its bus. One that is not installed does nothing.
    """

    kind: Literal["svc"] = _kind()
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, an offset of the voltage reference", usual=0.05, gt=0, le=1
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=5, gt=0, le=1000)
    B_max: float = quantity(..., "p.u.", "capacitive limit of the susceptance", usual=2, gt=0, le=1000)
    B_min: float = quantity(..., "p.u.", "inductive limit of the susceptance, negative", usual=-1, ge=-1000, le=0)
    K: float = quantity(
        ..., "p.u.", "gain of the regulator: susceptance per voltage, the inverse slope", usual=30, gt=0, le=1e4
    )
    T: float = quantity(0.05, "s", "time constant with which the susceptance follows", ge=0.001, le=10)
    V_min: float = quantity(0.05, "p.u.", "voltage of its bus below which it is blocked", gt=0, le=0.9)


class Hvdc(Transmission):
    """An [HVDC link](facts_devices.md) that carries power from a rectifier's bus to an inverter's bus.

    Its setpoint is power added to its order. Setpoints are in p.u. of the system base, powers of the link in MW: with a
    base of 100 MVA a `setpoint_max` of 0.5 is 50 MW. A link that is not installed stays in service and carries its
    order. With `P_min` below 0 it is the modulation of a link whose schedule stands among the loads.
    """

    kind: Literal["hvdc"] = _kind()
    P: float = quantity(
        ..., "MW", "power order, taken from the `from` bus; from `P_min` to `P_max`", usual=200, ge=0, le=1e5
    )
    P_max: float = quantity(..., "MW", "largest power, also with modulation", usual=300, gt=0, le=1e5)
    P_min: float = quantity(
        0.0,
        "MW",
        "smallest power, also with modulation; below 0 only without losses and reactive power",
        ge=-1e5,
        le=1e5,
    )
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, power added to the order", usual=0.5, gt=0, le=1000
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1e4)
    loss: float = quantity(0.0, "-", "losses of the converters, as a fraction of the power", ge=0, le=0.2)
    R: float = quantity(0.0, "p.u.", "resistance of the DC line, which loses R P^2", ge=0, le=10)
    pf_from: float = quantity(
        1.0, "-", "power factor of the rectifier, which draws reactive power; 1: none", ge=0.5, le=1
    )
    pf_to: float = quantity(1.0, "-", "power factor of the inverter, which draws reactive power; 1: none", ge=0.5, le=1)
    V_min: float = quantity(
        0.7, "p.u.", "voltage of either bus below which the power falls with its square", ge=0.1, le=1
    )
    T: float = quantity(
        0.02, "s", "time constant with which each end learns of the voltage at the other end", ge=0.001, le=10
    )

    @model_validator(mode="after")
    def _consistent(self) -> Hvdc:
        if not self.P_min <= self.P <= self.P_max:
            raise ValueError(f"P must be between P_min and P_max, given {self.P}, {self.P_min} and {self.P_max}")
        if self.P_min < 0.0 and (self.loss, self.R, self.pf_from, self.pf_to) != (0.0, 0.0, 1.0, 1.0):
            raise ValueError(f"P_min below 0 needs loss 0, R 0, pf_from 1 and pf_to 1, given {self.P_min:g}")
        return self


# What a device of a system may be.
DEVICES: list[type[DeviceModel]] = [Sssc, Statcom, Svc, Hvdc, *rows("devices", DeviceModel).values()]
