"""Controls of machines as tables of blocks: the models of the PSS/E library by their names and in their order of data.

A model is a list of `Block`s; the next one is a row of `MODELS`. It is data: `plant.block_controls` knows the kinds.
References: IEEE Std 421.5 (exciters, stabilisers), IEEE Committee Report, Dynamic Models for Steam and Hydro Turbines
in Power System Studies, 1973 (governors), IEEE Committee Report, Excitation System Models for Power System Stability
Studies, 1981 (EXST1, IEEEST), PSS/E Model Library.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    Constant = str | float | Callable[[Any], float]  # a field, a number, or a number that follows from fields

Role = Literal["exciter", "stabiliser", "governor"]

TABLES: dict[Role, str] = {"exciter": "exciters", "stabiliser": "stabilisers", "governor": "governors"}  # of a system

SHORTEST = 0.002  # s, of time constants; 0: a block without state


class Block(NamedTuple):
    """A block: the signal that it gives, its kind, what goes in, constants, and limits of its output or state."""

    name: str
    kind: str  # of plant.block_controls.KINDS
    inputs: str  # signals with signs: "Vref + Vs - VT"; with factors of constants: "K1 * P4 + K3 * P5"
    constants: tuple[Constant, ...] = ()
    low: Constant | None = None
    high: Constant | None = None
    low_of: str = "one"  # the signal that the limit is a multiple of
    high_of: str = "one"


class Model(NamedTuple):
    """A control: what it is for, its fields in the order of a DYR record, its blocks; the last one's output counts."""

    role: Role
    text: str
    fields: str
    blocks: tuple[Block, ...]
    ignored: str = ""  # fields of the record that have no effect here
    factors: dict[str, Callable[[Any], float]] = {}  # of inputs, that follow from fields
    record: bool = True  # whether it is one of the PSS/E library's, with fields in the order of a DYR record there


class Quantity(NamedTuple):
    """Unit, what it is, least and greatest value; `time`: 0 or at least `SHORTEST`."""

    unit: str
    text: str
    minimum: float = -1e4
    maximum: float = 1e4
    time: bool = False


def saturation(field: Any) -> tuple[float, float]:
    """A and B of SE(E) E = B (E - A)^2 above A, through SE1 at E1 and SE2 at E2; B = 0 where E1 is 0: none."""
    first, second = field.SE1 * field.E1, field.SE2 * field.E2
    if second <= 0.0 or field.E1 <= 0.0 or field.E1 == field.E2:
        return 0.0, 0.0
    root = math.sqrt(max(first, 0.0) / second)
    if root >= 1.0:
        return 0.0, 0.0
    A = (field.E1 - root * field.E2) / (1.0 - root)
    return A, second / ((field.E2 - A) * (field.E2 - A))


def exponential(field: Any) -> tuple[float, float]:
    """A and B of SE(E) = A exp(B E) through SE1 at E1 and SE2 at E2; A = 0 where one of them is 0: none."""
    if field.SE1 <= 0.0 or field.SE2 <= 0.0 or field.E1 == field.E2:
        return 0.0, 0.0
    B = math.log(field.SE1 / field.SE2) / (field.E1 - field.E2)
    return field.SE1 * math.exp(-B * field.E1), B


# Excitation systems -------------------------------------------------------------------------------------------------

_SEEN = Block("VT", "lag", "Vt", (1.0, "TR"))
_A: Callable[[Any], float] = lambda f: saturation(f)[0]  # noqa: E731 (constants are written beside each other)
_B: Callable[[Any], float] = lambda f: saturation(f)[1]  # noqa: E731
_EXP_A: Callable[[Any], float] = lambda f: exponential(f)[0]  # noqa: E731
_EXP_B: Callable[[Any], float] = lambda f: exponential(f)[1]  # noqa: E731
_REDUCTION = Block("VB", "lead_lag", "Vref + Vs - Vt", (1.0, lambda f: f.TATB * f.TB, "TB"))
_DC_FIELDS = "TR KA TA TB TC VRMAX VRMIN KE TE KF TF1 SWITCH E1 SE1 E2 SE2"


