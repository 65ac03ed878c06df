"""What devices have by where they stand: in series, in parallel, between two buses, or at a machine or inverter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity

KIND: Any = Field(..., description="kind of device")


def switch(description: str) -> Any:
    """A field that is true or false, and false if not given."""
    return Field(False, description=description)


def text(description: str) -> Any:
    """A field of one of several words, which must be given."""
    return Field(..., description=description)


class DeviceModel(ParameterModel):
    """A device that a run can install. The sections that follow have its kinds."""

    if TYPE_CHECKING:
        setpoint_max: float
        rate_max: float

    permanent: ClassVar[bool] = False  # in service whether a run installs it or not
    name: Name = Field(..., description="name, unique among lines, transformers and devices")
    kind: str
    response_time: float = quantity(
        0.0, "s", "time constant of the first-order lag behind the reference; 0: none", ge=0, le=10
    )
    dead_time: float = quantity(0.0, "s", "time after which an accepted setpoint acts; 0: at once", ge=0, le=0.5)

    @model_validator(mode="before")
    @classmethod
    def _former(cls, fields: Any) -> Any:
        if isinstance(fields, dict) and "hold" in fields:
            raise ValueError("'hold' given; allowed: 'watchdog.timeout' of the run, its new name")
        return fields

    @model_validator(mode="after")
    def _placed_and_checked(self) -> DeviceModel:  # extensions have validators of other names
        self.check_place()
        self.check()
        return self

    def check_place(self) -> None:
        """Raise `ValueError` where it is not clear where the device stands."""

    def check(self) -> None:
        """Raise `ValueError` where fields of a kind contradict each other."""


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

    def check_place(self) -> None:
        """A line, or two buses."""
        buses = [bus for bus in (self.from_bus, self.to_bus) if bus is not None]
        if len(buses) != (0 if self.line is not None else 2):
            raise ValueError("a device in series needs either `line`, or `from` and `to`")

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
    """What all kinds in parallel have: a bus. One that is neither installed nor permanent does nothing."""

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

    permanent: ClassVar[bool] = True
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


class AtUnit(DeviceModel):
    """What all kinds have that act on the controls of a machine or inverter. One not installed does nothing."""

    @property
    def buses(self) -> list[str]:
        """The buses of its ports: it has none."""
        return []


class AtMachine(AtUnit):
    """What all kinds have that act on a machine's controls."""

    machine: Name = Field(..., description="machine on whose exciter it acts")

    @property
    def place(self) -> str:
        """The machine."""
        return self.machine


class AtInverter(AtUnit):
    """What all kinds have that act on an inverter's controls."""

    inverter: Name = Field(..., description="inverter on whose controls it acts")
    input: str

    @property
    def place(self) -> str:
        """The inverter."""
        return self.inverter
