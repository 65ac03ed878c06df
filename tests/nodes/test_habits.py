"""What somebody with ROS in the fingers expects of a node that is started by itself."""

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
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_rosout_default

from facts_damping.compiling.store import home
from facts_damping.nodes import executables
from facts_damping.nodes.base.warmup import compile_once
from facts_damping.nodes.launching import forked
from tests.nodes.graphs import PATIENCE_S, somebody, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from rclpy.qos import QoSProfile

BIN = Path(sys.executable).parent
NODES = (
    *("plant_sim", "wan_link", "controller", "identifier", "supervisor", "recorder", "live_view"),
    *("c37118_server", "c37118_client"),
)
SOON_S = 30.0  # 2 s on a machine that does nothing else
INDIRECT = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """What the first node on a machine would say does not belong here."""
    compile_once()


@pytest.fixture
def listener(domain: int) -> Iterator[tuple[Any, Any]]:
    with somebody("listener") as found:
        yield found


@pytest.fixture
def heard(listener: tuple[Any, Any]) -> Callable[..., list[Any]]:
    return hearing(*listener)


def hearing(node: Any, executor: Any) -> Callable[..., list[Any]]:
    """What waits for a message of a topic, and gives all that came by then."""
    came: dict[str, list[Any]] = {}

    def hear(
        kind: Any, topic: str, until: Callable[[list[Any]], bool] | None = None, qos: QoSProfile | int = 100
    ) -> list[Any]:
        if topic not in came:
            came[topic] = []
            node.create_subscription(kind, topic, came[topic].append, qos)
        deadline = time.monotonic() + PATIENCE_S
        while until is not None and not until(came[topic]):
            assert time.monotonic() < deadline, came[topic]
            executor.spin_once(0.1)
        return came[topic]

    return hear


def on_loopback(loopback: Any, names: Iterable[str], **parameters: Any) -> dict[str, Any]:
    """Nodes by name, started on the loopback."""
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    mains = {name: importlib.import_module(f"facts_damping.nodes.{name}").main for name in names}
    return {name: loopback.start(name, main, ["--ros-args", *given]) for name, main in mains.items()}


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
    own = {"identifier": INDIRECT, "supervisor": ["supervision=standard"]}.get(executable)
    return ["--ros-args", "-p", f"set:={own}"] if own else []


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
def test_what_is_not_a_parameter_is_an_error_in_a_line(
    executable: str, arguments: list[str], expected: str, domain: int
) -> None:
    done = run(executable, "--ros-args", *arguments, cold=executable == "recorder")
    assert done.returncode == 2
    assert done.stdout == ""
    assert said in done.stderr
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
    kept: dict[str, Any] = {n: parameter_value_to_python(v) for n, v in zip(names, values, strict=True)}
    assert kept["gain"] == 7.5
    assert kept["set"] == [""]
    plain = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in kept.items()}
    file = tmp_path / "dumped.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": plain}}))
    start("controller", "-r", "__node:=second", "--params-file", str(file), mode="free")
    answers = client(GetParameters, "/second/get_parameters", GetParameters.Request(names=["gain"])).values
    assert answers[0].double_value == 7.5
    described = client(DescribeParameters, "/second/describe_parameters", DescribeParameters.Request(names=names))
    live = [one.name for one in described.descriptors if not one.read_only and one.name != "use_sim_time"]
    assert "gain" in live
    request = SetParameters.Request(
        parameters=[
            Parameter(name=name, value=value) for name, value in zip(names, values, strict=True) if name in live
        ]
    )
    results = client(SetParameters, "/second/set_parameters", request).results
    assert all(result.successful for result in results)


def test_services_answer_while_a_node_waits_for_others(start: Any, client: Any) -> None:
    """From when it is there: also in lockstep, where it waits for half a minute."""
    link = start("wan_link", link="delay_100ms")
    zero = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=0)
    request = SetParameters.Request(parameters=[Parameter(name="up.0.delay", value=zero)])
    assert client(SetParameters, "/wan_link/set_parameters", request).results[0].successful
    assert link.poll() is None


IDLE = ["scenario=large", "controllers.0.name=LLC", "controllers.0.parameters.gain=0"]  # synchronism is lost


def errors(came: list[Any]) -> set[str]:
    """Who has logged that synchronism is lost; 40: rcl_interfaces/Log.ERROR."""
    return {one.name for one in came if "synchronism lost" in one.msg and one.level == 40}


