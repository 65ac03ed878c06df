"""Messages without a tick: grid events, refused messages, nodes that joined later, changes, end of the run."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.monitor_table import COMMANDS
from facts_damping.parameters.yaml_text import UNREADABLE, parse
from facts_damping.recording.decode import time_ns
from facts_damping.signals import NANOSECONDS, RunChange

if TYPE_CHECKING:
    from collections.abc import Iterable

    from facts_damping.recording.columns import Block

ROLES = ("plant", "link", "controller", "identifier", "supervisor")
KINDS = ("start", *COMMANDS, "weights", "parameter", "link", "event", "rearm", "release", "pause", "resume", "step")
MAX_TICKS = 10**9  # upper bound of any run
ENDED, STOPPED = 2, "stopped"  # state of an ended RunState; the reason if the run was stopped early
TIME = r"[0-9]{1,18}"  # ns


def events(found: Iterable[Block]) -> list[dict[str, Any]]:
    """Grid events by time: `time_ns`, `kind`, `element`, `value`, `location` (NaN: not given)."""
    told = [
        (
            int(row),
            {
                "time_ns": int(at),
                "kind": block.message.kind,
                "element": block.message.element,
                "value": float(value),
                "location": float(location),
            },
        )
        for block in found
        for row, at, value, location in zip(
            block.rows, time_ns(block.message.header.stamp), block.message.value, block.message.location, strict=True
        )
    ]
    return [event for _, event in sorted(told, key=lambda one: (one[1]["time_ns"], one[0]))]


def refused(found: Iterable[Block]) -> list[dict[str, Any]]:
    """Totals refused by each node: `node`, `topic`, `cause`, `source`, `count` (its largest: counters only grow)."""
    maximum: dict[tuple[str, str, str, str], int] = {}
    for block in found:
        for entry in block.message.refused:
            key = (block.message.node, entry.topic, entry.cause, entry.source)
            maximum[key] = max(maximum.get(key, 0), int(np.max(entry.count)))
    return [
        {"node": node, "topic": topic, "cause": cause, "source": source, "count": count}
        for (node, topic, cause, source), count in maximum.items()
    ]


def changes(found: Iterable[Block]) -> list[RunChange]:
    """Changes during the run, by tick, then as recorded.

    Messages that this package cannot have sent are left out: unknown role or kind, a value that is not YAML.
    """
    told: list[tuple[int, RunChange]] = []
    for block in found:
        message = block.message
        if message.role not in ROLES or message.kind not in KINDS:
            continue
        with suppress(*UNREADABLE):
            value = parse(message.value)
            told += [
                (
                    int(row),
                    RunChange(int(tick), message.node, message.role, int(index), message.kind, message.name, value),
                )
                for row, tick, index in zip(block.rows, message.tick, message.index, strict=True)
                if tick < MAX_TICKS
            ]
    return [change for _, change in sorted(told, key=lambda one: (one[1].tick, one[0]))]


def run_ended(found: Iterable[Block]) -> str | None:
    """Reason why the run ended, by the last message of its plant; None if the plant does not state one."""
    told = [
        (int(row), str(block.message.reason) if state == ENDED else None)
        for block in found
        for row, state in zip(block.rows, block.message.state, strict=True)
    ]
    return max(told, key=lambda one: one[0])[1] if told else None


def joined(found: Iterable[Block]) -> list[dict[str, Any]]:
    """Nodes that joined during the run, by time: `node`, `time_s`, `armed_s` (None: disarmed to the end)."""
    last: dict[tuple[int, str], float | None] = {}
    for block in found:
        for status in block.message.status:
            said = {value.key: value.value for value in status.values}
            at, armed = said.get("joined_ns", ""), said.get("armed_ns", "")
            if re.fullmatch(TIME, at):
                key = (int(at), status.name)
                last[key] = last.get(key) or (int(armed) / NANOSECONDS if re.fullmatch(TIME, armed) else None)
    return [{"node": name, "time_s": at / NANOSECONDS, "armed_s": armed} for (at, name), armed in sorted(last.items())]
