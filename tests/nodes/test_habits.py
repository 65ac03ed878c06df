"""What a ROS user expects of a node that is started by itself."""

from __future__ import annotations

import importlib
import os
import re
import signal
import subprocess
import sys
import time
from importlib.metadata import entry_points
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from facts_damping_msgs.msg import PmuDataFrame
from rcl_interfaces.msg import Log, Parameter, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_rosout_default

from facts_damping.compiling.store import home
from facts_damping.nodes import executables
from facts_damping.nodes.base.warmup import compile_once
from facts_damping.nodes.launching import forked
from tests.nodes.graphs import PATIENCE_S, set_parameter, somebody, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from rclpy.qos import QoSProfile

BIN = Path(sys.executable).parent
NODES = (
    *("plant_sim", "wan_link", "controller", "identifier", "supervisor", "recorder", "live_view"),
    *("cockpit", "c37118_server", "c37118_client"),
)
SOON_S = 30.0  # 2 s on a machine that does nothing else
INDIRECT = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """Else the first node would report that it compiles."""
    compile_once()


@pytest.fixture
def listener(domain: int) -> Iterator[tuple[Any, Any]]:
    with somebody("listener") as node_and_executor:
        yield node_and_executor


@pytest.fixture
def receive(listener: tuple[Any, Any]) -> Callable[..., list[Any]]:
    return receiver(*listener)


def receiver(node: Any, executor: Any) -> Callable[..., list[Any]]:
    """A function that waits for messages of a topic and returns all received so far."""
    received: dict[str, list[Any]] = {}

    def receive(
        kind: Any, topic: str, until: Callable[[list[Any]], bool] = lambda _: True, qos: QoSProfile | int = 100
    ) -> list[Any]:
        if topic not in received:
            received[topic] = []
            node.create_subscription(kind, topic, received[topic].append, qos)
        wait_until(lambda: until(received[topic]), meanwhile=lambda: executor.spin_once(0.1))
        return received[topic]

    return receive


def on_loopback(loopback: Any, names: Iterable[str], **parameters: Any) -> dict[str, Any]:
    """Nodes by name, started on the loopback."""
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    mains = {name: importlib.import_module(executables.module_of(name)).main for name in names}
    return {name: loopback.start(name, main, ["--ros-args", *words]) for name, main in mains.items()}


def run(executable: str, *arguments: str, cold: bool = True) -> subprocess.CompletedProcess[str]:
    """`cold`: as `ros2 run` does; else forked from a process that has everything loaded."""
    if cold:
        command = [str(BIN / executable), *arguments]
        return subprocess.run(command, check=False, capture_output=True, text=True, timeout=PATIENCE_S)
    with NamedTemporaryFile("r") as out, NamedTemporaryFile("r") as errors:
        node = forked.start(executable, arguments, os.environ, out.name, errors.name)
        node.join(PATIENCE_S)
        return subprocess.CompletedProcess(arguments, node.exitcode or 0, out.read(), errors.read())


@pytest.mark.parametrize("executable", NODES)
def test_help_says_what_it_does_its_parameters_and_an_example(executable: str, domain: int) -> None:
    first = executable == "plant_sim"
    done = run(executable, "-h" if first else "--help", *identifies(executable), cold=first)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"usage: ros2 run facts_damping {executable}" in done.stdout
    assert f"example: ros2 run facts_damping {executable}" in done.stdout
    assert re.search(r"^  run \('two_area_free'\): name of a run", done.stdout, re.MULTILINE)
    assert re.search(r"^  duration \(0.0, 0 to 100000\): simulated time", done.stdout, re.MULTILINE)


def identifies(executable: str) -> list[str]:
    run_sets = {"identifier": INDIRECT, "supervisor": ["supervision=standard"]}.get(executable)
    return ["--ros-args", "-p", f"set:={run_sets}"] if run_sets else []


