"""Excitation systems as tables of blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model, exponential, saturation

if TYPE_CHECKING:
    from collections.abc import Callable

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


EXCITERS = {
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
