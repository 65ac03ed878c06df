"""Mechanical power: constant, or a hydraulic turbine with its governor (HYGOV); compiled.

Other governors are tables of blocks: `machine_controls`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant.machines.block_rest import LimitViolation

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.machines import Governor

STATE_NAMES = ["filter", "gate_wanted", "gate", "flow"]
FIELDS = ("R", "r", "Tr", "Tf", "Tg", "rate_max", "gate_min", "gate_max", "Tw", "At", "Dt", "q_nl")

GOVERNOR = np.dtype([("offset", "i8"), *((name, "f8") for name in FIELDS)])  # offset -1: constant power


def row(governor: Governor | None, offset: int) -> Any:
    """A row of GOVERNOR."""
    if governor is None:
        return (-1, *(1.0 for _ in FIELDS))
    return (offset, *(getattr(governor, name) for name in FIELDS))


def start(governor: Governor, mechanical_power: float) -> tuple[Float1, list[LimitViolation]]:
    """Steady-state states for a mechanical power (p.u. of the rating): gate = flow = Pm / At + q_nl.

    And the limit of the gate that excludes it, if one does.
    """
    gate = mechanical_power / governor.At + governor.q_nl
    low, high = governor.gate_min, governor.gate_max
    beyond = [] if low <= gate <= high else ["gate_min" if gate < low else "gate_max"]
    violations = [LimitViolation(governor, "gate", gate, low, high, field, gate) for field in beyond]
    return np.array([0.0, gate, gate, gate]), violations


@compiled
def power(t: Any, x: Float1, reference: float, omega: float) -> float:
    """Mechanical power, p.u. of the rating: At h (q - q_nl) - Dt g omega with the head h = (q / g)^2.

    Without a governor it is the reference.
    """
    if t.offset < 0:
        return reference
    gate, flow = x[t.offset + 2], x[t.offset + 3]
    head = (flow / gate) ** 2
    return t.At * head * (flow - t.q_nl) - t.Dt * gate * omega  # type: ignore[no-any-return]


@compiled
def derivatives(t: Any, x: Float1, reference: float, omega: float, dx: Float1) -> None:
    """Write the derivatives of a governor's and turbine's states, 1/s, at a power reference (p.u. of the rating).

    Filter: Tf de = n_ref - omega - R c - e with n_ref = R (Pref / At + q_nl). Desired gate:
    dc = clip((e + Tr de) / (r Tr)), c stops at its limits. Servo: Tg dg = c - g. Flow: Tw dq = 1 - h.
    """
    if t.offset < 0:
        return
    o = t.offset
    error, wanted, gate, flow = x[o], x[o + 1], x[o + 2], x[o + 3]
    error_slope = (t.R * (reference / t.At + t.q_nl - wanted) - omega - error) / t.Tf
    rate = min(max((error + t.Tr * error_slope) / (t.r * t.Tr), -t.rate_max), t.rate_max)
    if (wanted >= t.gate_max and rate > 0.0) or (wanted <= t.gate_min and rate < 0.0):
        rate = 0.0
    dx[o] = error_slope
    dx[o + 1] = rate
    dx[o + 2] = (wanted - gate) / t.Tg
    dx[o + 3] = (1.0 - (flow / gate) ** 2) / t.Tw
