"""What the commands for streams of synchrophasors do."""

from __future__ import annotations

import asyncio
import sys
import time
from typing import TYPE_CHECKING

from facts_damping.case.names import link_addresses
from facts_damping.cli.runs import say
from facts_damping.errors import InputError
from facts_damping.simulation.replay import case_of
from facts_damping.streaming import recorded, serving
from facts_damping.streaming.concentrator import WAIT_S, Concentrator
from facts_damping.streaming.serving import Serving
from facts_damping.terminal import write_json

if TYPE_CHECKING:
    import argparse


def pmu_serve(arguments: argparse.Namespace) -> None:
    """The stations of a recording as PMUs, or as a concentrator's stream, at its own pace."""
    from facts_damping.recording.reader import load

    record = load(arguments.recording)
    case = case_of(record, str(arguments.recording), None, [])
    links, link = len(link_addresses(case)), arguments.behind
    if link is not None and link >= links:
        raise InputError(f"--behind: {link} given; allowed: a link of the recording, 0 to {links - 1}")
    epoch = int(time.time()) if arguments.epoch is None else arguments.epoch
    asked = Serving(
        arguments.host, arguments.port, arguments.to, arguments.idcode, arguments.format, each=arguments.each
    )
    servers = serving.servers(case, asked, lambda: (epoch, 0))
    concentrator = Concentrator(case, epoch, None if link is None else WAIT_S)

    async def whole() -> None:
        try:
            for line in await serving.begin(servers, asked):
                say(arguments, line)
            sys.stdout.flush()
            await recorded.play(servers, recorded.instants(record, concentrator, link), each=asked.each)
        finally:
            for server in servers:
                await server.end()

    asyncio.run(whole())
    rows = serving.counted(servers)
    write_json(arguments.json, {"streams": rows})
    for row in rows:
        say(arguments, serving.told(row))
    if concentrator.alignment.late:
        say(arguments, f"later than {WAIT_S:g} s: {concentrator.alignment.late} of the link's entries, left out")
