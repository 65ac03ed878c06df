"""Runs a case as a ROS 2 graph: starts the nodes as processes, watches and stops them, and cleans up."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case.names import replaceable
from facts_damping.errors import InputError, RunError
from facts_damping.interruption import RECORDED, clean_up_first
from facts_damping.nodes import clock
from facts_damping.nodes.base import lines
from facts_damping.nodes.launching import starting
from facts_damping.nodes.launching.processes import start_again
from facts_damping.parameters.files import new_folder
from facts_damping.parameters.security import read_keys

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from facts_damping.case.model import Case
    from facts_damping.nodes.launching.processes import Process, Refusals
    from facts_damping.simulation.programs.policies import StepTimes

MAX_DOMAIN = 232
FIRST_S = 60.0  # longest wait for the first tick: longer than the nodes' own time-outs
MORE_S = 5.0  # time that a silent plant has beyond the time-out of its nodes


@dataclass
class Outcome:
    """Result of a graph: recording, duration, counts."""

    recording: Path
    wall_s: float
    ticks: int  # that the source of frames has published
    deadline_misses: int
    messages_lost: int
    messages_refused: Refusals
    fallen: list[str]  # reasons of nodes that ended before the run, in real time
    step_times: dict[str, StepTimes]  # of controllers that are the user's own programs


def run(
    case: Case,
    mode: str,
    out: Path,
    progress: Callable[[int, int], None],
    timeout: float = 5.0,
    look: Callable[[int, dict[str, Process]], None] | None = None,
    parts: starting.Parts = starting.ALONE,
) -> Outcome:
    """Run a case as a graph of processes; the recording is `out / "recording"`.

    `look`: called repeatedly while the plant runs, with the newest tick that it has reported and the nodes by name.
    In real time a run that has begun goes on if a link, controller, supervisor or identifier ends.

    Raises `RunError` naming the node that ended or is silent, `InputError` if the folder is in use.
    """
    clean_up_first()
    check(case, out, parts)
    new_folder(out)
    began, fallen = clock.monotonic(), dict[str, str]()
    with starting.started(case, mode, out, timeout, parts) as running:
        clean_up_first(RECORDED)
        plant = next(running[name] for name in starting.SOURCES if name in running)
        ticks, reported_s = lines.Ticks(0, 0, 0), clock.monotonic() + FIRST_S
        while plant.process.exitcode is None:
            for ticks in plant.progress():
                # After tick 1 all have answered once.
                reported_s = clock.monotonic() if ticks.newest > 1 else max(reported_s, clock.monotonic())
                progress(ticks.newest, ticks.of)
            if look is not None:
                look(ticks.newest, running)
            if starting.COCKPIT in running and mode == "realtime":
                obey(running, replaceable(case), running[starting.COCKPIT].read())
            _check_others(running, fallen if ticks.newest > 1 and mode == "realtime" else None)
            if clock.monotonic() - reported_s > timeout + MORE_S:
                raise RunError(f"{plant.name} is silent: no progress within {timeout + MORE_S:g} s")
            clock.sleep(starting.POLL_S)
        if plant.failed():
            _check_others(running, fallen if ticks.newest > 1 and mode == "realtime" else None)
            raise plant.failure()
        for ticks in plant.progress():
            progress(ticks.newest, ticks.of)
        # A node that ended earlier gives the reason, such as a second graph in the same domain.
        _check_others(running, fallen if mode == "realtime" else None)
        wall_s = clock.monotonic() - began
        starting.stop(running)
        return _outcome(out, running, ticks, wall_s, list(fallen.values()))


def _outcome(out: Path, running: dict[str, Process], ticks: lines.Ticks, wall_s: float, fallen: list[str]) -> Outcome:
    """What the nodes of a graph, which have ended, have said. Raises `RunError` if the recorder has failed."""
    recorder = running[starting.RECORDER]
    if recorder.failed():
        raise recorder.failure()
    times = {name.rpartition("/")[2]: process.step_times() for name, process in running.items()}
    return Outcome(
        out / "recording",
        wall_s,
        ticks.newest,
        ticks.late,
        lines.lost(recorder.read()),
        {how: count for process in running.values() for how, count in process.refused().items()},
        fallen,
        {name: row for name, row in times.items() if row is not None},
    )


def check(case: Case, out: Path, parts: starting.Parts) -> None:
    """Raise `InputError` before anything starts: for a folder in use, a domain, a program, keys."""
    check_domain((parts.environment or os.environ).get("ROS_DOMAIN_ID", "0"))
    if (out / "recording").exists():
        raise InputError(f"--out {out}: holds a recording already; allowed: a new folder")
    for c, controller in enumerate(case.controllers):
        if controller.command is not None and shutil.which(controller.command[0]) is None:
            text = f"controllers.{c}.command: '{controller.command[0]}' given"
            raise InputError(f"{text}; allowed: an executable program")
    if case.run.security is not None and parts.replayed is None:
        read_keys(Path(case.run.security.keys))


def check_domain(domain: str) -> None:
    """Raise `InputError` for a ROS_DOMAIN_ID for which DDS has no ports."""
    if not (domain.isdecimal() and int(domain) <= MAX_DOMAIN):
        raise InputError(f"ROS_DOMAIN_ID: '{domain}' given; allowed: 0 to {MAX_DOMAIN}")


def obey(running: dict[str, Process], allowed: Collection[str], output: str) -> None:
    """Carry out the lines `kill NODE` and `restart NODE` in the output of a cockpit, for nodes that may be replaced.

    A node that has ended starts again, disarmed. A user's own program, and a node that still runs, are not started.
    """
    for order, name in lines.orders(output):
        node = running.get(name) if name in allowed else None
        if node is None:
            continue
        if order == "kill" and node.process.exitcode is None:
            node.process.kill()
        elif order == "restart":
            start_again(running, name)


def _check_others(running: dict[str, Process], fallen: dict[str, str] | None = None) -> None:
    """Raise `RunError` if a node other than the source has ended; a killed node counts as the cause.

    `fallen`: if given, takes the reasons of ended nodes, and the run goes on; except if the recorder has ended.
    """
    apart = (*starting.SOURCES, *starting.VIEWS)
    ended = [p for name, p in running.items() if name not in apart and p.process.exitcode is not None]
    if fallen is not None:
        fallen |= {p.name: p.reason() for p in ended if p.name != starting.RECORDER}
        ended = [p for p in ended if p.name == starting.RECORDER]
    if ended:
        killed = [p for p in ended if (p.process.exitcode or 0) < 0]
        raise (killed or ended)[0].failure()
