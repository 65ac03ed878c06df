"""Constants of the inverters of the study: those of data sheets and PSS/E's example cases, per unit of the rating."""

from __future__ import annotations

from typing import Any

GRID_SIDE: dict[str, dict[str, float]] = {
    "REGCA1": {
        **{"Lvplsw": 1, "Tg": 0.02, "Rrpwr": 10.0, "Brkpt": 0.9, "Zerox": 0.4, "Lvpl1": 1.22, "Volim": 1.2},
        **{"Lvpnt1": 0.8, "Lvpnt0": 0.4, "Iolim": -1.3, "Tfltr": 0.02, "Khv": 0.7, "Iqrmax": 99.0, "Iqrmin": -99.0},
    },
    "REGCB1": {
        **{"RateFlag": 0, "PQFlag": 0, "Tg": 0.02, "Tfltr": 0.02, "Iqrmax": 99.0, "Iqrmin": -99.0, "rrpwr": 10.0},
        **{"Te": 0.0, "Imax": 1.2, "Re": 0.0, "Xe": 0.2},
    },
    "REGCC1": {
        **{"RateFlag": 0, "PQFlag": 0, "Tg": 0.02, "Tfltr": 0.02, "Iqrmax": 99.0, "Iqrmin": -99.0, "rrpwr": 10.0},
        **{"Te": 0.0, "Imax": 1.2, "Kip": 0.3, "Kii": 10.0, "Kppll": 20.0, "Kipll": 200.0, "wmax": 60.0},
        **{"wmin": -60.0, "Re": 0.0, "Xe": 0.2},
    },
    "REGFMA1": {
        **{"VFlag": 1, "QVFlag": 1, "Tpf": 0.02, "Tqf": 0.02, "Tvf": 0.02, "Imax": 1.5, "Emax": 1.5, "Emin": 0.0},
        **{"Pmax": 1.05, "Pmin": -0.05, "Qmax": 0.6, "Qmin": -0.6, "mp": 0.02, "mq": 0.05, "Kppmax": 0.02},
        **{"Kipmax": 0.1, "Kpqmax": 0.3, "Kiqmax": 5.0, "Kpv": 0.0, "Kiv": 5.86, "Re": 0.0, "Xe": 0.15},
    },
    "REGFMB1": {
        **{"wFlag": 0, "VdrpFlag": 0, "QVFlag": 1, "PQFlag": 0, "FFlag": 1, "ESFlag": 1, "mq": 0.05, "Kpv": 0.5},
        **{"Kiv": 5.0, "mp": 0.02, "Dwmax": 0.2, "Dwmin": -0.2, "KpPLL": 0.05, "KiPLL": 0.5, "DwPLLmax": 0.3},
        **{"DwPLLmin": -0.3, "Tp": 0.02, "H": 1.0, "D1": 20.0, "D2": 100.0, "wD": 50.0, "ImaxSS": 1.1, "Kf": 0.9},
        **{"Ki": 20.0, "ImaxF": 1.5, "Tpf": 0.01, "Tqf": 0.01, "Tvf": 0.01, "Tif": 0.01, "Ke": 1.0},
        **{"VPLLfrz": 0.1, "Re": 0.0, "Xe": 0.15},
    },
}

COMMON: dict[str, float] = {
    **{"PFFLAG": 0, "VFLAG": 1, "QFLAG": 1, "PQFLAG": 0, "Vdip": 0.85, "Vup": 1.2, "Trv": 0.02, "dbd1": -0.05},
    **{"dbd2": 0.05, "Kqv": 2.0, "Iqh1": 1.1, "Iql1": -1.1, "Vref0": 0.0, "Tp": 0.05, "Qmax": 0.6, "Qmin": -0.6},
    **{"Vmax": 1.2, "Vmin": 0.8, "Kqp": 0.0, "Kqi": 0.5, "Kvp": 0.0, "Kvi": 20.0, "Tiq": 0.02, "dPmax": 99.0},
    **{"dPmin": -99.0, "Pmax": 1.2, "Pmin": -1.2, "Imax": 1.25, "Tpord": 0.02},
}
NO_TABLE = {f"{what}{sort}{i}": 0.0 for sort in "qp" for i in range(1, 5) for what in "VI"}
ELECTRICAL: dict[str, dict[str, float]] = {
    "REECB1": COMMON,
    "REECA1": {**COMMON, **NO_TABLE, "PFLAG": 0, "Iqfrz": 0.2, "Thld": 0.1, "Thld2": 0.1, "Vbias": 0.0},
}
ELECTRICAL["REECB1"] = dict(COMMON)

PLANT: dict[str, float] = {
    **{"VCFlag": 0, "RefFlag": 1, "Fflag": 0, "Tfltr": 0.02, "Kp": 1.0, "Ki": 2.0, "Tft": 0.0, "Tfv": 0.1},
    **{"Vfrz": 0.7, "Rc": 0.0, "Xc": 0.0, "Kc": 0.05, "emax": 0.2, "emin": -0.2, "dbd1": -0.005, "dbd2": 0.005},
    **{"Qmax": 0.6, "Qmin": -0.6, "Kpg": 0.5, "Kig": 0.5, "Tp": 0.1, "fdbd1": -0.0006, "fdbd2": 0.0006},
    **{"femax": 0.5, "femin": -0.5, "Pmax": 1.2, "Pmin": 0.0, "Tg": 0.1, "Ddn": 20.0, "Dup": 0.0},
}


def fields(table: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A row with other values."""
    return {**table, **changes}
