"""The loopback: endpoints match as with DDS, services and parameters answer, time is simulated, runs repeat."""

from __future__ import annotations

import importlib
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from facts_damping import nodes
from facts_damping.errors import RunError
from facts_damping_testing.loopback.domain import parse
from facts_damping_testing.loopback.opening import StandIn, opened
from facts_damping_testing.loopback.processes import World, never
from tests.nodes.graphs import payloads, run_graph, set_parameter, somebody

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
VOLATILE, LATCHED = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL


def profile(reliability: Any = RELIABLE, durability: Any = VOLATILE, depth: int = 10) -> QoSProfile:
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, reliability=reliability, durability=durability, depth=depth)


def received(node: Any, executor: Any, topic: str, qos: QoSProfile) -> list[str]:
    texts: list[str] = []
    node.create_subscription(String, topic, lambda message: texts.append(message.data), qos)
    executor.spin_once(timeout_sec=0.1)
    return texts


@pytest.mark.parametrize(
    ("offered", "wanted", "meet"),
    [
        (profile(), profile(), True),
        (profile(), profile(BEST_EFFORT), True),
        (profile(BEST_EFFORT), profile(), False),
        (profile(durability=LATCHED), profile(), True),
        (profile(), profile(durability=LATCHED), False),
    ],
)
def test_ends_meet_where_no_more_is_wanted_than_is_offered(
    loopback: Any, offered: QoSProfile, wanted: QoSProfile, meet: bool
) -> None:
    with somebody("a") as (node, executor):
        publisher = node.create_publisher(String, "topic", offered)
        texts = received(node, executor, "topic", wanted)
        publisher.publish(String(data="one"))
        executor.spin_once(timeout_sec=1.0)
        assert texts == (["one"] if meet else [])
        assert publisher.get_subscription_count() == int(meet)


def test_late_subscriber_gets_latched_messages_up_to_the_depth(loopback: Any) -> None:
    with somebody("a") as (node, executor):
        publisher = node.create_publisher(String, "topic", profile(durability=LATCHED, depth=2))
        for text in ("one", "two", "three"):
            publisher.publish(String(data=text))
        late: list[str] = []
        node.create_subscription(String, "topic", lambda m: late.append(m.data), profile(durability=LATCHED))
        node.create_subscription(String, "topic", lambda _: late.append("never"), profile())
        for _ in range(4):
            executor.spin_once(timeout_sec=0.1)
        assert late == ["two", "three"]


def test_services_parameters_timers_and_time(loopback: Any) -> None:
    with somebody("server") as (server, serving), somebody("client") as (client, asking):
        server.declare_parameter("gain", 1.0)

        def answer(_: Any, response: Any) -> Any:
            response.success, response.message = True, "yes"
            return response

        server.create_service(Trigger, "ask", answer)
        calls: list[float] = []
        began, real = time.monotonic(), time.clock_gettime(time.CLOCK_MONOTONIC)
        server.create_timer(0.5, lambda: calls.append(time.monotonic() - began))

        def call(kind: Any, name: str, request: Any) -> Any:
            service: Any = client.create_client(kind, name)
            assert service.wait_for_service(1.0)
            future = service.call_async(request)
            for _ in range(20):
                serving.spin_once(timeout_sec=0.0)
                asking.spin_once(timeout_sec=0.0)
            return future.result()

        assert call(Trigger, "/ask", Trigger.Request()).message == "yes"
        assert set_parameter(call, "server", "gain", 2.5).successful
        values = call(GetParameters, "/server/get_parameters", GetParameters.Request(names=["gain"])).values
        assert values[0].double_value == 2.5
        while time.monotonic() < began + 60.0:
            serving.spin_once(timeout_sec=0.1)
        assert calls == pytest.approx([0.5 * (k + 1) for k in range(len(calls))], abs=0.01)
        assert len(calls) >= 119
        assert time.clock_gettime(time.CLOCK_MONOTONIC) - real < 30.0  # nobody waits for the clock


