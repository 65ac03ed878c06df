"""Draws the cases of a set for scores; each set was drawn once, and its file is what counts (config/case_sets).

python -m facts_damping_reproduction.score_cases two_area config/case_sets/two_area_1.0.yaml
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from facts_damping.output.writing import write_whole
from facts_damping.parameters.yaml_text import dump

Random = np.random.Generator
START = 2.0  # s, of events and disturbances
SEED = 20261128
KINDS = {
    "nominal": "the grid as it was designed for; faults, trips, steps of loads and units",
    "drift": "",  # by grid
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
CALLED = {"wrong sign": "wrong sign behind the supervisor"}  # on cards: the device is told the wrong sign


class Grid(NamedTuple):
    """What a grid's cases vary, and who is scored on them. Fields of the run are paths with values."""

    description: str
    run: dict[str, Any]
    loads: dict[str, float]
    units: dict[str, float]
    wrong: dict[str, dict[str, float]]  # data of the model, each group times one random factor
    out: dict[str, Any]  # takes `out_line` out from the start
    out_line: str  # a line that is faulted beside it
    lines: tuple[str, ...]  # of faults and trips
    steps: tuple[str, str, str]  # load that falls, unit, load that rises
    drift: tuple[str, float, dict[str, tuple[float, float]]]  # text, largest change of loads, ranges of units
    pmus: tuple[str, str]  # those that go bad
    numbers: dict[str, int]  # of cases of a kind; else 4
    delayed: tuple[int, ...]  # events of the kinds `delay ...`
    controllers: dict[str, list[dict[str, Any]]]
    beside: list[str]
    signals: dict[str, list[str]]  # of a controller that names none


def number(random: Random, low: float, high: float, *, logarithmic: bool = False) -> float:
    """A random number of four digits."""
    value = float(random.uniform(low, high))
    if logarithmic:
        value = float(np.exp(random.uniform(np.log(low), np.log(high))))
    return float(f"{value:.4g}")


def scaled(fields: dict[str, float], factor: float) -> dict[str, float]:
    """Fields times a factor."""
    return {name: float(f"{value * factor:.6g}") for name, value in fields.items()}


def event(random: Random, grid: Grid, i: int, start: float = START) -> list[dict[str, Any]]:
    """One of six kinds of events."""
    line, place = grid.lines[random.integers(len(grid.lines))], number(random, 0.1, 0.9)
    fault = {"time": start, "kind": "fault", "line": line, "location": place}
    end, step = round(start + number(random, 0.05, 0.1), 3), number(random, 0.05, 0.15)
    falls, unit, rises = grid.steps
    return [
        [fault, {"time": end, "kind": "line_out", "line": line}],
        [fault, {"time": end, "kind": "clear", "line": line}],
        [{"time": start, "kind": "load_step", "load": falls, "change": -step}],
        [{"time": start, "kind": "mechanical_power_step", "machine": unit, "change": -step}],
        [{"time": start, "kind": "line_out", "line": line}],
        [{"time": start, "kind": "load_step", "load": rises, "change": step}],
    ][i % 6]


def usual(random: Random, grid: Grid) -> dict[str, Any]:
    """What varies in every case: loads, dispatch, noise, delay, loss, seed."""
    fields: dict[str, Any] = scaled(grid.loads, number(random, 0.97, 1.03))
    fields |= {name: float(f"{value * number(random, 0.95, 1.05):.6g}") for name, value in grid.units.items()}
    fields |= {
        "load_noise.std": number(random, 0.005, 0.015),
        "measurement.noise.frequency": number(random, 3e-4, 3e-3, logarithmic=True),
    }
    fields |= {
        "link.up.1.delay": number(random, 0.003, 0.063),
        "link.up.4.loss": number(random, 1e-3, 0.02, logarithmic=True),
    }
    return fields | {"seed": int(random.integers(2**31))}


def late(kind: str) -> float:
    """The delay of a kind, s; 3 ms are those of the link itself."""
    return round(0.003 + int(kind.split()[1]) / 1e3, 3)


