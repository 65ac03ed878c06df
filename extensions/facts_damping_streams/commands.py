"""The commands for synchrophasor streams."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case import loading
from facts_damping.case.names import controller_names, label, link_addresses
from facts_damping.cli.reporting import say, tell_graph
from facts_damping.cli.runs import WITH_RUN, out_folder
from facts_damping.errors import InputError, RunError
from facts_damping.interruption import tell
from facts_damping.output.tables import table
from facts_damping.output.terminal import Progress, put
from facts_damping.output.writing import write_json
from facts_damping.signals import NEVER
from facts_damping.simulation.replaying.replay import case_of, check_has_run
from facts_damping_streams.parameters import read_streams, server
from facts_damping_streams.streaming import listening, recorded, serving
from facts_damping_streams.streaming.pdc import WAIT_S, Pdc
from facts_damping_streams.streaming.serving import Serving

if TYPE_CHECKING:
    import argparse

    from facts_damping.case.model import Case
    from facts_damping.record import Record


def pmu_serve(arguments: argparse.Namespace) -> None:
    """Serve the PMUs of a recording, each by itself or all by one PDC, at the recorded pace."""
    from facts_damping.recording.reader import load

    record = load(arguments.recording)
    check_has_run(record, str(arguments.recording), WITH_RUN)
    case = case_of(record, str(arguments.recording), None, [])
    links, link = len(link_addresses(case)), arguments.behind
    if link is not None and link >= links:
        raise InputError(f"--behind: {link} given; allowed: a link of the recording, 0 to {links - 1}")
    epoch = int(time.time()) if arguments.epoch is None else arguments.epoch
    asked = Serving(**{name: getattr(arguments, name) for name in Serving._fields})
    servers = serving.servers(case, asked, lambda: (epoch, 0))
    pdc = Pdc(case, epoch, None if link is None else WAIT_S)

    tell("the streams have ended")

    async def whole() -> None:
        try:
            say(arguments, *await serving.begin(servers, asked))
            put("", flush=True)
            with Progress("pmu-serve", "s") as progress:
                timed = recorded.with_progress(
                    recorded.instants(record, pdc, link), float(np.ptp(record.time_s)), progress
                )
                await recorded.play(servers, timed, each=asked.each)
        finally:
            for server in servers:
                await server.end()

    asyncio.run(whole())
    rows = serving.counted(servers)
    write_json(arguments.json, {"streams": rows})
    say(arguments, *map(serving.told, rows))
    if pdc.alignment.late:
        say(arguments, f"later than {WAIT_S:g} s: {pdc.alignment.late} of the link's entries, left out")


def pmu_listen(arguments: argparse.Namespace) -> None:
    """Print data of servers; with a run, operate its controllers on the streams in shadow mode."""
    streams = read_streams(arguments.streams)
    if arguments.run is not None:
        _in_shadow(arguments)
        return
    options = [name for name in ("set", "out", "supervised") if getattr(arguments, name)]
    if options:
        raise InputError(f"--{options[0]}: given without --run; allowed: with --run RUN")
    states = asyncio.run(listening.listen([server(text) for text in streams.servers], arguments.seconds))
    write_json(arguments.json, {"servers": [state.result() for state in states]})
    for server_state in states:
        say(arguments, str(server_state))
        if server_state.configuration is not None:
            say(arguments, *table(listening.TITLES, server_state.rows(), 4))
    silent = [state for state in states if state.configuration is None]
    if silent:
        raise RunError(f"{silent[0]} (within {arguments.seconds:g} s)")


def _in_shadow(arguments: argparse.Namespace) -> None:
    """Run a case's nodes, with streams in place of the plant, and record them."""
    from facts_damping.nodes.launching import graph
    from facts_damping.nodes.launching.starting import Parts

    case = loading.load_case(arguments.run, arguments.set, arguments.supervised)
    if case.supervision is not None:  # the supervisors stay in shadow
        case = loading.load_case(arguments.run, [*arguments.set, "arm_at=null"], arguments.supervised)
    name = label(case.summary())
    folder = out_folder(arguments, f"shadow-{name}")
    with Progress(name) as progress:
        outcome = graph.run(
            case, "realtime", folder, progress, arguments.timeout, parts=Parts(streams=arguments.streams)
        )
    tell_graph(arguments, name, outcome, folder, partial(_received, case))


def _received(case: Case, record: Record) -> tuple[dict[str, Any], list[str]]:
    """Number of frames from each PMU, and the output that each controller would have had; with lines of text."""
    frames = dict(zip(record.pmus, (record.measured_ns != NEVER).sum(axis=0).tolist(), strict=True))
    pmus = {name: {"frames": count, "absent": len(record.measured_ns) - count} for name, count in frames.items()}
    rows = [(name, str(row["frames"]), str(row["absent"])) for name, row in pmus.items()]
    lines, controllers = table(("pmu", "frames", "absent"), rows), {}
    for c, name in enumerate(controller_names(case)):
        setpoints = record.issued[record.issued["controller"] == c]["value"]
        largest = float(np.abs(setpoints).max(initial=0.0))
        controllers[name] = {"setpoints": len(setpoints), "largest": largest}
        lines.append(f"{name}: {len(setpoints)} setpoints, the largest {largest:.4g} p.u.")
    return {"pmus": pmus, "controllers": controllers}, lines
