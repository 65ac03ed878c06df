"""What the tests of graphs share: running one, comparing recordings, striking a node."""

from __future__ import annotations

import os
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from mcap.reader import make_reader
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from facts_damping.case.loading import load_case
from facts_damping.digest import digest
from facts_damping.errors import RunError
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rclpy.node import Node

    from facts_damping.case.model import Case
    from facts_damping.signals import Record

ARRAYS = (
    *("time_ns", "frames", "measured_ns", "status", "delivered", "issued", "applied"),
    *("machines", "devices", "in_synchronism", "estimates", "learning", "supervised", "supervision"),
)
PATIENCE_S = 60.0
LOADED_S = 20.0  # longest wait for a node where silence is not what is tested: two graphs may be on two cores
SILENCE_S = 3.0  # a node that lives answers within it, on a loaded machine, too


def quiet(_done: int, _of: int) -> None:
    """No progress."""


def run_graph(folder: Path, sets: list[str], mode: str = "lockstep", timeout: float = LOADED_S) -> Record:
    graph.run(load_case(None, sets), mode, folder, quiet, timeout)
    return load(folder / "recording")


def assert_same(recorded: Record, computed: Record) -> None:
    for name in ARRAYS:
        a, b = getattr(recorded, name), getattr(computed, name)
        assert a.dtype == b.dtype
        assert a.shape == b.shape, name
        assert a.tobytes() == b.tobytes(), name
    assert digest(recorded) == digest(computed)
    assert recorded.notes == []
    assert str(recorded.events) == str(computed.events)
    for name in ("pmus", "machine_names", "device_names", "controller_names", "configuration"):
        assert getattr(recorded, name) == getattr(computed, name)


def as_in_process(folder: Path, case: Case) -> Record:
    """The run in process, which is what a graph in lockstep records in `folder`."""
    outcome, computed = graph.run(case, "lockstep", folder, quiet, LOADED_S), loop.run(case)
    assert outcome.messages_lost == 0
    assert_same(load(outcome.recording), computed)
    return computed


@contextmanager
def somebody(name: str, **options: Any) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """A node of somebody else's, with a context of its own, and what spins it."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node(name, context=context, **options)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def ticks(plant: Any) -> int:
    """How many ticks a plant has told so far."""
    lines = [line.split() for line in plant.texts()[0].splitlines() if line.startswith("tick ")]
    return int(lines[-1][1]) if lines else 0


def payloads(folder: Path, until_ns: int | None = None) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    with next((folder / "recording").glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(ending_before=until_ns, log_time_order=False):
            found.setdefault(channel.topic, []).append(message.data)
    return found


def assert_kept_apart(sets: list[str], folder: Path) -> None:
    """A graph that runs beside another in its domain is refused at the start.

    Or, where its nodes had found each other before they saw the other's, it takes nothing of it and says what it
    refused.
    """
    case = load_case(None, sets)
    try:
        outcome = graph.run(case, "realtime", folder, quiet, LOADED_S)
    except RunError as error:
        assert "ROS_DOMAIN_ID" in str(error)  # noqa: PT017 (one of two good ends)
        return
    assert {cause for _, cause, _, _ in outcome.messages_refused} == {"publisher"}
    if outcome.deadline_misses == 0:
        assert_same(load(outcome.recording), loop.run(case))


BEGUN = 40_000  # bytes of a recording that has more than its configuration


def recorded_bytes(folder: Path) -> int:
    """Size of the largest recording so far."""
    return max((file.stat().st_size for file in folder.rglob("*.mcap")), default=0)


def wait_until(what: Callable[[], bool], otherwise: str = "") -> None:
    """Wait for something, not for ever."""
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline, otherwise
        time.sleep(0.01)


def wait_until_recording(folder: Path, size: int = 100_000) -> None:
    wait_until(lambda: recorded_bytes(folder) > size, "no recording grows")


def nodes_left(folder: Path) -> list[str]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue
            if "facts_damping.nodes" in command and str(folder) in command:
                found.append(command)
    return found


def assert_named(sets: Sequence[str], folder: Path, started: dict[str, Any], node: str, number: int, expected: str) -> None:
    """A graph whose node gets a signal ends soon, says so by the node's name, and leaves no process."""

    def strike(done: int, _of: int) -> None:
        if done > 1 and node in started:
            os.kill(started.pop(node).process.pid, number)

    began = time.monotonic()
    with pytest.raises(RunError, match=said):
        graph.run(load_case(None, [*sets, "duration=1000"]), "lockstep", folder, strike, SILENCE_S)
    assert time.monotonic() - began < PATIENCE_S
    assert nodes_left(folder) == []


def odd_requests(node: Any, names: Iterable[str]) -> None:
    """Requests that make no sense, to every node; nobody waits for their answers."""
    for name in names:
        for kind, end in ((SetParameters, "set_parameters"), (SetParametersAtomically, "set_parameters_atomically")):
            client: Any = node.create_client(kind, f"/{name}/{end}")
            if client.wait_for_service(0.5):
                odd = Parameter(name="gain", value=ParameterValue(type=99))
                client.call_async(kind.Request(parameters=[odd]))
