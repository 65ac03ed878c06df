"""What several models have in common: transducers, saturation, DC and AC exciters, sources of static ones."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import SHORTEST, Block, exponential, saturation

if TYPE_CHECKING:
    from collections.abc import Callable

VOLTAGE_SEEN = Block("VT", "lag", "Vc", (1.0, "TR"))
A: Callable[[Any], float] = lambda f: saturation(f)[0]  # noqa: E731 (constants are written beside each other)
B: Callable[[Any], float] = lambda f: saturation(f)[1]  # noqa: E731
EXPONENTIAL_A: Callable[[Any], float] = lambda f: exponential(f)[0]  # noqa: E731
EXPONENTIAL_B: Callable[[Any], float] = lambda f: exponential(f)[1]  # noqa: E731
GAIN_REDUCTION = Block("VB", "lead_lag", "Vref + Vs - Vc", (1.0, lambda f: f.TATB * f.TB, "TB"))
DC_FIELDS = "TR KA TA TB TC VRMAX VRMIN KE TE KF TF1 SWITCH E1 SE1 E2 SE2"


def dc_exciter(limited_by: str, gives: str = "Efd") -> tuple[Block, ...]:
    """IEEE type DC1 (limits constant) and DC2 (limits in proportion to the terminal voltage).

    TE dEfd = VR - KE Efd - SE(Efd) Efd. With KE 0, KE is VRMAX / (10 Efd) - SE(Efd) at the start, so that VR is a tenth
    of VRMAX there (PSS/E Program Application Guide, volume 2, 15.2.4, as OpenIPSL cites it).
    """
    return (
        VOLTAGE_SEEN,
        Block("VF", "rate", gives, ("KF", "TF1")),
        Block("error", "sum", "Vref + Vs - VT - VF"),
        Block("VB", "lead_lag", "error", (1.0, "TC", "TB")),
        Block("VR", "lag", "VB", ("KA", "TA"), "VRMIN", "VRMAX", limited_by, limited_by),
        Block(gives, "field", "VR", ("KE", "TE", A, B)),
    )


# A static exciter's source: the terminals' voltage and current over a rectifier, VB, at most VBMAX.
COMPOUND_SOURCE = (
    Block("VE", "source", "Vd + Vq + Id + Iq", ("KP", "THETAP", "KI", "XL")),
    Block("rectified", "rectifier", "VE + Ifd", ("KC",)),
    Block("VB", "limiter", "rectified", (), None, "VBMAX"),
)


def ac_exciter(*regulator: Block) -> tuple[Block, ...]:
    """An alternator with a diode rectifier; its field current VFE demagnetises it. `regulator`: from VB to VR.

    VFE = KE VE + SE(VE) VE + KD Ifd,  TE dVE = VR - VFE above 0,  Efd = VE FEX(KC Ifd / VE),  VF = s KF/(1 + s TF) VFE
    """
    return (
        VOLTAGE_SEEN,
        Block("VB", "lead_lag", "Vref + Vs - VT - VF", (1.0, "TC", "TB")),
        *regulator,
        Block("magnetising", "saturation", "VE", ("KE", A, B)),
        Block("VFE", "sum", "magnetising + KD * Ifd"),
        Block("VF", "rate", "VFE", ("KF", "TF")),
        Block("VE", "integral", "VR - VFE", (lambda f: 1.0 / max(f.TE, SHORTEST),), 0.0),
        Block("Efd", "rectifier", "VE + Ifd", ("KC",)),
    )


def _sees(f: Any, code: float, bus: float = 0.0) -> bool:
    """Whether one of a stabiliser's inputs has a code, and is of a bus that is numbered from `bus` on."""
    inputs = ((f.IC, f.IB), (getattr(f, "IC2", 0.0), getattr(f, "IB2", 0.0)))
    return any(here == code and at >= bus for here, at in inputs)


OTHER_INPUTS: dict[str, Callable[[Any], bool]] = {
    "the speed of the machine stands for the frequency of a bus": lambda f: _sees(f, 2.0),
    "the voltage of the machine stands for that of another bus": lambda f: _sees(f, 5.0, bus=1.0),
}


def pss_output(limited: str, voltage: str = "Vt") -> Block:
    """The output of a stabiliser, cut off while a voltage is not between VCL and VCU; 0: no such bound."""
    return Block("Vs", "window", f"{voltage} + {limited} + none", (lambda f: f.VCL or -inf, lambda f: f.VCU or inf))


def two_inputs(sections: str, *, limited: bool = False) -> tuple[Block, ...]:
    """IEEE type PSS2 up to its lead-lag sections (names of numerators and denominators), the last of which is the last.

    With `limited` inputs are kept between VS1MIN and VS1MAX, VS2MIN and VS2MAX.
    """
    first, second = ("in_1", "in_2") if limited else ("input", "input_2")
    inputs = (
        Block("in_1", "limiter", "input", (), "VS1MIN", "VS1MAX"),
        Block("in_2", "limiter", "input_2", (), "VS2MIN", "VS2MAX"),
    )
    leads, before = list[Block](), "difference"
    for i, pair in enumerate(sections.split(), start=1):
        leads.append(Block(f"L{i}", "lead_lag", before, (1.0, *pair.split("/"))))
        before = f"L{i}"
    return (
        *(inputs if limited else ()),
        Block("W1", "washout", first, (1.0, "TW1")),
        Block("W2", "washout", "W1", (1.0, "TW2")),
        Block("low", "lag", "W2", (1.0, "T6")),
        Block("W3", "washout", second, (1.0, "TW3")),
        Block("W4", "washout", "W3", (1.0, "TW4")),
        Block("power", "lag", "W4", ("KS2", "T7")),
        Block("tracked", "ramp_tracking", "low + KS3 * power", ("T8", "T9", "M", "N")),
        Block("difference", "sum", "KS1 * tracked - KS1 * power"),
        *leads,
    )
