"""Controls as tables of blocks: beside the transfer functions of their standards, at rest, and at their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facts_damping.errors import InputError
from facts_damping.machine_controls import block_models
from facts_damping.machine_controls.block_models import quantity_of
from facts_damping.parameters.plant.machines import BLOCK_CONTROLS
from facts_damping.plant.machines import block_controls, block_rest, blocks
from facts_damping.plant.machines.block_controls import GIVES
from facts_damping.plant.machines.blocks import SENSED

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

MODELS = {name: row for name, row in block_models.MODELS.items() if row.role in GIVES}  # of machines
# Constants of each model in the order of a record: within limits, and no two alike.
DC = "0.02 50 0.06 0.9 0.5 10 -10 1.1 0.5 0.08 1.3 0 2 0.1 3 0.5"
AC, ALTERNATOR = "0.02 0.9 0.5 50 0.06 10 -10", "0.8 0.03 1.2 0.2 0.38 1.05 2 0.1 3 0.5"
PSS2 = "1 0 3 0 5 1 2.1 2 0.1 2.2 0 2.3 0.3 1 0.5 0.1 10 0.25 0.03 0.15 0.015"
DATA = {
    "IEEEX1": DC,
    "EXDC1": DC,
    "ESDC1A": DC,
    "EXDC2": DC,
    "ESDC2A": DC,
    "DC4B": "0.02 50 6 4 0.02 0.9 0.06 10 -10 1.1 0.5 0.08 1.3 2 0.1 3 0.5",
    "IEEET1": "0.02 50 0.06 10 -10 1.1 0.5 0.08 1.3 0 2 0.1 3 0.5",
    "IEEET2": "0.02 50 0.06 10 -10 1.1 0.5 0.08 1.3 0.4 2 0.1 3 0.5",
    "EXST1": "0.01 10 -10 0.9 5 50 0.05 10 -10 0 0.02 1.1",
    "EXST3": "0.02 10 -10 1.2 0.9 5 20 0.1 99 -99 0.7 3.67 0 20 0 0 3.86 0",
    "ESST3A": "0.02 10 -10 8 0.9 5 20 0.1 99 -99 0.7 3.67 0 20 0 0 3.86 0 0.4 99 -99",
    "EXAC1": f"{AC} {ALTERNATOR}",
    "ESAC1A": f"{AC} {ALTERNATOR} 11 -11",
    "ESST1A": "1 1 0.02 10 -10 0.9 5 0.3 0.4 50 0.05 12 -12 11 -11 0.1 0.02 1.1 4.54 1.5",
    "ESST4B": "0.02 10.75 9 99 -99 0.02 0.3 5 98 -98 0.7 6.67 0 19 0 0 0",
    "ST6B": "0 0.012 20 15 2 0.05 9 -9 0.8 1.2 1.06 17.33 9 9 -9 1.1 0.02",
    "ST8C": "0 0 0 1 0.01 5 4 99 -99 4 3 98 -98 1.35 0.003 97 -97 0.5 0.005 0.1 4 0 0 0 96 0 0 95",
    "SEXS": "0.4 5 20 0.1 -10 10",
    "SCRX": "0.4 5 20 0.1 -10 10 1 10",
    "TGOV1": "0.05 0.49 2 0 2.1 7 0.1",
    "IEEEG1": "0 0 20 0.1 0.05 0.2 1 -1 2 0 0.3 0.3 0 5 0.4 0 0.5 0.2 0 0.15 0.1 0",
    "IEESGO": "0.2 0.1 0.5 0.12 5 0.6 20 0.59 0.43 2 0",
    "TG": "0.05 0.5 15 1 1.1 0.6 1",
    "GAST": "0.05 0.4 0.1 3 1.1 2 1.2 0 0.3",
    "WSIEG1": "0 0 20 0.1 0.05 0.2 1 -1 2 0 0.3 0.3 0 5 0.4 0 0.5 0.2 0 0.15 0.1 0 "
    "0 0 0 0 0 0.5 0.7 0.9 0.95 0 0 0 0 0",
    "DEGOV": "0.1 0.3 0.05 18 12 5 0.2 0.04 2 -0.1",
    "DEGOV1": "0 0.19 0.05 0.02 0.9 5.1 0.3 0.25 0.04 1.1 0 0.07 0.06",
    "PIDGOV": "1 0.05 0.01 5 1 0.1 0.5 0.9 0.3 0.1 0.7 0.4 0.9 0.7 0.95 1 0.05 1.2 0.6 0.04 -0.04",
    "WPIDHY": "0.01 -0.05 3 0.5 2 0.02 0.012 0.03 -0.03 1 0.2 1.3 1.2 0 0.3 0.12 0.55 0.4 0.83 0.75 1",
    "IEEEST": "1 0 0.1 0.01 0.2 0.02 0.05 0.003 0.25 0.03 0.15 0.015 1.41 1.5 5 9 -9 0 0",
    "ST2CUT": "1 0 3 0 5 2 0.02 0.03 1.4 1.5 0.2 0.02 0.15 0.025 0.1 0.3 9 -9 0 0",
    "STAB1": "20 1.5 13.3 0.0447 12.1 0.05 9",
    "PSSSIM": "1 34 30 5 6 7 8 100 20 0.06 0.04 0.08 0.03 9 -9",
    "PSS2B": f"{PSS2} 0.2 0.3 9 -9 8 -8 7 -7",
    "PSS2C": f"{PSS2} 0.2 0.3 9 -9 8 -8 7 -7 0.15 0.25 0.3 0.2 0 0",
    "STAB2A": "1.1 4 0.55 2 1.6 1.2 0.01 9",
    "PSS2A": f"{PSS2} 9 -9",
}
VOLTAGE, FIELD, POWER = 1.02, 1.8, 0.8  # p.u., of the start


def control_of(model: str, **changes: float) -> Any:
    """The parameters of a control."""
    values = dict(zip(MODELS[model].fields.split(), map(float, DATA[model].split()), strict=True))
    return BLOCK_CONTROLS[model](machine="G1", model=model, **{**values, **changes})


def sensed(**changes: float) -> dict[str, float]:
    start = {"Vt": VOLTAGE, "Vc": VOLTAGE, "Ifd": FIELD, "Pe": POWER, "Vd": 0.0, "Vq": VOLTAGE, "Id": 0.5, "Iq": 0.6}
    return {**start, **changes}


class AtRest(NamedTuple):
    states: NDArray[np.float64]
    reference: float
    gives: float
    violations: list[block_rest.LimitViolation]


def at_rest(data: Any, **changes: float) -> tuple[block_controls.Control, AtRest]:
    role = MODELS[data.model].role
    wanted = {"exciter": {"Efd": FIELD}, "governor": {"Pm": POWER}}.get(role, {})
    references = {"exciter": ["Vref"], "governor": ["Pref"]}.get(role, [])
    control = block_controls.control(data)
    rest = block_rest.at_rest(control, [data], sensed(**changes), wanted, references)
    gives = float(rest.signals[len(SENSED) + control.gives.index(GIVES[role])])
    return control, AtRest(rest.states, rest.references[0] if references else 0.0, gives, rest.violations)


def response(data: Any, signals: str, s: complex) -> complex:
    """From signals that move together to what the control gives, at a complex frequency, by central differences."""
    control, rest = at_rest(data)
    n, at = len(rest.states), len(SENSED)
    gives = at + control.gives.index(GIVES[MODELS[data.model].role])
    values = np.zeros(at + len(control.rows))
    reference = {"exciter": "Vref", "governor": "Pref"}.get(MODELS[data.model].role, "none")
    for name, value in {"one": 1.0, **sensed(), reference: rest.reference}.items():
        values[SENSED.index(name)] = value
    values[SENSED.index("none")] = 0.0

    def move(z: NDArray[np.float64]) -> NDArray[np.float64]:
        outputs, dx, x = values.copy(), np.zeros(n), np.ascontiguousarray(z[:n])
        outputs[moved] += z[n]
        blocks.outputs(control.rows, 0, len(control.rows), at, x, outputs)
        blocks.derivatives(control.rows, 0, len(control.rows), x, outputs, dx)
        return np.append(dx, outputs[gives])

    names = signals.replace("Vt", "Vt+Vc").split("+")  # without load compensation
    moved, z = [SENSED.index(name) for name in names], np.append(rest.states, 0.0)
    slopes = np.array([(move(z + 1e-6 * e) - move(z - 1e-6 * e)) / 2e-6 for e in np.eye(n + 1)]).T
    A, B, C, D = slopes[:n, :n], slopes[:n, n], slopes[n, :n], slopes[n, n]
    return complex(C @ np.linalg.solve(s * np.eye(n) - A, B) + D)


# The transfer functions of the standards, each written out by itself: from the first signal, p.u. over p.u.


def dc(s: complex, d: Any, *, forward: complex | None = None, feedback: complex | None = None) -> complex:
    """From Vt: -1/(1 + s TR) times the forward path over one plus the loop; with the slope of SE(E) E."""
    first, second = d.SE1 * d.E1, d.SE2 * d.E2
    root = np.sqrt(first / second)
    A = (d.E1 - root * d.E2) / (1.0 - root)
    slope = 2.0 * second / (d.E2 - A) ** 2 * max(0.0, FIELD - A)
    field = 1.0 / (s * d.TE + d.KE + slope)
    regulator = d.KA / (1.0 + s * d.TA)
    before = 1.0 if forward is None else forward
    back = s * d.KF / (1.0 + s * getattr(d, "TF1", getattr(d, "TF", 1.0))) if feedback is None else feedback
    return complex(-before * regulator * field / (1.0 + s * d.TR) / (1.0 + before * regulator * field * back))


def dc_with_lead(s: complex, d: Any) -> complex:
    return dc(s, d, forward=(1.0 + s * d.TC) / (1.0 + s * d.TB))


def dc4b(s: complex, d: Any) -> complex:
    """With the slope of SE(E) E, SE exponential."""
    B = np.log(d.SE1 / d.SE2) / (d.E1 - d.E2)
    slope = d.SE1 * np.exp(B * (FIELD - d.E1)) * (1.0 + B * FIELD)
    field = 1.0 / (s * d.TE + d.KE + slope)
    forward = (d.KP + d.KI / s + s * d.KD / (1.0 + s * d.TD)) * d.KA / (1.0 + s * d.TA) * field
    return complex(-forward / (1.0 + s * d.TR) / (1.0 + forward * s * d.KF / (1.0 + s * d.TF)))


def ieeet2(s: complex, d: Any) -> complex:
    regulator, rate = d.KA / (1.0 + s * d.TA), s * d.KF / (1.0 + s * d.TF1) / (1.0 + s * d.TF2)
    plain = dc(s, d, feedback=0.0)
    return complex(plain / (1.0 + regulator * rate))


def exst1(s: complex, d: Any) -> complex:
    before, regulator = (1.0 + s * d.TC) / (1.0 + s * d.TB), d.KA / (1.0 + s * d.TA)
    return complex(-before * regulator / (1.0 + s * d.TR) / (1.0 + before * regulator * s * d.KF / (1.0 + s * d.TF)))


def exst3(s: complex, d: Any) -> complex:
    """KP Vt alone feeds it; KG Efd is subtracted before the regulator."""
    VB, regulator = d.KP * VOLTAGE, d.KA / (1.0 + s * d.TA)
    before = d.KJ * (1.0 + s * d.TC) / (1.0 + s * d.TB) / (1.0 + s * d.TR)
    # dEfd = VB dVR + VR KP dVt with dVR = regulator (-before dVt - KG dEfd)
    return complex((FIELD / VB * d.KP - VB * regulator * before) / (1.0 + VB * regulator * d.KG))


def esst3a(s: complex, d: Any) -> complex:
    """KP Vt alone feeds it: VB = KP Vt, which acts beside the regulator; KG Efd closes the inner loop."""
    VB, inner = d.KP * VOLTAGE, d.KM / (1.0 + s * d.TM)
    regulator = d.KA / (1.0 + s * d.TA) * (1.0 + s * d.TC) / (1.0 + s * d.TB) / (1.0 + s * d.TR)
    VM = FIELD / VB
    direct = VM * d.KP
    # dEfd = VB dVM + VM KP dVt with dVM = inner (-regulator dVt - KG dEfd)
    return complex((direct - VB * inner * regulator) / (1.0 + VB * inner * d.KG))


def _rate(s: complex, d: Any) -> complex:
    return complex(s * d.KF / (1.0 + s * d.TF))


def _esst1a(s: complex, d: Any) -> complex:
    """From the error to the output."""
    leads = (1.0 + s * d.TC) * (1.0 + s * d.TC1) / ((1.0 + s * d.TB) * (1.0 + s * d.TB1))
    return complex(leads * d.KA / (1.0 + s * d.TA))


def esst1a(s: complex, d: Any) -> complex:
    forward = _esst1a(s, d)
    return complex(-forward / (1.0 + s * d.TR) / (1.0 + forward * _rate(s, d)))


def esst1a_current(s: complex, d: Any) -> complex:
    """The field current is above ILR, so the limiter takes off KLR per p.u., inside the loop of the rate feedback."""
    return complex(-d.KLR / (1.0 + _esst1a(s, d) * _rate(s, d)))


def _alternator(s: complex, d: Any) -> tuple[complex, float]:
    """The regulator, and the slope of KE VE + SE(VE) VE; the rectifier works in its first mode, VE - 0.577 KC Ifd."""
    VE = FIELD + 0.577 * d.KC * FIELD
    assert d.KC * FIELD / VE < 0.433
    root = np.sqrt(d.SE1 * d.E1 / (d.SE2 * d.E2))
    A = (d.E1 - root * d.E2) / (1.0 - root)
    slope = 2.0 * d.SE2 * d.E2 / (d.E2 - A) ** 2 * (VE - A)
    return complex(d.KA / (1.0 + s * d.TA) * (1.0 + s * d.TC) / (1.0 + s * d.TB)), float(d.KE + slope)


def ac1(s: complex, d: Any) -> complex:
    """VE = VR / (s TE + k), fed back k VE."""
    regulator, k = _alternator(s, d)
    forward = regulator / (s * d.TE + k)
    return complex(-forward / (1.0 + s * d.TR) / (1.0 + forward * k * _rate(s, d)))


def ac1_current(s: complex, d: Any) -> complex:
    """s TE VE = -(1 + H) (k VE + KD Ifd) with the loop H of the rate feedback; the rectifier drops 0.577 KC Ifd."""
    regulator, k = _alternator(s, d)
    H = 1.0 + regulator * _rate(s, d)
    return complex(-H * d.KD / (s * d.TE + H * k) - 0.577 * d.KC)


def esst4b(s: complex, d: Any) -> complex:
    """KP Vt alone feeds it: dEfd = VB dVM + VM KP dVt with dVM = inner (dVR - KG dEfd)."""
    VB, inner = d.KP * VOLTAGE, d.KPM + d.KIM / s
    regulator = (d.KPR + d.KIR / s) / (1.0 + s * d.TA) / (1.0 + s * d.TR)
    return complex((FIELD / VB * d.KP - VB * inner * regulator) / (1.0 + VB * inner * d.KG))


def st6b(s: complex, d: Any) -> complex:
    """dEfd = Vt dVR + VR dVt with dVR = (KFF + KM) dVA - KM KG dEfd / (1 + s TG)."""
    pid = (d.KPA + d.KIA / s + s * d.KDA / (1.0 + s * d.TDA)) / (1.0 + s * d.TR)
    back = VOLTAGE * d.KM * d.KG / (1.0 + s * d.TG)
    return complex((FIELD / VOLTAGE - VOLTAGE * (d.KFF + d.KM) * pid) / (1.0 + back))


def _st8c(s: complex, d: Any) -> tuple[float, complex]:
    """VB1 with the rectifier in its first mode, and from the error of the field current to VR."""
    VB1 = float(d.KP * VOLTAGE - 0.577 * d.KC1 * FIELD)
    return VB1, complex(d.KPA + d.KIA / s) * complex(d.KA / (1.0 + s * d.TA))


def st8c(s: complex, d: Any) -> complex:
    VB1, inner = _st8c(s, d)
    return complex(FIELD / VB1 * d.KP - VB1 * inner * (d.KPR + d.KIR / s) / (1.0 + s * d.TR))


def st8c_current(s: complex, d: Any) -> complex:
    VB1, inner = _st8c(s, d)
    return complex(-VB1 * inner * d.KF / (1.0 + s * d.TF) - FIELD / VB1 * 0.577 * d.KC1)


def sexs(s: complex, d: Any) -> complex:
    return complex(-(1.0 + s * d.TATB * d.TB) / (1.0 + s * d.TB) * d.K / (1.0 + s * d.TE))


def tgov1(s: complex, d: Any) -> complex:
    return complex(-(1.0 / d.R) / (1.0 + s * d.T1) * (1.0 + s * d.T2) / (1.0 + s * d.T3) - d.DT)


def ieeeg1(s: complex, d: Any) -> complex:
    valve = -d.K * (1.0 + s * d.T2) / (1.0 + s * d.T1) / (1.0 + s * d.T3)
    P4 = valve / (1.0 + s * d.T4)
    P5 = P4 / (1.0 + s * d.T5)
    P6 = P5 / (1.0 + s * d.T6)
    P7 = P6 / (1.0 + s * d.T7)
    return complex((d.K1 + d.K2) * P4 + (d.K3 + d.K4) * P5 + (d.K5 + d.K6) * P6 + (d.K7 + d.K8) * P7)


def ieesgo(s: complex, d: Any) -> complex:
    wanted = -d.K1 * (1.0 + s * d.T2) / ((1.0 + s * d.T1) * (1.0 + s * d.T3))
    P4 = wanted / (1.0 + s * d.T4)
    P5 = d.K2 * P4 / (1.0 + s * d.T5)
    P6 = d.K3 * P5 / (1.0 + s * d.T6)
    return complex((1.0 - d.K2) * P4 + (1.0 - d.K3) * P5 + P6)


def tg(s: complex, d: Any) -> complex:
    return complex(
        -1.0 / d.R / (1.0 + s * d.TS) * (1.0 + s * d.T3) / (1.0 + s * d.TC) * (1 - s * d.TW) / (1 + s * d.T5)
    )


def gast(s: complex, d: Any) -> complex:
    return complex(-1.0 / d.R / (1.0 + s * d.T1) / (1.0 + s * d.T2) - d.DTURB)


def wsieg1(s: complex, d: Any) -> complex:
    """On the second part of the curve of its valve."""
    return complex(ieeeg1(s, d) * (d.PGV3 - d.PGV2) / (d.GV3 - d.GV2))


def _engine(s: complex, d: Any) -> complex:
    """From the error of speed to the throttle."""
    box = (1.0 + s * d.T3) / (1.0 + s * d.T1 + s * s * d.T1 * d.T2)
    return complex(box * d.K * (1.0 + s * d.T4) / (s * (1.0 + s * d.T5) * (1.0 + s * d.T6)))


def degov(s: complex, d: Any) -> complex:
    """The torque, delayed by exp(-s TD), times the speed."""
    return complex(POWER - np.exp(-s * d.TD) * _engine(s, d))


def degov1(s: complex, d: Any) -> complex:
    loop = 0.0 if d.M else d.DROOP * _engine(s, d)
    return complex(POWER - np.exp(-s * d.TD) * _engine(s, d) / (1.0 + loop))


def degov1_power(s: complex, d: Any) -> complex:
    seen = d.DROOP / (1.0 + s * d.TE) if d.M else 0.0
    return complex(-np.exp(-s * d.TD) * _engine(s, d) * seen)


def _water(s: complex, d: Any, TW: float) -> complex:
    """From the gate to the power, about the start."""
    gates, powers = (d.G0, d.G1, d.G2, 1.0), (0.0, d.P1, d.P2, d.P3)
    part = int(np.searchsorted(powers, POWER))
    slope = (powers[part] - powers[part - 1]) / (gates[part] - gates[part - 1])
    return complex(slope * (1.0 - s * TW) / (1.0 + 0.5 * s * TW))


def _pidgov(s: complex, d: Any) -> tuple[complex, complex]:
    """From the error of speed to the gate, and from what the droop sees to that error."""
    PID = ((d.KP + d.KI / s) + s * d.KD) / (1.0 + s * d.TA) ** 2
    return PID / (1.0 + s * d.TB), d.RPERM / (1.0 + s * d.TREG)


def pidgov(s: complex, d: Any) -> complex:
    forward, back = _pidgov(s, d)
    gate = -forward / (1.0 + (forward * back if d.M else 0.0))
    return complex(gate * _water(s, d, d.ATW * d.TW) - d.DTURB)


def pidgov_power(s: complex, d: Any) -> complex:
    forward, back = _pidgov(s, d)
    return 0.0 if d.M else -forward * back * _water(s, d, d.ATW * d.TW)


def _wpidhy(s: complex, d: Any) -> complex:
    """From the error of speed to the power."""
    PID = (d.KP + d.KI / s + s * d.KD) / (1.0 + s * d.TA) ** 2
    return complex(PID / (1.0 + s * d.TB) / s * _water(s, d, d.TW))


def wpidhy(s: complex, d: Any) -> complex:
    return -_wpidhy(s, d) - float(d.D)


def wpidhy_power(s: complex, d: Any) -> complex:
    return complex(_wpidhy(s, d) * d.REG / (1.0 + s * d.TREG))


def ieeest(s: complex, d: Any) -> complex:
    shaped = (1.0 + d.A5 * s + d.A6 * s * s) / ((1.0 + d.A1 * s + d.A2 * s * s) * (1.0 + d.A3 * s + d.A4 * s * s))
    leads = (1.0 + d.T1 * s) * (1.0 + d.T3 * s) / ((1.0 + d.T2 * s) * (1.0 + d.T4 * s))
    return complex(d.KS * d.T5 * s / (1.0 + d.T6 * s) * shaped * leads)


def st2cut(s: complex, d: Any) -> complex:
    leads = (1.0 + d.T5 * s) * (1.0 + d.T7 * s) * (1.0 + d.T9 * s)
    leads /= (1.0 + d.T6 * s) * (1.0 + d.T8 * s) * (1.0 + d.T10 * s)
    return complex(d.K1 / (1.0 + d.T1 * s) * d.T3 * s / (1.0 + d.T4 * s) * leads)


def st2cut_power(s: complex, d: Any) -> complex:
    return complex(st2cut(s, d) / d.K1 * (1.0 + d.T1 * s) * d.K2 / (1.0 + d.T2 * s))


def stab1(s: complex, d: Any) -> complex:
    leads = (1.0 + s * d.T1T3 * d.T3) * (1.0 + s * d.T2T4 * d.T4) / ((1.0 + s * d.T3) * (1.0 + s * d.T4))
    return complex(d.KT * d.T * s / (1.0 + s * d.T) * leads)


def psssim(s: complex, d: Any) -> complex:
    leads = (1.0 + s * d.T1) * (1.0 + s * d.T3) / ((1.0 + s * d.T2) * (1.0 + s * d.T4))
    return complex(d.K * s / (1.0 + s * d.TW) * leads)


def stab2a(s: complex, d: Any) -> complex:
    washed = -((d.K2 * d.T2 * s / (1.0 + d.T2 * s)) ** 3)
    return complex(washed * (d.K4 + d.K3 / (1.0 + d.T3 * s)) * (d.K5 / (1.0 + d.T5 * s)) ** 2)


def _pss2a(s: complex, d: Any) -> tuple[complex, complex]:
    """The ramp-tracking filter, and what stands behind the difference."""
    ramp = ((1.0 + d.T8 * s) / (1.0 + d.T9 * s) ** d.M) ** d.N
    behind = d.KS1 * (1.0 + d.T1 * s) * (1.0 + d.T3 * s) / ((1.0 + d.T2 * s) * (1.0 + d.T4 * s))
    for over, under in (("T10", "T11"), ("T12", "T13")):  # of PSS2B and PSS2C
        behind *= (1.0 + getattr(d, over, 0.0) * s) / (1.0 + getattr(d, under, 0.0) * s)
    return ramp, behind


def pss2a(s: complex, d: Any) -> complex:
    ramp, behind = _pss2a(s, d)
    washed = d.TW1 * s / (1.0 + d.TW1 * s) * d.TW2 * s / (1.0 + d.TW2 * s)
    return complex(behind * ramp * washed / (1.0 + d.T6 * s))


def pss2a_power(s: complex, d: Any) -> complex:
    ramp, behind = _pss2a(s, d)
    power = d.TW3 * s / (1.0 + d.TW3 * s) * d.KS2 / (1.0 + d.T7 * s)
    return complex(behind * (ramp * d.KS3 - 1.0) * power)


EXPECTED: list[tuple[str, str, Callable[[complex, Any], complex]]] = [
    ("IEEEX1", "Vt", dc_with_lead),
    ("EXDC1", "Vt", dc_with_lead),
    ("ESDC1A", "Vt", dc_with_lead),
    ("EXDC2", "Vt", dc_with_lead),
    ("ESDC2A", "Vt", dc_with_lead),
    ("EXDC2", "omega", lambda _s, _d: FIELD),  # the field voltage follows the speed
    ("DC4B", "Vt", dc4b),
    ("IEEET1", "Vt", dc),
    ("IEEET2", "Vt", ieeet2),
    ("EXST1", "Vt", exst1),
    ("EXST3", "Vt+Vq", exst3),
    ("ESST3A", "Vt+Vq", esst3a),  # its source is Vd + j Vq, here in the q axis
    ("ESST1A", "Vt", esst1a),
    ("ESST1A", "Ifd", esst1a_current),
    ("EXAC1", "Vt", ac1),
    ("EXAC1", "Ifd", ac1_current),
    ("ESAC1A", "Vt", ac1),
    ("ESAC1A", "Ifd", ac1_current),
    ("ESST4B", "Vt+Vq", esst4b),
    ("ST6B", "Vt", st6b),
    ("ST8C", "Vt+Vq", st8c),
    ("ST8C", "Ifd", st8c_current),
    ("SEXS", "Vt", sexs),
    ("SCRX", "Vt", sexs),
    ("TGOV1", "omega", tgov1),
    ("IEEEG1", "omega", ieeeg1),
    ("IEESGO", "omega", ieesgo),
    ("TG", "omega", tg),
    ("GAST", "omega", gast),
    ("WSIEG1", "omega", wsieg1),
    ("DEGOV", "omega", degov),
    ("DEGOV1", "omega", degov1),
    ("DEGOV1", "Pe", degov1_power),
    ("PIDGOV", "omega", pidgov),
    ("PIDGOV", "Pe", pidgov_power),
    ("WPIDHY", "omega", wpidhy),
    ("WPIDHY", "Pe", wpidhy_power),
    ("IEEEST", "omega", ieeest),
    ("ST2CUT", "omega", st2cut),
    ("ST2CUT", "Pe", st2cut_power),
    ("STAB1", "omega", stab1),
    ("PSSSIM", "omega", psssim),
    ("STAB2A", "Pe", stab2a),
    *((model, "omega", pss2a) for model in ("PSS2A", "PSS2B", "PSS2C")),
    *((model, "Pe", pss2a_power) for model in ("PSS2A", "PSS2B", "PSS2C")),
]


def test_table_of_transfer_functions_covers_all_control_models() -> None:
    assert {model for model, _, _ in EXPECTED} == set(BLOCK_CONTROLS) == set(DATA)


@pytest.mark.parametrize(("model", "signals", "expected"), EXPECTED)
@pytest.mark.parametrize("hertz", [0.02, 0.6, 2.0, 20.0])
def test_control_is_the_transfer_function_of_its_standard(
    model: str, signals: str, expected: Callable[[complex, Any], complex], hertz: float
) -> None:
    data, s = control_of(model), 2j * np.pi * hertz
    assert response(data, signals, s) == pytest.approx(expected(s, data), rel=1e-5, abs=1e-7)
    if hasattr(data, "M") and MODELS[model].role == "governor":  # where its droop comes from
        other = control_of(model, M=1.0 - data.M)
        assert response(other, signals, s) == pytest.approx(expected(s, other), rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("hertz", [0.1, 0.7, 5.0])
@pytest.mark.parametrize("filters", [(1.013, 0.013, 0.0, 0.0), (0.1, 0.0, 0.2, 0.0), (0.1, 0.0, 0.2, 0.02)])
def test_numerator_of_order_two_acts_over_any_denominator_of_order_two(
    filters: tuple[float, ...], hertz: float
) -> None:
    """IEEEST as in WECC-240, whose second filter is none; of two filters of first order; of the second alone."""
    changes = dict(zip(("A1", "A2", "A3", "A4"), filters, strict=True))
    data, s = control_of("IEEEST", **changes, A5=1.013, A6=0.113, T1=3.0, T2=0.02, T3=0.0, T4=0.0), 2j * np.pi * hertz
    assert response(data, "omega", s) == pytest.approx(ieeest(s, data), rel=1e-5)


@pytest.mark.parametrize("model", BLOCK_CONTROLS)
def test_block_whose_time_constant_is_zero_has_no_state(model: str) -> None:
    """But for those that need one: of a loop, of an integrator."""
    needed = {"T3", "TA", "TE", "TM", "TF1", "TG"}
    times = [name for name in MODELS[model].fields.split() if quantity_of(name).time]
    fast = {name: 0.0 for name in times if name not in needed}
    plain, quick = block_controls.control(control_of(model)), block_controls.control(control_of(model, **fast))
    assert len(quick.states) < len(plain.states)
    assert sorted(quick.gives) == sorted(plain.gives)


def test_control_models_start_at_rest_within_their_limits() -> None:
    for model in BLOCK_CONTROLS:
        data = control_of(model)
        control, rest = at_rest(data)
        assert rest.violations == []
        values, dx = np.zeros(len(SENSED) + len(control.rows)), np.ones(len(rest.states))
        reference = {"exciter": "Vref", "governor": "Pref"}.get(MODELS[model].role, "none")
        for name, value in {"one": 1.0, **sensed(), reference: rest.reference}.items():
            values[SENSED.index(name)] = value
        values[SENSED.index("none")] = 0.0
        blocks.outputs(control.rows, 0, len(control.rows), len(SENSED), rest.states, values)
        blocks.derivatives(control.rows, 0, len(control.rows), rest.states, values, dx)
        assert np.abs(dx).max() < 1e-8
        output = values[len(SENSED) + control.gives.index(GIVES[MODELS[model].role])]
        assert output == pytest.approx({"exciter": FIELD, "governor": POWER, "stabiliser": 0.0}[MODELS[model].role])


@given(st.lists(st.floats(-50.0, 50.0), min_size=5, max_size=40))
def test_limited_state_stays_within_its_limits_and_leaves_them_at_once(errors: list[float]) -> None:
    """It does not wind up: where the input turns, so does the state."""
    data = control_of("IEEEX1", TB=0.0, TC=0.0, KF=0.0)
    control, rest = at_rest(data)
    x, dx, values = rest.states.copy(), np.zeros(len(rest.states)), np.zeros(len(SENSED) + len(control.rows))
    values[SENSED.index("one")] = 1.0
    VR, h = control.states.index("VR"), 0.001
    for error in errors:
        values[SENSED.index("Vref")], values[SENSED.index("Vc")] = error, 0.0
        x[control.states.index("VT")] = 0.0
        for _ in range(20):
            blocks.outputs(control.rows, 0, len(control.rows), len(SENSED), x, values)
            blocks.derivatives(control.rows, 0, len(control.rows), x, values, dx)
            towards = np.sign(data.KA * error - x[VR])
            assert dx[VR] * towards >= 0.0
            assert dx[VR] != 0.0 or x[VR] in (data.VRMIN, data.VRMAX) or towards == 0.0
            x[VR] = min(max(x[VR] + h * dx[VR], data.VRMIN), data.VRMAX)


def test_integral_of_a_pid_stops_at_its_limit_and_leaves_it_at_once() -> None:
    data = control_of("DC4B", KA=2.0)
    control, rest = at_rest(data)
    x, dx, values = rest.states.copy(), np.zeros(len(rest.states)), np.zeros(len(SENSED) + len(control.rows))
    values[SENSED.index("one")] = 1.0
    integral = control.states.index("integral")
    x[integral] = data.VRMAX / data.KA
    for error, slope in ((0.1, 0.0), (-0.1, -0.1 * data.KI)):
        x[control.states.index("VT")] = rest.reference - error
        values[SENSED.index("Vref")] = rest.reference
        blocks.outputs(control.rows, 0, len(control.rows), len(SENSED), x, values)
        blocks.derivatives(control.rows, 0, len(control.rows), x, values, dx)
        assert dx[integral] == pytest.approx(slope)


@pytest.mark.parametrize(
    ("loading", "fraction"),
    [(-0.1, 1.0), (0.0, 1.0), (0.2, 0.8846), (0.433, 0.7502), (0.6, 0.6245), (0.75, 0.4330), (0.9, 0.1732), (1.2, 0.0)],
)
def test_rectifier_is_that_of_the_standard(loading: float, fraction: float) -> None:
    """IEEE Std 421.5, annex D: three modes of commutation."""
    assert blocks._rectified(2.0, 2.0 * loading) == pytest.approx(2.0 * fraction, abs=2e-4)


def test_source_of_a_compound_exciter_is_that_of_the_standard() -> None:
    """VE = |KP V + j (KI + KP XL) I|, KP at the angle THETAP."""
    data = control_of("ESST3A", KI=0.435, XL=0.0098, THETAP=3.33, KC=0.01)
    control, rest = at_rest(data, Vd=0.3, Vq=0.97)
    values = np.zeros(len(SENSED) + len(control.rows))
    for name, value in {"one": 1.0, **sensed(Vd=0.3, Vq=0.97), "Vref": rest.reference}.items():
        values[SENSED.index(name)] = value
    blocks.outputs(control.rows, 0, len(control.rows), len(SENSED), rest.states, values)
    KP = 3.67 * np.exp(1j * np.radians(3.33))
    expected = abs(KP * (0.3 + 0.97j) + 1j * (0.435 + KP * 0.0098) * (0.5 + 0.6j))
    assert values[len(SENSED) + control.gives.index("VE")] == pytest.approx(expected)


def test_invalid_data_of_a_control_model_are_refused() -> None:
    with pytest.raises(InputError, match=r"ESST3A of G1: an algebraic loop: .*; allowed: a time constant above 0"):
        block_controls.control(control_of("ESST3A", TM=0.0))
    with pytest.raises(ValueError, match=r"TA must be 0 or at least 0.002 s, given 0.001"):
        control_of("IEEEX1", TA=0.001)
    _, rest = at_rest(control_of("IEEEX1", VRMAX=1.0))
    (violation,) = rest.violations
    assert str(violation).startswith("exciters: G1: IEEEX1: VR is ")
    assert str(violation).endswith(" p.u. at the start; allowed by its limits: -10 to 1 (VRMAX)")
    assert (violation.field, violation.wanted) == ("VRMAX", violation.value)


def test_blocks_fit_into_their_rows() -> None:
    for model in BLOCK_CONTROLS:
        control = block_controls.control(control_of(model))
        assert control.rows["inputs"].max() <= blocks.MAX_INPUTS
        assert len(set(control.states)) == len(control.states)
