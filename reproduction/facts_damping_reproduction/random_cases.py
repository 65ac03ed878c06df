"""Random cases of two areas, as the published experiments have them: what varies, and one event each."""

from __future__ import annotations

from typing import Any

import numpy as np

Random = np.random.Generator
LINES = ("line_1", "line_2", "line_3", "line_4")  # of faults and trips
LOADS: dict[str, float] = {
    "system.loads.0.P": 967,
    "system.loads.0.Q": 100,
    "system.loads.1.P": 1767,
    "system.loads.1.Q": 100,
}
UNITS = {"system.machines.0.P": 700, "system.machines.2.P": 719, "system.machines.3.P": 700}
WRONG: dict[str, dict[str, float]] = {  # data of the model, each group times one random factor
    "H west": {"system.machines.0.H": 6.5, "system.machines.1.H": 6.5},
    "H east": {"system.machines.2.H": 6.175, "system.machines.3.H": 6.175},
    "tie": {f"system.lines.{i}.x": 0.001 for i in range(2, 6)},
    "regulators": {f"system.exciters.{i}.KA": 200 for i in range(4)},
    "governors": {f"system.governors.{i}.Tg": 0.2 for i in range(4)},
    "loads": {"system.loads.0.kpf": 1.5, "system.loads.1.kpf": 1.5},
}


def number(random: Random, low: float, high: float, *, logarithmic: bool = False) -> float:
    """A random number of four digits."""
    value = float(random.uniform(low, high))
    if logarithmic:
        value = float(np.exp(random.uniform(np.log(low), np.log(high))))
    return float(f"{value:.4g}")


def scaled(fields: dict[str, float], factor: float) -> dict[str, float]:
    """Fields times a factor."""
    return {name: float(f"{value * factor:.6g}") for name, value in fields.items()}


def event(random: Random, i: int, start: float) -> list[dict[str, Any]]:
    """One of six kinds of events."""
    line, place = LINES[random.integers(len(LINES))], number(random, 0.1, 0.9)
    fault = {"time": start, "kind": "fault", "line": line, "location": place}
    end, step = round(start + number(random, 0.05, 0.1), 3), number(random, 0.05, 0.15)
    return [
        [fault, {"time": end, "kind": "line_out", "line": line}],
        [fault, {"time": end, "kind": "clear", "line": line}],
        [{"time": start, "kind": "load_step", "load": "load_2", "change": -step}],
        [{"time": start, "kind": "mechanical_power_step", "machine": "G3", "change": -step}],
        [{"time": start, "kind": "line_out", "line": line}],
        [{"time": start, "kind": "load_step", "load": "load_1", "change": step}],
    ][i % 6]


def usual(random: Random) -> dict[str, Any]:
    """What varies in every case: loads, dispatch, noise, delay, loss, seed."""
    fields: dict[str, Any] = scaled(LOADS, number(random, 0.97, 1.03))
    fields |= {name: float(f"{value * number(random, 0.95, 1.05):.6g}") for name, value in UNITS.items()}
    fields |= {
        "load_noise.std": number(random, 0.005, 0.015),
        "measurement.noise.frequency": number(random, 3e-4, 3e-3, logarithmic=True),
    }
    fields |= {
        "link.up.1.delay": number(random, 0.003, 0.063),
        "link.up.4.loss": number(random, 1e-3, 0.02, logarithmic=True),
    }
    return fields | {"seed": int(random.integers(2**31))}
