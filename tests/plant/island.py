"""A machine by itself with a load at its terminals: what the load draws is what the machine gives."""

from __future__ import annotations

from typing import Any

from facts_damping.parameters.plant.system import System

P, X, H, V = 0.8, 0.3, 5.0, 1.0  # p.u., p.u., s, p.u.


def island(**load: Any) -> System:
    """Base 100 MVA; a classical machine and a load of constant power, active, unless it is told otherwise."""
    return System.model_validate(
        {
            "name": "island",
            "buses": [{"name": "B", "nominal_voltage": 20.0}],
            "machines": [
                {
                    "name": "G",
                    "bus": "B",
                    "rating": 100.0,
                    "model": "classical",
                    "slack": True,
                    "V": V,
                    "H": H,
                    "Xd1": X,
                }
            ],
            "loads": [
                {"name": "load", "bus": "B", "P": 100 * P, "Q": 0.0, "P_fractions": {"power": 1.0}, "T_f": 0.02, **load}
            ],
            "pmus": [{"name": "G", "machine": "G"}],
        }
    )
