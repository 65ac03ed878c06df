"""Events of a run in words, for the log of the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.monitor_table import STATES, cause_name
from facts_damping.record import group_by
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from facts_damping.record import Record

LEVELS = {"tripped": "error", "fallback": "warn", "disarmed": "warn"}  # of a supervisor's state; others: info
SWITCHES = {"line_out": True, "line_in": False, "reset": False}  # kinds after which a branch, or all, is out or in
LONGEST = 160  # characters of a value


def event(t: float, text: str, level: str = "info", kind: str = "", element: str = "") -> dict[str, Any]:
    """An event as the page gets it; one that switches a branch has its name (all: empty), and whether it is out."""
    content = {"type": "event", "t": round(float(t), 3), "level": level, "text": text}
    return content | ({"branch": element, "out": SWITCHES[kind]} if kind in SWITCHES else {})


def grid_event(kind: str, element: str, value: float) -> str:
    """An event of the grid."""
    much = "" if np.isnan(value) else f", {value:g}"
    return f"{kind.replace('_', ' ')}: {element}{much}"


def change(node: str, kind: str, name: str, value: Any) -> str:
    """A change during a run; `value` of a link: its stages."""
    if kind == "link" and isinstance(value, dict):
        value = "; ".join(
            f"{way} {' + '.join(map(_stage, value.get(way) or ())) or 'no delay'}" for way in ("up", "down")
        )
    text = " ".join(str(part) for part in (kind, name, value) if part not in ("", None))
    return f"{node.lstrip('/')}: {text if len(text) <= LONGEST else f'{text[:LONGEST]}...'}"


def _stage(stage: dict[str, Any]) -> str:
    numbers = {k: v for k, v in stage.items() if isinstance(v, (int, float)) and k != "start"}
    return " ".join([str(stage.get("model")), *(f"{k} {v:g}" for k, v in numbers.items())])


def supervisor(controller: str, state: str, cause: str) -> str:
    """A new state of a supervisor."""
    return f"{controller}: {state}{f', {cause}' if cause else ''}"


def of_record(record: Record) -> list[dict[str, Any]]:
    """All events of a record, by time."""
    events = [
        event(
            grid_change.time_ns / NANOSECONDS,
            grid_event(grid_change.kind, grid_change.element, grid_change.value),
            "warn",
            grid_change.kind,
            grid_change.element,
        )
        for grid_change in record.events
    ]
    events += [
        event(
            run_change.tick / record.frame_rate,
            change(run_change.node, run_change.kind, run_change.name, run_change.value),
            kind=run_change.kind,
        )
        for run_change in record.changes
    ]
    for (c,), statuses in group_by(record.supervision, "controller"):
        for row in statuses[np.flatnonzero(np.diff(statuses["state"], prepend=-1))]:
            state = STATES[int(row["state"])]
            text = supervisor(record.controller_names[c], state, cause_name(int(row["cause"])))
            events.append(event(row["tick"] / record.frame_rate, text, LEVELS.get(state, "info")))
    return sorted(events, key=lambda listed_event: float(listed_event["t"]))