def _dc(limited_by: str, gives: str = "Efd") -> tuple[Block, ...]:
    """IEEE type DC1 (limits constant) and DC2 (limits in proportion to the terminal voltage)."""
    return (
        _SEEN,
        Block("VF", "rate", gives, ("KF", "TF1")),
        Block("error", "sum", "Vref + Vs - VT - VF"),
        Block("VB", "lead_lag", "error", (1.0, "TC", "TB")),
        Block("VR", "lag", "VB", ("KA", "TA"), "VRMIN", "VRMAX", limited_by, limited_by),
        Block(gives, "field", "VR", ("KE", "TE", _A, _B)),
    )


_EXCITERS = {
    "IEEEX1": Model("exciter", "IEEE type 1 of 1979 (DC1A), a rotating DC exciter", _DC_FIELDS, _dc("one"), "SWITCH"),
    "EXDC2": Model(
        "exciter",
        "IEEE type DC2 of 1981: limits follow the voltage, the field voltage the speed",
        _DC_FIELDS,
        (*_dc("Vt", "VX"), Block("speed", "sum", "one + omega"), Block("Efd", "product", "VX + speed")),
        "SWITCH",
    ),
    "ESDC2A": Model("exciter", "IEEE type DC2A of 1992, limits follow the voltage", _DC_FIELDS, _dc("Vt"), "SWITCH"),
    "DC4B": Model(
        "exciter",
        "IEEE type DC4B of 2005, a rotating DC exciter with a PID regulator",
        "TR KP KI KD TD KA TA VRMAX VRMIN KE TE KF TF E1 SE1 E2 SE2",
        (
            _SEEN,
            Block("VF", "rate", "Efd", ("KF", "TF")),
            Block("error", "sum", "Vref + Vs - VT - VF"),
            Block("integral", "integral", "error", ("KI",), lambda f: f.VRMIN / f.KA, lambda f: f.VRMAX / f.KA),
            Block("rate", "rate", "error", ("KD", "TD")),
            Block("PID", "sum", "KP * error + integral + rate", (), lambda f: f.VRMIN / f.KA, lambda f: f.VRMAX / f.KA),
            Block("VR", "lag", "PID", ("KA", "TA"), "VRMIN", "VRMAX"),
            Block("Efd", "exponential", "VR", ("KE", "TE", _EXP_A, _EXP_B)),
        ),
        record=False,
    ),
    "IEEET1": Model(
        "exciter",
        "IEEE type 1 of 1968, a rotating DC exciter",
        "TR KA TA VRMAX VRMIN KE TE KF TF SWITCH E1 SE1 E2 SE2",
        (
            _SEEN,
            Block("VF", "rate", "Efd", ("KF", "TF")),
            Block("VR", "lag", "Vref + Vs - VT - VF", ("KA", "TA"), "VRMIN", "VRMAX"),
            Block("Efd", "field", "VR", ("KE", "TE", _A, _B)),
        ),
        "SWITCH",
    ),
    "IEEET2": Model(
        "exciter",
        "IEEE type 2 of 1968, rate feedback from the regulator",
        "TR KA TA VRMAX VRMIN KE TE KF TF1 TF2 E1 SE1 E2 SE2",
        (
            _SEEN,
            Block("rate", "rate", "VR", ("KF", "TF1")),
            Block("VF", "lag", "rate", (1.0, "TF2")),
            Block("VR", "lag", "Vref + Vs - VT - VF", ("KA", "TA"), "VRMIN", "VRMAX"),
            Block("Efd", "field", "VR", ("KE", "TE", _A, _B)),
        ),
    ),
    "EXST1": Model(
        "exciter",
        "IEEE type ST1 of 1981, a static exciter fed by the terminals",
        "TR VIMAX VIMIN TC TB KA TA VRMAX VRMIN KC KF TF",
        (
            _SEEN,
            Block("VF", "rate", "VR", ("KF", "TF")),
            Block("VI", "sum", "Vref + Vs - VT - VF", (), "VIMIN", "VIMAX"),
            Block("VB", "lead_lag", "VI", (1.0, "TC", "TB")),
            Block("VR", "lag", "VB", ("KA", "TA")),
            Block("minimum", "sum", "VRMIN * Vt - KC * Ifd"),
            Block("maximum", "sum", "VRMAX * Vt - KC * Ifd"),
            Block("Efd", "sum", "VR", (), 1.0, 1.0, "minimum", "maximum"),
        ),
    ),
    "EXST3": Model(
        "exciter",
        "IEEE type ST3 of 1981, a static exciter fed by voltage and current",
        "TR VIMAX VIMIN KJ TC TB KA TA VRMAX VRMIN KG KP KI EFDMAX KC XL VGMAX THETAP",
        (
            _SEEN,
            Block("VI", "sum", "Vref + Vs - VT", (), "VIMIN", "VIMAX"),
            Block("VA", "lead_lag", "VI", ("KJ", "TC", "TB")),
            Block("VG", "sum", "KG * Efd", (), None, "VGMAX"),
            Block("VR", "lag", "VA - VG", ("KA", "TA"), "VRMIN", "VRMAX"),
            Block("VE", "source", "Vd + Vq + Id + Iq", ("KP", "THETAP", "KI", "XL")),
            Block("VB", "rectifier", "VE + Ifd", ("KC",)),
            Block("supplied", "product", "VB + VR"),
            Block("Efd", "sum", "supplied", (), None, "EFDMAX"),
        ),
    ),
    "ESST3A": Model(
        "exciter",
        "IEEE type ST3A of 1992, a static exciter with an inner loop of the field voltage",
        "TR VIMAX VIMIN KM TC TB KA TA VRMAX VRMIN KG KP KI VBMAX KC XL VGMAX THETAP TM VMMAX VMMIN",
        (
            _SEEN,
            Block("VI", "sum", "Vref + Vs - VT", (), "VIMIN", "VIMAX"),
            Block("VA", "lead_lag", "VI", (1.0, "TC", "TB")),
            Block("VR", "lag", "VA", ("KA", "TA"), "VRMIN", "VRMAX"),
            Block("VE", "source", "Vd + Vq + Id + Iq", ("KP", "THETAP", "KI", "XL")),
            Block("rectified", "rectifier", "VE + Ifd", ("KC",)),
            Block("VB", "sum", "rectified", (), None, "VBMAX"),
            Block("VG", "sum", "KG * Efd", (), None, "VGMAX"),
            Block("VM", "lag", "VR - VG", ("KM", "TM"), "VMMIN", "VMMAX"),
            Block("Efd", "product", "VB + VM"),
        ),
    ),
    "SEXS": Model(
        "exciter",
        "simplified excitation system",
        "TATB TB K TE EMIN EMAX",
        (_REDUCTION, Block("Efd", "lag", "VB", ("K", "TE"), "EMIN", "EMAX")),
    ),
    "SCRX": Model(
        "exciter",
        "static exciter fed by the terminals (CSWITCH 0) or by a constant source (1)",
        "TATB TB K TE EMIN EMAX CSWITCH RCRFD",
        (
            _REDUCTION,
            Block("VR", "lag", "VB", ("K", "TE"), "EMIN", "EMAX"),
            Block("supply", "sum", "SOLID * one + FED * Vt"),
            Block("Efd", "product", "VR + supply"),
        ),
        "RCRFD",
        {"SOLID": lambda f: float(f.CSWITCH == 1.0), "FED": lambda f: float(f.CSWITCH != 1.0)},
    ),
}

