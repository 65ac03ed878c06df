"""Power system stabilisers as tables of blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model

if TYPE_CHECKING:
    from collections.abc import Callable


def _first(name: str) -> Callable[[Any], float]:
    """The numerator of IEEEST belongs to its first filter where the second has no denominator."""
    return lambda f: float(getattr(f, name)) if f.A3 == f.A4 == 0.0 else 0.0


def _second(name: str) -> Callable[[Any], float]:
    return lambda f: 0.0 if f.A3 == f.A4 == 0.0 else float(getattr(f, name))


STABILISERS = {
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
