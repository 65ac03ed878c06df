"""Load modulation: power drawn at a bus in addition to its loads, in proportion to the setpoint; compiled.

A positive setpoint is more load, as in PSTess (docs/facts_devices.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant.converters.hvdc import beside
from facts_damping.plant.converters.power_at_bus import current
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.actuators import LoadModulation
    from facts_damping.plant.converters.site import Site

# `q`: reactive power drawn, relative to the active power.
LOAD_MODULATION = np.dtype([("V_min", "f8"), ("q", "f8")])


def start(device: LoadModulation, _site: Site) -> Start:
    """The device at rest, without power and states."""
    return Start((device.V_min, beside(device.pf)), [], 0.0)


@compiled
def characteristic(device: Any, _x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network that draws u (1 + j q), relative to the voltage's direction, and its derivative, p.u."""
    d = device.load_modulation
    return current(-u, -u * d.q, 0.0, voltage, d.V_min)
