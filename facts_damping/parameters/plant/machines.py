"""Synchronous machines and their controls as data: exciter, stabiliser, turbine and governor."""

from __future__ import annotations

import itertools
from math import inf
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union

from pydantic import BeforeValidator, Field, create_model, model_validator

from facts_damping.fields import PHYSICAL, Name, ParameterModel, quantity
from facts_damping.machine_controls.block_models import MODELS, quantity_of
from facts_damping.machine_controls.blocks import SHORTEST

# What each machine model needs beside P, V, H, D and Ra.
NEEDED = {
    "classical": ("Xd1",),
    "two_axis": ("Xd", "Xd1", "Td01", "Xq"),
    "cascade": ("Xd", "Xd1", "Xd2", "Td01", "Td02", "Xq", "Xq2", "Tq02"),
    "genrou": ("Xl", "Xd", "Xd1", "Xd2", "Td01", "Td02", "Xq", "Xq2", "Tq02"),
    "gensal": ("Xl", "Xd", "Xd1", "Xd2", "Td01", "Td02", "Xq", "Xq2", "Tq02"),
}


class Machine(ParameterModel):
    """A synchronous [machine](machines.md): its bus, its operating point and its data, on its own rating.

    There is what each model needs. Without `Xq1` and `Tq01` it has salient poles. Subtransient reactances must not
    exceed transient ones, nor these the synchronous ones, and `Xl` must be the smallest.

    Exactly one machine or grid-forming inverter is the slack, or none in a system with an infinite bus. Machines at the
    same bus hold the same voltage. A bus with an infinite bus has no machine.
    """

    forming: ClassVar[bool] = True  # a grid, with an angle of its own
    name: Name = Field(..., description="name, unique among machines and inverters")
    bus: Name = Field(..., description="bus to which it is connected")
    area: Name | None = Field(
        None, description="area, to tell interarea modes from local ones; given for all machines or for none"
    )
    rating: float = quantity(..., "MVA", "rated power, the base of its data", gt=0, le=1e5)
    model: Literal["classical", "two_axis", "cascade", "genrou", "gensal"] = Field(
        "genrou",
        description="`classical`: constant E' behind X'd; `two_axis`: transient circuits only; `cascade`: model of the "
        "thesis, corrected; `genrou`: standard subtransient model with leakage reactance; `gensal`: with salient "
        "poles, of which the field alone saturates",
    )
    P: float | None = quantity(None, "MW", "active power; not given for the slack machine", ge=-1e5, le=1e5)
    Q: float = quantity(0.0, "Mvar", "reactive power if machines share the bus; by ratings: the rest", ge=-1e5, le=1e5)
    V: float = quantity(..., "p.u.", "terminal voltage", gt=0.5, le=1.5)
    slack: bool = Field(False, description="true: the machine that balances the power flow")
    angle: float = quantity(0.0, "deg", "angle of the slack machine's terminal voltage", ge=-360, le=360)
    H: float = quantity(..., "s", "inertia constant", gt=0, le=1000)
    D: float = quantity(0.0, "p.u.", "damping torque per speed deviation", lowest=-inf, ge=0, le=1e4)
    Ra: float = quantity(0.0, "p.u.", "stator resistance", lowest=-inf, ge=0, le=0.5)
    speed_voltage: bool = Field(
        False, description="true: the speed multiplies the EMF, as in PSTess; only without saturation"
    )
    speed_torque: bool = Field(
        False,
        description="true: the turbine's torque is (P - D w)/(1 + w), as in PSS/E; false: its power is a torque",
    )
    Xl: float | None = quantity(None, "p.u.", "leakage reactance", ge=0, le=2)
    Xd: float | None = quantity(None, "p.u.", "d-axis synchronous reactance", gt=0, le=10)
    Xd1: float | None = quantity(None, "p.u.", "d-axis transient reactance X'd", gt=0, le=5)
    Xd2: float | None = quantity(None, "p.u.", "d-axis subtransient reactance X''d", gt=0, le=5)
    Xq: float | None = quantity(None, "p.u.", "q-axis synchronous reactance", gt=0, le=10)
    Xq1: float | None = quantity(None, "p.u.", "q-axis transient reactance X'q; none: salient poles", gt=0, le=5)
    Xq2: float | None = quantity(None, "p.u.", "q-axis subtransient reactance X''q", gt=0, le=5)
    Td01: float | None = quantity(None, "s", "d-axis transient open-circuit time constant T'd0", gt=0, le=100)
    Td02: float | None = quantity(None, "s", "d-axis subtransient open-circuit time constant T''d0", ge=0.005, le=10)
    Tq01: float | None = quantity(
        None, "s", "q-axis transient open-circuit time constant T'q0; none: salient poles", ge=0.005, le=100
    )
    Tq02: float | None = quantity(None, "s", "q-axis subtransient open-circuit time constant T''q0", ge=0.005, le=10)
    S10: float = quantity(
        0.0, "-", "saturation: extra field current at a flux of 1.0 p.u., relative to that without", ge=0, le=10
    )
    S12: float = quantity(
        0.0, "-", "saturation at a flux of 1.2 p.u., above `S10`; 0: no saturation, as for `classical`", ge=0, le=100
    )

    saturation: Literal["quadratic", "exponential"] = Field(
        "quadratic", description="form of the saturation; `exponential`: needs `S10` above 0"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Machine:
        missing = [name for name in NEEDED[self.model] if getattr(self, name) is None]
        if missing:
            raise ValueError(f"a machine of model {self.model} needs {', '.join(missing)}")
        if (self.Xq1 is None) != (self.Tq01 is None):
            raise ValueError("Xq1 and Tq01 must be given both or neither (neither: salient pole)")
        if self.model == "gensal" and self.Xq1 is not None:
            raise ValueError("Xq1: a machine of model gensal has salient poles; allowed: none")
        if self.saturation == "exponential" and self.S10 == 0 < self.S12:
            raise ValueError("S10: 0 given; allowed: above 0 where the saturation is exponential")
        for names in (("Xl", "Xd2", "Xd1", "Xd"), ("Xl", "Xq2", "Xq1", "Xq")):
            X = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
            falls = not PHYSICAL.get() and any(low > high for low, high in itertools.pairwise(X.values()))
            if PHYSICAL.get():
                X.pop(names[1], None)  # X'' may be Xl: no equation has the inverse of their difference
            if self.model != "classical" and (falls or list(X.values()).count(self.Xl) > 1):
                raise ValueError(f"{' < '.join(X)} must hold (X'' <= X' <= X), given {list(X.values())}")
        if self.S12 > 0 and not self.S10 < self.S12:
            raise ValueError(f"S10 must be below S12, given {self.S10:g} and {self.S12:g}")
        if self.S12 > 0 and self.model == "classical":
            raise ValueError("S12: a classical machine has no saturation")
        if self.S12 > 0 and self.speed_voltage:
            raise ValueError("speed_voltage: true given; allowed: false with saturation")
        if self.speed_voltage and self.speed_torque:
            raise ValueError(
                "speed_torque: true given; allowed: false with speed_voltage, which divides by the speed too"
            )
        if self.S10 > 0 and self.S12 == 0:
            raise ValueError(f"S10 = {self.S10:g} needs S12 above it")
        if self.slack == (self.P is not None):
            raise ValueError("P must be given for every machine but the slack, and not for that")
        return self


class ExciterModel(ParameterModel):
    """What all excitation systems have."""

    machine: Name = Field(..., description="machine to which it belongs; not a `classical` one")
    model: str
    KA: float = quantity(200.0, "p.u.", "regulator gain", gt=0, le=5000)
    TR: float = quantity(0.02, "s", "time constant of the voltage transducer; 0: none, else at least 2 ms", ge=0, le=10)
    KF: float = quantity(0.0, "p.u.", "gain of the rate feedback; 0: none", ge=0, le=10)
    TF: float = quantity(0.1, "s", "time constant of the rate feedback", ge=0.01, le=100)
    minimum: float | None = quantity(None, "p.u.", "lower limit of Efd (static) or of VR (dc)", ge=-100, le=0)
    maximum: float | None = quantity(None, "p.u.", "upper limit of Efd (static) or of VR (dc)", gt=0, le=100)

    @model_validator(mode="after")
    def _transducer(self) -> ExciterModel:
        if 0 < self.TR < 0.002:
            raise ValueError(f"TR must be 0 or at least 0.002 s, given {self.TR:g}")
        return self


class StaticExciter(ExciterModel):
    """A [static exciter](machines.md), with the transient gain reduction of IEEE ST1A; at most one per machine.

    A machine without an exciter has a constant field voltage.
    """

    model: Literal["static"] = Field(..., description="model of the exciter; if not given, `static`")
    TB: float = quantity(
        0.0, "s", "denominator of the transient gain reduction; 0: none, else at least 10 ms", ge=0, le=100
    )
    TC: float = quantity(0.0, "s", "numerator of the transient gain reduction; needs `TB`", ge=0, le=100)

    @model_validator(mode="after")
    def _reduction(self) -> StaticExciter:
        if 0 < self.TB < 0.01:
            raise ValueError(f"TB must be 0 or at least 0.01 s, given {self.TB:g}")
        if self.TC > 0 and self.TB == 0:
            raise ValueError(f"TC = {self.TC:g} needs TB above 0")
        return self


class DcExciter(ExciterModel):
    """A self-excited [DC exciter](machines.md), IEEE DC1A; at most one exciter per machine."""

    model: Literal["dc"] = Field(..., description="model of the exciter")
    TA: float = quantity(0.055, "s", "regulator time constant", ge=0.005, le=10)
    KE: float = quantity(1.0, "p.u.", "exciter constant", ge=-1, le=10)
    TE: float = quantity(0.36, "s", "exciter time constant", ge=0.01, le=10)
    AEX: float = quantity(0.0, "p.u.", "factor of the saturation SE(Efd) = AEX exp(BEX Efd)", ge=0, le=10)
    BEX: float = quantity(0.0, "1/p.u.", "exponent of the saturation", ge=0, le=10)


class Pss1a(ParameterModel):
    """A [power system stabiliser](machines.md) from the machine's own speed to its exciter; at most one per machine.

    `K s Tw/(1 + s Tw) (1 + s T1)/(1 + s T2) (1 + s T3)/(1 + s T4)`, numbered as in IEEE PSS1A. The defaults are
    those of Kundur's example 12.6.
    """

    machine: Name = Field(..., description="machine to which it belongs; with an exciter, unless the stabiliser is off")
    model: Literal["PSS1A"] = Field("PSS1A", description="model of the stabiliser; if not given, `PSS1A`")
    enabled: bool = Field(True, description="false: switched off")
    K: float = quantity(20.0, "p.u./p.u.", "gain", ge=-1000, le=1000)
    Tw: float = quantity(10.0, "s", "time constant of the washout", ge=0.01, le=1000)
    T1: float = quantity(0.05, "s", "numerator of the first lead-lag section", ge=0, le=100)
    T2: float = quantity(0.02, "s", "denominator of the first lead-lag section", ge=0.005, le=100)
    T3: float = quantity(3.0, "s", "numerator of the second lead-lag section", ge=0, le=100)
    T4: float = quantity(5.4, "s", "denominator of the second lead-lag section", ge=0.005, le=100)
    minimum: float = quantity(-0.2, "p.u.", "lower limit of the output", ge=-10, le=0)
    maximum: float = quantity(0.2, "p.u.", "upper limit of the output", ge=0, le=10)


class Hygov(ParameterModel):
    """A hydraulic turbine and its [governor](machines.md) (HYGOV), on the machine's rating; at most one per machine.

    A machine without a governor has constant mechanical power.
    """

    machine: Name = Field(..., description="machine to which it belongs")
    model: Literal["HYGOV"] = Field("HYGOV", description="model of turbine and governor; if not given, `HYGOV`")
    enabled: bool = Field(True, description="false: switched off")
    R: float = quantity(0.05, "p.u.", "permanent droop: speed per gate", ge=0, le=1)
    r: float = quantity(0.4, "p.u.", "temporary droop", gt=0, le=10)
    Tr: float = quantity(5.0, "s", "time constant of the temporary droop", ge=SHORTEST, le=100)
    Tf: float = quantity(0.05, "s", "time constant of the filter", ge=SHORTEST, le=10)
    Tg: float = quantity(0.2, "s", "time constant of the gate servo", ge=SHORTEST, le=100)
    rate_max: float = quantity(0.2, "p.u./s", "largest velocity of the gate", gt=0, le=10)
    gate_min: float = quantity(0.01, "p.u.", "smallest gate opening, below `gate_max`", ge=0.001, le=1)
    gate_max: float = quantity(1.0, "p.u.", "largest gate opening", gt=0, le=2)
    Tw: float = quantity(1.0, "s", "water starting time", ge=SHORTEST, le=20)
    At: float = quantity(1.2, "p.u.", "turbine gain: power per flow at rated head", gt=0, le=10)
    Dt: float = quantity(0.0, "p.u.", "turbine damping: power per speed deviation and gate", ge=0, le=10)
    q_nl: float = quantity(0.08, "p.u.", "flow at no load", ge=0, le=1)

    @model_validator(mode="after")
    def _gate(self) -> Hygov:
        if self.gate_min >= self.gate_max:
            raise ValueError(f"gate_min must be below gate_max, given {self.gate_min:g} and {self.gate_max:g}")
        return self


class BlockModel(ParameterModel):
    """What is a table of blocks."""

    if TYPE_CHECKING:
        model: str

    @model_validator(mode="after")
    def _times(self) -> BlockModel:
        for name in MODELS[self.model].fields.split():
            value = getattr(self, name)
            if quantity_of(name).time and 0.0 < value < SHORTEST:
                raise ValueError(f"{name} must be 0 or at least {SHORTEST:g} s, given {value:g}")
        return self


class BlockControl(BlockModel):
    """A control that is a [table of blocks](machines.md); at most one of its sort per machine."""

    machine: Name = Field(..., description="machine to which it belongs")
    model: str
    enabled: bool = Field(True, description="false: switched off")


def block_fields(name: str) -> dict[str, Any]:
    """The fields of a model of `MODELS`, all of them needed but for those without effect."""
    row = MODELS[name]
    fields: dict[str, Any] = {"model": (Literal[name], Field(..., description="model"))}
    for field in row.fields.split():
        about = quantity_of(field)
        default = 0.0 if field in (*row.ignored.split(), *row.optional.split()) else ...
        fields[field] = (float, quantity(default, about.unit, about.text, ge=about.minimum, le=about.maximum))
    return fields


def _block_control(name: str) -> Any:
    fields = block_fields(name)
    if MODELS[name].role == "exciter":
        for part, what in (("RC", "resistance"), ("XC", "reactance")):
            text = f"{what} of the load compensation: it controls |V + (RC + j XC) I|, I out of the machine"
            fields[part] = (float, quantity(0.0, "p.u.", text, ge=-10, le=10))
    return create_model(name, __base__=BlockControl, __doc__=f"{MODELS[name].text}.", **fields)


BLOCK_CONTROLS: dict[str, Any] = {
    name: _block_control(name) for name, row in MODELS.items() if row.role in ("exciter", "stabiliser", "governor")
}
globals().update(BLOCK_CONTROLS)  # where pickle looks for them

if TYPE_CHECKING:
    Exciter = StaticExciter | DcExciter
    Stabiliser = Pss1a
    Governor = Hygov
else:

    def _one_of(role: str, usual: str, *models: type) -> Any:
        """A control by its model; one that names none is the usual one."""
        choices = (*models, *(control for name, control in BLOCK_CONTROLS.items() if MODELS[name].role == role))

        def named(content: Any) -> Any:
            return {"model": usual, **content} if isinstance(content, dict) else content

        union = Annotated[Union[choices], Field(discriminator="model")]  # noqa: UP007 (made from the list)
        return Annotated[union, BeforeValidator(named)]

    Exciter = _one_of("exciter", "static", StaticExciter, DcExciter)
    Stabiliser = _one_of("stabiliser", "PSS1A", Pss1a)
    Governor = _one_of("governor", "HYGOV", Hygov)
