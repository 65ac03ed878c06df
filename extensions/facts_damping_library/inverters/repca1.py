"""REPCA1: WECC's REPC_A, the control of a plant of inverters.

RefFlag 1: it controls the voltage, compensated along a branch, |Vbus - (Rc + j Xc) I| (VCFlag 1), or with a droop,
Vbus + Kc Q; 0: the reactive power of the branch. Its regulator is held while the voltage of the bus is below Vfrz.
Fflag 1: it controls the active power of the branch, with droops Ddn above and Dup below the dead band fdbd1, fdbd2 of
the frequency, which is that of the bus behind two lags of 20 ms; 0: the power reference stays.

Its references are what there is at the start. `Vplant` is added to that of the voltage (RefFlag 1), `Qplant` before
the lead-lag Tft / Tfv, `Pplant` before the lag Tg (Fflag 1). The output stands for that of the power that the
electrical control wants; with PFFLAG 1 that has no use for Qext.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

T_FREQUENCY = 0.02  # s, of a measurement of frequency
ANGLE_TO_FREQUENCY = 1.0  # rad/s per rad/s

ROW = Model(
    "inverter_control",
    "WECC type REPC_A, a plant control of voltage or reactive power, and of active power with frequency response",
    "BUSR BUSF BUST CKT VCFlag RefFlag Fflag Tfltr Kp Ki Tft Tfv Vfrz Rc Xc Kc emax emin dbd1 dbd2 Qmax Qmin "
    "Kpg Kig Tp fdbd1 fdbd2 femax femin Pmax Pmin Tg Ddn Dup",
    (
        Block("plant_held", "window", "Vbus + none + one", ("Vfrz", 1e4)),
        Block("V_plant", "lag", "Vcomp", (1.0, "Tfltr"), when=lambda f: f.RefFlag == 1.0 == f.VCFlag),
        Block("V_plant", "lag", "Vbus + Kc * Qbranch", (1.0, "Tfltr"), when=lambda f: f.RefFlag == 1.0 != f.VCFlag),
        Block("Q_plant", "lag", "Qbranch", (1.0, "Tfltr"), when=lambda f: f.RefFlag != 1.0),
        Block("plant_error", "sum", "Vcomp0 + Vplant - V_plant", when=lambda f: f.RefFlag == 1.0 == f.VCFlag),
        Block(
            "plant_error",
            "sum",
            "Vbus0 + Kc * Qbranch0 + Vplant - V_plant",
            when=lambda f: f.RefFlag == 1.0 != f.VCFlag,
        ),
        Block("plant_error", "sum", "Qbranch0 - Q_plant", when=lambda f: f.RefFlag != 1.0),
        Block("plant_beyond", "dead_band", "plant_error", ("dbd1", "dbd2")),
        Block("plant_bounded", "limiter", "plant_beyond", (), "emin", "emax"),
        Block("Q_regulated", "regulator", "plant_bounded", ("Kp", "Ki"), "Qmin", "Qmax", hold="plant_held", start=0.0),
        Block("Qext", "lead_lag", "Q_regulated + Qplant", (1.0, "Tft", "Tfv")),
        Block("P_plant", "lag", "Pbranch", (1.0, "Tp"), when=lambda f: f.Fflag == 1.0),
        Block("angle_seen", "angle_lag", "theta_bus", (T_FREQUENCY,), when=lambda f: f.Fflag == 1.0),
        Block("turning", "rate", "angle_seen", (ANGLE_TO_FREQUENCY, T_FREQUENCY), when=lambda f: f.Fflag == 1.0),
        Block("frequency", "quotient", "turning + omega_0", when=lambda f: f.Fflag == 1.0),
        Block("f_beyond", "dead_band", "- frequency", ("fdbd1", "fdbd2"), when=lambda f: f.Fflag == 1.0),
        Block("droop_down", "limiter", "Ddn * f_beyond", (), None, 0.0, when=lambda f: f.Fflag == 1.0),
        Block("droop_up", "limiter", "Dup * f_beyond", (), 0.0, when=lambda f: f.Fflag == 1.0),
        Block(
            "P_error",
            "limiter",
            "Pbranch0 + droop_down + droop_up - P_plant",
            (),
            "femin",
            "femax",
            when=lambda f: f.Fflag == 1.0,
        ),
        Block(
            "P_regulated",
            "regulator",
            "P_error",
            ("Kpg", "Kig"),
            "Pmin",
            "Pmax",
            when=lambda f: f.Fflag == 1.0,
            start=0.0,
        ),
        Block("Pext", "lag", "P_regulated + Pplant", (1.0, "Tg"), when=lambda f: f.Fflag == 1.0),
    ),
    "BUSR BUSF BUST CKT",
)
