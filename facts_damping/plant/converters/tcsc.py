"""The thyristor-controlled series capacitor: a reactance that follows its setpoint; compiled.

A positive setpoint is more capacitive, which raises the transfer (docs/facts_devices.md). Its port stands behind
`rs + j xs`, what is left while it is bypassed, so that its source is the voltage -j (x + xs) I.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.errors import InputError
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.actuators import Tcsc
    from facts_damping.plant.converters.site import Site

STATE_NAMES = ["x"]
FIELDS = ("rs", "xs", "X", "X_min", "X_max", "T")

TCSC = np.dtype([("offset", "i8"), *((name, "f8") for name in FIELDS)])


def start(device: Tcsc, site: Site) -> Start:
    """The device at rest with its reactance X. Raises `InputError` if its current is so large that it is bypassed."""
    if site.size > device.I_max:
        raise InputError(
            f"devices: {device.name} carries {site.size:.4g} p.u. at the start; "
            f"allowed: at most I_max, {device.I_max:g}"
        )
    return Start((site.offset, *(getattr(device, name) for name in FIELDS)), [device.X], 0.0, device.I_max)


@compiled
def characteristic(device: Any, x: Float1, _u: float, magnitude: float) -> tuple[complex, complex]:
    """Voltage drop relative to the direction of the current, -j (x + xs) |I|, and its derivative by |I|, p.u."""
    d = device.tcsc
    slope = complex(0.0, -(x[d.offset] + d.xs))
    return slope * magnitude, slope


@compiled
def derivatives(device: Any, x: Float1, u: float, _magnitude: float, dx: Float1) -> None:
    """Write the derivative of the state, p.u./s: T dx = clip(X + u, X_min, X_max) - x."""
    d = device.tcsc
    dx[d.offset] = (min(max(d.X + u, d.X_min), d.X_max) - x[d.offset]) / d.T


@compiled
def truth(device: Any, x: Float1, _u: float, magnitude: float, blocked: bool, out: Any) -> None:
    """Write its fields of DEVICE_TRUTH: reactance, voltages, and the power that it gives."""
    d = device.tcsc
    capacitive = -d.xs if blocked else x[d.offset]
    out.state = x[d.offset]
    out.injected_voltage = capacitive * magnitude
    out.active_voltage = 0.0
    out.current = magnitude
    out.active_power = -d.rs * magnitude * magnitude
    out.reactive_power = capacitive * magnitude * magnitude
