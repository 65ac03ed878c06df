"""Loads that depend on voltage (ZIP model) or frequency, or have noise; compiled.

The network contains every load as its constant impedance at the reference voltage V0. Other loads inject the
difference.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.elementary import atan2, magnitude
from facts_damping.elementary.arithmetic import divided

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.grid import Load

LOAD = np.dtype(
    [
        ("P", "f8"),  # p.u., drawn at V0
        ("Q", "f8"),
        ("V0", "f8"),  # p.u.
        ("P_current", "f8"),  # fractions of constant current and constant power
        ("P_power", "f8"),
        ("Q_current", "f8"),
        ("Q_power", "f8"),
        ("V_min", "f8"),  # p.u. of V0
        ("port", "i8"),
        ("offset", "i8"),  # index of its states in the plant's; -1: independent of frequency
        ("kpf", "f8"),
        ("kqf", "f8"),
        ("T_f", "f8"),  # s
    ]
)
STATE_NAMES = ["theta", "theta_w"]  # lagged angles of the bus voltage (rad)
MINIMUM = 0.05  # p.u., voltage below which its angle is not used
TURN = 2.0 * math.pi


def row(load: Load, base_power: float, reference_voltage: float, port: int, offset: int) -> Any:
    """A row of LOAD; `offset`: index of its states if it depends on frequency."""
    p, q = load.P_fractions, load.Q_fractions
    power = load.P / base_power, load.Q / base_power
    fractions = p.current, p.power, q.current, q.power
    common = port, offset if depends_on_frequency(load) else -1, load.kpf, load.kqf, load.T_f
    return (*power, reference_voltage, *fractions, load.V_min, *common)


def is_impedance(load: Load) -> bool:
    """Whether a load is a pure constant impedance."""
    return load.P_fractions.impedance == load.Q_fractions.impedance == 1.0 and not depends_on_frequency(load)


def depends_on_frequency(load: Load) -> bool:
    """Whether a load depends on the frequency."""
    return load.kpf != 0.0 or load.kqf != 0.0


@compiled
def excess(r: float, current: float, power: float, v_min: float, low: bool) -> tuple[float, float]:
    """Power drawn beyond the impedance at r = V / V0, relative to the power at V0, and its derivative by r.

    i r + p - (i + p) r^2; below V_min the fractions i and p become an impedance: (i V_min + p) (r / V_min)^2. With
    `low` they are this impedance at any voltage.
    """
    if r >= v_min and not low:
        return current * r + power - (current + power) * r * r, current - 2.0 * (current + power) * r
    square = (current * v_min + power) / (v_min * v_min) - (current + power)
    return square * r * r, 2.0 * square * r


@compiled
def frequency(d: Any, x: Float1, omega_0: float) -> float:
    """Frequency deviation at a load's bus, p.u.: (theta - theta_w) / (T_f omega_0)."""
    return (x[d.offset] - x[d.offset + 1]) / (d.T_f * omega_0)  # type: ignore[no-any-return]


@compiled
def derivatives(d: Any, x: Float1, voltage: complex, dx: Float1) -> None:
    """Write the derivatives of a load's angles, rad/s: T_f dtheta = arg V - theta, T_f dtheta_w = theta - theta_w.

    So `frequency` is s arg V / (1 + s T_f)^2, a lag and a washout, as in BusFreq of ANDES. The angles are held while
    the voltage is nearly zero.
    """
    o = d.offset
    if not magnitude(voltage) > MINIMUM:
        dx[o] = dx[o + 1] = 0.0
        return
    ahead = atan2(voltage.imag, voltage.real) - x[o]
    dx[o] = (ahead - TURN * math.floor(ahead / TURN + 0.5)) / d.T_f
    dx[o + 1] = (x[o] - x[o + 1]) / d.T_f


@compiled
def characteristic(
    d: Any, voltage: float, low: bool, active_factor: float, reactive_factor: float
) -> tuple[complex, complex]:
    """Current injected beside the impedance relative to the voltage's direction, and its derivative by |V|, p.u.

    It is -conj(dS) / |V| with dS the power beyond the impedance. If the power at a voltage is multiplied by m, dS is m
    times its value plus (m - 1) r^2.
    """
    r = voltage / d.V0
    active, active_slope = excess(r, d.P_current, d.P_power, d.V_min, low)
    reactive, reactive_slope = excess(r, d.Q_current, d.Q_power, d.V_min, low)
    more, more_reactive = active_factor - 1.0, reactive_factor - 1.0
    active, active_slope = active_factor * active + more * r * r, active_factor * active_slope + 2.0 * more * r
    reactive = reactive_factor * reactive + more_reactive * r * r
    reactive_slope = reactive_factor * reactive_slope + 2.0 * more_reactive * r
    drawn = complex(d.P * active, -d.Q * reactive)
    slope = complex(d.P * active_slope / d.V0, -d.Q * reactive_slope / d.V0)
    relative = divided(drawn, voltage)
    return -relative, divided(relative - slope, voltage)
