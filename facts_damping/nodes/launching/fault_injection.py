"""Faults done to a real graph: a node is killed, or stands still for a while, or somebody else speaks in the domain."""

from __future__ import annotations

import itertools
import os
import re
import signal
import socket
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.case.names import controller_addresses, link_addresses, supervisor_addresses
from facts_damping.errors import RunError
from facts_damping.nodes.launching import graph
from facts_damping.recording import seal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.nodes.launching.graph import Outcome, Process
    from facts_damping.signals import Record

DOMAINS = range(215, 233)  # of such graphs: DDS's ports for them are free on Linux, and 0 to 101 are for others
DOMAIN = "ROS_DOMAIN_ID"
LOCKSTEP, REALTIME = "lockstep", "realtime"
ATTACKER = "attacker"
PATIENCE_S = 20.0  # with a node in lockstep: two graphs may be on two cores
GONE_S = 2.0  # with readers that do not answer, at the end of a run by the clock

_domains = itertools.cycle(DOMAINS)

TARGETS: dict[str, Callable[[Case], str]] = {
    "wan_link": lambda case: str(link_addresses(case)[case.used_links[0]]),
    "controller": lambda case: str(controller_addresses(case)[0]),
    "supervisor": lambda case: str(supervisor_addresses(case)[0]),
}  # whom a fault hits: of the run's first controller


class GraphFault(NamedTuple):
    """What is done: nothing (empty), `kill NODE`, `stop NODE`, `forge`; from when, for how long (None: to the end).

    Who is killed stays dead: DDS misses it after some 20 s alone, and before that nobody can take its place.
    """

    real: str
    start_s: float  # simulated time
    duration_s: float | None

    @property
    def kind(self) -> str:
        """`kill`, `stop`, `forge`, or nothing."""
        return self.real.partition(" ")[0]


class FaultedRun(NamedTuple):
    """A graph that was struck: how it ended, what it recorded, when it was done, what a attacker said by topic."""

    outcome: Outcome
    record: Record
    begun_s: float | None  # simulated time; None: the run was over before
    back_s: float | None  # when who stood still went on
    forged: dict[str, int]


class FaultInjector:
    """Looks at a graph that runs, and strikes when it is time."""

    def __init__(
        self, case: Case, mode: str, fault: GraphFault, run_file: Path, environment: Mapping[str, str]
    ) -> None:
        """`mode`: of the graph; in real time simulated time goes on between two lines of the plant.

        `run_file`, `environment`: those of its nodes, for a attacker.
        """
        self._rate, self._paced, self._fault, self._run_file = case.run.frame_rate, mode == REALTIME, fault, run_file
        self._environment = environment
        target = fault.real.partition(" ")[2]
        self._target = TARGETS[target](case) if fault.kind in ("kill", "stop") else None
        self._newest, self._at = 0, 0.0
        self.begun_s: float | None = None
        self.back_s: float | None = None
        self.attacker: Process | None = None

    def __call__(self, tick: int, running: Mapping[str, Process]) -> None:
        """Do what is due."""
        if self._fault.kind == "forge" and self.attacker is None:
            parameters = {"run": self._run_file, "first": round(self._fault.start_s * self._rate)}
            self.attacker = graph.start(ATTACKER, ATTACKER, parameters, None, self._environment)
        if tick != self._newest:
            self._newest, self._at = tick, time.monotonic()
        if tick == 0 or not self._fault.kind:
            return
        now = tick / self._rate + (time.monotonic() - self._at if self._paced else 0.0)
        if self.begun_s is None and now >= self._fault.start_s:
            self.begun_s = now
            self._signal(running, signal.SIGKILL if self._fault.kind == "kill" else signal.SIGSTOP)
        lasts = self._fault.duration_s
        if self.begun_s is None or self._fault.kind != "stop" or self.back_s is not None or lasts is None:
            return
        if now >= self.begun_s + lasts:
            self.back_s = now
            self._signal(running, signal.SIGCONT)

    def _signal(self, running: Mapping[str, Process], number: int) -> None:
        if self._target is not None:
            with suppress(ProcessLookupError):  # it may have ended
                os.kill(running[self._target].process.pid or 0, number)

    def end(self) -> dict[str, int]:
        """End the attacker; what it has said, by topic."""
        if self.attacker is None:
            return {}
        graph.end([self.attacker], signal.SIGINT)
        said, failed, reason = self.attacker.said(), self.attacker.failed(), self.attacker.reason()
        self.attacker.output.close()
        self.attacker.errors.close()
        if failed:
            raise RunError(reason)
        return {topic: int(count) for count, topic in re.findall(r"^sent (\d+) (\S+)$", said, re.MULTILINE)}


def run_with_fault(
    case: Case, mode: str, out: Path, fault: GraphFault, domain: int, wanted: Callable[[], bool] = lambda: True
) -> FaultedRun:
    """Run a case as a graph, in a ROS domain, to which something is done; the recording is `out / "recording"`.

    It may run in a thread beside others; it ends when it is not `wanted` any more. Raises `RunError` then, and where
    the graph, or a attacker, does not go on as it should.
    """
    environment = {**os.environ, DOMAIN: str(domain)}
    striker = FaultInjector(case, mode, fault, out / graph.RUN_FILE, environment)
    timeout = GONE_S if mode == REALTIME else PATIENCE_S

    def look(tick: int, running: Mapping[str, Process]) -> None:
        if not wanted():
            raise RunError("interrupted")
        striker(tick, running)

    try:
        outcome = graph.run(case, mode, out, _quiet, timeout, look=look, environment=environment)
    finally:
        forged = striker.end()
    return FaultedRun(outcome, seal(outcome.recording), striker.begun_s, striker.back_s, forged)


def _quiet(_done: int, _of: int) -> None:
    """No progress: a campaign tells how many graphs are done."""


@contextmanager
def own_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID of `DOMAINS` that no other graph of a campaign uses.

    Taken by a socket without a file, which nothing can leave behind. Raises `RunError` where all are taken.
    """
    with socket.socket(socket.AF_UNIX) as held:
        for number in itertools.islice(_domains, len(DOMAINS)):
            with suppress(OSError):
                held.bind(f"\0facts_damping_domain_{number}")
                break
        else:
            raise RunError(f"{DOMAIN}: {DOMAINS[0]} to {DOMAINS[-1]} are in use by other graphs of campaigns")
        yield number
