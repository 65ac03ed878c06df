"""Excitation systems: constant field voltage, static exciter, IEEE DC1A; branches on a code."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.system import Exciter

CONSTANT, STATIC, DC = 0, 1, 2
STATES = {CONSTANT: 0, STATIC: 2, DC: 4}
STATE_NAMES = {CONSTANT: [], STATIC: ["Vm", "xf"], DC: ["Vm", "VR", "Vc", "Efd"]}
CODES = {"static": STATIC, "dc": DC}

EXCITER = np.dtype(
    [
        ("code", "i8"),
        ("offset", "i8"),  # index of its first state
        ("KA", "f8"),
        ("TR", "f8"),
        ("KF", "f8"),
        ("TF", "f8"),
        ("TA", "f8"),
        ("KE", "f8"),
        ("TE", "f8"),
        ("AEX", "f8"),
        ("BEX", "f8"),
        ("minimum", "f8"),
        ("maximum", "f8"),
        ("Vref", "f8"),  # p.u., reference that keeps the start; field voltage itself where constant
    ]
)


def row(exciter: Exciter | None, offset: int, voltage: float, field_voltage: float) -> tuple[Any, NDArray[np.float64]]:
    """A row of EXCITER with the reference that holds the start, and the states at the start.

    static: xf = Efd, Vm = |V|, Vref = |V| + Efd / KA. dc: VR = (KE + SE) Efd, Vc = -KF / TF Efd,
    Vref = |V| + VR / KA.
    """
    made = np.zeros((), EXCITER)
    made["offset"] = offset
    if exciter is None:
        made["code"], made["Vref"] = CONSTANT, field_voltage
        return made, np.empty(0)
    for name in ("KA", "TR", "KF", "TF", "TA", "KE", "TE", "AEX", "BEX"):
        made[name] = getattr(exciter, name)
    made["code"] = CODES[exciter.model]
    made["minimum"] = -math.inf if exciter.minimum is None else exciter.minimum
    made["maximum"] = math.inf if exciter.maximum is None else exciter.maximum
    if made["code"] == STATIC:
        made["Vref"] = voltage + field_voltage / exciter.KA
        return made, np.array([voltage, field_voltage])
    regulator = (exciter.KE + exciter.AEX * math.exp(exciter.BEX * field_voltage)) * field_voltage
    made["Vref"] = voltage + regulator / exciter.KA
    return made, np.array([voltage, regulator, -exciter.KF / exciter.TF * field_voltage, field_voltage])


@compiled
def field_voltage(e: Any, x: NDArray[np.float64]) -> float:
    """Field voltage of an exciter in state `x`, p.u.

    static, TA = TE = 0 (thesis 2.25-2.30): Efd = clip(KA (Vref - Vm + KF / TF xf) / (1 + KA KF / TF)).
    """
    if e.code == CONSTANT:
        return e.Vref  # type: ignore[no-any-return]
    if e.code == DC:
        return x[e.offset + 3]  # type: ignore[no-any-return]
    feedback = e.KF / e.TF
    wanted = e.KA * (e.Vref - x[e.offset] + feedback * x[e.offset + 1]) / (1.0 + e.KA * feedback)
    return min(max(wanted, e.minimum), e.maximum)  # type: ignore[no-any-return]


@compiled
def derivatives(e: Any, x: NDArray[np.float64], voltage: float, efd: float, dx: NDArray[np.float64]) -> None:
    """Write the derivatives of an exciter's states, 1/s, at terminal voltage |V| and field voltage, p.u.

    TR dVm = |V| - Vm; static: TF dxf = Efd - xf; dc: TA dVR = KA (Vref - Vm - KF / TF Efd - Vc) - VR,
    TF dVc = -KF / TF Efd - Vc, TE dEfd = VR - (KE + AEX exp(BEX Efd)) Efd (thesis 2.24-2.30). VR does
    not move beyond its limits.
    """
    if e.code == CONSTANT:
        return
    o = e.offset
    dx[o] = (voltage - x[o]) / e.TR
    if e.code == STATIC:
        dx[o + 1] = (efd - x[o + 1]) / e.TF
        return
    regulator = x[o + 1]
    slope = (e.KA * (e.Vref - x[o] - e.KF / e.TF * efd - x[o + 2]) - regulator) / e.TA
    if (regulator >= e.maximum and slope > 0.0) or (regulator <= e.minimum and slope < 0.0):
        slope = 0.0
    dx[o + 1] = slope
    dx[o + 2] = (-e.KF / e.TF * efd - x[o + 2]) / e.TF
    dx[o + 3] = (regulator - (e.KE + e.AEX * math.exp(e.BEX * efd)) * efd) / e.TE
