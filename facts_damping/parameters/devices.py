"""FACTS devices as data, in series or in parallel; impedances, voltages and currents on the system base."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity


class DeviceModel(ParameterModel):
    """What every kind has."""

    if TYPE_CHECKING:
        v_max: float
        rate_max: float

    name: Name
    kind: str
    response_time: float = quantity(0.0, "s", "first-order lag behind its reference; 0: none", ge=0, le=10)
    dead_time: float = quantity(0.0, "s", "time after which an accepted setpoint acts; 0: at once", ge=0, le=0.5)

    @model_validator(mode="before")
    @classmethod
    def _former(cls, given: Any) -> Any:
        if isinstance(given, dict) and "hold" in given:
            raise ValueError("'hold' given; allowed: 'watchdog.timeout' of the run, as it is called now")
        return given


class Series(DeviceModel):
    """What every kind in series has: two buses, or a line in which it stands next to its `from` or `to` bus.

    It acts behind an impedance, and where it is not installed it is its resistance alone.
    """

    from_bus: Name | None = Field(None, alias="from")
    to_bus: Name | None = Field(None, alias="to")
    line: Name | None = Field(None, description="the line it stands in, instead of `from` and `to`")
    end: Literal["from", "to"] = Field("from", description="which end of that line")
    rs: float = quantity(..., "p.u.", "resistance of the coupling transformer", ge=1e-6, le=1)
    xs: float = quantity(..., "p.u.", "reactance of the coupling transformer", gt=0, le=1)

    @model_validator(mode="after")
    def _one_place(self) -> Series:
        buses = [bus for bus in (self.from_bus, self.to_bus) if bus is not None]
        if len(buses) != (0 if self.line is not None else 2):
            raise ValueError("a device in series needs either `line`, or `from` and `to`")
        return self

    @property
    def ends(self) -> tuple[str, str]:
        """The two buses it stands between; empty while it is placed by its line."""
        return self.from_bus or "", self.to_bus or ""

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return self.line or "-".join(self.ends)


class Parallel(DeviceModel):
    """What every kind in parallel has: a bus. It is nothing where it is not installed."""

    bus: Name

    @property
    def buses(self) -> list[str]:
        """The buses of its ports."""
        return [self.bus]

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return self.bus


class Transmission(DeviceModel):
    """What every kind has that carries power between two buses: it is in service whether it is installed or not."""

    from_bus: Name = Field(..., alias="from")
    to_bus: Name = Field(..., alias="to")

    @property
    def buses(self) -> list[str]:
        """The buses of its ports, that to which it carries power first."""
        return [self.to_bus, self.from_bus]

    @property
    def place(self) -> str:
        """Where it stands, for people."""
        return f"{self.from_bus}-{self.to_bus}"


class Sssc(Series):
    """A static synchronous series compensator; its setpoint is a voltage in quadrature to its current.

    Regulators and DC link: docs/plant.md, after (2.87)-(2.89), (2.100)-(2.104) and appendix A.3.
    """

    kind: Literal["sssc"]
    rs: float = quantity(0.000053, "p.u.", "resistance of the coupling transformer", ge=1e-6, le=1)
    xs: float = quantity(0.0016, "p.u.", "reactance of the coupling transformer", gt=0, le=1)
    v_max: float = quantity(0.1, "p.u.", "limit of the quadrature voltage setpoint", gt=0, le=1)
    rate_max: float = quantity(5.0, "p.u./s", "rate limit of the quadrature voltage reference", gt=0, le=1000)
    vp_max: float = quantity(0.1, "p.u.", "limit of the active converter voltage", gt=0, le=1)
    vc_max: float = quantity(0.11, "p.u.", "limit of the converter voltage as a whole", gt=0, le=1)
    Kp: float = quantity(0.00375, "-", "injected-voltage regulator, proportional gain", ge=0, le=10)
    Ki: float = quantity(0.1875, "1/s", "injected-voltage regulator, integral gain", ge=0, le=1000)
    Kd: float = quantity(0.4, "p.u.", "DC voltage regulator, proportional gain", ge=0, le=100)
    Kdi: float = quantity(8.0, "p.u./s", "DC voltage regulator, integral gain", ge=0, le=1e4)
    tau: float = quantity(0.006, "s", "DC link, C V^2 / S of the system base", ge=0.001, le=10)
    g: float = quantity(0.0, "p.u.", "loss conductance of the DC link", ge=0, le=10)
    I_rated: float = quantity(10.0, "p.u.", "rated current; above it the DC regulator keeps its power", gt=0, le=1000)
    enforce_rating: bool = Field(False, description="above I_rated the converter is bypassed")
    I_min: float = quantity(0.02, "p.u.", "current below which the converter is blocked", gt=0, le=1)

    @model_validator(mode="after")
    def _consistent(self) -> Sssc:
        if self.vp_max >= self.vc_max:
            raise ValueError(f"vp_max must be below vc_max, given {self.vp_max} and {self.vc_max}")
        return self


class Statcom(Parallel):
    """A static synchronous compensator at a bus; its setpoint is an offset of its voltage reference.

    Regulators and DC link: docs/plant.md, after (2.90)-(2.92), (2.105)-(2.109) and appendix A.4.
    """

    kind: Literal["statcom"]
    R: float = quantity(0.0073, "p.u.", "resistance of the coupling transformer", ge=0, le=10)
    L: float = quantity(0.22, "p.u.", "reactance of the coupling transformer", gt=0, le=10)
    v_max: float = quantity(..., "p.u.", "limit of the setpoint, an offset of the voltage reference", gt=0, le=1)
    rate_max: float = quantity(..., "p.u./s", "rate limit of that offset", gt=0, le=1000)
    I_max: float = quantity(..., "p.u.", "limit of active and of reactive current", gt=0, le=1000)
    Kp: float = quantity(5.0, "p.u.", "AC voltage regulator, proportional gain: current per voltage", ge=0, le=1000)
    Ki: float = quantity(1000.0, "p.u./s", "AC voltage regulator, integral gain", ge=0, le=1e5)
    droop: float = quantity(0.0, "p.u.", "voltage per reactive current", ge=0, le=1)
    Kd: float = quantity(4.0, "p.u.", "DC voltage regulator, proportional gain: current per voltage", ge=0, le=1000)
    Kdi: float = quantity(80.0, "p.u./s", "DC voltage regulator, integral gain", ge=0, le=1e5)
    Kc: float = quantity(0.3, "p.u.", "current regulator, proportional gain", ge=0, le=100)
    Kci: float = quantity(10.0, "p.u./s", "current regulator, integral gain", ge=0, le=1e4)
    Kf: float = quantity(0.22, "p.u.", "current regulator, feed-forward of the transformer's voltage", ge=0, le=10)
    tau: float = quantity(0.006, "s", "DC link, C V^2 / S of the system base", ge=0.001, le=10)
    g: float = quantity(0.0, "p.u.", "loss conductance of the DC link", ge=0, le=10)
    enforce_rating: bool = Field(False, description="I_max limits the whole current, the active part first")
    V_min: float = quantity(0.05, "p.u.", "voltage of its bus below which the converter is blocked", gt=0, le=0.9)


class Svc(Parallel):
    """A static var compensator at a bus; its setpoint is an offset of its voltage reference: docs/plant.md."""

    kind: Literal["svc"]
    v_max: float = quantity(..., "p.u.", "limit of the setpoint, an offset of the voltage reference", gt=0, le=1)
    rate_max: float = quantity(..., "p.u./s", "rate limit of that offset", gt=0, le=1000)
    B_max: float = quantity(..., "p.u.", "limit of the susceptance, capacitive", gt=0, le=1000)
    B_min: float = quantity(..., "p.u.", "limit of the susceptance, inductive: negative", ge=-1000, le=0)
    K: float = quantity(..., "p.u.", "regulator, susceptance per voltage: the inverse of its slope", gt=0, le=1e4)
    T: float = quantity(0.05, "s", "time in which the susceptance follows", ge=0.001, le=10)
    V_min: float = quantity(0.05, "p.u.", "voltage of its bus below which it is blocked", gt=0, le=0.9)


class Hvdc(Transmission):
    """An HVDC link from a rectifier to an inverter; its setpoint is added to its power order: docs/plant.md."""

    kind: Literal["hvdc"]
    P: float = quantity(..., "MW", "power order, taken from the `from` bus", ge=0, le=1e5)
    P_max: float = quantity(..., "MW", "capacity, also with modulation", gt=0, le=1e5)
    P_min: float = quantity(0.0, "MW", "least power, also with modulation", ge=0, le=1e5)
    v_max: float = quantity(..., "p.u.", "limit of the setpoint, power added to the order", gt=0, le=1000)
    rate_max: float = quantity(..., "p.u./s", "ramp limit of that power", gt=0, le=1e4)
    loss: float = quantity(0.0, "-", "share of the power that the converters lose", ge=0, le=0.2)
    R: float = quantity(0.0, "p.u.", "resistance of the line: loses R P^2", ge=0, le=10)
    pf_from: float = quantity(1.0, "-", "power factor of the rectifier, which draws Q; 1: none", ge=0.5, le=1)
    pf_to: float = quantity(1.0, "-", "power factor of the inverter, which draws Q; 1: none", ge=0.5, le=1)
    V_min: float = quantity(0.7, "p.u.", "voltage of either bus below which power falls with its square", ge=0.1, le=1)
    T: float = quantity(0.02, "s", "time in which each end knows of the other's voltage", ge=0.001, le=10)

    @model_validator(mode="after")
    def _consistent(self) -> Hvdc:
        if not self.P_min <= self.P <= self.P_max:
            raise ValueError(f"P must be between P_min and P_max, given {self.P}, {self.P_min} and {self.P_max}")
        return self


# What a device of a system may be.
DEVICES: list[type[DeviceModel]] = [
    Sssc,
    Statcom,
    Svc,
    Hvdc,
]
