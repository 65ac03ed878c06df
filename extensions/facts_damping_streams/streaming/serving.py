"""Servers of a run's PMUs: one for all, as a PDC, or one for each PMU."""

from __future__ import annotations

import asyncio
import socket
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError, check_known, one_line
from facts_damping.output.tables import some_of
from facts_damping_streams.c37118 import session, system_pmus
from facts_damping_streams.c37118.configuration import FORMATS, Site
from facts_damping_streams.parameters import MAX_ID
from facts_damping_streams.streaming.pdc import grid_pmus
from facts_damping_streams.streaming.server import Server

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case
    from facts_damping_streams.streaming.server import Address


class Serving(NamedTuple):
    """Options for serving a run's PMUs."""

    host: str  # address of this computer
    port: int  # port of the first server, TCP and UDP; 0: any free ones
    to: Sequence[str]  # HOST:PORT of further UDP receivers
    idcode: int  # of the first stream
    format: str | None  # names of FORMATS, separated by commas; None: all
    each: bool  # one server per PMU


def servers(case: Case, asked: Serving, now: Callable[[], tuple[int, int]]) -> list[Server]:
    """The servers, not yet started; `now`: time of their answers. Raises `InputError`."""
    grid, rate, measured = grid_pmus(case), case.run.frame_rate, case.measurement
    if asked.idcode + len(grid) > MAX_ID:
        problem = f"idcode: {asked.idcode} given with {len(grid)} PMUs"
        raise InputError(f"{problem}; allowed: 1 to {MAX_ID - len(grid)}")
    formats, ranges = _formats(asked.format), (measured.voltage_range, measured.current_range)
    late, sample = round(1e6 * case.filter.delay / rate), 1e6 / (rate * case.filter.per_frame)
    service, window = "P" if measured.filter == "p_class" else "M", round(2 * case.filter.side * sample)
    site = Site(service_class=service, window_us=window, group_delay_us=late)
    built = []
    for i, group in enumerate([[pmu] for pmu in grid] if asked.each else [grid]):
        number = asked.idcode + i
        pmu = number if asked.each else number + 1
        configured = system_pmus.configuration(group, rate, round(case.system.frequency), formats, site, ranges, pmu)
        text = f"{case.system.name}: {', '.join(pmu.name for pmu in group)}"
        built.append(Server(session.stream(number, configured, text), now))
    return built


def _formats(text: str | None) -> dict[str, bool]:
    """FORMAT by the names of its bits; None: all; `none`: all integers, rectangular."""
    names = FORMATS if text is None else [name for name in text.split(",") if name and name != "none"]
    for name in names:
        check_known("format", name, [*FORMATS, "none"])
    return {name: name in names for name in FORMATS}


async def begin(stream_servers: Sequence[Server], asked: Serving) -> list[str]:
    """Open the servers' ports; returns a line per stream with its address. Raises `InputError`, `RunError`."""
    targets, lines = [await _address(text, asked.host) for text in asked.to], []
    for i, server in enumerate(stream_servers):
        at = (asked.host, asked.port + i if asked.port else 0)
        await server.begin(at, at, targets)
        stream = server.stream
        names = f"IDCODE {stream.idcode}, {some_of([pmu.name for pmu in stream.configuration.pmus])}"
        lines.append(f"serving {names}: {asked.host}, TCP {server.ports[0]}, UDP {server.ports[1]}")
    return lines


async def _address(text: str, source: str) -> Address:
    """Address of a receiver, resolved; `source`: address of this computer to send from."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"to: '{text}' given; allowed: HOST:PORT")
    try:
        loop = asyncio.get_running_loop()
        resolved = (await loop.getaddrinfo(host, int(port), family=socket.AF_INET, type=socket.SOCK_DGRAM))[0][4]
    except (OSError, UnicodeError) as error:
        raise InputError(f"to: '{text}' given: {one_line(error)}; allowed: HOST:PORT of a host that is known") from None
    there = ip_address(resolved[0])
    if source.startswith("127.") and not (there.is_loopback or there.is_multicast):
        raise InputError(f"to: '{text}' given with host {source}; allowed: this computer, groups; or another host")
    return str(resolved[0]), int(port)


def counted(stream_servers: Sequence[Server]) -> list[dict[str, Any]]:
    """Counters of sent and refused frames, one row per stream."""
    rows = [{"idcode": server.stream.idcode, **vars(server.counts)} for server in stream_servers]
    return [{**row, "refused": dict(row["refused"])} for row in rows]


def told(row: dict[str, Any]) -> str:
    """Text of such a row."""
    refused = ", ".join(f"{what} {times}" for what, times in row["refused"].items()) or "nothing"
    sent = f"{row['frames']} frames, {row['clients']} clients, {row['dropped']} dropped"
    return f"IDCODE {row['idcode']}: {sent}; refused: {refused}"