@pytest.mark.parametrize(
    ("executable", "arguments", "expected"),
    [
        ("plant_sim", ["-p", "runn:=two_area_small"], "parameter runn: given; allowed: autostart, clock.drift, "),
        ("recorder", ["-p", "outptu:=here"], "parameter outptu: given; allowed: "),
        ("live_view", ["-p", "mode:=free"], "parameter mode: given; allowed: "),
        ("controller", ["-p", "set:=[a"], "Failed to parse"),
        ("wan_link", ["-p", "duration:=long"], "duration"),
    ],
)
def test_invalid_node_parameter_is_an_error_without_traceback(
    executable: str, arguments: list[str], expected: str, domain: int
) -> None:
    done = run(executable, "--ros-args", *arguments, cold=executable == "recorder")
    assert done.returncode == 2
    assert done.stdout == ""
    assert expected in done.stderr
    assert "Traceback" not in done.stderr


def test_whole_numbers_are_taken_for_floats(start: Any, client: Any) -> None:
    start("controller", mode="free", gain=12, duration=8, timeout=6, set=str(["controllers.0.name=LLC"]))
    names = ["gain", "duration", "timeout"]
    values = client(GetParameters, "/controller/get_parameters", GetParameters.Request(names=names)).values
    assert [parameter_value_to_python(value) for value in values] == [12.0, 8.0, 6.0]


def test_parameters_of_a_node_are_dumped_and_load_into_another(start: Any, client: Any, tmp_path: Path) -> None:
    """As `ros2 param dump` and `load` do it: by the parameter services."""
    start("controller", mode="free", gain=7.5)
    names = client(ListParameters, "/controller/list_parameters", ListParameters.Request()).result.names
    values = client(GetParameters, "/controller/get_parameters", GetParameters.Request(names=names)).values
    assert all(value.type != ParameterType.PARAMETER_NOT_SET for value in values)
    dumped: dict[str, Any] = {n: parameter_value_to_python(v) for n, v in zip(names, values, strict=True)}
    assert dumped["gain"] == 7.5
    assert dumped["set"] == [""]
    plain = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in dumped.items()}
    file = tmp_path / "dumped.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": plain}}))
    start("controller", "-r", "__node:=second", "--params-file", str(file), mode="free")
    answers = client(GetParameters, "/second/get_parameters", GetParameters.Request(names=["gain"])).values
    assert answers[0].double_value == 7.5
    described = client(DescribeParameters, "/second/describe_parameters", DescribeParameters.Request(names=names))
    live = [
        descriptor.name
        for descriptor in described.descriptors
        if not descriptor.read_only and descriptor.name != "use_sim_time"
    ]
    assert "gain" in live
    parameters = [Parameter(name=name, value=value) for name, value in zip(names, values, strict=True) if name in live]
    request = SetParameters.Request(parameters=parameters)
    results = client(SetParameters, "/second/set_parameters", request).results
    assert all(result.successful for result in results)


def test_services_answer_while_a_node_waits_for_others(start: Any, client: Any) -> None:
    link = start("wan_link", link="delay_100ms")
    assert set_parameter(client, "wan_link", "up.0.delay", 0).successful
    assert link.poll() is None


IDLE = ["scenario=large", "controllers.0.name=LLC", "controllers.0.parameters.gain=0"]  # synchronism is lost


def errors(logs: list[Any]) -> set[str]:
    """Nodes that have logged a loss of synchronism; 40: rcl_interfaces/Log.ERROR."""
    return {log.name for log in logs if "synchronism lost" in log.msg and log.level == 40}


def test_logs_go_to_rosout_and_only_the_supervisor_gets_lines(start: Any, receive: Any, listener: Any) -> None:
    """The controller, which has no effect, starts once the listener has found the others."""
    receive(Log, "/rosout", qos=qos_profile_rosout_default)
    common = {"progress": "false", "set": str(IDLE), "start_timeout": PATIENCE_S}
    nodes = {name: start(name, **common) for name in ("plant_sim", "wan_link")}

    def all_found(_logs: list[Any]) -> bool:
        return set(nodes) <= {endpoint.node_name for endpoint in listener[0].get_publishers_info_by_topic("/rosout")}

    receive(Log, "/rosout", all_found)
    controller = start("controller", **common)
    receive(Log, "/rosout", errors)
    for node in (*nodes.values(), controller):
        assert node.communicate(timeout=PATIENCE_S) == ("", "")
        assert node.returncode == 0


