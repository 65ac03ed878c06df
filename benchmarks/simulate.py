"""Compute time of 20 s of closed loop in process; beside other programs: `facts-damping bench`."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

from facts_damping.case.loading import load_case
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable

RUNS = 7
OURS = {
    "two_area small, LLC": ["scenario=small"],
    "two_area large, LLC": ["scenario=large"],
    "two_area large, HBsWC direct": ["scenario=large", "controllers.0.name=HBsWC", "controllers.0.scheme=direct"],
    "two_area large, HBsWC indirect": ["scenario=large", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"],
    "two_area small, LLC, SSSC and STATCOM": ["scenario=small", "devices=[sssc, statcom]"],
    "two_area large, LLC, SSSC and STATCOM": ["scenario=large", "devices=[sssc, statcom]"],
    "two_area multiple, LLC, 100 ms": ["scenario=multiple", "link=delay_100ms"],
    "two_area large, LLC, m_class, noise, lag": [
        *("scenario=large", "controllers.0.signals=[frequency]", "measurement=m_class"),
        *("system.devices.0.response_time=0.015", "system.devices.0.dead_time=0.005", "system.devices.0.g=0.01"),
    ],
    "smib nominal, LLC": ["system=smib", "scenario=nominal"],
    "kundur_12_6 bus8_fault, no device": [
        "system=kundur_12_6",
        "scenario=bus8_fault",
        "devices=[]",
        "controllers=[]",
    ],
}


def median_s(function: Callable[[], object]) -> float:
    """Median wall time of a few calls, after one that is not counted, s."""
    times = []
    for _ in range(RUNS + 1):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return statistics.median(times[1:])


def compiled_s(sets: list[str]) -> float:
    """Median time of the compiled loop alone, s: power flow and set-up not counted."""
    case = load_case(None, sets)
    times = []
    for _ in range(RUNS + 1):
        parts = loop.build_loop(case)
        began = time.perf_counter()
        loop.run_loop(parts)
        times.append(time.perf_counter() - began)
    return statistics.median(times[1:])


def main() -> None:
    """Print all times."""
    print(f"{'20 s of':<38} {'loop s':>8} {'run() s':>8}   (median of {RUNS})")
    for name, sets in OURS.items():
        case = load_case(None, sets)
        print(f"{name:<38} {compiled_s(sets):8.4f} {median_s(lambda case=case: loop.run(case)):8.4f}")  # type: ignore[misc]


if __name__ == "__main__":
    main()
