"""Scenarios for a system without any, chosen by the controllability of the mode at each place.

One is a short fault at the bus where a device moves the mode most. The other is a fault on the line where a device
moves it most, cleared by tripping the line. Each is the first candidate after which the machines stay in synchronism
without control.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.loading import make_case
from facts_damping.devices.base import Parallel, Series
from facts_damping.errors import FactsDampingError
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_studies.design.places import Place, Tried

AT_S, CLEARED_S, DURATION_S = 1.0, 0.1, 20.0
TRIED = 6  # candidates of each kind


def training_cases(
    run: dict[str, Any], tried: Sequence[Tried], place: Place, mode: int, progress: Callable[[int, int], None]
) -> dict[str, dict[str, Any]]:
    """The content of scenario files by name: `fault` and `line_out`, as far as they were found.

    `run`: content of a run of the system. `place`: place of its device, whose line does not trip. `mode`: index of the
    mode in the places' strengths.
    """
    order = np.argsort([-t.strength[mode] for t in tried])  # NaN last
    places = [tried[i].place for i in order.tolist() if not tried[i].why_not]
    buses = [p.at for p in places if isinstance(p.device, Parallel)][:TRIED]
    lines = [p.at for p in places if isinstance(p.device, Series) and p.device.line is not None and p.at != place.at]
    if not buses or not lines:  # all candidates are of other kinds: the grid's places in their order
        units = [row for table in ("machines", "inverters") for row in run["system"].get(table, ())]
        own_buses = {unit["bus"] for unit in units}
        names = [bus["name"] for bus in run["system"]["buses"]]
        buses = buses or [name for name in names if name not in own_buses][:TRIED] or names[:TRIED]
        lines = lines or [line["name"] for line in run["system"].get("lines", ()) if line["name"] != place.at]
    kinds = {"fault": [fault(bus) for bus in buses], "line_out": [trip(line) for line in lines[:TRIED]]}
    contents, done = dict[str, dict[str, Any]](), 0
    for name, scenarios in kinds.items():
        for scenario in scenarios:
            progress(done, len(buses) + TRIED)
            done += 1
            if _keeps_synchronism(run, scenario["events"]):
                contents[name] = {"name": name, **scenario}
                break
    progress(1, 1)
    return contents


def fault(bus: str) -> dict[str, Any]:
    """A self-clearing bolted fault at a bus."""
    events = [{"time": AT_S, "kind": "fault", "bus": bus, "duration": CLEARED_S}]
    text = f"a bolted fault at {bus} for {1e3 * CLEARED_S:.0f} ms"
    return {"description": text, "duration": DURATION_S, "events": events}


def trip(line: str) -> dict[str, Any]:
    """A bolted fault in the middle of a line, cleared by tripping the line for good."""
    events = [
        {"time": AT_S, "kind": "fault", "line": line, "location": 0.5},
        {"time": AT_S + CLEARED_S, "kind": "line_out", "line": line},
    ]
    text = f"a bolted fault on {line}, cleared after {1e3 * CLEARED_S:.0f} ms by its trip; it stays out"
    return {"description": text, "duration": DURATION_S, "events": events}


def _keeps_synchronism(run: dict[str, Any], events: list[dict[str, Any]]) -> bool:
    try:
        case = make_case({**run, "scenario": events, "controllers": [], "duration": DURATION_S}, "design")
        return bool(loop.run(case).in_synchronism.all())
    except FactsDampingError:  # the trip would split the network
        return False