def test_nodes_log_the_loss_of_synchronism_and_end(loopback: Any) -> None:
    with somebody("listener") as listener:
        receive = receiver(*listener)
        receive(Log, "/rosout", qos=qos_profile_rosout_default)
        nodes = on_loopback(loopback, ("plant_sim", "wan_link", "controller"), mode="lockstep", set=IDLE)
        receive(Log, "/rosout", lambda logs: errors(logs) == set(nodes))
        for node in nodes.values():
            node.join(PATIENCE_S)
            assert node.exitcode == 0


def test_nodes_say_who_comes_and_goes_and_what_is_released(loopback: Any) -> None:
    with somebody("listener") as listener:
        receive = receiver(*listener)
        receive(Log, "/rosout", qos=qos_profile_rosout_default)
        nodes = on_loopback(loopback, ("plant_sim", "wan_link", "controller"), mode="free")

        def logged(*texts: str) -> Callable[[list[Any]], bool]:
            return lambda logs: all(any(text in f"{log.name}: {log.msg}" for log in logs) for text in texts)

        receive(Log, "/rosout", logged("controller: started: facts_damping ", "wan_link: /controller has joined"))
        nodes["controller"].kill()
        logs = list(receive(Log, "/rosout", logged("wan_link: /controller has left", "plant_sim: sssc released at")))
        again = on_loopback(loopback, ("controller",), mode="free")
        receive(Log, "/rosout", lambda later: logged("wan_link: /controller has joined")(later[len(logs) :]))
        assert sum("has joined" in log.msg for log in logs if log.name == "plant_sim") == 1  # its link, not every tick
        again["controller"].kill()


def test_log_level_is_obeyed(domain: int) -> None:
    short = ["-p", "duration:=0.1", "-p", "mode:=free"]
    assert run("plant_sim", "--ros-args", "--log-level", "warn", *short, cold=False).stderr == ""
    assert "[INFO]" in run("plant_sim", "--ros-args", *short, cold=False).stderr


def test_nodes_publish_their_diagnostics(loopback: Any) -> None:
    names = {"plant_sim", "wan_link", "controller", "identifier"}
    nodes = on_loopback(loopback, sorted(names), mode="free", set=INDIRECT)

    def newest(messages: list[Any]) -> dict[str, Any]:
        return {status.name: status for message in messages for status in message.status}

    def warned(messages: list[Any]) -> bool:
        silent = "no answer from controller_0_HBsWC" in newest(messages)["wan_link"].message
        return silent and "released: sssc" in newest(messages)["plant_sim"].message

    with somebody("listener") as listener:
        receive = receiver(*listener)
        messages = receive(DiagnosticArray, "/diagnostics", lambda message: set(newest(message)) >= names)
        assert {newest(messages)[name].hardware_id for name in names} == {"two_area", "wan_link", "sssc"}
        os.kill(nodes["controller"].pid, signal.SIGTERM)
        receive(DiagnosticArray, "/diagnostics", warned)
        os.kill(nodes["plant_sim"].pid, signal.SIGTERM)
        receive(
            DiagnosticArray, "/diagnostics", lambda message: "nothing has come" in newest(message)["wan_link"].message
        )


def test_plant_alone_publishes_soon(start: Any, receive: Any) -> None:
    receive(PmuDataFrame, "/pmu/frames")
    start("plant_sim", mode="free")
    frames = receive(PmuDataFrame, "/pmu/frames", bool)
    assert frames[0].tick < 60 * SOON_S


