"""The static var compensator: a susceptance that follows a voltage regulator; compiled.

A setpoint is an offset of the voltage reference (docs/facts_devices.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.devices import Svc
    from facts_damping.plant.converters.site import Site

STATE_NAMES = ["B"]
FIELDS = ("K", "T", "B_min", "B_max")

SVC = np.dtype([("offset", "i8"), ("Vref", "f8"), *((name, "f8") for name in FIELDS)])


def start(device: Svc, site: Site) -> Start:
    """The device at rest: zero susceptance, and the matching voltage reference."""
    row = (site.offset, site.size, *(getattr(device, name) for name in FIELDS))
    return Start(row, [0.0], device.V_min)


@compiled
def characteristic(device: Any, x: Float1, _u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network relative to the direction of the voltage, -j B |V|, and its derivative by |V|, p.u."""
    d = device.svc
    slope = complex(0.0, -x[d.offset])
    return slope * voltage, slope


@compiled
def derivatives(device: Any, x: Float1, u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the state, 1/s: T dB = clip(K (Vref + u - V), B_min, B_max) - B."""
    d = device.svc
    wanted = d.K * (d.Vref + u - voltage)
    dx[d.offset] = (min(max(wanted, d.B_min), d.B_max) - x[d.offset]) / d.T


@compiled
def truth(device: Any, x: Float1, _u: float, _voltage: float, _blocked: bool, out: Any) -> None:
    """Write its susceptance as the state of DEVICE_TRUTH."""
    out.state = x[device.svc.offset]
