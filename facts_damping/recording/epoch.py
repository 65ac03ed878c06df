"""Recordings stamped by the wall clock: subtracts the time at which the run began from all stamps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.recording.decode import time_ns
from facts_damping.recording.events import MAX_TICKS
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from facts_damping.recording.columns import Block

SIMULATED_NS = 10**17  # about three years: simulated times are below, wall times above


def subtract_epoch(messages: Mapping[str, Sequence[Block]], plant: Iterable[str], frame_rate: Any) -> None:
    """Shift all stamps so that they count from the start of the run; `plant`: topics that determine that start.

    The start is the median over the plant's messages. An unknown frame rate follows from their median time step.
    """
    found = [block for topic in plant for block in messages[topic]]
    none = np.zeros(0, np.int64)
    stamps = np.concatenate([none, *(time_ns(block.message.header.stamp) for block in found)])
    told = (np.minimum(np.asarray(block.message.tick, np.uint64), np.uint64(MAX_TICKS)) for block in found)
    ticks = np.concatenate([none, *(one.astype(np.int64) for one in told)])
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
        for one in part:
            _shift(one, begin_ns)
        return
    content = getattr(part, "__dict__", None)
    if content is None:
        return
    if {"sec", "nanosec"} <= content.keys():
        moved = time_ns(part) - begin_ns
        part.sec, part.nanosec = moved // NANOSECONDS, moved % NANOSECONDS
        return
    for one in content.values():
        _shift(one, begin_ns)
