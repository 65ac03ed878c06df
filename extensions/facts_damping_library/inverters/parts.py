"""What inverters have in common: what they see of the grid, limits of power and current, lags with limited rates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import SHORTEST, Block
from facts_damping.plant.machines.blocks import NO_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable

    When = Callable[[Any], bool]


def seen(name: str, of: str, time: str) -> Block:
    """A measured quantity; always with a state, as an EMF follows from states alone."""
    return Block(name, "lag", of, (1.0, lambda f: max(getattr(f, time), SHORTEST)))


def overload(of: str, gain: str, integral: str) -> tuple[Block, ...]:
    """What keeps P or Q within its limits: PI of the excess, at the upper limit at most 0, at the lower at least 0.

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


FOLLOWING: dict[str, Callable[[Any], float]] = {
    "FREE": lambda _: NO_LIMIT,
    "SPEED": lambda f: 1.0 / max(f.TG, SHORTEST),
}


def _ramped(name: str, order: str, of: str, when: When | None = None) -> tuple[Block, ...]:
    """A lag TG of `order`, its rate between the signals `of_falling` and `of_rising`, p.u./s."""
    error = f"SPEED * {order} - SPEED * {name}"
    return (
        Block(f"{name}_rate", "limiter", error, (), 1.0, 1.0, f"{of}_falling", f"{of}_rising", when=when),
        Block(name, "integral", f"{name}_rate", (1.0,), when=when),
    )


def _rates(of: str, sign: str, rising: str, falling: str) -> tuple[Block, ...]:
    """Limits of rates: `rising` while the signal `sign` is above 0, else `falling`; the other way is free."""
    return (
        Block(f"{of}_most", "sum", rising),
        Block(f"{of}_least", "sum", falling),
        Block(f"{of}_rising", "window", f"{sign} + free + {of}_most", (-math.inf, 0.0)),
        Block(f"{of}_falling", "window", f"{sign} + {of}_least - free", (-math.inf, 0.0)),
    )


def _within(first: str, second: str, when: When) -> tuple[Block, ...]:
    """Currents within IMAX: the first as it is, the second in the room that is left."""
    return (
        Block(f"{first}_limited", "sum", first, (), lambda f: -f.IMAX, "IMAX", when=when),
        Block("room", "room", f"{first}_limited", ("IMAX",), when=when),
        Block(f"{second}_limited", "sum", second, (), -1.0, 1.0, "room", "room", when=when),
    )


def limited_currents() -> tuple[Block, ...]:
    """`Ip_limited` and `Iq_limited`, p.u. into the grid, from the commands: lags with limits of rates, then IMAX."""
    return (
        Block("free", "sum", "FREE * one"),
        Block("V_filtered", "lag", "Vt", (1.0, "TFLTR"), 0.01),
        *_rates("Ip", "Ipcmd", "RRPWR * one", "none - RRPWR * one"),
        *_rates("Iq", "Qe0", "IQRMAX * one", "IQRMIN * one"),
        Block("P_order", "product", "Ipcmd + V_filtered", when=lambda f: f.RATEFLAG == 1),
        *_ramped("P_ramped", "P_order", "Ip", lambda f: f.RATEFLAG == 1),
        Block("Ip", "quotient", "P_ramped + V_filtered", when=lambda f: f.RATEFLAG == 1),
        *_ramped("Ip", "Ipcmd", "Ip", lambda f: f.RATEFLAG == 0),
        *_ramped("Iq_into", "Iqcmd", "Iq"),
        *_within("Iq_into", "Ip", lambda f: f.PQFLAG == 0),
        *_within("Ip", "Iq_into", lambda f: f.PQFLAG == 1),
    )


def source_voltage(Ip: str, Iq: str) -> tuple[Block, ...]:
    """The EMF for the currents Ip - j Iq: V + (RE + j XE) (Ip - j Iq), `Ed` and `Eq`, with a lag TE."""
    lag: Callable[[Any], float] = lambda f: max(f.TE, SHORTEST)  # noqa: E731
    return (
        Block("Ed", "lag", f"Vd + RE * {Ip} + XE * {Iq}", (1.0, lag)),
        Block("Eq", "lag", f"Vq + XE * {Ip} - RE * {Iq}", (1.0, lag)),
    )
