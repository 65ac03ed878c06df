"""Synchronous machines and their controls as data: exciter, stabiliser, turbine and governor."""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity

# What each machine model needs beside P, V, H, D and Ra.
NEEDED = {
    "classical": ("Xd1",),
    "two_axis": ("Xd", "Xd1", "Td01", "Xq"),
    "cascade": ("Xd", "Xd1", "Xd2", "Td01", "Td02", "Xq", "Xq2", "Tq02"),
    "genrou": ("Xl", "Xd", "Xd1", "Xd2", "Td01", "Td02", "Xq", "Xq2", "Tq02"),
}


class Machine(ParameterModel):
    """A synchronous machine: dispatch, and data on its own rating. What a model does not need may be left out.

    Without X'q and T'q0 the q axis has no transient circuit: a salient pole.
    """

    name: Name
    bus: Name
    area: Name | None = Field(None, description="area it belongs to: tells interarea from local modes")
    rating: float = quantity(..., "MVA", "rated power, the base of its data", gt=0, le=1e5)
    model: Literal["classical", "two_axis", "cascade", "genrou"] = Field(
        "genrou",
        description="classical: constant E' behind X'd; two_axis: transient circuits alone; "
        "cascade: thesis (2.1)-(2.6), corrected; genrou: standard subtransient model with leakage",
    )
    P: float | None = quantity(None, "MW", "active power; none for the slack machine", ge=-1e5, le=1e5)
    V: float = quantity(..., "p.u.", "terminal voltage", gt=0.5, le=1.5)
    slack: bool = Field(False, description="the machine that balances the power flow, where no infinite bus does")
    angle: float = quantity(0.0, "deg", "angle of the slack machine's terminal voltage", ge=-360, le=360)
    H: float = quantity(..., "s", "inertia constant", gt=0, le=1000)
    D: float = quantity(0.0, "p.u.", "damping torque per speed deviation", ge=0, le=100)
    Ra: float = quantity(0.0, "p.u.", "stator resistance", ge=0, le=0.5)
    Xl: float | None = quantity(None, "p.u.", "leakage reactance", gt=0, le=2)
    Xd: float | None = quantity(None, "p.u.", "d-axis synchronous reactance", gt=0, le=10)
    Xd1: float | None = quantity(None, "p.u.", "d-axis transient reactance X'd", gt=0, le=5)
    Xd2: float | None = quantity(None, "p.u.", "d-axis subtransient reactance X''d", gt=0, le=5)
    Xq: float | None = quantity(None, "p.u.", "q-axis synchronous reactance", gt=0, le=10)
    Xq1: float | None = quantity(None, "p.u.", "q-axis transient reactance X'q; none: salient pole", gt=0, le=5)
    Xq2: float | None = quantity(None, "p.u.", "q-axis subtransient reactance X''q", gt=0, le=5)
    Td01: float | None = quantity(None, "s", "d-axis transient open-circuit time constant T'd0", gt=0, le=100)
    Td02: float | None = quantity(None, "s", "d-axis subtransient open-circuit time constant T''d0", ge=0.005, le=10)
    Tq01: float | None = quantity(None, "s", "q-axis transient open-circuit time constant T'q0", ge=0.005, le=100)
    Tq02: float | None = quantity(None, "s", "q-axis subtransient open-circuit time constant T''q0", ge=0.005, le=10)
    S10: float = quantity(0.0, "-", "saturation: extra field current at 1.0 p.u. flux", ge=0, le=10)
    S12: float = quantity(0.0, "-", "saturation: extra field current at 1.2 p.u. flux; 0: none", ge=0, le=10)

    @model_validator(mode="after")
    def _consistent(self) -> Machine:
        missing = [name for name in NEEDED[self.model] if getattr(self, name) is None]
        if missing:
            raise ValueError(f"a machine of model {self.model} needs {', '.join(missing)}")
        if (self.Xq1 is None) != (self.Tq01 is None):
            raise ValueError("Xq1 and Tq01 must be given both or neither (neither: salient pole)")
        for names in (("Xl", "Xd2", "Xd1", "Xd"), ("Xl", "Xq2", "Xq1", "Xq")):
            given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
            falls = any(low > high for low, high in itertools.pairwise(given.values()))
            if self.model != "classical" and (falls or list(given.values()).count(self.Xl) > 1):
                raise ValueError(f"{' < '.join(given)} must hold (X'' <= X' <= X), given {list(given.values())}")
        if self.S12 > 0 and not self.S10 < self.S12:
            raise ValueError(f"S10 must be below S12, given {self.S10:g} and {self.S12:g}")
        if self.S12 > 0 and self.model == "classical":
            raise ValueError("S12: a classical machine has no saturation")
        if self.S10 > 0 and self.S12 == 0:
            raise ValueError(f"S10 = {self.S10:g} needs S12 above it")
        if self.slack == (self.P is not None):
            raise ValueError("P must be given for every machine but the slack, and not for that")
        return self


