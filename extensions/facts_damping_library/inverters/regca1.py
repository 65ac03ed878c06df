"""REGCA1: WECC's REGC_A, a converter that is a source of current in the direction of its voltage.

Ipcmd and Iqcmd pass lags of Tg. With Lvplsw 1 the active current is at most LVPL: 0 below Zerox, rising to Lvpl1 at
Brkpt, without limit above it, of the voltage behind the lag Tfltr; its lag comes down to LVPL within 2 ms, so that
the current recovers at Rrpwr. Rrpwr limits the rate of its magnitude upwards: to more power, or with P below 0 at the
start to less. Iqrmax limits the rate of the reactive current out of the inverter upwards where Q is positive at the
start, Iqrmin downwards where it is negative; else it is free.

With the network's voltage the active current falls in proportion from Lvpnt1 to Lvpnt0, where it is 0; above Volim the
reactive current is less by Khv (V - Volim), but not below Iolim. Accel is of PSS/E's iteration.
"""

from __future__ import annotations

from math import inf

from facts_damping.machine_controls.blocks import SHORTEST, Block, Model, Source

ROW = Model(
    "inverter",
    "WECC type REGC_A, a grid-following converter without phase-locked loop",
    "Lvplsw Tg Rrpwr Brkpt Zerox Lvpl1 Volim Lvpnt1 Lvpnt0 Iolim Tfltr Khv Iqrmax Iqrmin Accel",
    (
        Block("V_low", "lag", "Vt", (1.0, lambda f: max(f.Tfltr, SHORTEST)), when=lambda f: f.Lvplsw == 1.0),
        Block("ramp", "limiter", "RISE * V_low - OFFSET * one", (), 0.0, when=lambda f: f.Lvplsw == 1.0),
        Block("LVPL", "window", "V_low + ramp + FREE * one", (-inf, "Brkpt"), when=lambda f: f.Lvplsw == 1.0),
        Block("Ip_allowed", "limiter", "Ipcmd", (), None, 1.0, high_of="LVPL", when=lambda f: f.Lvplsw == 1.0),
        Block("Ip_beyond", "limiter", "Ip_lag - LVPL", (), 0.0, when=lambda f: f.Lvplsw == 1.0),
        Block("Ip_wanted", "sum", "Ip_allowed - BACK * Ip_beyond", when=lambda f: f.Lvplsw == 1.0),
        Block("Ip_wanted", "sum", "Ipcmd", when=lambda f: f.Lvplsw != 1.0),
        Block(
            "Ip_lag",
            "servo",
            "Ip_wanted",
            ("Tg", lambda f: -inf if f.P >= 0.0 else -f.Rrpwr, lambda f: f.Rrpwr if f.P >= 0.0 else inf),
        ),
        Block("Ip", "limiter", "Ip_lag", (), None, 1.0, high_of="LVPL", when=lambda f: f.Lvplsw == 1.0),
        Block("Ip", "sum", "Ip_lag", when=lambda f: f.Lvplsw != 1.0),
        Block(
            "Iq_ahead",
            "servo",
            "- Iqcmd",
            ("Tg", lambda f: -f.Iqrmax if f.Q > 0.0 else -inf, lambda f: -f.Iqrmin if f.Q < 0.0 else inf),
        ),
    ),
    "Accel",
    {
        "RISE": lambda f: f.Lvpl1 / max(f.Brkpt - f.Zerox, 1e-6),
        "OFFSET": lambda f: f.Lvpl1 / max(f.Brkpt - f.Zerox, 1e-6) * f.Zerox,
        "FREE": lambda _f: 1e4,  # p.u.: none
        "BACK": lambda f: max(f.Tg / SHORTEST - 1.0, 0.0),
    },
    source=Source("current", "Ip", "Iq_ahead", ("Lvpnt0", "Lvpnt1", "Volim", "Iolim", "Khv")),
)
