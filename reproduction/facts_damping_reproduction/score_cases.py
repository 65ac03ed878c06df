"""Draws the cases of a set for scores; each set was drawn once, and its file is what counts (config/case_sets)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from facts_damping.parameters.yaml_text import dump
from facts_damping.terminal import write_whole

Random = np.random.Generator
START = 2.0  # s, of events and disturbances
SEED = 20261128
LOADS: dict[str, float] = {
    "system.loads.0.P": 967,
    "system.loads.0.Q": 100,
    "system.loads.1.P": 1767,
    "system.loads.1.Q": 100,
}
UNITS: dict[str, float] = {"system.machines.0.P": 700, "system.machines.2.P": 719, "system.machines.3.P": 700}
WRONG: dict[str, dict[str, float]] = {  # data of the model, each group times one random factor
    "H west": {"system.machines.0.H": 6.5, "system.machines.1.H": 6.5},
    "H east": {"system.machines.2.H": 6.175, "system.machines.3.H": 6.175},
    "tie": {f"system.lines.{i}.x": 0.001 for i in range(2, 6)},
    "regulators": {f"system.exciters.{i}.KA": 200 for i in range(4)},
    "governors": {f"system.governors.{i}.Tg": 0.2 for i in range(4)},
    "loads": {"system.loads.0.kpf": 1.5, "system.loads.1.kpf": 1.5},
}
KINDS = {
    "nominal": "the grid as it was designed for; faults, trips, steps of loads and units",
    "drift": "the flow over the tie moved by up to 200 MW, the loads by up to 8 %",
    "wrong model": "inertias, reactances, regulators, governors and loads off by up to 30 %; in a third a line out",
    "delay 100 ms": "100 ms more delay",
    "delay 200 ms": "200 ms more delay",
    "delay 300 ms": "300 ms more delay",
    "delay 400 ms": "400 ms more delay",
    "loss": "10 to 40 % of the frames lost, alone or in bursts",
    "bad PMU": "from the event on the values of one PMU are frozen, biased, noisy or scaled",
    "device lost": "from the event on no setpoint reaches the device",
    "wrong sign": "from the event on all setpoints have the wrong sign",
    "noise": "no event; the measure is the variance of the speed differences",
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


def event(random: Random, i: int, start: float = START) -> list[dict[str, Any]]:
    """One of six kinds of events."""
    line, place = f"line_{random.integers(1, 5)}", number(random, 0.1, 0.9)
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
    found: dict[str, Any] = scaled(LOADS, number(random, 0.97, 1.03))
    found |= {name: float(f"{value * number(random, 0.95, 1.05):.6g}") for name, value in UNITS.items()}
    found |= {
        "load_noise.std": number(random, 0.005, 0.015),
        "measurement.noise.frequency": number(random, 3e-4, 3e-3, logarithmic=True),
    }
    found |= {
        "link.up.1.delay": number(random, 0.003, 0.063),
        "link.up.4.loss": number(random, 1e-3, 0.02, logarithmic=True),
    }
    return found | {"seed": int(random.integers(2**31))}


def late(kind: str) -> float:
    """The delay of a kind, s; 3 ms are those of the link itself."""
    return round(0.003 + int(kind.split()[1]) / 1e3, 3)


def case(random: Random, kind: str, i: int) -> dict[str, Any]:
    """A case of a kind."""
    found = {**usual(random), "scenario": event(random, i)}
    if kind == "drift":
        found |= scaled(LOADS, number(random, 0.92, 1.08))
        found |= {"system.machines.2.P": number(random, 520, 850), "system.machines.0.P": number(random, 620, 780)}
    elif kind == "wrong model":
        for fields in WRONG.values():
            found |= scaled(fields, number(random, 0.7, 1.3))
        found |= {"system.lines.5.x": 10.0, "system.lines.5.b": 0.0} if i % 3 == 0 else {}
        found["scenario"] = event(random, 1) if i % 3 == 0 else found["scenario"]
        if i % 3 == 0:
            found["scenario"] = [{**one, "line": "line_1"} for one in found["scenario"]]
    elif kind == "loss" and i % 2:
        found["link.up.4.loss"] = number(random, 0.1, 0.4)
    elif kind == "loss":
        bursts: dict[str, Any] = {
            "stage": "network",
            "model": "gilbert_elliott",
            "p_GB": 0.02,
            "p_BG": number(random, 0.05, 0.2),
        }
        found["link.up.+"] = {**bursts, "loss_G": 0.0, "loss_B": 1.0}
    elif kind == "bad PMU":
        bad: list[dict[str, Any]] = [
            {"model": "freeze"},
            {"model": "bias", "bias": 2e-3},
            {"model": "noise", "std": 2e-3},
        ]
        bad += [{"model": "scale", "factor": 3.0}]
        found["link.up.+"] = {"stage": "pmu", **bad[i % 4], "start": START, "channels": ["G1" if i % 2 else "G3"]}
        found["link.up.+"] |= {} if i % 4 == 0 else {"measurement": "frequency"}
    elif kind == "device lost":
        found["link.down.+"] = {"stage": "actuator", "model": "bernoulli", "loss": 1.0, "start": START}
    elif kind == "wrong sign":
        found["link.down.+"] = {"stage": "actuator", "model": "scale", "factor": -1.0, "start": START}
    elif kind == "noise":
        found |= {"scenario": [], "duration": 40.0}
    return {"kind": kind, "set": found}


NUMBERS = {
    "nominal": 12,
    "drift": 12,
    "wrong model": 12,
    "loss": 8,
    "bad PMU": 8,
    "wrong sign": 6,
    "device lost": 4,
    "noise": 4,
}


def main(path: str) -> None:
    """Write the set."""
    random = np.random.default_rng(SEED)
    delayed = [{**usual(random), "scenario": event(random, i)} for i in (0, 1, 1, 2, 3, 4)]
    cases = []
    for kind in KINDS:
        if kind.startswith("delay"):  # the same cases with each delay
            cases += [{"kind": kind, "set": {**one, "link.up.1.delay": late(kind)}} for one in delayed]
        else:
            cases += [case(random, kind, i) for i in range(NUMBERS.get(kind, 4))]
    controllers: dict[str, Any] = {name: [{"name": name}] for name in ("LLC", "LLC-tuned", "LQG", "Hinf")}
    controllers |= {
        f"{name} {scheme}": [{"name": name, "scheme": scheme}]
        for name, scheme in (("ANFBsC", "direct"), ("ANFLeWC", "indirect"), ("HBsWC", "direct"))
    }
    content = {
        "description": "two areas as a deployment has them, SSSC in the tie: grid, events, network and faults vary",
        "version": "1.0",
        "run": {"system": "two_area", "scenario": []},
        "set": {
            "profile": "deployment",
            "duration": 10.5,
            "link.up.+": {"stage": "network", "model": "bernoulli", "loss": 0.0},
        },
        "controllers": controllers,
        "beside": ["LLC", "LLC-tuned", "LQG"],
        "kinds": KINDS,
        "cases": cases,
    }
    write_whole(Path(path), dump(content))


if __name__ == "__main__":
    main(sys.argv[1])
