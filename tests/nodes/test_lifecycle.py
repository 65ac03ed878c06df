"""Managed nodes: what ROS 2's lifecycle lists and changes; a run that is brought up in order has the same bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.lifecycle import LifecycleNode
from std_srvs.srv import Trigger

from facts_damping.case.loading import load_case
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping_testing.loopback.lifecycle import GRAPH, STATE_NUMBERS, STATES
from tests.nodes.graphs import PATIENCE_S, assert_replayed, assert_same, ticks
from tests.nodes.test_joining import RATE, Graph

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NODES = ("recorder", "controller", "wan_link", "plant_sim")  # in the order in which they are activated
LOCKSTEP = {"scenario": "large", "duration": 2.0, "recorder": "true", "autostart": "false", "start_timeout": PATIENCE_S}


@pytest.fixture
def change(client: Any) -> Callable[[str, str], bool]:

    def ask(node: str, label: str) -> bool:
        request = ChangeState.Request(transition=Transition(label=label))
        return bool(client(ChangeState, f"/{node}/change_state", request).success)

    return ask


@pytest.fixture
def state(client: Any) -> Callable[[str], str]:
    return lambda node: str(client(GetState, f"/{node}/get_state", GetState.Request()).current_state.label)


def test_loopback_has_the_states_and_transitions_of_ros() -> None:
    context = rclpy.Context()
    rclpy.init(context=context)
    node = LifecycleNode("managed", context=context, enable_communication_interface=False)
    machine: Any = node._state_machine
    assert dict(machine.available_states) == STATES
    assert sorted(machine.transition_graph) == sorted(
        (n, by, STATE_NUMBERS[a], a, STATE_NUMBERS[b], b) for n, by, a, b in GRAPH
    )
    node.destroy_node()
    context.try_shutdown()


def start_all(start: Any, folder: Path, parameters: dict[str, Any]) -> dict[str, Any]:
    more = {"recorder": {"output": folder / "bag"}}
    return {name: start(name, **parameters, **more.get(name, {})) for name in NODES}


def test_run_that_is_brought_up_in_order_has_the_same_bits(
    loopback: Any, start: Any, change: Any, state: Any, tmp_path: Path
) -> None:
    running = start_all(start, tmp_path, LOCKSTEP)
    assert {state(name) for name in NODES} == {"unconfigured"}
    assert not change("plant_sim", "activate")  # what is not configured cannot be
    assert all(change(name, "configure") for name in NODES)
    assert {state(name) for name in NODES} == {"inactive"}
    assert ticks(running["plant_sim"]) == 0
    assert all(change(name, "activate") for name in NODES[:-1])
    assert change("plant_sim", "activate")
    assert not change("controller", "deactivate")
    assert state("controller") == "active"
    running["plant_sim"].communicate(timeout=PATIENCE_S)
    for name in NODES[:-1]:
        running[name].stop()
    assert_same(load(tmp_path / "bag"), loop.run(load_case(None, ["scenario=large", "duration=2"])))


def test_plant_s_inactive_state_is_the_paused_run(
    loopback: Any, start: Any, change: Any, state: Any, tmp_path: Path
) -> None:
    running = start_all(start, tmp_path, LOCKSTEP | {"autostart": "true", "duration": 10.0})
    plant = running["plant_sim"]
    plant.wait(lambda: ticks(plant) > RATE, PATIENCE_S)
    assert change("plant_sim", "deactivate")
    assert state("plant_sim") == "inactive"
    assert change("plant_sim", "activate")
    plant.communicate(timeout=PATIENCE_S)
    for name in NODES[:-1]:
        running[name].stop()
    record = load(tmp_path / "bag")
    assert [run_change.kind for run_change in record.changes] == ["pause", "resume"]
    assert_same(record, rerun(load_case(None, ["scenario=large", "duration=10"]), record.changes))


def test_inactive_controller_takes_part_and_has_no_effect(
    loopback: Any, start: Any, change: Any, state: Any, client: Any, tmp_path: Path
) -> None:
    run = Graph(start, tmp_path)
    run.add("wan_link")
    run.add("controller", autostart="false")
    run.add("plant_sim")
    assert change("controller", "configure")
    run.run_until(RATE)
    assert state("controller") == "inactive"
    assert client(Trigger, "/controller/arm", Trigger.Request()).success  # arm and activate are one
    assert state("controller") == "active"
    run.run_until(3 * RATE)
    assert change("controller", "deactivate")
    run.run_until(5 * RATE)
    record = run.finish()
    assert [run_change.kind for run_change in record.changes if run_change.role == "controller"] == [
        "disarm",
        "arm",
        "disarm",
    ]
    first, armed, disarmed = (run_change.tick for run_change in record.changes if run_change.role == "controller")
    assert first == 0
    assert np.all((record.issued["tick"] >= armed) & (record.issued["tick"] < disarmed))
    assert len(record.issued) > RATE
    assert_replayed(record)


def test_cleanup_begins_again(loopback: Any, start: Any, change: Any, state: Any) -> None:
    start("wan_link", mode="free", autostart="false")
    assert change("wan_link", "configure")
    assert change("wan_link", "cleanup")
    assert state("wan_link") == "unconfigured"
    assert change("wan_link", "configure")


def test_over_dds_too_until_shutdown(start: Any, change: Any, state: Any) -> None:
    link = start("wan_link", mode="free", autostart="false")
    assert change("wan_link", "configure")
    assert change("wan_link", "activate")
    assert state("wan_link") == "active"
    assert change("wan_link", "shutdown")
    link.communicate(timeout=PATIENCE_S)
    assert (link.returncode, link.texts()[1]) == (0, "")


def test_bad_input_leaves_a_node_unconfigured(loopback: Any, start: Any, change: Any, state: Any) -> None:
    node = start("controller", autostart="false", index=7)
    assert not change("controller", "configure")
    assert state("controller") == "unconfigured"
    assert "index: 7 given" in node.texts()[0]
