"""Power system stabilisers: washout and two lead-lag sections with speed input (thesis 2.31-2.34); compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.machines import Stabiliser

STATE_NAMES = ["washout", "lead_1", "lead_2"]
FIELDS = ("K", "Tw", "T1", "T2", "T3", "T4", "minimum", "maximum")

STABILISER = np.dtype([("offset", "i8"), *((name, "f8") for name in FIELDS)])  # offset -1: none


def row(stabiliser: Stabiliser | None, offset: int) -> Any:
    """A row of STABILISER; all states are zero in steady state."""
    if stabiliser is None:
        return (-1, *(1.0 for _ in FIELDS))
    return (offset, *(getattr(stabiliser, name) for name in FIELDS))


@compiled
def output(s: Any, x: Float1, omega: float) -> float:
    """Output of a stabiliser at a speed deviation, p.u.; zero if absent.

    With the washout's state w and the lags' l1, l2: v1 = K omega - w; v2 = l1 + T1/T2 (v1 - l1);
    v3 = l2 + T3/T4 (v2 - l2), limited.
    """
    if s.offset < 0:
        return 0.0
    o = s.offset
    washed = s.K * omega - x[o]
    first = x[o + 1] + s.T1 / s.T2 * (washed - x[o + 1])
    second = x[o + 2] + s.T3 / s.T4 * (first - x[o + 2])
    return min(max(second, s.minimum), s.maximum)  # type: ignore[no-any-return]


@compiled
def derivatives(s: Any, x: Float1, omega: float, dx: Float1) -> None:
    """Write the derivatives of a stabiliser's states, 1/s: Tw dw = K omega - w, T2 dl1 = v1 - l1, T4 dl2 = v2 - l2."""
    if s.offset < 0:
        return
    o = s.offset
    washed = s.K * omega - x[o]
    first = x[o + 1] + s.T1 / s.T2 * (washed - x[o + 1])
    dx[o] = washed / s.Tw
    dx[o + 1] = (washed - x[o + 1]) / s.T2
    dx[o + 2] = (first - x[o + 2]) / s.T4