def test_logs_go_to_rosout_and_only_the_supervisor_gets_lines(start: Any, heard: Any, listener: Any) -> None:
    """The run waits for a controller, which does nothing, until the listener has found the others. Who leaves does not
    wait until its last words are heard: one is enough."""
    heard(Log, "/rosout", qos=qos_profile_rosout_default)
    common = {"progress": "false", "set": str(IDLE), "start_timeout": PATIENCE_S}
    nodes = {name: start(name, **common) for name in ("plant_sim", "wan_link")}

    def found(_came: list[Any]) -> bool:
        return set(nodes) <= {one.node_name for one in listener[0].get_publishers_info_by_topic("/rosout")}

    heard(Log, "/rosout", found)
    controller = start("controller", **common)
    heard(Log, "/rosout", errors)
    for node in (*nodes.values(), controller):
        assert node.communicate(timeout=PATIENCE_S) == ("", "")
        assert node.returncode == 0


def test_all_log_that_synchronism_is_lost_and_end(loopback: Any) -> None:
    with somebody("listener") as listener:
        heard = hearing(*listener)
        heard(Log, "/rosout", qos=qos_profile_rosout_default)
        nodes = on_loopback(loopback, ("plant_sim", "wan_link", "controller"), mode="lockstep", set=IDLE)
        heard(Log, "/rosout", lambda came: errors(came) == set(nodes))
        for node in nodes.values():
            node.join(PATIENCE_S)
            assert node.exitcode == 0


def test_nodes_say_who_comes_and_goes_and_what_is_released(loopback: Any) -> None:
    with somebody("listener") as listener:
        heard = hearing(*listener)
        heard(Log, "/rosout", qos=qos_profile_rosout_default)
        nodes = on_loopback(loopback, ("plant_sim", "wan_link", "controller"), mode="free")

        def said(*texts: str) -> Callable[[list[Any]], bool]:
            return lambda came: all(any(text in f"{one.name}: {one.msg}" for one in came) for text in texts)

        heard(Log, "/rosout", said("controller: started: facts_damping ", "wan_link: /controller has joined"))
        nodes["controller"].kill()
        told = list(heard(Log, "/rosout", said("wan_link: /controller has left", "plant_sim: sssc released at")))
        again = on_loopback(loopback, ("controller",), mode="free")
        heard(Log, "/rosout", lambda came: said("wan_link: /controller has joined")(came[len(told) :]))
        assert sum("has joined" in one.msg for one in told if one.name == "plant_sim") == 1  # its link, not every tick
        again["controller"].kill()


def test_a_log_level_is_obeyed(domain: int) -> None:
    short = ["-p", "duration:=0.1", "-p", "mode:=free"]
    assert run("plant_sim", "--ros-args", "--log-level", "warn", *short, cold=False).stderr == ""
    assert "[INFO]" in run("plant_sim", "--ros-args", *short, cold=False).stderr


def test_every_node_tells_how_it_is(loopback: Any) -> None:
    """By its full name, with what it stands for; by what is now, not by what once was."""
    names = {"plant_sim", "wan_link", "controller", "identifier"}
    nodes = on_loopback(loopback, sorted(names), mode="free", set=INDIRECT)

    def newest(came: list[Any]) -> dict[str, Any]:
        return {one.name: one for message in came for one in message.status}

    def warned(told: list[Any]) -> bool:
        silent = "no answer from controller_0_HBsWC" in newest(told)["wan_link"].message
        return silent and "released: sssc" in newest(told)["plant_sim"].message

    with somebody("listener") as listener:
        heard = hearing(*listener)
        came = heard(DiagnosticArray, "/diagnostics", lambda told: set(newest(told)) >= names)
        assert {newest(came)[name].hardware_id for name in names} == {"two_area", "wan_link", "sssc"}
        os.kill(nodes["controller"].pid, signal.SIGTERM)
        heard(DiagnosticArray, "/diagnostics", warned)
        os.kill(nodes["plant_sim"].pid, signal.SIGTERM)
        heard(DiagnosticArray, "/diagnostics", lambda told: "nothing has come" in newest(told)["wan_link"].message)


def test_a_plant_alone_publishes_soon(start: Any, heard: Any) -> None:
    """Of its ticks, the first are lost until it and the listener have found each other."""
    heard(PmuDataFrame, "/pmu/frames")
    start("plant_sim", mode="free")
    frames = heard(PmuDataFrame, "/pmu/frames", lambda came: len(came) > 0)
    assert frames[0].tick < 60 * SOON_S


