"""The network as data: buses, lines, transformers, loads, shunts, infinite buses."""

from __future__ import annotations

from math import inf
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from facts_damping.fields import MINIMUM, Name, ParameterModel, quantity


def _other_than_zero(value: float) -> float:
    if abs(value) < MINIMUM:
        raise ValueError(f"{value:g} given; allowed: other than 0")
    return value


Reactance = Annotated[float, AfterValidator(_other_than_zero)]


class Bus(ParameterModel):
    """A node of the network."""

    name: Name = Field(..., description="name, unique among the buses")
    nominal_voltage: float = quantity(..., "kV", "line-to-line voltage that is 1 p.u.", gt=0, le=2000)
    position: list[float] | None = Field(
        None, min_length=2, max_length=2, description="place in the one-line diagram, right and up, in any unit"
    )


class Line(ParameterModel):
    """A transmission line; data per length, on the system base."""

    name: Name = Field(..., description="name, unique among lines, transformers and devices")
    from_bus: Name = Field(..., alias="from", description="first bus")
    to_bus: Name = Field(..., alias="to", description="second bus")
    length: float = quantity(1.0, "km", "length; with 1 the other values are those of the whole line", ge=1e-3, le=5000)
    r: float = quantity(..., "p.u./km", "series resistance", lowest=-inf, ge=0, le=10)
    x: Reactance = quantity(..., "p.u./km", "series reactance; below 0: of a series capacitor", ge=-10, le=10)
    b: float = quantity(0.0, "p.u./km", "shunt susceptance of both ends together", lowest=-inf, ge=0, le=10)


class Transformer(ParameterModel):
    """A two-winding transformer; impedances on its own rating."""

    name: Name = Field(..., description="name, unique among lines, transformers and devices")
    from_bus: Name = Field(..., alias="from", description="first bus, the side of the tap and the magnetising branch")
    to_bus: Name = Field(..., alias="to", description="second bus")
    rating: float = quantity(..., "MVA", "rated power, the base of its data", gt=0, le=1e5)
    r: float = quantity(0.0, "p.u.", "series resistance of both windings", lowest=-inf, ge=0, le=1)
    x: Reactance = quantity(..., "p.u.", "series reactance; below 0: in a star", ge=-10, le=10)
    tap: float = quantity(1.0, "p.u.", "off-nominal turns ratio at the first bus", gt=0.5, lt=2)
    phase_shift: float = quantity(0.0, "deg", "angle by which the first bus leads at no load", ge=-180, le=180)
    magnetising_r: float | None = quantity(None, "p.u.", "iron-loss resistance; none: not modelled", gt=0, le=1e6)
    magnetising_x: float | None = quantity(None, "p.u.", "magnetising reactance; none: not modelled", gt=0, le=1e6)


SUM_TOLERANCE = 1e-9


class Fractions(ParameterModel):
    """How the power of a load depends on its voltage: three fractions whose sum must be 1.

    A fraction that is not given is 0, so `{current: 1}` is a load of constant current.
    """

    impedance: float = quantity(0.0, "-", "fraction of constant impedance, with the square of the voltage", ge=0, le=1)
    current: float = quantity(0.0, "-", "fraction of constant current, with the voltage", ge=0, le=1)
    power: float = quantity(0.0, "-", "fraction of constant power", ge=0, le=1)

    @model_validator(mode="after")
    def _sum(self) -> Fractions:
        total = self.impedance + self.current + self.power
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"impedance + current + power must be 1, given {total:g}")
        return self


CONSTANT_IMPEDANCE = Fractions(impedance=1.0)


class Load(ParameterModel):
    """A [load](network.md) that depends on voltage (ZIP model: impedance, current, power) and frequency.

    `P(V) = P [z (V/V0)^2 + i V/V0 + p] (1 + kpf df)`, with the fractions z, i and p and the reference voltage V0. The
    same holds for Q with its own fractions and `kqf`.
    """

    name: Name = Field(..., description="name, unique among the loads")
    bus: Name = Field(..., description="bus to which it is connected")
    at: Literal["solved", "nominal"] = Field(
        "solved", description="reference voltage V0, at which it draws P and Q: that of the power flow, or 1 p.u."
    )
    P: float = quantity(..., "MW", "active power drawn at V0", ge=-1e5, le=1e5)
    Q: float = quantity(0.0, "Mvar", "reactive power drawn at V0", ge=-1e5, le=1e5)
    P_fractions: Fractions = Field(
        CONSTANT_IMPEDANCE, description="how P depends on the voltage; by default a constant impedance"
    )
    Q_fractions: Fractions = Field(
        CONSTANT_IMPEDANCE, description="how Q depends on the voltage; by default a constant impedance"
    )
    V_min: float = quantity(
        0.7, "p.u. of V0", "voltage below which the fractions of current and power become an impedance", gt=0, le=1
    )
    kpf: float = quantity(
        0.0, "p.u./p.u.", "change of active power per deviation of the frequency at its bus", ge=-20, le=20
    )
    kqf: float = quantity(
        0.0, "p.u./p.u.", "change of reactive power per deviation of the frequency at its bus", ge=-20, le=20
    )
    T_f: float = quantity(
        0.02, "s", "time constant of the lag and the washout that give this frequency", ge=0.01, le=10
    )


class Shunt(ParameterModel):
    """A capacitor (Q > 0) or a reactor (Q < 0), with losses."""

    name: Name = Field(..., description="name, unique among the shunts")
    bus: Name = Field(..., description="bus to which it is connected")
    Q: float = quantity(..., "Mvar", "reactive power given at a voltage of 1 p.u.", ge=-1e5, le=1e5)
    P: float = quantity(0.0, "MW", "active power drawn at a voltage of 1 p.u.", ge=-1e5, le=1e5)


class InfiniteBus(ParameterModel):
    """A source of constant voltage: the rest of a grid that is much larger than the modelled part.

    A system with an infinite bus has no slack machine.
    """

    name: Name = Field(..., description="name, unique among the infinite buses")
    bus: Name = Field(..., description="bus whose voltage it holds; without a machine or another infinite bus")
    V: float = quantity(1.0, "p.u.", "magnitude of the voltage", gt=0.5, le=1.5)
    angle: float = quantity(0.0, "deg", "angle of the voltage", ge=-360, le=360)
