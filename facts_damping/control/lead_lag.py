"""The lead-lag controller of appendix B of the thesis; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


@compiled
def section(n1: float, n0: float, d1: float, dt: float, state: Float1, at: int, u: float) -> float:
    """One step of (n1 s + n0) / (d1 s + 1) by the bilinear transform with step `dt`, s.

    With c = 2 / dt: (1 + d1 c) y = (n0 + n1 c) u + (n0 - n1 c) u_before - (1 - d1 c) y_before.
    `state[at]`, `state[at + 1]`: input and output of the step before.
    """
    c = 2.0 / dt
    y = ((n0 + n1 * c) * u + (n0 - n1 * c) * state[at] - (1.0 - d1 * c) * state[at + 1]) / (1.0 + d1 * c)
    state[at] = u
    state[at + 1] = y
    return y  # type: ignore[no-any-return]


@compiled
def step(p: Any, state: Float1, y: float, dt: float) -> float:
    """Output before limits: kG s Tw / (1 + s Tw) (1 + s T1) / (1 + s T2) (1 + s T3) / (1 + s T4), p.u.

    `p` has gain (kG), Tw and T1 to T4; `dt`: time between the two newest frames, s; 0 at the first frame,
    at which the washout starts at rest.
    """
    if dt <= 0.0:
        state[:] = 0.0
        state[0] = y
        return 0.0
    u = section(p.gain * p.Tw, 0.0, p.Tw, dt, state, 0, y)
    u = section(p.T1, 1.0, p.T2, dt, state, 2, u)
    return section(p.T3, 1.0, p.T4, dt, state, 4, u)
