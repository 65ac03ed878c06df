"""Stamps counted from the start of a run, and its messages without a tick.

These are grid events, refused messages, nodes that joined later, changes, and the end of the run.
"""

from __future__ import annotations

import re
from contextlib import suppress
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.monitor_table import COMMANDS
from facts_damping.parameters.yaml_text import UNREADABLE, parse
from facts_damping.record import GridEvent, NodeJoined, RefusedMessages, RunChange
from facts_damping.recording.decode import time_ns
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from facts_damping.recording.columns import Block

ROLES = ("plant", "link", "controller", "identifier", "supervisor")
KINDS = ("start", *COMMANDS, "weights", "parameter", "link", "event", "rearm", "release", "pause", "resume", "step")
MAX_TICKS = 10**9  # upper bound of any run
ENDED = 2  # state of an ended RunState
STOPPED, FAILED = "stopped", "failed: "  # the reason if the run was stopped early; its begin if the plant failed
TIME = r"[0-9]{1,18}"  # ns
SIMULATED_NS = 10**17  # about three years: simulated times are below, wall times above


def subtract_epoch(messages: Mapping[str, Sequence[Block]], plant: Iterable[str], frame_rate: Any) -> None:
    """Shift all stamps so that they count from the start of the run; `plant`: topics that determine that start.

    The start is the median over the plant's messages. An unknown frame rate follows from their median time step.
    """
    plant_blocks = [block for topic in plant for block in messages[topic]]
    none = np.zeros(0, np.int64)
    stamps = np.concatenate([none, *(time_ns(block.message.header.stamp) for block in plant_blocks)])
    bounded = (np.minimum(np.asarray(block.message.tick, np.uint64), np.uint64(MAX_TICKS)) for block in plant_blocks)
    ticks = np.concatenate([none, *(part.astype(np.int64) for part in bounded)])
    if not len(stamps) or np.median(stamps) < SIMULATED_NS:
        return
    stamps, ticks = stamps[ticks < MAX_TICKS], ticks[ticks < MAX_TICKS]
    if not (isinstance(frame_rate, int) and frame_rate > 0):
        steps = np.diff(stamps)[np.diff(ticks) == 1]
        frame_rate = round(NANOSECONDS / np.median(steps)) if len(steps) and np.median(steps) > 0 else 0
    starts = ticks * NANOSECONDS // frame_rate if frame_rate else stamps - stamps.min()
    begin = int(np.sort(stamps - starts)[len(stamps) // 2])
    for blocks in messages.values():
        for block in blocks:
            _shift(block.message, begin)


def _shift(part: Any, begin_ns: int) -> None:
    """Subtract a time from all times in a message and its parts."""
    if isinstance(part, (list, tuple)):
        for member in part:
            _shift(member, begin_ns)
        return
    content = getattr(part, "__dict__", None)
    if content is None:
        return
    if {"sec", "nanosec"} <= content.keys():
        moved = time_ns(part) - begin_ns
        part.sec, part.nanosec = moved // NANOSECONDS, moved % NANOSECONDS
        return
    for member in content.values():
        _shift(member, begin_ns)


def events(blocks: Iterable[Block]) -> list[GridEvent]:
    """Grid events by time."""
    numbered = [
        (int(row), GridEvent(int(at), block.message.kind, block.message.element, float(value), float(location)))
        for block in blocks
        for row, at, value, location in zip(
            block.rows, time_ns(block.message.header.stamp), block.message.value, block.message.location, strict=True
        )
    ]
    return [event for _, event in sorted(numbered, key=lambda pair: (pair[1].time_ns, pair[0]))]


def refused(blocks: Iterable[Block]) -> list[RefusedMessages]:
    """Totals refused by each node: the largest counts, as counters only grow."""
    maximum: dict[tuple[str, str, str, str], int] = {}
    for block in blocks:
        for entry in block.message.refused:
            key = (block.message.node, entry.topic, entry.cause, entry.source)
            maximum[key] = max(maximum.get(key, 0), int(np.max(entry.count)))
    return [RefusedMessages(*key, count) for key, count in maximum.items()]


def changes(blocks: Iterable[Block]) -> list[RunChange]:
    """Changes during the run, by tick, then as recorded.

    Messages that this package cannot have sent are left out: unknown role or kind, a value that is not YAML.
    """
    rows: list[tuple[int, int, RunChange]] = []
    for block in blocks:
        message = block.message
        if message.role not in ROLES or message.kind not in KINDS:
            continue
        with suppress(*UNREADABLE):
            value = parse(message.value)
            for row, tick, index in zip(block.rows, message.tick, message.index, strict=True):
                fields = int(tick), message.node, message.role, int(index), message.kind, message.name, value
                rows += [(int(tick), int(row), RunChange(*fields))] if tick < MAX_TICKS else []
    return [change for _, _, change in sorted(rows, key=itemgetter(0, 1))]


def run_ended(blocks: Iterable[Block]) -> tuple[str, int] | None:
    """Why the run ended and its last tick, by its plant; None if the plant does not state them.

    If the clock was set back meanwhile, this is not its last message.
    """
    ends = [
        (int(row), str(block.message.reason), int(tick))
        for block in blocks
        for row, state, tick in zip(block.rows, block.message.state, block.message.tick, strict=True)
        if state == ENDED
    ]
    return max(ends)[1:] if ends else None


def joined(blocks: Iterable[Block]) -> list[NodeJoined]:
    """Nodes that joined during the run, by time."""
    last: dict[tuple[int, str], float | None] = {}
    for block in blocks:
        for status in block.message.status:
            values = {value.key: value.value for value in status.values}
            at, armed = values.get("joined_ns", ""), values.get("armed_ns", "")
            if re.fullmatch(TIME, at):
                key = (int(at), status.name)
                last[key] = last.get(key) or (int(armed) / NANOSECONDS if re.fullmatch(TIME, armed) else None)
    return [NodeJoined(name, at / NANOSECONDS, armed) for (at, name), armed in sorted(last.items())]
