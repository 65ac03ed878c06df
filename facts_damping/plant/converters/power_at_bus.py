"""Power at a bus as a current by its voltage, reduced at low voltage; compiled."""

from __future__ import annotations

from facts_damping.compiling import compiled
from facts_damping.plant.converters.hvdc import power_fraction


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