# Turbines and governors ---------------------------------------------------------------------------------------------

_GOVERNORS = {
    "TGOV1": Model(
        "governor",
        "steam turbine with a governor",
        "R T1 VMAX VMIN T2 T3 DT",
        (
            Block("valve", "lag", "Pref - GAIN * omega", (1.0, "T1"), "VMIN", "VMAX"),
            Block("reheat", "lead_lag", "valve", (1.0, "T2", "T3")),
            Block("Pm", "sum", "reheat - DT * omega"),
        ),
        factors={"GAIN": lambda f: 1.0 / f.R},
    ),
    "IEEEG1": Model(
        "governor",
        "steam turbine of IEEE type 1; all its power acts on one shaft",
        "JBUS JM K T1 T2 T3 UO UC PMAX PMIN T4 K1 K2 T5 K3 K4 T6 K5 K6 T7 K7 K8",
        (
            Block("speed", "lead_lag", "omega", ("K", "T2", "T1")),
            Block("valve", "servo", "Pref - speed", ("T3", "UC", "UO"), "PMIN", "PMAX"),
            Block("P4", "lag", "valve", (1.0, "T4")),
            Block("P5", "lag", "P4", (1.0, "T5")),
            Block("P6", "lag", "P5", (1.0, "T6")),
            Block("P7", "lag", "P6", (1.0, "T7")),
            Block("Pm", "sum", "K12 * P4 + K34 * P5 + K56 * P6 + K78 * P7"),
        ),
        "JBUS JM",
        {
            "K12": lambda f: f.K1 + f.K2,
            "K34": lambda f: f.K3 + f.K4,
            "K56": lambda f: f.K5 + f.K6,
            "K78": lambda f: f.K7 + f.K8,
        },
    ),
    "IEESGO": Model(
        "governor",
        "IEEE standard turbine and governor",
        "T1 T2 T3 T4 T5 T6 K1 K2 K3 PMAX PMIN",
        (
            Block("speed", "lag", "omega", ("K1", "T1")),
            Block("lead", "lead_lag", "speed", (1.0, "T2", "T3")),
            Block("wanted", "sum", "Pref - lead", (), "PMIN", "PMAX"),
            Block("P4", "lag", "wanted", (1.0, "T4")),
            Block("P5", "lag", "P4", ("K2", "T5")),
            Block("P6", "lag", "P5", ("K3", "T6")),
            Block("Pm", "sum", "HIGH * P4 + MIDDLE * P5 + P6"),
        ),
        factors={"HIGH": lambda f: 1.0 - f.K2, "MIDDLE": lambda f: 1.0 - f.K3},
    ),
    "TG": Model(
        "governor",
        "turbine and governor of PST (`tg`); TW: water starting time, 0 for steam",
        "R TS TC T3 TW T5 VMAX",
        (
            Block("order", "sum", "Pref - GAIN * omega", (), 0.0, "VMAX"),
            Block("servo", "lag", "order", (1.0, "TS")),
            Block("turbine", "lead_lag", "servo", (1.0, "T3", "TC")),
            Block("Pm", "lead_lag", "turbine", (1.0, lambda f: -f.TW, "T5")),
        ),
        factors={"GAIN": lambda f: 1.0 / f.R},
        record=False,
    ),
}

