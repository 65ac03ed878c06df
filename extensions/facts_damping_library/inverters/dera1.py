"""DERA1: EPRI's DER_A, the inverters of a distribution grid as one.

FreqFlag 1: a regulator of the active power sees droops Ddn above and Dup below the dead band fdbd1, fdbd2 of the
frequency, which is that of the bus behind a lag of 20 ms and Trf; 0: the power reference stays. PfFlag 1: reactive
power has the power factor of the start. Kqv beyond a dead band about Vref0 (0: the voltage at the start) supports the
voltage. PQFlag: of the circle Imax, Q (0) or P (1) comes first; GenFlag 1: active power is not taken. rrpwr limits the
rate of its magnitude upwards. `Paux` is added to the power reference, `Qaux` to the reactive power that is wanted,
`Vaux` to Vref0. It does not trip.

Source: EPRI, The New Aggregated Distributed Energy Resources (der_a) Model for Transmission Planning Studies,
3002015320.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import SHORTEST, Block, Model, Source

if TYPE_CHECKING:
    from collections.abc import Callable

LOWEST_VOLTAGE = 0.01  # p.u., that powers are divided by
T_FREQUENCY = 0.02  # s, of a measurement of frequency
NEVER = 1e4  # p.u., voltage that is not reached
TRIPS = "Vl0 Vl1 Vh0 Vh1 tvl0 tvl1 tvh0 tvh1 Vrfrac fltrp fhtrp tfl tfh"
WITH_FREQUENCY: Callable[[Any], bool] = lambda f: f.FreqFlag == 1.0  # noqa: E731 (beside its counterpart)
WITHOUT: Callable[[Any], bool] = lambda f: f.FreqFlag != 1.0  # noqa: E731
Q_FIRST: Callable[[Any], bool] = lambda f: f.PQFlag != 1.0  # noqa: E731
P_FIRST: Callable[[Any], bool] = lambda f: f.PQFlag == 1.0  # noqa: E731

ROW = Model(
    "inverter",
    "EPRI type DER_A, distributed energy resources as one inverter",
    "PfFlag FreqFlag PQFlag GenFlag VtripFlag FtripFlag Trv Trf dbd1 dbd2 Kqv Vref0 Tp Tiq Ddn Dup fdbd1 fdbd2 "
    f"femax femin Pmax Pmin dPmax dPmin Tpord Kpg Kig Imax {TRIPS} Tg rrpwr Tv Vpr Iqh1 Iql1",
    (
        Block("V_seen", "lag", "Vt", (1.0, "Trv")),
        Block("V_divisor", "limiter", "V_seen", (), LOWEST_VOLTAGE),
        Block("P_seen", "lag", "Pe", (1.0, "Tp")),
        Block("V_deviation", "sum", "Vref0 * one + AT_START * Vt0 + Vaux - V_seen"),
        Block("V_beyond", "dead_band", "V_deviation", ("dbd1", "dbd2")),
        Block("Iqv", "limiter", "Kqv * V_beyond", (), "Iql1", "Iqh1"),
        Block("tangent", "quotient", "Qe0 + Pe0", when=lambda f: f.PfFlag == 1.0),
        Block("Q_wanted", "product", "tangent + P_seen", when=lambda f: f.PfFlag == 1.0),
        Block("Q_wanted", "sum", "Qext", when=lambda f: f.PfFlag != 1.0),
        Block("Q_order", "sum", "Q_wanted + Qaux"),
        Block("Iq_wanted", "quotient", "Q_order + V_divisor"),
        Block("Iq_order", "lag", "Iq_wanted", (1.0, "Tiq")),
        Block("angle_seen", "angle_lag", "theta", (T_FREQUENCY,), when=WITH_FREQUENCY),
        Block("turning", "rate", "angle_seen", (1.0, lambda f: max(f.Trf, SHORTEST)), when=WITH_FREQUENCY),
        Block("frequency", "quotient", "turning + omega_0", when=WITH_FREQUENCY),
        Block("f_beyond", "dead_band", "- frequency", ("fdbd1", "fdbd2"), when=WITH_FREQUENCY),
        Block("droop_down", "limiter", "Ddn * f_beyond", (), None, 0.0, when=WITH_FREQUENCY),
        Block("droop_up", "limiter", "Dup * f_beyond", (), 0.0, when=WITH_FREQUENCY),
        Block(
            "P_error",
            "limiter",
            "Pref + Paux + droop_down + droop_up - P_seen",
            (),
            "femin",
            "femax",
            when=WITH_FREQUENCY,
        ),
        Block("P_wanted", "regulator", "P_error", ("Kpg", "Kig"), "Pmin", "Pmax", when=WITH_FREQUENCY),
        Block("P_wanted", "sum", "Pref + Paux", when=WITHOUT),
        Block("Pord", "servo", "P_wanted", ("Tpord", "dPmin", "dPmax"), "Pmin", "Pmax"),
        Block("Ip_order", "quotient", "Pord + V_divisor"),
        Block("Iqmax", "sum", "Imax * one", when=Q_FIRST),
        Block("Iqmax", "room", "Ipcmd", ("Imax",), when=P_FIRST),
        Block("Ipmax", "room", "Iqcmd", ("Imax",), when=Q_FIRST),
        Block("Ipmax", "sum", "Imax * one", when=P_FIRST),
        Block("Iqcmd", "sum", "Iq_order + Iqv", (), -1.0, 1.0, "Iqmax", "Iqmax"),
        Block("Ipcmd", "sum", "Ip_order", (), lambda f: f.GenFlag - 1.0, 1.0, "Ipmax", "Ipmax"),
        Block(
            "Ip",
            "servo",
            "Ipcmd",
            ("Tg", lambda f: -inf if f.P >= 0.0 else -f.rrpwr, lambda f: f.rrpwr if f.P >= 0.0 else inf),
        ),
        Block("Iq_ahead", "lag", "- Iqcmd", (1.0, "Tg")),
    ),
    f"{TRIPS} Tv Vpr",
    {"AT_START": lambda f: float(f.Vref0 == 0.0)},
    approximations={
        "it does not trip by voltage": lambda f: f.VtripFlag == 1.0,
        "it does not trip by frequency": lambda f: f.FtripFlag == 1.0,
    },
    source=Source("current", "Ip", "Iq_ahead", (-1.0, 0.0, NEVER, -NEVER, 0.0)),
)
