"""Loads whose power depends on their voltage (ZIP model); compiled.

The network holds every load as the impedance that it is at its reference voltage V0. A load with shares of
constant current or power injects beside it what makes up the difference.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled

if TYPE_CHECKING:
    from facts_damping.parameters.grid import Load

LOAD = np.dtype(
    [
        ("P", "f8"),  # p.u., drawn at V0
        ("Q", "f8"),
        ("V0", "f8"),  # p.u.
        ("P_current", "f8"),  # shares of constant current and constant power
        ("P_power", "f8"),
        ("Q_current", "f8"),
        ("Q_power", "f8"),
        ("V_min", "f8"),  # p.u. of V0
    ]
)


def row(load: Load, base_power: float, reference_voltage: float) -> Any:
    """A row of LOAD."""
    p, q = load.P_shares, load.Q_shares
    power = load.P / base_power, load.Q / base_power
    return (*power, reference_voltage, p.current, p.power, q.current, q.power, load.V_min)


def is_impedance(load: Load) -> bool:
    """Whether a load is one of constant impedance alone."""
    return load.P_shares.impedance == load.Q_shares.impedance == 1.0


@compiled
def excess(r: float, current: float, power: float, v_min: float, low: bool) -> tuple[float, float]:
    """What a load draws beyond an impedance at r = V / V0, relative to its power at V0, and its derivative by r.

    i r + p - (i + p) r^2; below V_min the shares i and p are an impedance: (i V_min + p) (r / V_min)^2. With
    `low` they are that at any voltage.
    """
    if r >= v_min and not low:
        return current * r + power - (current + power) * r * r, current - 2.0 * (current + power) * r
    square = (current * v_min + power) / (v_min * v_min) - (current + power)
    return square * r * r, 2.0 * square * r


@compiled
def characteristic(d: Any, magnitude: float, low: bool) -> tuple[complex, complex]:
    """Current injected beside the impedance over the direction of the bus voltage, and its derivative by |V|, p.u.

    -conj(dS) / |V| with dS the power drawn beyond the impedance.
    """
    r = magnitude / d.V0
    active, active_slope = excess(r, d.P_current, d.P_power, d.V_min, low)
    reactive, reactive_slope = excess(r, d.Q_current, d.Q_power, d.V_min, low)
    drawn = complex(d.P * active, -d.Q * reactive)
    slope = complex(d.P * active_slope, -d.Q * reactive_slope) / d.V0
    return -drawn / magnitude, (drawn / magnitude - slope) / magnitude
