"""Nodes and graphs as the tests start them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, TYPE_CHECKING, Any

import pytest

from facts_damping.nodes import frame_source
from facts_damping.nodes.launching import forked, processes
from facts_damping.testing import loopback
from tests.nodes.graphs import PATIENCE_S, somebody

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


__all__ = ["loopback"]  # a fixture


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The processes that a graph starts, by name; on the loopback the plant reports every few ticks."""
    by_name: dict[str, Any] = {}
    original = processes.start

    def spy(name: str, *arguments: Any) -> Any:
        by_name[name] = original(name, *arguments)
        return by_name[name]

    monkeypatch.setattr(processes, "start", spy)
    monkeypatch.setattr(frame_source, "PROGRESS_S", 0.02)
    return by_name


@dataclass
class Started:
    """A node that was started, and its output files."""

    name: str
    pid: int
    poll: Callable[[], int | None]
    output: IO[str]
    errors: IO[str]

    def wait(self, until: Callable[[], bool], timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{self.name}: nothing within {timeout:g} s")
            time.sleep(0.01)

    def communicate(self, timeout: float) -> tuple[str, str]:
        """Wait until it has ended. Returns `texts`."""
        self.wait(lambda: self.poll() is not None, timeout)
        return self.texts()

    def texts(self) -> tuple[str, str]:
        """Standard output and standard error so far."""
        return Path(self.output.name).read_text(), Path(self.errors.name).read_text()

    @property
    def returncode(self) -> int | None:
        return self.poll()

    def finish(self) -> None:
        """Wait until it has ended with status 0 and without an error."""
        assert (self.communicate(PATIENCE_S)[1], self.returncode) == ("", 0)

    def stop(self, number: int = signal.SIGTERM) -> None:
        """Send a signal and wait until it has ended."""
        self.send_signal(number)
        self.communicate(PATIENCE_S)

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)


@pytest.fixture
def start(domain: int) -> Iterator[Callable[..., Started]]:
    """Starts executables by name with parameters; those that still run at the end are stopped and printed.

    `cold`: as `ros2 run` does, not forked from a process that has everything loaded. In lockstep and with lines for
    this process, unless parameters say otherwise.
    """
    with ExitStack() as opened:
        running: list[Started] = []

        def start_one(executable: str, *options: str, cold: bool = False, **parameters: Any) -> Started:
            arguments, node_parameters = (
                [*processes.QUIET, *options],
                {"progress": True, "mode": "lockstep"} | parameters,
            )
            if executable in ("live_view", "cockpit", "c37118_server"):
                del node_parameters["mode"]
            for name, value in node_parameters.items():
                arguments += ["-p", f"{name}:={value}"]
            output, errors = (opened.enter_context(NamedTemporaryFile("w")) for _ in range(2))
            if cold:
                command = [str(Path(sys.executable).parent / executable), *arguments]
                popen = subprocess.Popen(command, stdout=output, stderr=errors)
                running.append(Started(executable, popen.pid, popen.poll, output, errors))
            else:
                node = forked.start(executable, arguments, os.environ, output.name, errors.name)
                running.append(Started(executable, node.pid or 0, lambda: node.exitcode, output, errors))
            return running[-1]

        yield start_one
        ended = [node.poll() for node in running]
        for node, status in zip(running, ended, strict=True):
            node.terminate()
            try:
                node.communicate(timeout=10)
            except TimeoutError:
                node.send_signal(signal.SIGKILL)
            state = "still ran" if status is None else "had ended"
            print(f"{node.name}: {state}, {node.communicate(timeout=10)}, {node.poll()}")


@pytest.fixture
def client(domain: int) -> Iterator[Callable[[Any, str, Any], Any]]:
    """Calls a service of another node and returns the answer."""
    with somebody("tester") as (node, executor):
        known: dict[str, Any] = {}

        def call(kind: Any, name: str, request: Any) -> Any:
            service = known[name] = known.get(name) or node.create_client(kind, name)
            assert service.wait_for_service(PATIENCE_S), name
            future = service.call_async(request)
            executor.spin_until_future_complete(future, PATIENCE_S)
            assert future.done(), f"no answer from {name}"
            return future.result()

        yield call
