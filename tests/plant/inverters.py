"""Inverters of tests, with the constants of PowerSimulationsDynamics.jl's cases (BSD-3, commit f77d3df)."""

from __future__ import annotations

from typing import Any

from facts_damping.machine_controls.block_models import MODELS

VALUES = {
    "REGCA1": "0 0.02 10 0.9 0.4 1.22 1.2 0.9 0.5 -1.3 0.2 0 100 -100 0",
    "REECB1": "0 0 0 0 0 -99 99 0.02 -0.01 0.01 1 1.1 -1.1 0 0 0.44 -0.44 1.05 0.9 "
    "0 0.01 10 60 0.02 99 -99 1.2 0 1.11 0.02",
    "REPCA1": "0 0 0 0 0 1 0 0.02 25 15 0 0.05 0 0 0 0 0.4 -0.4 0 0 0.43 -0.43 "
    "1 0.05 0.25 -0.01 0.01 99 -99 1.2 0 0.1 0 0",
}

# With sources of voltage: no two time constants alike, all limits there.
SOURCES = {
    "REGFMA1": "0 1 0.02 0.025 0.016 1.4 1.2 0 1 0 0.6 -0.5 0.03 0.05 0.02 0.2 0.1 10 0.1 6 0.01 0.12 0 0 0",
    "REGFMB1": "0 0 1 1 1 1 0.05 0.1 5 0.02 0.05 -0.05 0.265 2.65 0.2 -0.2 0.03 0.5 1 80 40 1.2 0.9 2 1.4 "
    "0.02 0.026 0.017 0.012 1 0.05 0.005 0.1",
    "REGCB1": "0 0 0.02 0.03 20 -20 10 0.01 1.3 0.005 0.15",
    "REGCC1": "0 0 0.018 0.03 20 -20 10 0.01 1.3 0.5 20 20 700 60 -60 0.005 0.15",
}


def constants(model: str, **changes: Any) -> dict[str, Any]:
    """A model with its constants."""
    values = map(float, {**VALUES, **SOURCES}[model].split())
    return {"model": model, **dict(zip(MODELS[model].fields.split(), values, strict=True)), **changes}


def following(name: str, bus: str, P: float, **changes: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """An inverter that follows the grid, with REECB1 and REPCA1; `changes` by model, or of its own row."""
    of_model = {model: changes.pop(model, {}) for model in VALUES}
    row = {"name": name, "bus": bus, "P": P, "rating": 100.0, **constants("REGCA1", **of_model["REGCA1"]), **changes}
    return row, [{"inverter": name, **constants(model, **of_model[model])} for model in ("REECB1", "REPCA1")]