# Power system stabilisers -------------------------------------------------------------------------------------------


def _first(name: str) -> Callable[[Any], float]:
    """The numerator of IEEEST belongs to its first filter where the second has no denominator."""
    return lambda f: float(getattr(f, name)) if f.A3 == f.A4 == 0.0 else 0.0


def _second(name: str) -> Callable[[Any], float]:
    return lambda f: 0.0 if f.A3 == f.A4 == 0.0 else float(getattr(f, name))


_STABILISERS = {
    "IEEEST": Model(
        "stabiliser",
        "IEEE stabiliser of one input",
        "IC IB A1 A2 A3 A4 A5 A6 T1 T2 T3 T4 T5 T6 KS LSMAX LSMIN VCU VCL",
        (
            Block("F1", "second_order", "input", (_first("A5"), _first("A6"), "A1", "A2")),
            Block("F2", "second_order", "F1", (_second("A5"), _second("A6"), "A3", "A4")),
            Block("L1", "lead_lag", "F2", (1.0, "T1", "T2")),
            Block("L2", "lead_lag", "L1", (1.0, "T3", "T4")),
            Block("washed", "washout", "L2", (lambda f: f.KS * (f.T5 / f.T6 if f.T6 > 0 else 1.0), "T6")),
            Block("Vs", "sum", "washed", (), "LSMIN", "LSMAX"),
        ),
        "IB VCU VCL",
    ),
    "ST2CUT": Model(
        "stabiliser",
        "stabiliser of two inputs",
        "IC IB IC2 IB2 K1 K2 T1 T2 T3 T4 T5 T6 T7 T8 T9 T10 LSMAX LSMIN VCU VCL",
        (
            Block("in_1", "lag", "input", ("K1", "T1")),
            Block("in_2", "lag", "input_2", ("K2", "T2")),
            Block("washed", "washout", "in_1 + in_2", (lambda f: f.T3 / f.T4 if f.T4 > 0 else 1.0, "T4")),
            Block("L1", "lead_lag", "washed", (1.0, "T5", "T6")),
            Block("L2", "lead_lag", "L1", (1.0, "T7", "T8")),
            Block("L3", "lead_lag", "L2", (1.0, "T9", "T10")),
            Block("Vs", "sum", "L3", (), "LSMIN", "LSMAX"),
        ),
        "IB IB2 VCU VCL",
    ),
    "STAB2A": Model(
        "stabiliser",
        "stabiliser of electrical power (ASEA)",
        "K2 T2 K3 T3 K4 K5 T5 HLIM",
        (
            Block("W1", "washout", "-Pe", ("K2", "T2")),
            Block("W2", "washout", "W1", ("K2", "T2")),
            Block("W3", "washout", "W2", ("K2", "T2")),
            Block("low", "lag", "W3", ("K3", "T3")),
            Block("S1", "lag", "low + K4 * W3", ("K5", "T5")),
            Block("S2", "lag", "S1", ("K5", "T5")),
            Block("Vs", "sum", "S2", (), lambda f: -f.HLIM, "HLIM"),
        ),
    ),
    "PSS2A": Model(
        "stabiliser",
        "IEEE stabiliser of two inputs, integral of accelerating power",
        "IC IB IC2 IB2 M N TW1 TW2 T6 TW3 TW4 T7 KS2 KS3 T8 T9 KS1 T1 T2 T3 T4 VSTMAX VSTMIN",
        (
            Block("W1", "washout", "input", (1.0, "TW1")),
            Block("W2", "washout", "W1", (1.0, "TW2")),
            Block("low", "lag", "W2", (1.0, "T6")),
            Block("W3", "washout", "input_2", (1.0, "TW3")),
            Block("W4", "washout", "W3", (1.0, "TW4")),
            Block("power", "lag", "W4", ("KS2", "T7")),
            Block("tracked", "ramp_tracking", "low + KS3 * power", ("T8", "T9", "M", "N")),
            Block("difference", "sum", "KS1 * tracked - KS1 * power"),
            Block("L1", "lead_lag", "difference", (1.0, "T1", "T2")),
            Block("L2", "lead_lag", "L1", (1.0, "T3", "T4")),
            Block("Vs", "sum", "L2", (), "VSTMIN", "VSTMAX"),
        ),
        "IB IB2",
    ),
}

