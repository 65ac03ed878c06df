"""What the electrical controls of inverters have in common: REEC_A, REEC_B and REEC_D.

They follow the specifications of WECC's Renewable Energy Modeling Task Force and EPRI, Model User Guide for Generic
Renewable Energy System Models, 3002014083; where these leave a choice, PSS/E's traces decide.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import SHORTEST, Block

if TYPE_CHECKING:
    from collections.abc import Callable

LOWEST_VOLTAGE = 0.01  # p.u., that powers are divided by
LEAST_POWER = 1e-6  # p.u., at the start, below which there is no power factor
STEP = 1e-6  # p.u. of voltage, width of a vertical step of a table

FACTORS: dict[str, Callable[[Any], float]] = {"AT_START": lambda f: float(f.Vref0 == 0.0)}


def measured(dip_of: str = "Vt") -> tuple[Block, ...]:
    """The voltage that is seen, the least that powers are divided by, and whether there is a dip (or a swell)."""
    return (
        Block("V_seen", "lag", "Vt", (1.0, "Trv")),
        Block("V_divisor", "limiter", "V_seen", (), LOWEST_VOLTAGE),
        Block("dip", "window", f"{dip_of} + none + one", ("Vdip", "Vup")),
    )


# Reactive current in support of the voltage, Kqv beyond a dead band about Vref0 (0: the voltage at the start).
SUPPORT = (
    Block("V_deviation", "sum", "Vref0 * one + AT_START * Vt0 - V_seen"),
    Block("V_beyond", "dead_band", "V_deviation", ("dbd1", "dbd2")),
    Block("Iqv", "limiter", "Kqv * V_beyond", (), "Iql1", "Iqh1"),
)


def reactive(controlled: str = "V_seen", bias: str = " + Vbias * one") -> tuple[Block, ...]:
    """From Qext, or the power factor of the start (PFFLAG 1), to Iq_order, p.u.

    QFLAG 0: Q / V through the lag Tiq; 1: through a regulator of the voltage, whose reference a regulator of Q gives
    (VFLAG 1), or which Qext is itself (VFLAG 0). A dip holds their states.
    """
    both, alone = (lambda f: f.QFLAG == 1.0 == f.VFLAG), (lambda f: f.QFLAG == 1.0 != f.VFLAG)
    return (
        Block("P_seen", "lag", "Pe", (1.0, "Tp"), when=lambda f: f.PFFLAG == 1.0),
        Block("P_least", "window", "Pe0 + one + Pe0", (-LEAST_POWER, LEAST_POWER), when=lambda f: f.PFFLAG == 1.0),
        Block("tangent", "quotient", "Qe0 + P_least", when=lambda f: f.PFFLAG == 1.0),
        Block("Q_wanted", "product", "tangent + P_seen", when=lambda f: f.PFFLAG == 1.0),
        Block("Q_wanted", "sum", "Qext", when=lambda f: f.PFFLAG != 1.0),
        Block("Q_order", "sum", "Q_wanted + Qaux", when=lambda f: f.QFLAG != 1.0),
        Block("Iq_wanted", "quotient", "Q_order + V_divisor", when=lambda f: f.QFLAG != 1.0),
        Block("Iq_order", "lag", "Iq_wanted", (1.0, "Tiq"), hold="dip", when=lambda f: f.QFLAG != 1.0),
        Block("Q_order", "sum", "Q_wanted + Qaux", (), "Qmin", "Qmax", when=both),
        Block("V_order", "regulator", "Q_order - Qe", ("Kqp", "Kqi"), "Vmin", "Vmax", hold="dip", when=both),
        Block("V_wanted", "sum", "V_order + Vaux", (), "Vmin", "Vmax", when=both),
        Block("V_wanted", "sum", f"Q_wanted{bias} + Vaux", (), "Vmin", "Vmax", when=alone),
        Block(
            "Iq_order",
            "regulator",
            f"V_wanted - {controlled}",
            ("Kvp", "Kvi"),
            -1.0,
            1.0,
            "Iqmax",
            "Iqmax",
            "dip",
            lambda f: f.QFLAG == 1.0,
        ),
    )


def active(reference: str) -> tuple[Block, ...]:
    """The power that is ordered, p.u.: the reference, its rate from dPmin to dPmax, times the speed (PFLAG 1).

    99 p.u./s and more are no limit of a rate; else the reference follows within 2 ms.
    """
    return (
        Block(
            "P_wanted",
            "servo",
            reference,
            (SHORTEST, "dPmin", "dPmax"),
            when=lambda f: f.dPmax < 99.0 or f.dPmin > -99.0,
        ),
        Block("P_wanted", "sum", reference, when=lambda f: f.dPmax >= 99.0 and f.dPmin <= -99.0),
        Block("P_turned", "product", "P_wanted + speed", when=lambda f: f.PFLAG == 1.0),
        Block("P_turned", "sum", "P_wanted", when=lambda f: f.PFLAG != 1.0),
        Block("Pord", "lag", "P_turned", (1.0, "Tpord"), "Pmin", "Pmax", hold="dip"),
    )


def limits(iq: str = "Iqmax", ip: str = "Ipmax") -> tuple[Block, ...]:
    """Limits of the currents, p.u., from tables VDLq, VDLp and the circle Imax: of Q first (PQFLAG 0), or of P."""
    first = lambda f: f.PQFLAG != 1.0  # noqa: E731 (conditions are written beside each other)
    return (
        Block(iq, "limiter", "VDLq", (), None, "Imax", when=first),
        Block("Ip_room", "room", "Iqcmd", ("Imax",), when=first),
        Block(ip, "limiter", "VDLp", (), None, 1.0, high_of="Ip_room", when=first),
        Block(ip, "limiter", "VDLp", (), None, "Imax", when=lambda f: f.PQFLAG == 1.0),
        Block("Iq_room", "room", "Ipcmd", ("Imax",), when=lambda f: f.PQFLAG == 1.0),
        Block(iq, "limiter", "VDLq", (), None, 1.0, high_of="Iq_room", when=lambda f: f.PQFLAG == 1.0),
    )


def commands(reactive_current: str, least: float | Callable[[Any], float] = 0.0) -> tuple[Block, ...]:
    """Ipcmd and Iqcmd within the limits, p.u.; `least`: of the active current, as a multiple of its limit."""
    return (
        Block("Iqcmd", "sum", reactive_current, (), -1.0, 1.0, "Iqmax", "Iqmax"),
        Block("Ipcmd", "sum", "Ip_order", (), least, 1.0, "Ipmax", "Ipmax"),
    )


def table(sort: str, count: int) -> tuple[Block, ...]:
    """VDLq or VDLp: the limit of a current over the voltage that is seen, constant beyond its ends.

    Points that are not to the right of all before are none, but for one straight above or below the last: a step. With
    fewer than two the table is none, and the limit Imax.
    """
    names = [f"V{sort}{i}" for i in range(1, count + 1)]
    points = tuple(c for name in names for c in (_stepped(name), name.replace("V", "I")))

    def end(f: Any) -> float:
        """The last voltage."""
        return max(_stepped(name)(f) for name in names)

    def with_a_table(f: Any) -> bool:
        """With points."""
        return any(getattr(f, name) > getattr(f, names[0]) for name in names)

    def without_a_table(f: Any) -> bool:
        """Without points."""
        return not with_a_table(f)

    return (
        Block(f"V_{sort}", "limiter", "V_seen", (), names[0], end, when=with_a_table),
        Block(f"VDL{sort}", "curve", f"V_{sort}", points, when=with_a_table),
        Block(f"VDL{sort}", "sum", "Imax * one", when=without_a_table),
    )


def _stepped(name: str) -> Callable[[Any], float]:
    """The voltage of a point, a STEP to the right where it is that of the point before, too."""

    def voltage(f: Any) -> float:
        kind, i = name[:2], int(name[2:])
        return float(getattr(f, name)) + STEP * (i > 1 and getattr(f, name) == getattr(f, f"{kind}{i - 1}"))

    return voltage
