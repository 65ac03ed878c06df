"""The HVDC link: ordered power from one bus to another, reduced at low voltage; compiled.

Its first port is at the inverter's bus, into which it feeds power; the other one is at the rectifier's. A setpoint is
added to the power order (docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.errors import InputError
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.devices import Hvdc
    from facts_damping.plant.converters.site import Site

STATE_NAMES = ["V_to", "V_from"]
POWERS = ("P", "P_min", "P_max")
FIELDS = ("loss", "R", "V_min", "T")

# `q_to`, `q_from`: reactive power drawn, relative to the active power.
HVDC = np.dtype([("offset", "i8"), *((name, "f8") for name in (*POWERS, *FIELDS, "q_to", "q_from"))])


def beside(power_factor: float) -> float:
    """Reactive over active power at a power factor, tan(arccos(pf))."""
    return math.sqrt(1.0 - power_factor * power_factor) / power_factor


def consumed_power(device: Hvdc, _voltages: Sequence[float], base_power: float) -> list[complex]:
    """Power drawn at rest from the inverter's bus and the rectifier's, P + j Q, p.u. of the base (MVA)."""
    P = device.P / base_power
    given = P * (1.0 - device.loss) - device.R * P * P
    return [given * complex(-1.0, beside(device.pf_to)), P * complex(1.0, beside(device.pf_from))]


def start(device: Hvdc, site: Site) -> Start:
    """The link at its power order. Raises `InputError` if an initial voltage is too low for it."""
    for bus, voltage in zip(device.buses, (site.size, site.other), strict=True):
        if voltage < device.V_min:
            raise InputError(
                f"devices: {device.name}: {bus} has {voltage:.4g} p.u. of voltage at the start; "
                f"allowed: at least its V_min, {device.V_min:g}"
            )
    powers = (getattr(device, name) / site.base_power for name in POWERS)
    others = (getattr(device, name) for name in FIELDS)
    row = (site.offset, *powers, *others, beside(device.pf_to), beside(device.pf_from))
    return Start(row, [site.size, site.other], 0.0)


@compiled
def power_fraction(voltage: float, V_min: float) -> float:
    """Factor of the power at a bus voltage: one above V_min, (V / V_min)^2 below, as an impedance."""
    return 1.0 if voltage >= V_min else voltage * voltage / (V_min * V_min)


@compiled
def power(d: Any, x: Float1, u: float, voltage: float) -> tuple[float, float]:
    """Power at the rectifier by the voltage of one end's bus, and its derivative by that voltage; p.u.

    P = clip(P0 + u, P_min, P_max) min(fraction(V), fraction(V_to), fraction(V_from)). V_to and V_from are states: the
    lagged voltages known to both ends.
    """
    order = min(max(d.P + u, d.P_min), d.P_max)
    known = min(power_fraction(x[d.offset], d.V_min), power_fraction(x[d.offset + 1], d.V_min))
    own = power_fraction(voltage, d.V_min)
    if own < known:
        return order * own, 2.0 * order * voltage / (d.V_min * d.V_min)
    return order * known, 0.0


@compiled
def to_end(device: Any, x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the inverter's bus relative to the direction of its voltage, and its derivative by |V|, p.u.

    The link feeds in p = P (1 - loss) - R P^2 and draws q p: conj(S) / |V| = p (1 + j q) / |V|.
    """
    d = device.hvdc
    P, slope = power(d, x, u, voltage)
    given, by_power = P * (1.0 - d.loss) - d.R * P * P, 1.0 - d.loss - 2.0 * d.R * P
    along = complex(1.0, d.q_to)
    value = given * along / voltage
    return value, (by_power * slope * along - value) / voltage


@compiled
def from_end(device: Any, x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the rectifier's bus, where the link draws P and q P: P (-1 + j q) / |V|, and its derivative, p.u."""
    d = device.hvdc
    P, slope = power(d, x, u, voltage)
    along = complex(-1.0, d.q_from)
    value = P * along / voltage
    return value, (slope * along - value) / voltage


@compiled
def derivatives(device: Any, x: Float1, _u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the lagged voltage of the inverter's bus, 1/s: T dV_to = |V| - V_to."""
    d = device.hvdc
    dx[d.offset] = (voltage - x[d.offset]) / d.T


@compiled
def from_derivatives(device: Any, x: Float1, _u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the lagged voltage of the rectifier's bus, 1/s: T dV_from = |V| - V_from."""
    d = device.hvdc
    dx[d.offset + 1] = (voltage - x[d.offset + 1]) / d.T
