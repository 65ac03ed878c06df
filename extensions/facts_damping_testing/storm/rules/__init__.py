"""Rules that must hold in every storm: functions of what was seen of the graph, each of which returns its violations.

A rule needs the record alone where it can, so that it also judges recordings of graphs on DDS.
"""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping_testing.storm.rules import devices, nodes, recordings

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_testing.storm.running import Trace

RULES: dict[str, Callable[[Trace], list[str]]] = {
    rule.__name__: rule
    for rule in (
        *(devices.nothing_foreign_acts, devices.device_is_released, devices.setpoints_are_limited, devices.trips_hold),
        *(devices.restarted_nodes_are_disarmed, nodes.time_goes_on, nodes.graph_survives, nodes.ends_are_named),
        *(nodes.refusals_are_counted, nodes.refusals_are_complete, nodes.queues_are_bounded, nodes.memory_is_bounded),
        *(recordings.recording_is_readable, recordings.end_is_recorded, recordings.recording_keeps_what_was_flushed),
        *(recordings.equals_in_process, recordings.replay_is_exact),
    )
}


def violations(trace: Trace) -> list[tuple[str, str]]:
    """Violations of a trace: rule, text."""
    return [(name, text) for name in RULES for text in _applied(name, trace)]


def _applied(name: str, trace: Trace) -> list[str]:
    """Violations of a rule; an error of the library in what it asks for is one."""
    try:
        return RULES[name](trace)
    except Exception as error:  # noqa: BLE001 (whatever it is, it should not be)
        at = traceback.extract_tb(error.__traceback__)[-1]
        return [f"{type(error).__name__}: {error} ({Path(at.filename).name}:{at.lineno})"]
