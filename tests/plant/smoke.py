"""What holds for devices of any kind: one follows its linear model; a lead-lag by `design` that commands it damps."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import expm

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import make_case
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise
from facts_damping_studies.design import design
from tests.plant.running import follow, shipped

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.plant.build import Built

SCENARIO = [{"time": 1.0, "kind": "fault", "bus": "B8W", "duration": 0.05}]


def _quiet(_name: str, _what: str) -> Callable[[int, int], None]:
    return lambda _done, _of: None


def damps(device: dict[str, Any], signal: str = "w_area_1_area_2", damping: float = 0.1) -> design.Design:
    """Assert that the design for two_area reaches its damping ratio, and that the ITAE of a run falls by half."""
    devices = [row.model_dump(by_alias=True, exclude_none=True) for row in shipped("two_area").devices]
    sets = [f"devices={json.dumps([*devices, device])}"]
    task = design.Task("two_area", sets, damping, 0.1, place=device["name"], signal=signal, kinds=())
    designed = design.design(task, 1, _quiet)
    assert designed.tuned.reached
    run = {**designed.run, "system": designed.content, "scenario": SCENARIO, "duration": 15.0}
    controlled: Any = summarise(loop.run(make_case(run, "test")))
    free: Any = summarise(loop.run(make_case({**run, "controllers": []}, "test")))
    assert controlled.stable
    assert controlled.indices["ITAE"] < 0.5 * free.indices["ITAE"]
    return designed


def follows_linear_model(built: Built, u: float = 1e-3, seconds: float = 1.0, within: float = 2e-3) -> None:
    """Assert speeds after a step of the first device's setpoint to be those of expm(A t); a ramp acts at its middle."""
    A, B = linearise(built)
    rate = float(built.plant.devices["rate_max"][0])
    trace = follow(built, [0.0, seconds], [(0.0, u)])
    n = len(A)
    both = np.zeros((n + 1, n + 1))
    both[:n, :n], both[:n, n] = A, B[:, 0] * u
    moved = expm(both * (seconds - 0.5 * u / rate))[:n, n]
    at = [i for i, name in enumerate(built.state_names) if name.endswith(".omega")]
    np.testing.assert_allclose(trace.x[-1, at], moved[at], rtol=0, atol=within * np.abs(moved[at]).max())
