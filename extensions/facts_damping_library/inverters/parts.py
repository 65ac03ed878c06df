"""What inverters have in common: what they see of the grid, the angle that they form, limits of P and Q."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import SHORTEST, Block
from facts_damping.plant.machines.blocks import NO_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable

CURRENT_LIMIT: Callable[[Any], float] = lambda f: f.IMAX if f.IMAX > 0.0 else NO_LIMIT  # noqa: E731
# Its angle, rad, in a frame that turns at the rated speed.
FORMED_ANGLE = (
    Block("angle_rate", "product", "omega_0 + slip"),
    Block("angle_order", "integral", "angle_rate", (1.0,)),
    Block("angle", "lag", "angle_order", (1.0, "TD")),
)


def seen(name: str, of: str, time: str) -> Block:
    """A measured quantity; always with a state, as an EMF follows from states alone."""
    return Block(name, "lag", of, (1.0, lambda f: max(getattr(f, time), SHORTEST)))


def overload(of: str, gain: str, integral: str) -> tuple[Block, ...]:
    """What keeps P or Q within its limits: PI of the excess, never above 0 at the upper limit nor below it at the lower.

    `of`: P or Q; the signals `P_above`, `P_below` come out, p.u. of speed (P) or voltage (Q).
    """
    blocks = list[Block]()
    for side, limit, bounds in (("above", f"{of}MAX", (None, 0.0)), ("below", f"{of}MIN", (0.0, None))):
        room = f"{of}_room_{side}"
        blocks += [
            Block(room, "sum", f"{limit} * one - {of}_seen"),
            Block(f"{of}_integral_{side}", "stop", room, (integral,), *bounds),
            Block(f"{of}_{side}", "limiter", f"{gain} * {room} + {of}_integral_{side}", (), *bounds),
        ]
    return tuple(blocks)