def case(random: Random, grid: Grid, kind: str, i: int) -> dict[str, Any]:
    """A case of a kind."""
    changes = {**usual(random, grid), "scenario": event(random, grid, i)}
    if kind == "drift":
        _, most, units = grid.drift
        changes |= scaled(grid.loads, number(random, 1.0 - most, 1.0 + most))
        changes |= {name: number(random, low, high) for name, (low, high) in units.items()}
    elif kind == "wrong model":
        for fields in grid.wrong.values():
            changes |= scaled(fields, number(random, 0.7, 1.3))
        if i % 3 == 0:
            changes |= grid.out
            changes["scenario"] = [{**event_of_case, "line": grid.out_line} for event_of_case in event(random, grid, 1)]
    elif kind == "loss" and i % 2:
        changes["link.up.4.loss"] = number(random, 0.1, 0.4)
    elif kind == "loss":
        bursts = {"stage": "network", "model": "gilbert_elliott", "p_GB": 0.02, "p_BG": number(random, 0.05, 0.2)}
        changes["link.up.+"] = {**bursts, "loss_G": 0.0, "loss_B": 1.0}
    elif kind == "bad PMU":
        bad: list[dict[str, Any]] = [
            {"model": "freeze"},
            {"model": "bias", "bias": 2e-3},
            {"model": "noise", "std": 2e-3},
            {"model": "scale", "factor": 3.0},
        ]
        changes["link.up.+"] = {"stage": "pmu", **bad[i % 4], "start": START, "channels": [grid.pmus[i % 2]]}
        changes["link.up.+"] |= {} if i % 4 == 0 else {"measurement": "frequency"}
    elif kind == "device lost":
        changes["link.down.+"] = {"stage": "actuator", "model": "bernoulli", "loss": 1.0, "start": START}
    elif kind == "wrong sign":
        changes["link.down.+"] = {"stage": "actuator", "model": "scale", "factor": -1.0, "start": START}
    elif kind == "noise":
        changes |= {"scenario": [], "duration": 40.0}
    return {"kind": kind, "set": changes}


def drawn(grid: Grid) -> dict[str, Any]:
    """The content of a set."""
    random = np.random.default_rng(SEED)
    delayed = [{**usual(random, grid), "scenario": event(random, grid, i)} for i in grid.delayed]
    cases = []
    for kind in KINDS:
        if kind.startswith("delay"):  # the same cases with each delay
            cases += [{"kind": kind, "set": {**case_set, "link.up.1.delay": late(kind)}} for case_set in delayed]
        else:
            cases += [case(random, grid, kind, i) for i in range(grid.numbers.get(kind, 4))]
    return {
        "description": grid.description,
        "version": "1.0",
        "run": grid.run,
        "set": {
            "profile": "deployment",
            "duration": 10.5,
            "link.up.+": {"stage": "network", "model": "bernoulli", "loss": 0.0},
        },
        "controllers": grid.controllers,
        "beside": grid.beside,
        **grid.signals,
        "kinds": {**KINDS, "drift": grid.drift[0]},
        "called": CALLED,
        "cases": cases,
    }


