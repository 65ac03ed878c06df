"""What tests of both devices of two_area share: one controller for both, or one for each."""

from __future__ import annotations

import json

from facts_damping.control.table import kind

BOTH = ["sssc", "statcom"]


def centralised(name: str, scheme: str | None) -> list[str]:
    """The changes to a run that make it one with a single controller."""
    controller: dict[str, object] = {
        "name": name,
        "devices": BOTH,
        "signals": ["speed", "power"][: kind(name).signals],
        "scheme": scheme,
    }
    return _sets([controller])


def decentralised(name: str, scheme: str | None) -> list[str]:
    """And with one beside each device."""
    signals = {"sssc": ["speed"], "statcom": ["speed", "power"]}
    return _sets([{"name": name, "devices": [device], "signals": signals[device], "scheme": scheme} for device in BOTH])


def _sets(controllers: list[dict[str, object]]) -> list[str]:
    rows = [{key: value for key, value in row.items() if value is not None} for row in controllers]
    return [f"devices={json.dumps(BOTH)}", f"controllers={json.dumps(rows)}"]


# Devices of two_area of the kinds that it lacks.
ACTUATORS = [
    {"name": "bess", "kind": "bess", "bus": "B9", "S_rated": 100, "E_rated": 1, "setpoint_max": 0.5, "rate_max": 5},
    {"name": "shed", "kind": "load_modulation", "bus": "B7", "setpoint_max": 0.5, "rate_max": 5},
    {"name": "tcsc", "kind": "tcsc", "line": "line_3", "X": 0.01, "X_min": 0.002, "X_max": 0.02}
    | {"setpoint_max": 0.005, "rate_max": 0.3},
    {"name": "avr", "kind": "exciter_input", "machine": "G2", "setpoint_max": 0.05, "rate_max": 5},
]
