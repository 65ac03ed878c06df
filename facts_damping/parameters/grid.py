"""The network as data: buses, lines, transformers, loads, shunts, infinite buses."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity


class Bus(ParameterModel):
    """A node of the network."""

    name: Name
    nominal_voltage: float = quantity(..., "kV", "line-to-line voltage that is 1 p.u.", gt=0, le=2000)


class Line(ParameterModel):
    """A transmission line, per-unit-length data on the system base."""

    name: Name
    from_bus: Name = Field(..., alias="from")
    to_bus: Name = Field(..., alias="to")
    length: float = quantity(
        1.0, "km", "length; with 1 the other figures are those of the whole line", ge=1e-3, le=5000
    )
    r: float = quantity(..., "p.u./km", "series resistance", ge=0, le=10)
    x: float = quantity(..., "p.u./km", "series reactance", gt=0, le=10)
    b: float = quantity(0.0, "p.u./km", "shunt susceptance", ge=0, le=10)


class Transformer(ParameterModel):
    """A two-winding transformer, figures on its own rating."""

    name: Name
    from_bus: Name = Field(..., alias="from")
    to_bus: Name = Field(..., alias="to")
    rating: float = quantity(..., "MVA", "rated power", gt=0, le=1e5)
    r: float = quantity(0.0, "p.u.", "series resistance of both windings", ge=0, le=1)
    x: float = quantity(..., "p.u.", "series reactance of both windings", gt=0, le=10)
    tap: float = quantity(1.0, "p.u.", "off-nominal turns ratio, at the first bus", gt=0.5, lt=2)
    phase_shift: float = quantity(0.0, "deg", "angle by which the first bus leads at no load", ge=-180, le=180)
    magnetising_r: float | None = quantity(None, "p.u.", "iron-loss resistance; none: no such branch", gt=0, le=1e6)
    magnetising_x: float | None = quantity(None, "p.u.", "magnetising reactance; none: no such branch", gt=0, le=1e6)


SUM_TOLERANCE = 1e-9


class Shares(ParameterModel):
    """How a load's power depends on its voltage: shares of constant impedance, current and power, in all one."""

    impedance: float = quantity(0.0, "-", "share that goes with the square of the voltage", ge=0, le=1)
    current: float = quantity(0.0, "-", "share that goes with the voltage", ge=0, le=1)
    power: float = quantity(0.0, "-", "share that stays", ge=0, le=1)

    @model_validator(mode="after")
    def _sum(self) -> Shares:
        total = self.impedance + self.current + self.power
        if abs(total - 1.0) > SUM_TOLERANCE:
            raise ValueError(f"impedance + current + power must be 1, given {total:g}")
        return self


CONSTANT_IMPEDANCE = Shares(impedance=1.0)


class Load(ParameterModel):
    """A load: what it draws at a reference voltage V0, and how that depends on voltage (ZIP model) and frequency.

    P(V) = P [z (V/V0)^2 + i V/V0 + p] (1 + kpf df), the same for Q with its own shares and kqf (Kundur 1994, 7.1.1).
    """

    name: Name
    bus: Name
    at: Literal["solved", "nominal"] = Field(
        "solved", description="voltage at which it draws P and Q: that of the power flow, or 1 p.u."
    )
    P: float = quantity(..., "MW", "active power drawn", ge=-1e5, le=1e5)
    Q: float = quantity(0.0, "Mvar", "reactive power drawn", ge=-1e5, le=1e5)
    P_shares: Shares = CONSTANT_IMPEDANCE
    Q_shares: Shares = CONSTANT_IMPEDANCE
    V_min: float = quantity(
        0.7, "p.u. of V0", "voltage below which the shares of current and power become an impedance", gt=0, le=1
    )
    kpf: float = quantity(0.0, "p.u./p.u.", "active power per deviation of the bus's frequency", ge=-20, le=20)
    kqf: float = quantity(0.0, "p.u./p.u.", "reactive power per deviation of the bus's frequency", ge=-20, le=20)
    T_f: float = quantity(0.02, "s", "time constant of the lag and of the washout that give it", ge=0.01, le=10)


class Shunt(ParameterModel):
    """A capacitor (Q > 0) or reactor (Q < 0), with losses."""

    name: Name
    bus: Name
    Q: float = quantity(..., "Mvar", "reactive power given at 1 p.u. voltage", ge=-1e5, le=1e5)
    P: float = quantity(0.0, "MW", "active power drawn at 1 p.u. voltage", ge=0, le=1e5)


class InfiniteBus(ParameterModel):
    """A bus whose voltage never changes: the rest of a grid that is large beside what is modelled."""

    name: Name
    bus: Name
    V: float = quantity(1.0, "p.u.", "voltage", gt=0.5, le=1.5)
    angle: float = quantity(0.0, "deg", "angle of its voltage", ge=-360, le=360)
