"""Power at a bus as a current by its voltage, reduced at low voltage; compiled."""

from __future__ import annotations

import math

from facts_damping.compiling import compiled


def beside(power_factor: float) -> float:
    """Reactive over active power at a power factor, tan(arccos(pf))."""
    return math.sqrt(1.0 - power_factor * power_factor) / power_factor


@compiled
def power_fraction(voltage: float, V_min: float) -> float:
    """Factor of the power at a bus voltage: one above V_min, (V / V_min)^2 below, as an impedance."""
    return 1.0 if voltage >= V_min else voltage * voltage / (V_min * V_min)


@compiled
def current(P: float, Q: float, Q_slope: float, voltage: float, V_min: float) -> tuple[complex, complex]:
    """Current into the network that gives P + j Q, relative to the direction of the voltage, and its derivative; p.u.

    i = k(V) (P - j Q) / V with k = 1 from V_min on, below it (V / V_min)^2, as an impedance. `Q_slope`: dQ/dV.
    """
    fraction = power_fraction(voltage, V_min)
    slope = 0.0 if voltage >= V_min else 2.0 * voltage / (V_min * V_min)
    power = complex(P, -Q)
    value = fraction * power / voltage
    return value, (slope * power + fraction * complex(0.0, -Q_slope) - value) / voltage