@pytest.mark.parametrize(
    ("executable", "after"), [("plant_sim", 0.0), ("controller", 0.6), ("plant_sim", 2.1), ("controller", 2.1)]
)
def test_ctrl_c_ends_a_node_soon_and_in_a_line_at_most(executable: str, after: float, domain: int) -> None:
    """While it loads, while it waits, while it works: after so many seconds from when it has its first library."""
    command = ["env", "--default-signal=INT", str(BIN / executable), "--ros-args", "--log-level", "warn"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as node:
        begun = time.monotonic()
        while "numpy" not in Path(f"/proc/{node.pid}/maps").read_text():  # Python alone answers before
            assert time.monotonic() - begun < PATIENCE_S
            time.sleep(0.01)
        time.sleep(after)
        node.send_signal(signal.SIGINT)
        told = time.monotonic()
        out, errors = node.communicate(timeout=PATIENCE_S)
    assert time.monotonic() - told < SOON_S
    assert (node.returncode, out, errors) == (0, "", "")


def test_a_first_node_says_that_it_compiles(tmp_path: Path) -> None:
    """And does not when that has been done; here it is told of, and not done."""
    code = """
import subprocess, sys
from facts_damping.nodes.base import warmup
from facts_damping.compiling import store
class Compiler:
    def __init__(self, command, **_):
        for symbol in command[3:]:
            (store.home() / store.file_name(warmup.ENTRY_POINTS[symbol])).touch()
    def wait(self):
        return 0
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


def test_who_is_started_in_lockstep_by_hand_ends_with_the_run(start: Any, tmp_path: Path) -> None:
    """With status 0 and no Ctrl-C, since the plant says that the run has ended; the recording is whole."""
    common = {"duration": 2.0, "progress": "false", "recorder": "true", "start_timeout": PATIENCE_S}
    recorder = start("recorder", output=tmp_path / "bag", **common)
    nodes = [recorder, *(start(name, **common) for name in ("wan_link", "controller", "plant_sim"))]
    for node in nodes:
        assert node.communicate(timeout=PATIENCE_S) == ("", "")
        assert node.returncode == 0
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


def test_a_launch_may_be_interrupted_while_python_starts() -> None:
    """The signal waits, as `run.launch.py` asks for, until the node takes it."""
    command = ["env", "--block-signal=INT", sys.executable, str(BIN / "wan_link")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as node:
        wait_until(lambda: Path(f"/proc/{node.pid}/exe").resolve() == Path(sys.executable).resolve())
        node.send_signal(signal.SIGINT)
        assert (*node.communicate(timeout=PATIENCE_S), node.returncode) == (b"", b"", 0)


def test_who_is_started_by_hand_ends_with_a_plant_that_is_told_to_stop(capsys: Any, loopback: Any) -> None:
    nodes = on_loopback(loopback, ("wan_link", "controller", "plant_sim"), mode="realtime", duration=600.0)
    time.sleep(3.0)
    os.kill(nodes["plant_sim"].pid, signal.SIGTERM)
    for node in nodes.values():
        node.join(PATIENCE_S)
        assert node.exitcode == 0
    assert capsys.readouterr() == ("", "")


def test_each_executable_is_a_node(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[str] = []
    monkeypatch.setattr(executables, "_start", lambda node, **_: found.append(node))
    installed = [one for one in entry_points(group="console_scripts") if one.module == executables.__name__]
    for one in installed:
        one.load()()
        assert found[-1] == one.name
        assert (BIN / one.name).exists()
    assert set(found) >= set(NODES)


def test_every_field_of_an_interface_has_its_meaning_on_its_own_line() -> None:
    """`ros2 interface show` cuts comments of nested types that stand on lines of their own."""
    folder = Path(__file__).parents[2] / "msg_defs"
    for path in [*folder.glob("msg/*.msg"), *folder.glob("srv/*.srv")]:
        for line in path.read_text().splitlines():
            field = re.match(r"^[\w/]+(\[\])? \w+( [^#=]*)?(= *\d+)?(#.*)?$", line.rstrip())
            if line.strip() and not line.startswith("#") and line.strip() != "---" and "=" not in line:
                assert field, (path.name, line)
                assert "# " in line, (path.name, line)
        assert not re.search(r"^[ \t]+#", path.read_text(), re.MULTILINE), path.name