def test_names_and_parameters_come_from_arguments_as_in_rclpy(loopback: Any, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("/**: {ros__parameters: {a: 1, b: {c: x}}}\nother: {ros__parameters: {a: 2}}\n", encoding="utf-8")
    arguments = [
        "--ros-args",
        "-r",
        "__node:=own",
        "-r",
        "__ns:=/here",
        "-r",
        "topic:=/there",
        "--params-file",
        str(file),
    ]
    with somebody("a", cli_args=[*arguments, "-p", "d:=[1.5, 2.0]", "-p", "other:d:=3"]) as (node, _):
        assert node.get_fully_qualified_name() == "/here/own"
        assert node.resolve_topic_name("topic") == "/there"
        assert node.resolve_topic_name("~/x") == "/here/own/x"
        parameters: dict[str, Any] = {
            name: node.declare_parameter(name, default).value for name, default in (("a", 0), ("b.c", ""))
        }
        assert parameters == {"a": 1, "b.c": "x"}
    with pytest.raises(RuntimeError, match="Couldn't parse"):
        parse(["--ros-args", "-p", "gain"])


def test_node_that_fails_or_never_waits_is_named(loopback: Any, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="controller_0_mine"):
        loopback.run(None, tmp_path, controllers=[{"name": "mine", "external": True}], duration=1)

    def fails() -> None:
        raise ValueError("of its own")

    process = loopback.start("mine", fails)
    time.sleep(0.1)
    assert process.exitcode == 1


def test_deadlock_on_the_loopback_names_those_that_wait() -> None:
    world = World()
    with pytest.raises(RuntimeError, match="main"):
        world.wait(never, 2**63 - 1)
    world.close()


def test_run_repeats_itself_with_all_its_messages(loopback: Any, tmp_path: Path) -> None:
    sets = ["duration=2", "link=pdci", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
    for name in ("first", "second"):
        run_graph(tmp_path / name, sets, "realtime")
    first, second = (payloads(tmp_path / name) for name in ("first", "second"))
    assert {topic: len(messages) for topic, messages in first.items()} == {k: len(v) for k, v in second.items()}
    filled = [topic for topic in first if topic.endswith(("frames", "delivered", "setpoints", "state", "estimate"))]
    assert len(filled) > 5  # others have bytes between their fields that nobody sets
    assert all(first[topic] == second[topic] for topic in filled if topic != "/run/state")
    assert len(first["/pmu/frames"]) == 120


def test_node_that_was_killed_is_forgotten(loopback: Any) -> None:
    def talk() -> None:
        with somebody("talker") as (node, executor):
            node.create_publisher(String, "topic", profile())
            while True:
                executor.spin_once(timeout_sec=1.0)

    talker = loopback.start("talker", talk)
    with somebody("listener") as (node, executor):
        executor.spin_once(timeout_sec=0.1)
        assert (node.count_publishers("topic"), "talker" in node.get_node_names()) == (1, True)
        os.kill(talker.pid, signal.SIGKILL)
        executor.spin_once(timeout_sec=0.1)
        assert (node.count_publishers("topic"), "talker" in node.get_node_names()) == (0, False)


def test_module_imported_under_the_loopback_is_restored_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "rclpy.validate_topic_name"
    monkeypatch.delitem(sys.modules, name)
    with opened():
        module: Any = importlib.import_module(name)
        meanwhile = module._rclpy
    assert type(meanwhile) is StandIn
    assert module._rclpy is rclpy_implementation


OF_THIS_PROCESS = {
    "nodes/clock.py": {"time"},
    "loopback/opening.py": {"time"},  # replaced for the nodes of users
    "loopback/processes.py": {"threading", "random"},  # whose turn it is
    "loopback/middleware.py": {"random"},
    "foreign/own_controller.py": {"time"},  # as a user writes it
    "base/asyncio_thread.py": {"threading"},  # sockets of servers, which no storm has
    "launching/forked.py": {"threading"},  # processes of the system
}


def test_nodes_know_one_clock_and_no_threads() -> None:
    root, by_file = Path(nodes.__file__).parents[2], {}
    rooms = ("loopback", "foreign", "nodes")
    packages = [root / "facts_damping", *(root / "extensions").iterdir()]
    paths = [path for room in rooms for package in packages for path in (package / room).rglob("*.py")]
    names = ("facts_damping_testing/attacker.py", "facts_damping_studies/campaigns/fault_injection.py")
    for path in [*paths, *(root / "extensions" / name for name in names)]:
        lines = re.findall(
            r"^\s*(?:import|from) (time|threading|datetime|random|uuid|secrets)\b", path.read_text(), re.MULTILINE
        )
        if lines:
            by_file["/".join(path.parts[-2:])] = set(lines)
    assert by_file == OF_THIS_PROCESS


def test_rclpy_is_itself_again_afterwards() -> None:
    assert not rclpy.ok()
    before = time.monotonic()
    time.sleep(0.01)
    assert 0.009 < time.monotonic() - before < 10.0
