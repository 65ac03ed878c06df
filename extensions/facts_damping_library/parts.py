"""What several models have in common: transducers, saturation, DC exciters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, exponential, saturation

if TYPE_CHECKING:
    from collections.abc import Callable

VOLTAGE_SEEN = Block("VT", "lag", "Vt", (1.0, "TR"))
A: Callable[[Any], float] = lambda f: saturation(f)[0]  # noqa: E731 (constants are written beside each other)
B: Callable[[Any], float] = lambda f: saturation(f)[1]  # noqa: E731
EXPONENTIAL_A: Callable[[Any], float] = lambda f: exponential(f)[0]  # noqa: E731
EXPONENTIAL_B: Callable[[Any], float] = lambda f: exponential(f)[1]  # noqa: E731
GAIN_REDUCTION = Block("VB", "lead_lag", "Vref + Vs - Vt", (1.0, lambda f: f.TATB * f.TB, "TB"))
DC_FIELDS = "TR KA TA TB TC VRMAX VRMIN KE TE KF TF1 SWITCH E1 SE1 E2 SE2"


def dc_exciter(limited_by: str, gives: str = "Efd") -> tuple[Block, ...]:
    """IEEE type DC1 (limits constant) and DC2 (limits in proportion to the terminal voltage)."""
    return (
        VOLTAGE_SEEN,
        Block("VF", "rate", gives, ("KF", "TF1")),
        Block("error", "sum", "Vref + Vs - VT - VF"),
        Block("VB", "lead_lag", "error", (1.0, "TC", "TB")),
        Block("VR", "lag", "VB", ("KA", "TA"), "VRMIN", "VRMAX", limited_by, limited_by),
        Block(gives, "field", "VR", ("KE", "TE", A, B)),
    )
