"""Training and evaluation cases of the experiment. Their kinds of events have nothing in common."""

from __future__ import annotations

from typing import Any

import numpy as np

from facts_damping_reproduction.random_cases import WRONG, Random, event, number, scaled, usual

KINDS = ("nominal", "drift", "wrong model")
EVENTS = ("reclosing onto a fault", "fault at a bus", "line out and in", "power step and line out")
BEGIN = 6.0  # s, of the event in training
STEPS = 10  # of a drift
DRIFT = (5.0, 55.0)  # s
TRAINING, EVALUATION = 1, 2  # streams of random numbers


def training(number_of: int, begin: float, after: float) -> list[dict[str, Any]]:
    """Cases for searches: the grid as designed for, one of each kind of event."""
    random = np.random.default_rng((TRAINING, 20261128))
    cases = []
    for i in range(number_of):
        case = {**usual(random), "scenario": event(random, i, begin)}
        del case["load_noise.std"]
        cases.append(case | {"duration": round(begin + 1.0 + after, 3)})
    return cases


def evaluation(number_of: int, begin: float, after: float, seed: int) -> list[dict[str, Any]]:
    """Held-out cases: `kind`, the kind of `event`, and what each sets."""
    random = np.random.default_rng((EVALUATION, seed))
    return [_evaluation(random, KINDS[i % len(KINDS)], i // len(KINDS), begin, after) for i in range(number_of)]


def _evaluation(random: Random, kind: str, i: int, begin: float, after: float) -> dict[str, Any]:
    changes = {
        **usual(random),
        "scenario": _new_event(random, i, begin),
        "duration": round(begin + 1.5 + after, 3),
    }
    if kind == "drift":
        moved = number(random, 60.0, 160.0) * (1.0 if random.random() < 0.5 else -1.0)  # MW over the tie
        times = np.linspace(*DRIFT, STEPS)
        changes["scenario"] = [
            *_steps("load_1", -moved / 967.0, times),
            *_steps("load_2", moved / 1767.0, times),
        ] + changes["scenario"]
    if kind == "wrong model":
        for fields in WRONG.values():
            changes |= scaled(fields, number(random, 0.7, 1.3))
    return {"kind": kind, "event": EVENTS[i % len(EVENTS)], "set": changes}


def _steps(load: str, change: float, times: np.ndarray[Any, Any]) -> list[dict[str, Any]]:
    """A load that moves by a fraction in equal steps."""
    parts = np.linspace(0.0, change, len(times) + 1)[1:]
    return [
        {"time": round(float(t), 3), "kind": "load_step", "load": load, "change": round(float(part), 6)}
        for t, part in zip(times, parts, strict=True)
    ]


def _new_event(random: Random, i: int, t: float) -> list[dict[str, Any]]:
    """One of four kinds of events that training does not have; loads are left to the drift."""
    line = f"line_{random.integers(1, 5)}"
    end = round(t + number(random, 0.06, 0.1), 3)
    again = round(end + number(random, 0.3, 0.6), 3)
    fault = {"time": t, "kind": "fault", "line": line, "location": number(random, 0.1, 0.9)}
    bus = ["B5", "B7", "B10", "B11"][int(random.integers(4))]
    unit = ["G1", "G2", "G4"][int(random.integers(3))]
    power = {"time": t, "kind": "mechanical_power_step", "machine": unit, "change": -number(random, 0.05, 0.15)}
    return [
        [
            fault,
            {"time": end, "kind": "line_out", "line": line},
            {"time": again, "kind": "line_in", "line": line},
            {"time": round(again + 0.06, 3), "kind": "line_out", "line": line},
        ],
        [{"time": t, "kind": "fault", "bus": bus, "duration": number(random, 0.03, 0.08)}],
        [{"time": t, "kind": "line_out", "line": line}, {"time": again, "kind": "line_in", "line": line}],
        [power, {"time": t, "kind": "line_out", "line": line}],
    ][i % len(EVENTS)]
