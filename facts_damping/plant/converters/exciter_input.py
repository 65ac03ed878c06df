"""Exciter input: a setpoint added where a machine's stabiliser adds its output; compiled.

It has no port: `plant.dynamics` adds the reference of a device at a machine to the regulator's summing point.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.actuators import ExciterInput
    from facts_damping.plant.converters.site import Site

EXCITER_INPUT = np.dtype([("machine", "i8")])  # its index


def start(_device: ExciterInput, site: Site) -> Start:
    """The device at rest, without states."""
    return Start((site.machine,), [], 0.0)


@compiled
def characteristic(_d: Any, _x: Float1, _u: float, _size: float) -> tuple[complex, complex]:
    """No source in the network."""
    return 0j, 0j
