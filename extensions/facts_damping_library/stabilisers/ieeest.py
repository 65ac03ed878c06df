"""IEEEST."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model

if TYPE_CHECKING:
    from collections.abc import Callable


def _first(name: str) -> Callable[[Any], float]:
    """The numerator belongs to the first filter where the second has no denominator."""
    return lambda f: float(getattr(f, name)) if f.A3 == f.A4 == 0.0 else 0.0


def _second(name: str) -> Callable[[Any], float]:
    return lambda f: 0.0 if f.A3 == f.A4 == 0.0 else float(getattr(f, name))


ROW = Model(
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
)
