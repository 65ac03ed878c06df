"""What inverters have in common: what they see of the grid, limits of power and current, lags with limited rates."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import SHORTEST, Block

if TYPE_CHECKING:
    from collections.abc import Callable


def seen(name: str, of: str, time: str) -> Block:
    """A measured quantity; always with a state, as an EMF follows from states alone."""
    return Block(name, "lag", of, (1.0, lambda f: max(getattr(f, time), SHORTEST)))


def overload(of: str, gain: str, integral: str) -> tuple[Block, ...]:
    """What keeps P or Q within its limits: PI of the excess, at the upper limit at most 0, at the lower at least 0.

    `of`: P or Q; the signals `P_above`, `P_below` come out, p.u. of speed (P) or voltage (Q).
    """
    blocks = [Block(f"{of}_at_start", "sum", f"{of}e0", (), f"{of}min", f"{of}max")]  # a dispatch beyond them is told
    for side, limit, bounds in (("above", f"{of}max", (None, 0.0)), ("below", f"{of}min", (0.0, None))):
        room = f"{of}_room_{side}"
        blocks += [
            Block(room, "sum", f"{limit} * one - {of}_seen"),
            Block(f"{of}_integral_{side}", "stop", room, (integral,), *bounds),
            Block(f"{of}_{side}", "limiter", f"{gain} * {room} + {of}_integral_{side}", (), *bounds),
        ]
    return tuple(blocks)


def limited_currents() -> tuple[Block, ...]:
    """`Ip_limited` and `Iq_into_limited`, p.u. into the grid, from the commands: lags with limits of rates, Imax."""
    growing = (lambda f: -inf if f.P >= 0.0 else -f.rrpwr, lambda f: f.rrpwr if f.P >= 0.0 else inf)
    recovering = (lambda f: f.Iqrmin if f.Q < 0.0 else -inf, lambda f: f.Iqrmax if f.Q > 0.0 else inf)
    return (
        Block("V_filtered", "lag", "Vt", (1.0, "Tfltr"), 0.01),
        Block("P_order", "product", "Ipcmd + V_filtered", when=lambda f: f.RateFlag == 1.0),
        Block("P_ramped", "servo", "P_order", ("Tg", *growing), when=lambda f: f.RateFlag == 1.0),
        Block("Ip", "quotient", "P_ramped + V_filtered", when=lambda f: f.RateFlag == 1.0),
        Block("Ip", "servo", "Ipcmd", ("Tg", *growing), when=lambda f: f.RateFlag != 1.0),
        Block("Iq_into", "servo", "Iqcmd", ("Tg", *recovering)),
        *_within("Iq_into", "Ip", lambda f: f.PQFlag != 1.0),
        *_within("Ip", "Iq_into", lambda f: f.PQFlag == 1.0),
    )


def _within(first: str, second: str, when: Callable[[Any], bool]) -> tuple[Block, ...]:
    """Currents within Imax: the first as it is, the second in the room that is left."""
    return (
        Block(f"{first}_limited", "sum", first, (), lambda f: -f.Imax, "Imax", when=when),
        Block("room", "room", f"{first}_limited", ("Imax",), when=when),
        Block(f"{second}_limited", "sum", second, (), -1.0, 1.0, "room", "room", when=when),
    )


def source_voltage(Ip: str, Iq: str) -> tuple[Block, ...]:
    """The EMF for the currents Ip - j Iq: V + (Re + j Xe) (Ip - j Iq), `Ed` and `Eq`, with a lag Te."""
    lag: Callable[[Any], float] = lambda f: max(f.Te, SHORTEST)  # noqa: E731
    return (
        Block("Ed", "lag", f"Vd + Re * {Ip} + Xe * {Iq}", (1.0, lag)),
        Block("Eq", "lag", f"Vq + Xe * {Ip} - Re * {Iq}", (1.0, lag)),
    )
