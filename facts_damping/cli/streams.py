"""What the commands for streams of synchrophasors do."""

from __future__ import annotations

import asyncio
import sys
import time
from typing import TYPE_CHECKING

from facts_damping.c37118 import session, stations
from facts_damping.c37118.configuration import FORMATS, Site
from facts_damping.cli.runs import say
from facts_damping.errors import InputError, check_known
from facts_damping.simulation.replay import case_of
from facts_damping.streaming import recorded
from facts_damping.streaming.server import Server
from facts_damping.terminal import write_json

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from facts_damping.c37118.session import Stream
    from facts_damping.case.model import Case
    from facts_damping.streaming.server import Address

MOST_ID = 65534
SHOWN = 8  # names of stations


def pmu_serve(arguments: argparse.Namespace) -> None:
    """The stations of a recording as PMUs, or as a concentrator's stream, at its own pace."""
    from facts_damping.recording.reader import load

    formats = _formats(arguments.format)
    record = load(arguments.recording)
    case = case_of(record, str(arguments.recording), None, [])
    streams = _streams(case, arguments, formats)
    targets = [_address(text) for text in arguments.to]
    epoch = int(time.time()) if arguments.epoch is None else arguments.epoch
    servers = [Server(one, lambda: (epoch, 0)) for one in streams]
    timed = recorded.instants(record, recorded.grid_stations(case.system), epoch)

    async def whole() -> None:
        try:
            for i, server in enumerate(servers):
                at = (arguments.host, arguments.port + i if arguments.port else 0)
                await server.begin(at, at, targets)
                say(
                    arguments,
                    f"serving {_names(server)}: {arguments.host}, TCP {server.ports[0]}, UDP {server.ports[1]}",
                )
            sys.stdout.flush()
            await recorded.play(servers, timed, each=arguments.each)
        finally:
            for server in servers:
                await server.end()

    asyncio.run(whole())
    _tell(arguments, servers)


def _streams(case: Case, arguments: argparse.Namespace, formats: dict[str, bool]) -> list[Stream]:
    """One of all stations, or one of each."""
    seen = recorded.grid_stations(case.system)
    one, rate = case.measurement, case.run.frame_rate
    ranges = (one.voltage_range, one.current_range)
    late = round(1e6 * case.filter.delay / rate)
    site = Site(service_class="P" if case.measurement.filter == "p_class" else "M", group_delay_us=late)
    groups = [[station] for station in seen] if arguments.each else [seen]
    if arguments.idcode + len(seen) > MOST_ID:
        most = MOST_ID - len(seen)
        raise InputError(f"--idcode: {arguments.idcode} given with {len(seen)} stations; allowed: 1 to {most}")
    streams = []
    for i, group in enumerate(groups):
        own = arguments.idcode + i
        pmu = own if arguments.each else own + 1
        made = stations.configuration(group, rate, round(case.system.frequency), formats, site, ranges, pmu)
        streams.append(session.stream(own, made, f"{case.system.name}: {', '.join(s.name for s in group)}"))
    return streams


def _names(server: Server) -> str:
    """Stream and stations, for people."""
    names = [pmu.name for pmu in server.stream.configuration.pmus]
    shown = ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
    return f"IDCODE {server.stream.idcode}, {shown}"


def _formats(text: str | None) -> dict[str, bool]:
    """FORMAT by the names of its bits; not given: all; `none`: all integers, rectangular."""
    names = FORMATS if text is None else [name for name in text.split(",") if name and name != "none"]
    for name in names:
        check_known("--format", name, [*FORMATS, "none"])
    return {name: name in names for name in FORMATS}


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"--to: '{text}' given; allowed: HOST:PORT")
    return host, int(port)


def _tell(arguments: argparse.Namespace, servers: Sequence[Server]) -> None:
    """What was sent, to whom, and what was refused."""
    rows = [{"idcode": one.stream.idcode, **vars(one.counts)} for one in servers]
    write_json(arguments.json, {"streams": rows})
    for row in rows:
        refused = ", ".join(f"{what} {times}" for what, times in row["refused"].items()) or "nothing"
        sent = f"{row['frames']} frames, {row['clients']} clients, {row['dropped']} dropped"
        say(arguments, f"IDCODE {row['idcode']}: {sent}; refused: {refused}")
