"""A recording as streams: its stations, what they measured at each instant, and its own pace."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.c37118 import stations
from facts_damping.c37118.configuration import TIME_BASE
from facts_damping.c37118.data import Data
from facts_damping.c37118.session import Instant
from facts_damping.c37118.stations import Station
from facts_damping.measurement.pmu import DATA_ERROR
from facts_damping.signals import LOST, NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from facts_damping.parameters.system import System
    from facts_damping.signals import Record
    from facts_damping.streaming.server import Server

    Timed = tuple[float, Instant]  # s since the first tick, what is sent then

WAIT_S = 0.02  # between two looks whether anybody listens


def grid_stations(system: System) -> list[Station]:
    """The system's stations with the bases of what they measure."""
    kilovolts = {bus.name: bus.nominal_voltage for bus in system.buses}
    return [Station(name, kilovolts[bus], system.base_power) for name, bus in system.station_buses().items()]


def instants(record: Record, seen: Sequence[Station], epoch: int) -> Iterator[Timed]:
    """What the PMUs of a recording said, tick by tick, time-aligned: stamped by the instant that they describe.

    A tick at which no station has measured yet is left out; a station that has not is absent in STAT. Of stations whose
    clocks are off, the stamp is the nearest instant of a frame: their error is in their angles.
    """
    first = int(record.time_ns[0])
    for k, now_ns in enumerate(record.time_ns.tolist()):
        there = record.measured_ns[k] != LOST
        if not there.any():
            continue
        values = np.where(there[:, None], record.frames[k], np.nan)
        status = np.where(there, record.status[k], DATA_ERROR)
        frame = round(float(np.median(record.measured_ns[k][there])) * record.frame_rate / NANOSECONDS)
        soc, parts = divmod(frame * TIME_BASE // record.frame_rate, TIME_BASE)
        yield (now_ns - first) / NANOSECONDS, Instant(epoch + soc, parts, 0, stations.to_data(seen, values, status))


def one_of(instant: Instant, i: int) -> Instant:
    """What one of the stations says alone."""
    d, phasors, analogs = instant.data, len(stations.PHASORS), len(stations.ANALOGS)
    own = Data(
        d.status[i : i + 1],
        d.phasors[phasors * i : phasors * (i + 1)],
        d.frequency[i : i + 1],
        d.rocof[i : i + 1],
        d.analogs[analogs * i : analogs * (i + 1)],
        d.digitals,
    )
    return instant._replace(data=own)


async def play(servers: Sequence[Server], timed: Iterator[Timed], *, each: bool) -> None:
    """Send what was recorded at its pace, from when somebody listens; `each`: a server a station."""
    while not any(server.listening for server in servers):  # noqa: ASYNC110 (clients come when they like)
        await asyncio.sleep(WAIT_S)
    loop = asyncio.get_running_loop()
    began = loop.time()
    for at, instant in timed:
        await asyncio.sleep(max(0.0, began + at - loop.time()))
        for i, server in enumerate(servers):
            server.send(one_of(instant, i) if each else instant)