TWO_AREA = Grid(
    description="two areas as a deployment has them, SSSC in the tie: grid, events, network and faults vary",
    run={"system": "two_area", "scenario": []},
    loads={"system.loads.0.P": 967, "system.loads.0.Q": 100, "system.loads.1.P": 1767, "system.loads.1.Q": 100},
    units={"system.machines.0.P": 700, "system.machines.2.P": 719, "system.machines.3.P": 700},
    wrong={
        "H west": {"system.machines.0.H": 6.5, "system.machines.1.H": 6.5},
        "H east": {"system.machines.2.H": 6.175, "system.machines.3.H": 6.175},
        "tie": {f"system.lines.{i}.x": 0.001 for i in range(2, 6)},
        "regulators": {f"system.exciters.{i}.KA": 200 for i in range(4)},
        "governors": {f"system.governors.{i}.Tg": 0.2 for i in range(4)},
        "loads": {"system.loads.0.kpf": 1.5, "system.loads.1.kpf": 1.5},
    },
    out={"system.lines.5.x": 10.0, "system.lines.5.b": 0.0},
    out_line="line_1",
    lines=("line_1", "line_2", "line_3", "line_4"),
    steps=("load_2", "G3", "load_1"),
    drift=(
        "the flow over the tie moved by up to 200 MW, the loads by up to 8 %",
        0.08,
        {"system.machines.2.P": (520, 850), "system.machines.0.P": (620, 780)},
    ),
    pmus=("G3", "G1"),
    numbers={"nominal": 12, "drift": 12, "wrong model": 12, "loss": 8, "bad PMU": 8, "wrong sign": 6},
    delayed=(0, 1, 1, 2, 3, 4),
    controllers={
        **{name: [{"name": name}] for name in ("LLC", "LLC-tuned", "LQG", "Hinf")},
        "ANFBsC direct": [{"name": "ANFBsC", "scheme": "direct"}],
        "ANFLeWC indirect": [{"name": "ANFLeWC", "scheme": "indirect"}],
        "HBsWC direct": [{"name": "HBsWC", "scheme": "direct"}],
    },
    beside=["LLC", "LLC-tuned", "LQG"],
    signals={},
)
BOTH = {"devices": ["sssc", "statcom"], "signals": ["frequency_4_5", "frequency_nyps_nets"]}
NETS_NYPS = Grid(
    description="New England and New York as a deployment has them, SSSC and STATCOM: grid, network, faults vary",
    run={"system": "nets_nyps", "scenario": [], "devices": BOTH["devices"]},
    loads={"system.loads.0.P": 6000, "system.loads.1.P": 2470, "system.loads.15.P": 1000, "system.loads.16.P": 1150},
    units={"system.machines.8.P": 800, "system.machines.11.P": 1350, "system.machines.13.P": 1785},
    wrong={
        "H New England": {f"system.machines.{i}.H": h for i, h in enumerate((42, 30.2, 35.8, 28.6, 26, 34.8))},
        "H neighbours": {"system.machines.13.H": 300, "system.machines.14.H": 300, "system.machines.15.H": 225},
        "ties": {"system.lines.1.x": 0.1141, "system.lines.2.x": 0.0288, "system.lines.57.x": 0.0363},
        "regulators": {f"system.exciters.{i}.KP": 200 for i in range(8)},
        "loads": {"system.loads.0.kpf": 1.5, "system.loads.1.kpf": 1.5, "system.loads.16.kpf": 1.5},
    },
    out={"system.lines.65.x": 10.0, "system.lines.65.b": 0.0},
    out_line="line_61_60",
    lines=("line_18_49", "line_61_60", "line_42_18", "line_40_48"),
    steps=("load_17", "G14", "load_18"),
    drift=(
        "the power of G14 and G12 moved by up to 300 MW each, the largest loads by up to 4 %",
        0.04,
        {"system.machines.13.P": (1485, 2085), "system.machines.11.P": (1050, 1650)},
    ),
    pmus=("G16", "G15"),
    numbers={"nominal": 6, **dict.fromkeys(("loss", "bad PMU", "device lost", "wrong sign", "noise"), 2)},
    delayed=(0, 2),
    controllers={
        "LLC": [
            {
                "name": "LLC",
                "devices": ["sssc"],
                "signals": ["frequency_4_5"],
                "parameters": {"gain": -62.29, "Tw": 10, "T1": 0.2559, "T2": 0.1631, "T3": 0.2559, "T4": 0.1631},
            },
            {
                "name": "LLC",
                "devices": ["statcom"],
                "signals": ["frequency_nyps_nets"],
                "parameters": {"gain": -4.89, "Tw": 10, "T1": 0.2596, "T2": 0.2771, "T3": 0.2596, "T4": 0.2771},
            },
        ],
        "LQG": [{"name": "LQG", **BOTH}],
        "LQG, SSSC": [{"name": "LQG"}],
    },
    beside=["LLC", "LQG"],
    signals={"devices": ["sssc"], "signals": ["frequency_4_5"]},
)
PROPORTIONAL = {"gain": 100, "T1": 0, "T2": 0.1, "T3": 0.1, "T4": 0.1}  # 10 MW/mHz through a low pass of 0.1 s
MINNIWECC = Grid(
    description="western North America as a deployment has it, Pacific DC Intertie: grid, events, network, faults vary",
    run={"system": "minniwecc", "scenario": [], "devices": ["pdci"]},
    loads={"system.loads.1.P": 5400, "system.loads.2.P": 3600},
    units={"system.machines.7.P": 2800},
    wrong={
        "H north": {f"system.machines.{i}.H": 5 for i in range(3)} | {"system.machines.33.H": 6.5},
        "H south": {f"system.machines.{i}.H": 6.5 for i in (20, 26, 27)},
        "ties": {"system.lines.32.x": 0.004175, "system.lines.33.x": 0.004175, "system.lines.35.x": 0.0084},
        "regulators": {f"system.exciters.{i}.KA": 200 for i in (0, 6, 20, 26, 33)},
        "loads": {f"system.loads.{i}.kpf": 1.5 for i in (8, 10, 13, 20)},
    },
    out={"system.lines.22.x": 10.0},
    out_line="line_86_87",
    lines=("line_86_87", "line_24_86_2", "line_83_84", "line_63_97"),
    steps=("load_73", "G27", "load_16"),
    drift=(
        "up to 1000 MW of G21, in the south, made up in the north; northern loads moved by up to 2 %",
        0.02,
        {"system.machines.20.P": (10049, 11049)},
    ),
    pmus=("NORTH", "SOUTH"),
    numbers={
        "nominal": 3,
        **dict.fromkeys(("drift", "wrong model", "loss", "bad PMU", "device lost", "wrong sign"), 2),
        "noise": 1,
    },
    delayed=(0, 2),
    controllers={
        "proportional": [{"name": "LLC", "devices": ["pdci"], "signals": ["hertz"], "parameters": PROPORTIONAL}],
        **{name: [{"name": name}] for name in ("LQG", "Hinf")},
        "ANFLeWC indirect": [{"name": "ANFLeWC", "scheme": "indirect"}],
    },
    beside=["proportional", "LQG"],
    signals={"devices": ["pdci"], "signals": ["frequency"]},
)
GRIDS = {"two_area": TWO_AREA, "nets_nyps": NETS_NYPS, "minniwecc": MINNIWECC}


def main(grid: str, path: str) -> None:
    """Write the set of a grid."""
    write_whole(Path(path), dump(drawn(GRIDS[grid])))


if __name__ == "__main__":
    main(*sys.argv[1:])
