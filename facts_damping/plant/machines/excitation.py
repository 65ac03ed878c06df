"""Excitation systems: constant field voltage, static exciter, IEEE DC1A; the model is selected by a code.

Further ones are tables of blocks: `machine_controls`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.elementary import exp
from facts_damping.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.machines import Exciter

CONSTANT, STATIC, DC = 0, 1, 2
CODES = {"static": STATIC, "dc": DC}
ABSENT = -1
FIELDS = ("KA", "TR", "KF", "TF", "TB", "TC", "TA", "KE", "TE", "AEX", "BEX")

EXCITER = np.dtype(
    [
        ("code", "i8"),
        ("Vm", "i8"),  # indices of its states; ABSENT: without transducer, without rate feedback, or another model
        ("xf", "i8"),
        ("xb", "i8"),  # of the transient gain reduction
        ("VR", "i8"),
        ("Efd", "i8"),
        *((name, "f8") for name in (*FIELDS, "minimum", "maximum")),  # 0 if the model has no such field
        ("Vref", "f8"),  # p.u., reference at the initial state; the field voltage itself if constant
    ]
)


class ExciterStart(NamedTuple):
    """An exciter in its initial state: row of EXCITER, names of its states, states."""

    row: NDArray[Any]
    names: list[str]
    states: list[float]


def steady_state(exciter: Exciter | None, offset: int, voltage: float, Efd: float) -> ExciterStart:
    """The row with the reference for the initial |V| and Efd (p.u.), and the initial states.

    static: xf = Efd, xb = Efd / KA, Vm = |V|, Vref = |V| + Efd / KA. dc: VR = (KE + SE) Efd,
    xf = KF / TF Efd, Vref = |V| + VR / KA. Raises `InputError` if the limits exclude them.
    """
    row = np.zeros((), EXCITER)
    for name in ("Vm", "xf", "xb", "VR", "Efd"):
        row[name] = ABSENT
    if exciter is None:
        row["code"], row["Vref"] = CONSTANT, Efd
        return ExciterStart(row, [], [])
    for name in FIELDS:
        row[name] = getattr(exciter, name, 0.0)
    row["code"] = CODES[exciter.model]
    row["minimum"] = -math.inf if exciter.minimum is None else exciter.minimum
    row["maximum"] = math.inf if exciter.maximum is None else exciter.maximum
    present = {"Vm": voltage} if exciter.TR > 0 else {}
    if exciter.model == "static":
        limited = regulator = Efd
        if exciter.KF > 0:
            present["xf"] = Efd
        if exciter.TB > 0:
            present["xb"] = Efd / exciter.KA
    else:
        saturation = exciter.AEX * exp(exciter.BEX * Efd)
        limited = regulator = (exciter.KE + saturation) * Efd
        present |= {"VR": regulator, "Efd": Efd}
        if exciter.KF > 0:
            present["xf"] = exciter.KF / exciter.TF * Efd
    if not row["minimum"] <= limited <= row["maximum"]:
        raise InputError(
            f"exciters: {exciter.machine} needs a field voltage of {Efd:.3f} p.u. at the start; "
            f"allowed by its limits: {row['minimum']:g} to {row['maximum']:g}"
        )
    row["Vref"] = voltage + regulator / exciter.KA
    for i, name in enumerate(present):
        row[name] = offset + i
    return ExciterStart(row, list(present), list(present.values()))


@compiled
def field_voltage(e: Any, x: Float1, voltage: float, stabiliser: float) -> float:
    """Field voltage of an exciter in state `x` at terminal voltage |V| and a stabiliser's output, p.u.

    static, TA = TE = 0 (thesis 2.25-2.30): Efd = clip(KA (Vref + Vs - Vm + KF / TF xf) / (1 + KA KF / TF)). With
    (1 + s TC) / (1 + s TB) before KA (IEEE ST1A), KA acts on xb + TC / TB (error - xb).
    """
    if e.code == CONSTANT:
        return e.Vref  # type: ignore[no-any-return]
    if e.code == DC:
        return x[e.Efd]  # type: ignore[no-any-return]
    error = e.Vref + stabiliser - (x[e.Vm] if e.Vm >= 0 else voltage)
    held, gain = 0.0, e.KA
    if e.xb >= 0:
        gain = e.KA * e.TC / e.TB
        held = (e.KA - gain) * x[e.xb]
    wanted = held + gain * error
    if e.xf >= 0:
        feedback = e.KF / e.TF
        wanted = (held + gain * (error + feedback * x[e.xf])) / (1.0 + gain * feedback)
    return min(max(wanted, e.minimum), e.maximum)  # type: ignore[no-any-return]


@compiled
def derivatives(e: Any, x: Float1, voltage: float, stabiliser: float, efd: float, dx: Float1) -> None:
    """Write the derivatives of an exciter's states, 1/s, at |V|, a stabiliser's output and field voltage, p.u.

    TR dVm = |V| - Vm; static: TF dxf = Efd - xf, TB dxb = Vref + Vs - Vm - KF / TF (Efd - xf) - xb;
    dc: TA dVR = KA (Vref + Vs - Vm - (KF / TF Efd - xf)) - VR, TF dxf = KF / TF Efd - xf,
    TE dEfd = VR - (KE + AEX exp(BEX Efd)) Efd (thesis 2.24-2.30), VR with non-windup limits.
    """
    if e.code == CONSTANT:
        return
    seen = voltage
    if e.Vm >= 0:
        seen = x[e.Vm]
        dx[e.Vm] = (voltage - seen) / e.TR
    if e.code == STATIC:
        if e.xf >= 0:
            dx[e.xf] = (efd - x[e.xf]) / e.TF
        if e.xb >= 0:
            error = e.Vref + stabiliser - seen
            if e.xf >= 0:
                error -= e.KF * dx[e.xf]
            dx[e.xb] = (error - x[e.xb]) / e.TB
        return
    feedback = 0.0
    if e.xf >= 0:
        feedback = e.KF / e.TF * efd - x[e.xf]
        dx[e.xf] = feedback / e.TF
    regulator = x[e.VR]
    slope = (e.KA * (e.Vref + stabiliser - seen - feedback) - regulator) / e.TA
    if (regulator >= e.maximum and slope > 0.0) or (regulator <= e.minimum and slope < 0.0):
        slope = 0.0
    dx[e.VR] = slope
    limited = min(max(regulator, e.minimum), e.maximum)  # within a step the state may exceed its limit
    dx[e.Efd] = (limited - (e.KE + e.AEX * exp(e.BEX * efd)) * efd) / e.TE