@pytest.mark.parametrize(
    ("executable", "after"), [("plant_sim", 0.0), ("controller", 0.6), ("plant_sim", 2.1), ("controller", 2.1)]
)
def test_ctrl_c_ends_a_node_soon_and_in_a_line_at_most(executable: str, after: float, domain: int) -> None:
    """While it loads, waits and works: `after` seconds from its first library on."""
    command = ["env", "--default-signal=INT", str(BIN / executable), "--ros-args", "--log-level", "warn"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as node:
        maps = Path(f"/proc/{node.pid}/maps")
        wait_until(lambda: "numpy" in maps.read_text())  # Python alone answers before
        time.sleep(after)
        node.send_signal(signal.SIGINT)
        stopped_at = time.monotonic()
        out, errors = node.communicate(timeout=PATIENCE_S)
    assert time.monotonic() - stopped_at < SOON_S
    assert (node.returncode, out, errors) == (0, "", "")


def test_first_node_says_that_it_compiles(tmp_path: Path) -> None:
    """And not again; the compiler is replaced."""
    code = """
import subprocess, sys
from facts_damping.nodes.base import warmup
from facts_damping.compiling import store
class Compiler:
    def __init__(self, command, **_):
        for symbol in command[3:]:
            store._write(warmup.ENTRY_POINTS[symbol], b"")
    returncode = 0
    def communicate(self):
        return None, b""
subprocess.Popen = Compiler
warmup.compile_once()
warmup.compile_once()
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        check=True,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert re.fullmatch(r"compiling \d+ numerical kernels, once on this machine: seconds\n", done.stderr)
    assert home() != tmp_path / "cache"


def test_nodes_started_by_hand_in_lockstep_end_with_the_run(start: Any, tmp_path: Path) -> None:
    common = {"duration": 2.0, "progress": "false", "recorder": "true", "start_timeout": PATIENCE_S}
    recorder = start("recorder", output=tmp_path / "bag", **common)
    nodes = [recorder, *(start(name, **common) for name in ("wan_link", "controller", "plant_sim"))]
    for node in nodes:
        assert node.communicate(timeout=PATIENCE_S) == ("", "")
        assert node.returncode == 0
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


def test_launch_may_be_interrupted_while_python_starts() -> None:
    command = ["env", "--block-signal=INT", sys.executable, str(BIN / "wan_link")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as node:
        wait_until(lambda: Path(f"/proc/{node.pid}/exe").resolve() == Path(sys.executable).resolve())
        node.send_signal(signal.SIGINT)
        assert (*node.communicate(timeout=PATIENCE_S), node.returncode) == (b"", b"", 0)


def test_nodes_started_by_hand_end_when_the_plant_is_terminated(capsys: Any, loopback: Any) -> None:
    nodes = on_loopback(loopback, ("wan_link", "controller", "plant_sim"), mode="realtime", duration=600.0)
    time.sleep(3.0)
    os.kill(nodes["plant_sim"].pid, signal.SIGTERM)
    for node in nodes.values():
        node.join(PATIENCE_S)
        assert node.exitcode == 0
    assert capsys.readouterr() == ("", "")


def test_installed_executables_start_their_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    modules: list[str] = []
    monkeypatch.setattr(executables, "_start", lambda module, **_: modules.append(module))
    installed = [
        installed_point for installed_point in entry_points(group="console_scripts") if installed_point.name in NODES
    ]
    for point in installed:
        point.load()()
        assert modules[-1] == executables.module_of(point.name)
        assert (BIN / point.name).exists()
    assert {installed_point.name for installed_point in installed} == set(NODES)


def test_interface_fields_have_their_meaning_on_the_same_line() -> None:
    """`ros2 interface show` cuts comments of nested types that stand on lines of their own."""
    folder = Path(__file__).parents[2] / "msg_defs"
    for path in [*folder.glob("msg/*.msg"), *folder.glob("srv/*.srv")]:
        for line in path.read_text().splitlines():
            field = re.match(r"^[\w/]+(\[\])? \w+( [^#=]*)?(= *\d+)?(#.*)?$", line.rstrip())
            if line.strip() and not line.startswith("#") and line.strip() != "---" and "=" not in line:
                assert field, (path.name, line)
                assert "# " in line, (path.name, line)
        assert not re.search(r"^[ \t]+#", path.read_text(), re.MULTILINE), path.name
