"""Plays a recording as a stream: the PMUs' reports at each tick, at the recorded pace."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.signals import NANOSECONDS
from facts_damping.simulation.measured_plant import entries
from facts_damping_streams.c37118 import system_pmus
from facts_damping_streams.c37118.data import Data

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from facts_damping.record import Record
    from facts_damping_streams.c37118.session import Instant
    from facts_damping_streams.streaming.pdc import Pdc
    from facts_damping_streams.streaming.server import Server

    Timed = tuple[float, Instant]  # s since the first tick, and the instant to send then

WAIT_S = 0.02  # s, polling period while no client listens


def instants(record: Record, pdc: Pdc, link: int | None = None) -> Iterator[Timed]:
    """Instants of a recording's PMUs, tick by tick; `link`: index of a link, for frames as it delivered them."""
    delivered = record.delivered[record.delivered["link"] == (-1 if link is None else link)]
    for k, (tick, now_ns) in enumerate(zip(record.ticks.tolist(), record.time_ns.tolist(), strict=True)):
        if link is None:
            rows = entries(now_ns, record.frames[k], record.measured_ns[k], record.status[k])
        else:
            rows = delivered[slice(*np.searchsorted(delivered["tick"], [tick, tick + 1]))]
        for instant in pdc.take(tick, rows):
            yield (now_ns - int(record.time_ns[0])) / NANOSECONDS, instant
    for instant in pdc.rest():
        yield (int(record.time_ns[-1]) - int(record.time_ns[0])) / NANOSECONDS, instant


def with_progress(timed: Iterator[Timed], last_s: float, progress: Callable[[int, int], object]) -> Iterator[Timed]:
    """The same instants; `progress` is called with their time at each new second, and with the last time."""
    before = -1
    for at, instant in timed:
        if int(at) > before:
            before = int(at)
            progress(before, math.ceil(last_s))
        yield at, instant


def one_of(instant: Instant, i: int) -> Instant:
    """Part of an instant for PMU i alone."""
    d, phasors, analogs = instant.data, len(system_pmus.PHASORS), len(system_pmus.ANALOGS)
    pmu_data = Data(
        d.status[i : i + 1],
        d.phasors[phasors * i : phasors * (i + 1)],
        d.frequency[i : i + 1],
        d.rocof[i : i + 1],
        d.analogs[analogs * i : analogs * (i + 1)],
        d.digitals,
    )
    return instant._replace(data=pmu_data)


async def play(servers: Sequence[Server], timed: Iterator[Timed], *, each: bool) -> None:
    """Send instants at the recorded pace once a client listens; `each`: one server per PMU."""
    while not any(server.listening for server in servers):  # noqa: ASYNC110 (clients come when they like)
        await asyncio.sleep(WAIT_S)
    loop = asyncio.get_running_loop()
    began = loop.time()
    for at, instant in timed:
        await asyncio.sleep(max(0.0, began + at - loop.time()))
        send(servers, instant, each=each)


def send(servers: Sequence[Server], instant: Instant, *, each: bool) -> None:
    """Send an instant to all listening clients; `each`: one server per PMU."""
    for i, server in enumerate(servers):
        server.send(one_of(instant, i) if each else instant)
