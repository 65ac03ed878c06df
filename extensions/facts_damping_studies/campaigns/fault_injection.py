"""Fault injection into a real graph: a node is killed or suspended, or an attacker publishes in the domain."""

from __future__ import annotations

import itertools
import os
import signal
import socket
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.case.names import controller_addresses, link_addresses, supervisor_addresses
from facts_damping.errors import RunError
from facts_damping.nodes import clock
from facts_damping.nodes.launching import graph, processes
from facts_damping.nodes.launching.starting import RUN_FILE, Parts
from facts_damping.recording import seal
from facts_damping_studies.campaigns import attack_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.nodes.launching.graph import Outcome
    from facts_damping.nodes.launching.processes import Process
    from facts_damping.record import Record

DOMAINS = range(215, 233)  # domains of faulted graphs: their DDS ports are free on Linux; 0 to 101 are left to others
DOMAIN = "ROS_DOMAIN_ID"
LOCKSTEP, REALTIME = "lockstep", "realtime"
ATTACKER = "attacker"
PATIENCE_S = 20.0  # time-out of nodes in lockstep: several graphs may share two cores
GONE_S = 2.0  # time-out of nodes in real time, at the end for readers that do not answer

_domains = itertools.cycle(DOMAINS)

TARGETS: dict[str, Callable[[Case], str]] = {
    "wan_link": lambda case: str(link_addresses(case)[case.used_links[0]]),
    "controller": lambda case: str(controller_addresses(case)[0]),
    "supervisor": lambda case: str(supervisor_addresses(case)[0]),
}  # target node of a fault: always that of the run's first controller


class GraphFault(NamedTuple):
    """Fault: none (empty), `kill NODE`, `stop NODE` or `forge`; start, and duration (None: to the end).

    A killed node is not restarted: DDS notices its end only after some 20 s, and until then no node can replace it.
    """

    real: str
    start_s: float  # simulated time
    duration_s: float | None

    @property
    def kind(self) -> str:
        """`kill`, `stop`, `forge`, or empty."""
        return self.real.partition(" ")[0]


class FaultedRun(NamedTuple):
    """Result of a faulted graph: outcome, recording, times of the fault, forged messages by topic."""

    outcome: Outcome
    record: Record
    begun_s: float | None  # simulated time of the fault; None: the run ended before
    back_s: float | None  # simulated time at which a suspended node was resumed
    forged: dict[str, int]


class FaultInjector:
    """Watches a running graph and injects the fault when it is due."""

    def __init__(
        self, case: Case, mode: str, fault: GraphFault, run_file: Path, environment: Mapping[str, str]
    ) -> None:
        """`mode`: of the graph; in real time, simulated time is extrapolated between two progress lines of the plant.

        `run_file`, `environment`: of the graph's nodes, for the attacker.
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
        """Start the attacker, suspend, kill or resume the target if that is due."""
        if self._fault.kind == "forge" and self.attacker is None:
            parameters = {"run": self._run_file, "first": round(self._fault.start_s * self._rate)}
            self.attacker = processes.start(ATTACKER, ATTACKER, parameters, None, self._environment)
        if tick != self._newest:
            self._newest, self._at = tick, clock.monotonic()
        if tick == 0 or not self._fault.kind:
            return
        now = tick / self._rate + (clock.monotonic() - self._at if self._paced else 0.0)
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
        """End the attacker. Returns the number of forged messages by topic; raises `RunError` if it failed."""
        if self.attacker is None:
            return {}
        processes.end([self.attacker], signal.SIGINT)
        text, failed, reason = self.attacker.text(), self.attacker.failed(), self.attacker.reason()
        self.attacker.output.close()
        self.attacker.errors.close()
        if failed:
            raise RunError(reason)
        return attack_lines.sent(text)


def run_with_fault(
    case: Case, mode: str, out: Path, fault: GraphFault, domain: int, wanted: Callable[[], bool] = lambda: True
) -> FaultedRun:
    """Run a case as a graph in a ROS domain and inject a fault; the recording is `out / "recording"`.

    Several of these may run in threads. Raises `RunError` when `wanted` becomes false, and if the graph or the
    attacker fails.
    """
    environment = {**os.environ, DOMAIN: str(domain)}
    injector = FaultInjector(case, mode, fault, out / RUN_FILE, environment)
    timeout = GONE_S if mode == REALTIME else PATIENCE_S

    def look(tick: int, running: Mapping[str, Process]) -> None:
        if not wanted():
            raise RunError("interrupted")
        injector(tick, running)

    try:
        outcome = graph.run(case, mode, out, lambda _done, _of: None, timeout, look, Parts(environment=environment))
    finally:
        forged = injector.end()
    return FaultedRun(outcome, seal(outcome.recording), injector.begun_s, injector.back_s, forged)


@contextmanager
def own_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID of `DOMAINS` that no other graph of a campaign uses.

    An abstract socket reserves it and leaves no file behind. Raises `RunError` if all are in use.
    """
    with socket.socket(socket.AF_UNIX) as held:
        for number in itertools.islice(_domains, len(DOMAINS)):
            with suppress(OSError):
                held.bind(f"\0facts_damping_domain_{number}")
                break
        else:
            raise RunError(f"{DOMAIN}: {DOMAINS[0]} to {DOMAINS[-1]} are in use by other graphs of campaigns")
        yield number
