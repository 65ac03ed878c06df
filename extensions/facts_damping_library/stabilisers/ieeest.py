"""IEEEST: IEEE stabiliser of one input (Committee Report of 1981).

    (1 + A5 s + A6 s^2) / [(1 + A1 s + A2 s^2) (1 + A3 s + A4 s^2)] (1 + T1 s)/(1 + T2 s) (1 + T3 s)/(1 + T4 s)
    KS T5 s / (1 + T6 s)

Where A2 and A4 are 0, the denominators are multiplied out, so that a numerator of second order has one of its order.
The output is zero while the terminal voltage is above VCU or below VCL; 0: no such bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import OTHER_INPUTS, pss_output

if TYPE_CHECKING:
    from collections.abc import Callable


def _filter(which: int, power: int, *, numerator: bool) -> Callable[[Any], float]:
    """A coefficient of the first or second filter; the numerator belongs to the one whose denominator is of order 2."""

    def of(f: Any) -> float:
        first = f.A4 == 0.0
        if numerator:
            return float((f.A5, f.A6)[power - 1]) if first == (which == 1) else 0.0
        if first and f.A2 == 0.0:
            return float((f.A1 + f.A3, f.A1 * f.A3)[power - 1]) if which == 1 else 0.0
        return float(((f.A1, f.A2), (f.A3, f.A4))[which - 1][power - 1])

    return of


def _coefficients(which: int) -> tuple[Callable[[Any], float], ...]:
    return tuple(_filter(which, power, numerator=numerator) for numerator in (True, False) for power in (1, 2))


ROW = Model(
    "stabiliser",
    "IEEE stabiliser of one input",
    "IC IB A1 A2 A3 A4 A5 A6 T1 T2 T3 T4 T5 T6 KS LSMAX LSMIN VCU VCL",
    (
        Block("F1", "second_order", "input", _coefficients(1)),
        Block("F2", "second_order", "F1", _coefficients(2)),
        Block("L1", "lead_lag", "F2", (1.0, "T1", "T2")),
        Block("L2", "lead_lag", "L1", (1.0, "T3", "T4")),
        Block("washed", "washout", "L2", (lambda f: f.KS * (f.T5 / f.T6 if f.T6 > 0 else 1.0), "T6")),
        Block("limited", "sum", "washed", (), "LSMIN", "LSMAX"),
        pss_output("limited"),
    ),
    "IB",
    optional="VCU VCL",
    approximations=OTHER_INPUTS,
)
