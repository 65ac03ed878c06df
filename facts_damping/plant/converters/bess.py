"""Battery storage: power by its setpoint within rating and charge, voltage support by a droop; compiled.

A positive setpoint is power into the grid (docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant.converters.hvdc import power_fraction
from facts_damping.plant.converters.power_at_bus import current
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.actuators import Bess
    from facts_damping.plant.converters.site import Site

STATE_NAMES = ["charge"]
FIELDS = ("charge_min", "charge_max", "taper", "eta_in", "eta_out", "K", "V_min")

# `S`: rating, p.u.; `E`: energy, p.u. s.
BESS = np.dtype([("offset", "i8"), *((name, "f8") for name in ("S", "E", "Vref", *FIELDS))])


def start(device: Bess, site: Site) -> Start:
    """The device at rest: no power, its initial charge, and the matching voltage reference."""
    S, E = device.S_rated / site.base_power, 3600.0 * device.E_rated / site.base_power
    row = (site.offset, S, E, site.size, *(getattr(device, name) for name in FIELDS))
    return Start(row, [device.charge], 0.0)


@compiled
def active(d: Any, charge: float, u: float) -> float:
    """Active power at a charge before the effect of low voltage, p.u.

    P = clip(u, -S f, S f), f = clip((charge_max - charge) / taper, 0, 1) for charging and
    clip((charge - charge_min) / taper, 0, 1) for discharging.
    """
    limit = d.S * min(max((charge - d.charge_min) / d.taper, 0.0), 1.0)
    floor = -d.S * min(max((d.charge_max - charge) / d.taper, 0.0), 1.0)
    return min(max(u, floor), limit)  # type: ignore[no-any-return]


@compiled
def characteristic(device: Any, x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network relative to the voltage's direction, of P + j Q, and its derivative by |V|; p.u.

    Q = clip(K (Vref - V), +-sqrt(S^2 - P^2)): active power has priority.
    """
    d = device.bess
    P = active(d, x[d.offset], u)
    room = math.sqrt(d.S * d.S - P * P)
    Q, slope = d.K * (d.Vref - voltage), -d.K
    if abs(Q) > room:
        Q, slope = math.copysign(room, Q), 0.0
    return current(P, Q, slope, voltage, d.V_min)


@compiled
def derivatives(device: Any, x: Float1, u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the charge, 1/s: -P / (eta_out E) discharging, -eta_in P / E charging."""
    d = device.bess
    P = active(d, x[d.offset], u) * power_fraction(voltage, d.V_min)
    dx[d.offset] = -(P / d.eta_out if P > 0.0 else P * d.eta_in) / d.E


@compiled
def truth(device: Any, x: Float1, _u: float, _voltage: float, _blocked: bool, out: Any) -> None:
    """Write its charge as the state of DEVICE_TRUTH."""
    out.state = x[device.bess.offset]