MODELS: dict[str, Model] = {**_EXCITERS, **_GOVERNORS, **_STABILISERS}

# What stands for `input` and `input_2` of a stabiliser by its code IC; 2 is the frequency of a bus, for which the speed
# of the machine stands; 0: there is none.
INPUTS = {0: "none", 1: "omega", 2: "omega", 3: "Pe", 4: "Pa", 5: "Vt"}

_COUNTS = {"SWITCH", "CSWITCH", "JBUS", "JM", "IC", "IC2", "IB", "IB2", "M", "N"}


def quantity_of(name: str) -> Quantity:
    """Unit, meaning and range of a field, by its name: those of the library's data sheets."""
    if name in _COUNTS:
        return Quantity("-", "as in the library", 0.0, 1e6)
    if name[0] == "T" and name not in ("TATB", "THETAP"):
        return Quantity("s", "time constant", 0.0, 1000.0, time=True)
    if name[0] == "A" and name[1:].isdigit():
        return Quantity("s, s²", "coefficient of a filter", 0.0, 1000.0)
    if name == "R":
        return Quantity("p.u.", "droop: speed per power", 0.001, 10.0)
    if name in ("KA", "K"):
        return Quantity("p.u.", "gain", 1e-3, 1e4)
    words = {"K": "gain", "V": "limit", "E": "voltage of the exciter"}
    return Quantity("p.u.", words.get(name[0], "as in the library"))
