"""The response time of a device: a first-order lag behind its reference; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.elementary import expm1

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


@compiled
def first_order_lag(z: float, reference: float, ramp: float, T: float, t: float) -> float:
    """Output of a lag after t s, p.u., for an input that starts at `reference` with slope `ramp`, p.u./s.

    T dz/dt = r - z with r = r0 + k t:  z(t) = z0 + (r0 - k T - z0) (1 - exp(-t/T)) + k t.
    """
    return z - (reference - ramp * T - z) * expm1(-t / T) + ramp * t  # type: ignore[no-any-return]


@compiled
def effective_reference(d: Any, x: Float1, u: float) -> float:
    """Effective input of a device, p.u.: its reference u, after its response time if it has one."""
    return x[d.lag] if d.response_time > 0.0 else u
