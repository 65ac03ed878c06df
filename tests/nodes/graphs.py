"""What the tests of graphs share: running one, comparing recordings, striking a node."""

from __future__ import annotations

import os
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rclpy
from facts_damping_msgs.srv import Step
from mcap.reader import make_reader
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.digest import digest
from facts_damping.errors import RunError
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation import loop
from facts_damping.simulation.replaying import replay
from facts_damping_studies.campaigns.invariants import late_ticks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from rclpy.node import Node

    from facts_damping.case.model import Case
    from facts_damping.record import Record

ARRAYS = (
    *("time_ns", "frames", "measured_ns", "status", "delivered", "issued", "applied"),
    *("machines", "devices", "in_synchronism", "estimates", "learning", "supervised", "supervision"),
)
PATIENCE_S = 60.0
LOADED_S = 20.0  # longest wait for a node where silence is not what is tested: two graphs may be on two cores
SILENCE_S = 3.0  # a node that lives answers within it, on a loaded machine, too


def quiet(_done: int, _of: int) -> None:
    """Show no progress."""


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
    """A foreign node with its own context, and its executor."""
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
    """Number of ticks that a plant has reported so far."""
    lines = [line.split() for line in plant.texts()[0].splitlines() if line.startswith("tick ")]
    return int(lines[-1][1]) if lines else 0


def payloads(folder: Path, until_ns: int | None = None, name: str = "recording") -> dict[str, list[bytes]]:
    """Messages of the recording `folder / name`, by topic."""
    by_topic: dict[str, list[bytes]] = {}
    with next((folder / name).glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(ending_before=until_ns, log_time_order=False):
            by_topic.setdefault(channel.topic, []).append(message.data)
    return by_topic


def assert_kept_apart(sets: list[str], folder: Path) -> None:
    """A graph that runs beside another in its domain is refused at the start.

    If its nodes had found each other before, it uses no message of the other graph and reports what it refused.
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


def wait_until(condition: Callable[[], bool], otherwise: str = "", meanwhile: Callable[[], Any] | None = None) -> None:
    """Wait for a condition, at most for PATIENCE_S; `meanwhile` is called again and again, else this sleeps."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, otherwise
        (meanwhile or partial(time.sleep, 0.01))()


def set_parameter(client: Any, node: str, name: str, value: Any) -> Any:
    """Set a parameter of a node by its service. Returns the result."""
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return client(SetParameters, f"/{node}/set_parameters", request).results[0]


def step(client: Any, count: int) -> None:
    """Let a paused run go on for so many ticks, and wait until they are done."""
    assert client(Step, "/plant_sim/step", Step.Request(ticks=count)).success
    pause = partial(client, Trigger, "/plant_sim/pause", Trigger.Request())
    wait_until(lambda: ", 0 ticks left to step" in pause().message)


def assert_replayed(record: Record) -> None:
    """A replay in process gives the recorded setpoints."""
    case = replay.case_of(record, "it", None, [])
    part = replay.fitted(record, case)
    assert len(part.time_ns) == len(record.time_ns)
    assert replay.first_difference(part, replay.play(case, part).issued) is None


def wait_until_recording(folder: Path, size: int = 100_000) -> None:
    wait_until(lambda: recorded_bytes(folder) > size, "no recording grows")


def nodes_left(folder: Path) -> list[str]:
    commands = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue
            if command.startswith(("facts_damping.", "facts_damping_")) and str(folder) in command:
                commands.append(command)
    return commands


def assert_named(
    sets: Sequence[str], folder: Path, started: dict[str, Any], node: str, number: int, expected: str
) -> None:
    """A graph whose node gets a signal ends soon with an error that names it, and leaves no process."""

    def strike(done: int, _of: int) -> None:
        if done > 1 and node in started:
            os.kill(started.pop(node).process.pid, number)

    began = time.monotonic()
    with pytest.raises(RunError, match=expected):
        graph.run(load_case(None, [*sets, "duration=1000"]), "lockstep", folder, strike, SILENCE_S)
    assert time.monotonic() - began < PATIENCE_S
    assert nodes_left(folder) == []


def odd_requests(node: Any, names: Iterable[str]) -> None:
    """Send invalid requests to every node; their answers are not awaited."""
    for name in names:
        for kind, end in ((SetParameters, "set_parameters"), (SetParametersAtomically, "set_parameters_atomically")):
            client: Any = node.create_client(kind, f"/{name}/{end}")
            if client.wait_for_service(0.5):
                odd = ParameterMessage(name="gain", value=ParameterValue(type=99))
                client.call_async(kind.Request(parameters=[odd]))


SLACK = 3  # ticks: a release by the wall clock is noticed once a tick, and recorded at the next


def assert_let_go(case: Case, record: Record, deadline_misses: int) -> None:
    """Each device is released to the end, and at zero within time-out and ramp after the last setpoint that acted.

    On a loaded machine a setpoint may have acted later, by as many ticks as the plant had deadline misses.
    """
    watchdog = case.run.watchdog
    assert watchdog is not None
    released = record.devices["released"] == 1.0
    slack = (SLACK + late_ticks(record, deadline_misses)) * NANOSECONDS // case.run.frame_rate
    for d, name in enumerate(case.run.devices):
        assert released[-1, d]
        first = int(np.flatnonzero(~released[:, d]).max()) + 1
        acted = record.applied[(record.applied["device"] == d) & (record.applied["tick"] < first)]
        last = int(np.maximum(acted["effective_ns"], record.time_ns[acted["tick"]]).max(initial=0))
        assert record.time_ns[first] <= last + int(watchdog.timeout * NANOSECONDS) + slack
        ramp = case.system.device(name).setpoint_max / watchdog.release_rate
        rest = record.time_ns > record.time_ns[first] + int(ramp * NANOSECONDS) + slack
        assert not record.devices["reference"][rest, d].any()
    assert [release.rearmed_s for release in summarise(record).releases] == [None] * len(case.run.devices)
