"""A small system for analytic solutions: what hangs on infinite buses does not disturb its neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System

if TYPE_CHECKING:
    from collections.abc import Sequence

TIE = 0.05  # p.u., reactance between the infinite buses
SPUR = 0.04  # p.u., reactance from A to S


def between_infinite_buses(
    devices: Sequence[dict[str, Any]], degrees: float = 30.0, V: float = 1.0, **fields: Any
) -> System:
    """Buses A and B of fixed voltage, A leading, a lossless line `tie` between; S at the end of a line `spur` at A.

    The machine that a system must have stands at its own line to A and gives nothing.
    """
    lossless = {"r": 0.0, "b": 0.0}
    system = {
        "name": "small",
        "buses": [{"name": name, "nominal_voltage": 100.0} for name in ("A", "B", "S", "G")],
        "lines": [
            {"name": "tie", "from": "A", "to": "B", "x": TIE, **lossless},
            {"name": "spur", "from": "A", "to": "S", "x": SPUR, **lossless},
            {"name": "own", "from": "A", "to": "G", "x": 0.2, **lossless},
        ],
        "infinite_buses": [
            {"name": "west", "bus": "A", "V": V, "angle": degrees},
            {"name": "east", "bus": "B", "V": V},
        ],
        "machines": [
            {"name": "G1", "bus": "G", "rating": 100.0, "model": "classical", "P": 0.0, "V": V, "H": 5.0, "Xd1": 0.3}
        ],
        "devices": list(devices),
        "pmus": [
            {"name": "A", "bus": "A", "branches": ["tie"]},
            {"name": "B", "bus": "B", "branches": ["tie"]},
            {"name": "S", "bus": "S", "branches": ["spur"]},
        ],
    }
    return place(System.model_validate({**system, **fields}))
