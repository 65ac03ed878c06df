"""A power system as data: the tables of a file under `config/systems`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import Model, Name, quantity

if TYPE_CHECKING:
    from collections.abc import Sequence


class Bus(Model):
    """A node of the network."""

    name: Name
    nominal_voltage: float = quantity(..., "kV", "line-to-line voltage that is 1 p.u.", gt=0, le=2000)


class Line(Model):
    """A transmission line, per-unit-length data on the system base."""

    name: Name
    from_bus: Name = Field(..., alias="from")
    to_bus: Name = Field(..., alias="to")
    length: float = quantity(1.0, "km", "length; with 1 the other figures are those of the whole line", gt=0, le=5000)
    r: float = quantity(..., "p.u./km", "series resistance", ge=0, le=10)
    x: float = quantity(..., "p.u./km", "series reactance", gt=0, le=10)
    b: float = quantity(0.0, "p.u./km", "shunt susceptance", ge=0, le=10)


class Transformer(Model):
    """A two-winding transformer, figures on its own rating."""

    name: Name
    from_bus: Name = Field(..., alias="from")
    to_bus: Name = Field(..., alias="to")
    rating: float = quantity(..., "MVA", "rated power", gt=0, le=1e5)
    r: float = quantity(0.0, "p.u.", "series resistance of both windings", ge=0, le=1)
    x: float = quantity(..., "p.u.", "series reactance of both windings", gt=0, le=2)
    magnetising_r: float | None = quantity(None, "p.u.", "iron-loss resistance; none: no such branch", gt=0, le=1e6)
    magnetising_x: float | None = quantity(None, "p.u.", "magnetising reactance; none: no such branch", gt=0, le=1e6)


class Load(Model):
    """A load of constant impedance, in the power flow too where its figures are those at nominal voltage."""

    name: Name
    bus: Name
    at: Literal["solved", "nominal"] = Field(
        "solved", description="voltage at which it draws P and Q: solved or 1 p.u."
    )
    P: float = quantity(..., "MW", "active power drawn", ge=-1e5, le=1e5)
    Q: float = quantity(0.0, "Mvar", "reactive power drawn", ge=-1e5, le=1e5)


class Shunt(Model):
    """A capacitor (Q > 0) or reactor (Q < 0)."""

    name: Name
    bus: Name
    Q: float = quantity(..., "Mvar", "reactive power given at 1 p.u. voltage", ge=-1e5, le=1e5)


class Machine(Model):
    """A synchronous machine: dispatch, and data on its own rating."""

    name: Name
    bus: Name
    rating: float = quantity(..., "MVA", "rated power, the base of its data", gt=0, le=1e5)
    model: Literal["cascade", "genrou"] = Field(
        "genrou",
        description="cascade: thesis (2.1)-(2.6), corrected; genrou: standard subtransient model with leakage",
    )
    P: float | None = quantity(None, "MW", "active power; none for the slack machine", ge=-1e5, le=1e5)
    V: float = quantity(..., "p.u.", "terminal voltage", gt=0.5, le=1.5)
    slack: bool = Field(False, description="the machine that balances the power flow: exactly one")
    angle: float = quantity(0.0, "deg", "angle of the slack machine's terminal voltage", ge=-360, le=360)
    H: float = quantity(..., "s", "inertia constant", gt=0, le=1000)
    D: float = quantity(0.0, "p.u.", "damping torque per speed deviation", ge=0, le=100)
    Ra: float = quantity(0.0, "p.u.", "stator resistance", ge=0, le=0.5)
    Xl: float = quantity(..., "p.u.", "leakage reactance", gt=0, le=2)
    Xd: float = quantity(..., "p.u.", "d-axis synchronous reactance", gt=0, le=10)
    Xd1: float = quantity(..., "p.u.", "d-axis transient reactance X'd", gt=0, le=5)
    Xd2: float = quantity(..., "p.u.", "d-axis subtransient reactance X''d", gt=0, le=5)
    Xq: float = quantity(..., "p.u.", "q-axis synchronous reactance", gt=0, le=10)
    Xq1: float = quantity(..., "p.u.", "q-axis transient reactance X'q", gt=0, le=5)
    Xq2: float = quantity(..., "p.u.", "q-axis subtransient reactance X''q; equal to Xd2", gt=0, le=5)
    Td01: float = quantity(..., "s", "d-axis transient open-circuit time constant T'd0", gt=0, le=100)
    Td02: float = quantity(..., "s", "d-axis subtransient open-circuit time constant T''d0", ge=0.005, le=10)
    Tq01: float = quantity(..., "s", "q-axis transient open-circuit time constant T'q0", ge=0.005, le=100)
    Tq02: float = quantity(..., "s", "q-axis subtransient open-circuit time constant T''q0", ge=0.005, le=10)

    @model_validator(mode="after")
    def _consistent(self) -> Machine:
        for names in (("Xl", "Xd2", "Xd1", "Xd"), ("Xl", "Xq2", "Xq1", "Xq")):
            values = [getattr(self, name) for name in names]
            if not (values[0] < values[1] <= values[2] <= values[3]) or values[0] == values[2]:
                raise ValueError(f"{' < '.join(names)} must hold, given {values}")
        if self.Xd2 != self.Xq2:
            raise ValueError(f"Xd2 and Xq2 must be equal (no subtransient saliency), given {self.Xd2} and {self.Xq2}")
        if self.slack == (self.P is not None):
            raise ValueError("P must be given for every machine but the slack, and not for that")
        return self


class Exciter(Model):
    """An excitation system. A machine without one keeps its field voltage constant."""

    machine: Name
    model: Literal["static", "dc"] = Field(
        "static", description="static: (2.24)-(2.28) with TA = TE = 0; dc: IEEE DC1A"
    )
    KA: float = quantity(200.0, "p.u.", "regulator gain", gt=0, le=5000)
    TR: float = quantity(0.02, "s", "time constant of the voltage transducer", ge=0.002, le=10)
    KF: float = quantity(0.0, "p.u.", "gain of the rate feedback", ge=0, le=10)
    TF: float = quantity(0.1, "s", "time constant of the rate feedback", ge=0.01, le=100)
    TA: float = quantity(0.055, "s", "regulator time constant (dc)", ge=0.005, le=10)
    KE: float = quantity(1.0, "p.u.", "exciter constant (dc)", ge=-1, le=10)
    TE: float = quantity(0.36, "s", "exciter time constant (dc)", ge=0.01, le=10)
    AEX: float = quantity(0.0, "p.u.", "saturation SE(Efd) = AEX exp(BEX Efd) (dc)", ge=0, le=10)
    BEX: float = quantity(0.0, "1/p.u.", "exponent of the saturation (dc)", ge=0, le=10)
    minimum: float | None = quantity(None, "p.u.", "lower limit: Efd (static), VR (dc); none: unlimited", ge=-100, le=0)
    maximum: float | None = quantity(None, "p.u.", "upper limit: Efd (static), VR (dc); none: unlimited", gt=0, le=100)


class Sssc(Model):
    """A static synchronous series compensator between two buses; impedances and voltages on the system base.

    Regulators and DC link: docs/plant.md, after (2.87)-(2.89), (2.100)-(2.104) and appendix A.3.
    """

    name: Name
    kind: Literal["sssc"] = "sssc"
    from_bus: Name = Field(..., alias="from")
    to_bus: Name = Field(..., alias="to")
    rs: float = quantity(0.000053, "p.u.", "resistance of the coupling transformer", gt=0, le=1)
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
    I_min: float = quantity(0.02, "p.u.", "current below which the converter is blocked", gt=0, le=1)

    @model_validator(mode="after")
    def _room(self) -> Sssc:
        if self.vp_max >= self.vc_max:
            raise ValueError(f"vp_max must be below vc_max, given {self.vp_max} and {self.vc_max}")
        return self


class Station(Model):
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


class Signal(Model):
    """A measured signal: a weighted sum of one channel over stations, or its deviation from the start."""

    channel: Literal["voltage_magnitude", "voltage_angle", "speed_deviation", "active_power", "reactive_power"]
    weights: dict[Name, float] = Field(..., min_length=1, description="station: weight")
    deviation: bool = Field(False, description="true: minus the value before the first event")


class Measures(Model):
    """The speed differences that the performance indices (4.108) sum up: names of signals."""

    local: list[Name] = []
    interarea: list[Name] = []


class System(Model):
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
    machines: list[Machine] = Field(..., min_length=1)
    exciters: list[Exciter] = []
    devices: list[Sssc] = []
    stations: list[Station] = Field(..., min_length=1)
    signals: dict[Name, Signal] = {}
    measures: Measures = Measures()

    @model_validator(mode="after")
    def _consistent(self) -> System:
        check_references(self)
        return self


def _unique(field: str, names: Sequence[str]) -> set[str]:
    """The names as a set; a name that stands twice is an error."""
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ValueError(f"{field}.{i}: '{name}' stands twice; allowed: each name once")
    return set(names)


def _known(field: str, name: str, allowed: set[str]) -> None:
    if name not in allowed:
        raise ValueError(f"{field}: '{name}' given; allowed: {', '.join(sorted(allowed)) or 'none'}")


def check_references(system: System) -> None:
    """Raise `ValueError` where a row names a bus, machine, branch, station or signal that is not there."""
    buses = _unique("buses", [b.name for b in system.buses])
    machines = _unique("machines", [m.name for m in system.machines])
    _unique("machines.*.bus", [m.bus for m in system.machines])
    _unique("exciters.*.machine", [e.machine for e in system.exciters])
    stations = _unique("stations", [s.name for s in system.stations])
    _unique("loads", [x.name for x in system.loads])
    _unique("shunts", [x.name for x in system.shunts])
    joined: list[tuple[str, Line | Transformer | Sssc]] = [("lines", row) for row in system.lines]
    joined += [("transformers", row) for row in system.transformers]
    joined += [("devices", row) for row in system.devices]
    branches = {row.name: {row.from_bus, row.to_bus} for _, row in joined}
    _unique("lines, transformers, devices", [row.name for _, row in joined])
    for field, row in joined:
        for end, bus in (("from", row.from_bus), ("to", row.to_bus)):
            _known(f"{field}: {row.name}.{end}", bus, buses)
        if row.from_bus == row.to_bus:
            raise ValueError(f"{field}: {row.name}.to: '{row.to_bus}' given twice; allowed: two different buses")
    standing: list[tuple[str, Load | Shunt | Machine]] = [("loads", load) for load in system.loads]
    standing += [("shunts", shunt) for shunt in system.shunts]
    standing += [("machines", machine) for machine in system.machines]
    for field, item in standing:
        _known(f"{field}: {item.name}.bus", item.bus, buses)
    for exciter in system.exciters:
        _known("exciters.*.machine", exciter.machine, machines)
    for station in system.stations:
        _known(f"stations: {station.name}", station.machine or station.bus or "", machines | buses)
        for branch in station.branches:
            _known(
                f"stations: {station.name}.branches",
                branch,
                {n for n, ends in branches.items() if station.bus in ends},
            )
    for name, signal in system.signals.items():
        for station_name in signal.weights:
            _known(f"signals: {name}.weights", station_name, stations)
    for name in (*system.measures.local, *system.measures.interarea):
        _known("measures", name, {n for n, s in system.signals.items() if s.channel == "speed_deviation"})
    slack = [m.name for m in system.machines if m.slack]
    if len(slack) != 1:
        raise ValueError(
            f"machines.*.slack: {len(slack)} slack machines given ({', '.join(slack)}); allowed: exactly one"
        )
