"""Limits of the model: each is told when it is left, and only then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis.run_warnings import limit_warnings
from facts_damping.analysis.summary import summarise
from facts_damping.api import simulate
from facts_damping.record import GridEvent
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record

SYSTEM: dict[str, Any] = {
    "name": "pair",
    "frequency": 60,
    "measures": {"local": ["w12"], "interarea": []},
    "signals": {"w12": {"weights": {"G1": 1.0, "G2": -1.0}}},
    "machines": [{"name": "G1", "rating": 900, "H": 6.0}, {"name": "G2", "rating": 300, "H": 6.0}],
    "governors": [{"machine": "G1", "enabled": False}],
}


@pytest.fixture
def calm(swing_record: Callable[..., Record]) -> Callable[..., Record]:
    """Two machines at 1 p.u. and 60 Hz, with a fault from 1 to 1.1 s; `speeds`, `voltages`: of G1 and G2."""

    def make(speeds: Any = (0.0, 0.0), voltages: Any = (1.0, 1.0), *more: GridEvent, **system: Any) -> Record:
        events = [GridEvent(NANOSECONDS, "fault", "B7"), *more, GridEvent(11 * NANOSECONDS // 10, "clear", "B7")]
        record = swing_record(configuration={"system": {**SYSTEM, **system}}, events=events)
        for i in (0, 1):
            record.machines["speed_deviation"][:, i] = speeds[i]
            record.machines["terminal_voltage"][:, i] = voltages[i]
        return record

    return make


T = np.arange(1200) / 60


def test_run_within_the_limits_of_the_model_has_no_warnings(calm: Callable[..., Record]) -> None:
    assert limit_warnings(calm()) == []
    assert limit_warnings(calm((2.4 / 60, -2.4 / 60), (0.71, 1.19), infinite_buses=[{"name": "GRID"}])) == []


def test_frequency(calm: Callable[..., Record]) -> None:
    fast = np.where((T >= 3) & (T < 3.5), 3.0 / 60, 0.0)
    assert limit_warnings(calm((fast, 0))) == ["frequency beyond 60 ± 2.5 Hz: G1 0.50 s from 3.00 s on (63.00 Hz)"]
    assert "G2" in limit_warnings(calm((0, -fast)))[0]
    assert "57.00 Hz" in limit_warnings(calm((0, -fast)))[0]
    gone = GridEvent(2 * NANOSECONDS, "generator_trip", "G1")
    assert (
        limit_warnings(calm((fast, 0), (1, 1), gone)) == []
    )  # nobody sees how fast a machine runs that is not connected


def test_forced_oscillation_that_does_not_end(calm: Callable[..., Record]) -> None:
    begun = [GridEvent((2 + i) * NANOSECONDS, "forced_oscillation", name, 0.1) for i, name in enumerate(("G1", "G2"))]
    ends = GridEvent(4 * NANOSECONDS, "forced_oscillation", "G2", 0.0)
    (warning,) = limit_warnings(calm((0, 0), (1, 1), *begun, ends))
    assert warning.startswith("a forced oscillation of G1 lasts to the end: ")


def test_voltage_outside_of_faults_alone(calm: Callable[..., Record]) -> None:
    fault = (T >= 1) & (T < 1.1)
    assert limit_warnings(calm((0, 0), (np.where(fault, 0.1, 1.0), 1.0))) == []
    sags = np.where(fault, 0.1, np.where((T > 1.09) & (T < 1.29), 0.6, 1.0))
    (low,) = limit_warnings(calm((0, 0), (sags, 1.0)))
    assert low == "voltage below 0.7 p.u. without a fault: G1 0.20 s from 1.10 s on (0.600 p.u.)"
    (high,) = limit_warnings(calm((0, 0), (1.0, 1.3)))
    assert high.startswith("voltage above 1.2 p.u. without a fault: G2 19.90 s from 0.00 s on (1.300 p.u.)")


def test_drift_that_nothing_holds(calm: Callable[..., Record]) -> None:
    up = T / 20 / 60  # 1 Hz in 20 s at G1, which has three quarters of the inertia
    assert limit_warnings(calm((up, 0))) == [
        "the common frequency has moved by +0.75 Hz at the end, and no governor holds it"
    ]
    assert limit_warnings(calm((0.6 * up, 0))) == []
    assert limit_warnings(calm((up, 0), governors=[{"machine": "G1", "enabled": True}])) == []
    assert limit_warnings(calm((up, 0), infinite_buses=[{"name": "GRID"}])) == []


def test_load_step_without_governors_drifts_and_with_them_does_not() -> None:
    summary = summarise(simulate())
    (line,) = summary.warnings
    assert line.startswith("the common frequency has moved by +2.4")
    held: dict[str, Any] = {f"system.governors.{i}.enabled": True for i in range(4)}
    assert summarise(simulate(**held)).warnings == []


def test_island_is_told() -> None:
    lines = [{"time": 1.0, "kind": "line_out", "line": name} for name in ("line_1", "line_2")]
    record = simulate(scenario=lines, duration=1.5, controllers=[])
    (island,) = [line for line in limit_warnings(record) if line.startswith("the grid has split")]
    assert island == "the grid has split at 1 s; apart from the rest: buses B1, B2, B5, B6, B7"
    assert not any("split" in line for line in limit_warnings(simulate(scenario=lines[:1], duration=1.5)))