class ExciterModel(ParameterModel):
    """What every excitation system has. A machine without one keeps its field voltage constant."""

    machine: Name
    model: str
    KA: float = quantity(200.0, "p.u.", "regulator gain", gt=0, le=5000)
    TR: float = quantity(0.02, "s", "time constant of the voltage transducer; 0: none, else at least 2 ms", ge=0, le=10)
    KF: float = quantity(0.0, "p.u.", "gain of the rate feedback", ge=0, le=10)
    TF: float = quantity(0.1, "s", "time constant of the rate feedback", ge=0.01, le=100)
    minimum: float | None = quantity(None, "p.u.", "lower limit: Efd (static), VR (dc); none: unlimited", ge=-100, le=0)
    maximum: float | None = quantity(None, "p.u.", "upper limit: Efd (static), VR (dc); none: unlimited", gt=0, le=100)

    @model_validator(mode="after")
    def _transducer(self) -> ExciterModel:
        if 0 < self.TR < 0.002:
            raise ValueError(f"TR must be 0 or at least 0.002 s, given {self.TR:g}")
        return self


class StaticExciter(ExciterModel):
    """A thyristor exciter: (2.24)-(2.28) with TA = TE = 0, and IEEE ST1A's transient gain reduction."""

    model: Literal["static"]
    TB: float = quantity(0.0, "s", "transient gain reduction, denominator; 0: none, else at least 10 ms", ge=0, le=100)
    TC: float = quantity(0.0, "s", "transient gain reduction, numerator", ge=0, le=100)

    @model_validator(mode="after")
    def _reduction(self) -> StaticExciter:
        if 0 < self.TB < 0.01:
            raise ValueError(f"TB must be 0 or at least 0.01 s, given {self.TB:g}")
        if self.TC > 0 and self.TB == 0:
            raise ValueError(f"TC = {self.TC:g} needs TB above 0")
        return self


class DcExciter(ExciterModel):
    """A self-excited DC exciter, IEEE DC1A."""

    model: Literal["dc"]
    TA: float = quantity(0.055, "s", "regulator time constant", ge=0.005, le=10)
    KE: float = quantity(1.0, "p.u.", "exciter constant", ge=-1, le=10)
    TE: float = quantity(0.36, "s", "exciter time constant", ge=0.01, le=10)
    AEX: float = quantity(0.0, "p.u.", "saturation SE(Efd) = AEX exp(BEX Efd)", ge=0, le=10)
    BEX: float = quantity(0.0, "1/p.u.", "exponent of the saturation", ge=0, le=10)


def _named(content: Any) -> Any:
    """An exciter that names no model is static."""
    return {"model": "static", **content} if isinstance(content, dict) else content


Exciter = Annotated[
    Annotated[StaticExciter | DcExciter, Field(discriminator="model")],
    BeforeValidator(_named),
]


class Stabiliser(ParameterModel):
    """A power system stabiliser at a machine's speed: K s Tw/(1+s Tw) (1+s T1)/(1+s T2) (1+s T3)/(1+s T4).

    (2.31)-(2.34), whose T1, T3 and T2, T4 are T1, T2 and T3, T4 here, as in IEEE PSS1A. Its output adds to
    the exciter's reference.
    """

    machine: Name
    enabled: bool = Field(True, description="false: there, but switched off")
    K: float = quantity(20.0, "p.u./p.u.", "gain", ge=-1000, le=1000)
    Tw: float = quantity(10.0, "s", "time constant of the washout", ge=0.01, le=1000)
    T1: float = quantity(0.05, "s", "numerator of the first lead-lag section", ge=0, le=100)
    T2: float = quantity(0.02, "s", "denominator of the first lead-lag section", ge=0.005, le=100)
    T3: float = quantity(3.0, "s", "numerator of the second lead-lag section", ge=0, le=100)
    T4: float = quantity(5.4, "s", "denominator of the second lead-lag section", ge=0.005, le=100)
    minimum: float = quantity(-0.2, "p.u.", "lower limit of the output", ge=-10, le=0)
    maximum: float = quantity(0.2, "p.u.", "upper limit of the output", ge=0, le=10)


class Governor(ParameterModel):
    """A hydraulic turbine with its governor (HYGOV), on the machine's rating. Without one Pm is constant."""

    machine: Name
    enabled: bool = Field(True, description="false: there, but switched off")
    R: float = quantity(0.05, "p.u.", "permanent droop: speed per gate", ge=0, le=1)
    r: float = quantity(0.4, "p.u.", "temporary droop", gt=0, le=10)
    Tr: float = quantity(5.0, "s", "time constant of the temporary droop", ge=0.05, le=100)
    Tf: float = quantity(0.05, "s", "time constant of the filter", ge=0.01, le=10)
    Tg: float = quantity(0.2, "s", "time constant of the gate servo", ge=0.01, le=10)
    rate_max: float = quantity(0.2, "p.u./s", "limit of the gate's velocity", gt=0, le=10)
    gate_min: float = quantity(0.01, "p.u.", "smallest gate", ge=0.001, le=1)
    gate_max: float = quantity(1.0, "p.u.", "largest gate", gt=0, le=2)
    Tw: float = quantity(1.0, "s", "water starting time", ge=0.05, le=20)
    At: float = quantity(1.2, "p.u.", "turbine gain: power per flow at rated head", gt=0, le=10)
    Dt: float = quantity(0.0, "p.u.", "turbine damping: power per speed deviation and gate", ge=0, le=10)
    q_nl: float = quantity(0.08, "p.u.", "flow at no load", ge=0, le=1)

    @model_validator(mode="after")
    def _gate(self) -> Governor:
        if self.gate_min >= self.gate_max:
            raise ValueError(f"gate_min must be below gate_max, given {self.gate_min:g} and {self.gate_max:g}")
        return self
