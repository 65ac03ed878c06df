"""Nodes and graphs as the tests start them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from facts_damping import graph
from tests.nodes.graphs import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.node import Node


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The processes that a graph starts, by name."""
    found: dict[str, Any] = {}
    original = graph.start

    def spy(name: str, *arguments: Any) -> Any:
        found[name] = original(name, *arguments)
        return found[name]

    monkeypatch.setattr(graph, "start", spy)
    return found


@pytest.fixture
def start(domain: int) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts executables by name with parameters; whatever still runs at the end is stopped, and told by a failure."""
    running: list[tuple[str, subprocess.Popen[str]]] = []

    def start_one(executable: str, *options: str, **parameters: Any) -> subprocess.Popen[str]:
        arguments = [str(Path(sys.executable).parent / executable), "--ros-args", *options]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        popen = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        running.append((executable, popen))
        return popen

    yield start_one
    for executable, popen in running:
        ended = popen.poll()
        if ended is None:
            popen.terminate()
        try:
            said = popen.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            popen.kill()
            said = popen.communicate()
        print(f"{executable}: {'still ran' if ended is None else 'had ended'}, {popen.returncode}, said {said}")


@pytest.fixture
def client(domain: int) -> Iterator[Callable[[Any, str, Any], Any]]:
    """Calls a service of another node and returns the answer."""
    context = Context()
    rclpy.init(context=context)
    node: Node = rclpy.create_node("tester", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def call(kind: Any, name: str, request: Any) -> Any:
        service: Any = node.create_client(kind, name)
        assert service.wait_for_service(PATIENCE_S), name
        future = service.call_async(request)
        executor.spin_until_future_complete(future, PATIENCE_S)
        assert future.done(), f"no answer from {name}"
        return future.result()

    yield call
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)
