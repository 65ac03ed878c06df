"""The executables as `ros2 run` starts them: any order, parameters with meaning and range, errors in one line."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from std_srvs.srv import Trigger

from facts_damping.case.loading import load_case
from facts_damping.nodes import wan_link
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.nodes.graphs import PATIENCE_S, set_parameter

if TYPE_CHECKING:
    from pathlib import Path


def test_nodes_started_one_by_one_give_the_in_process_run(start: Any, tmp_path: Path) -> None:
    """On DDS; the plant as `ros2 run` starts it."""
    common = {"scenario": "large", "duration": 2.0, "link": "delay_100ms", "recorder": "true", "start_timeout": 60.0}
    recorder = start("recorder", output=tmp_path / "bag", **common)
    plant = start("plant_sim", cold=True, **common)
    start("wan_link", **common)
    start("controller", "-r", "__node:=damper", **common)
    plant.finish()
    recorder.terminate()
    output, errors = recorder.communicate(timeout=PATIENCE_S)
    assert (recorder.returncode, output, errors) == (0, "lost 0\n", "")
    recorded = load(tmp_path / "bag")
    computed = loop.run(load_case(None, ["scenario=large", "duration=2.0", "link=delay_100ms"]))
    assert recorded.frames.tobytes() == computed.frames.tobytes()
    assert recorded.applied.tobytes() == computed.applied.tobytes()


def test_parameters_have_description_unit_and_range(loopback: Any, start: Any, client: Any) -> None:
    common = {"run": "two_area_deployment", "start_timeout": 60.0}
    for node in ("controller", "wan_link", "supervisor"):
        start(node, **common)
    start("plant_sim", mode="realtime", duration=1000.0, **common)
    for node in ("controller", "wan_link", "supervisor", "plant_sim"):
        names = client(ListParameters, f"/{node}/list_parameters", ListParameters.Request()).result.names
        asked = DescribeParameters.Request(names=names)
        for d in client(DescribeParameters, f"/{node}/describe_parameters", asked).descriptors:
            assert not d.integer_range or d.type == ParameterType.PARAMETER_INTEGER, (node, d.name)
            assert not d.floating_point_range or d.type == ParameterType.PARAMETER_DOUBLE, (node, d.name)
    arm = client(Trigger, "/controller/arm", Trigger.Request())
    assert (arm.success, arm.message) in ((False, "it acts already"), (False, "it has not begun yet"))
    names = client(ListParameters, "/controller/list_parameters", ListParameters.Request()).result.names
    parameters = {"gain", "Tw", "T1", "T2", "T3", "T4"}
    assert parameters | {"run", "set", "mode", "timeout", "index", "frame_rate", "duration", "seed"} <= set(names)
    described = client(DescribeParameters, "/controller/describe_parameters", DescribeParameters.Request(names=names))
    by_name = {d.name: d for d in described.descriptors}
    for name in parameters:
        assert by_name[name].description.endswith("]"), name
        assert by_name[name].floating_point_range[0].from_value < by_name[name].floating_point_range[0].to_value
        assert not by_name[name].read_only
    assert by_name["duration"].description.endswith("[s]")
    assert by_name["frame_rate"].integer_range[0].to_value == 1000
    assert by_name["frame_rate"].read_only
    assert all(
        d.description for d in described.descriptors if d.name not in ("use_sim_time", "start_type_description_service")
    )
    assert set_parameter(client, "controller", "gain", 30.0).successful
    refused = set_parameter(client, "controller", "gain", 1e6)
    assert not refused.successful
    assert refused.reason
    answer = client(GetParameters, "/controller/get_parameters", GetParameters.Request(names=["gain"]))
    assert answer.values[0].double_value == 30.0


@pytest.mark.parametrize(
    ("executable", "parameters", "expected"),
    [
        ("plant_sim", {"frame_rate": 0}, "frame_rate"),
        ("plant_sim", {"scenario": "huge"}, "allowed: large, multiple, small"),
        ("plant_sim", {"mode": "warp"}, "mode: 'warp' given; allowed: free, lockstep, realtime"),
        ("controller", {"set": "[controllers.0.name=HBsWC]", "width": 4.9}, "width: 4.9 given; allowed: the run's"),
        ("identifier", {}, "index: 0 given; allowed: none: no such controller"),
        ("supervisor", {}, "index: 0 given; allowed: none: no such supervised controller"),
        ("wan_link", {"link": "wet_string"}, "allowed: csg, delay_100ms, fibre, ideal"),
        ("wan_link", {"set": "[link.up.0.delay=-1]"}, "link.up.0.delay: -1 given"),
        ("controller", {"index": 7}, "index: 7 given; allowed: 0"),
        ("wan_link", {"index": 1}, "index: 1 given; allowed: 0"),
        ("controller", {"gain": 1e9}, "gain"),
        ("controller", {"run": "nowhere"}, "runs: 'nowhere' given"),
        ("recorder", {"output": "/proc/nowhere"}, "/proc/nowhere"),
    ],
)
def test_bad_parameter_is_exit_2_and_one_line(
    loopback: Any, start: Any, executable: str, parameters: Any, expected: str
) -> None:
    node = start(executable, **parameters)
    output, errors = node.communicate(timeout=PATIENCE_S)
    assert node.returncode == 2
    assert output == ""
    assert errors.count("\n") == 1
    assert expected in errors


def test_missing_peer_is_named(loopback: Any, start: Any) -> None:
    began = time.monotonic()
    node = start("plant_sim", start_timeout=1.0)
    _, errors = node.communicate(timeout=PATIENCE_S)
    assert 1.0 < time.monotonic() - began < 1.2
    assert node.returncode == 1
    assert "a subscriber of /pmu/frames, a publisher of /setpoints/delivered" in errors


def test_first_answer_is_waited_for_as_long_as_the_start(loopback: Any, start: Any, client: Any) -> None:
    request = GetParameters.Request(names=["duration"])
    common = {"duration": 0.1, "timeout": 2.0, "start_timeout": PATIENCE_S}
    link, controller = start("wan_link", **common), start("controller", **common)
    client(GetParameters, "/controller/get_parameters", request)  # wait until it serves
    controller.send_signal(signal.SIGSTOP)
    plant = start("plant_sim", **common)
    client(GetParameters, "/plant_sim/get_parameters", request)
    time.sleep(2.0 * common["timeout"])
    assert (plant.poll(), link.poll()) == (None, None)
    controller.send_signal(signal.SIGCONT)
    plant.finish()


def test_loss_of_synchronism_is_said_by_every_node(loopback: Any, start: Any, tmp_path: Path) -> None:
    sets = ["frame_rate=30", "link=satellite", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
    computed = loop.run(load_case(None, ["scenario=large", *sets]))
    common = {"scenario": "large", "set": str(sets), "timeout": 0.5, "start_timeout": PATIENCE_S, "recorder": "true"}
    text = f"synchronism lost at {computed.time_s[-1]:.3f} s"
    recorder = start("recorder", output=tmp_path / "bag", **common)
    others = [recorder, *(start(name, **common) for name in ("wan_link", "controller", "identifier"))]
    plant = start("plant_sim", **common)
    output, errors = plant.communicate(timeout=PATIENCE_S)
    assert (plant.returncode, errors) == (0, "")
    assert output.splitlines()[-1] == text
    for node in others:
        node.wait(lambda node=node: text in node.texts()[0].splitlines(), PATIENCE_S)
    time.sleep(0.5 + wan_link.PATIENCE_S + 1.0)
    assert [node.poll() for node in others] == [None] * 4


STUCK = """
import ctypes, sys
from facts_damping.nodes.base import run

run.LEAVE_S = 0.2
run._limit_the_end(int(sys.argv[1]))
ctypes.PyDLL(None).sleep(60)  # with Python's lock held
"""


@pytest.mark.parametrize("status", [0, 2])
def test_node_whose_middleware_does_not_end_ends_with_its_status(status: int) -> None:
    done = subprocess.run([sys.executable, "-c", STUCK, str(status)], check=False, timeout=PATIENCE_S)
    assert done.returncode == status
