"""What the launch file starts. There is no wheel of ROS 2's `launch`: stand-ins note what is requested."""

from __future__ import annotations

import importlib
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from lifecycle_msgs.msg import Transition

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.nodes.executables import module_of
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.nodes.graphs import PATIENCE_S, assert_same

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FOLDER = Path(__file__).parents[2] / "launch"


class Asked:
    """Stand-in for any class of `launch`: keeps its arguments."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.given, self.named = positional, named

    def perform(self, context: dict[str, str]) -> str:
        """A `LaunchConfiguration`'s value."""
        return context[self.given[0]]


def kinds(*names: str) -> dict[str, type[Asked]]:
    return {name: type(name, (Asked,), {}) for name in names}


MODULES = {
    "launch": kinds("LaunchContext", "LaunchDescription"),
    "launch.actions": kinds(
        "DeclareLaunchArgument", "EmitEvent", "ExecuteProcess", "OpaqueFunction", "RegisterEventHandler", "Shutdown"
    ),
    "launch.event_handlers": kinds("OnProcessExit"),
    "launch.substitutions": kinds("LaunchConfiguration"),
    "launch_ros": {},
    "launch_ros.actions": kinds("LifecycleNode", "Node"),
    "launch_ros.event_handlers": kinds("OnStateTransition"),
    "launch_ros.events": {},
    "launch_ros.events.lifecycle": kinds("ChangeState"),
}


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Any]]:
    """Runs a launch file with arguments and returns the requested nodes and event handlers."""
    for name, content in MODULES.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)

    def perform(file: Path, context: dict[str, str]) -> Iterator[Any]:
        (actions,) = runpy.run_path(str(file))["generate_launch_description"]().given
        for action in actions:
            match type(action).__name__:
                case "DeclareLaunchArgument":
                    context.setdefault(action.given[0], action.named["default_value"])
                case "OpaqueFunction":
                    yield from action.named["function"](context)
                case other:
                    raise AssertionError(other)

    return lambda file, **arguments: list(perform(FOLDER / file, arguments))


def nodes(actions: list[Any]) -> list[SimpleNamespace]:
    actions_of_nodes = [action for action in actions if type(action).__name__ == "Node"]
    assert {node.named["package"] for node in actions_of_nodes} == {"facts_damping"}
    return [SimpleNamespace(**{**node.named, "parameters": node.named["parameters"][0]}) for node in actions_of_nodes]


def places(actions: list[Any]) -> set[tuple[str, str, str, int | None]]:
    """Executable, namespace, name and index of all nodes."""
    return {(n.executable, n.namespace or "", n.name, n.parameters.get("index")) for n in nodes(actions)}


ALWAYS = {("plant_sim", "", "plant_sim", None), ("recorder", "", "recorder", None)}


def test_decentralised_starts_a_link_and_a_controller_in_each_namespace(launched: Any) -> None:
    assert places(launched("run.launch.py", run="two_area_decentralised")) == ALWAYS | {
        ("wan_link", "tie", "wan_link", 0),
        ("wan_link", "substation", "wan_link", 1),
        ("controller", "tie", "controller_0_ANFTSC", 0),
        ("controller", "substation", "controller_1_HBsWC", 1),
        ("identifier", "tie", "identifier_0_ANFTSI", 0),
        ("identifier", "substation", "identifier_1_ANFTSI", 1),
    }


def test_centralised_starts_one_link(launched: Any) -> None:
    started = places(launched("run.launch.py", run="two_area_centralised"))
    assert started >= ALWAYS | {("wan_link", "", "wan_link", 0)}
    others = started - ALWAYS - {("wan_link", "", "wan_link", 0)}
    assert {executable for executable, *_ in others} <= {"controller", "identifier"}
    assert {namespace for _, namespace, *_ in others} == {""}


def test_in_order_all_are_configured_and_the_plant_is_activated_last(launched: Any) -> None:
    actions = launched("run.launch.py", run="two_area_deployment", lifecycle="true")
    managed = [action for action in actions if type(action).__name__ == "LifecycleNode"]
    assert not any(node.named["parameters"][0]["autostart"] for node in managed)
    asked = [action.named["event"].named for action in actions if type(action).__name__ == "EmitEvent"]
    assert [change["transition_id"] for change in asked] == [Transition.TRANSITION_CONFIGURE] * len(managed)
    handlers = [a.given[0].named for a in actions if type(a).__name__ == "RegisterEventHandler"]
    order = [handler["target_lifecycle_node"] for handler in handlers if handler.get("goal_state") == "active"]
    assert len(order) == len(managed)
    assert order[-1].named["executable"] == "plant_sim"
    following = [handler["entities"] for handler in handlers if handler.get("goal_state") == "active"]
    for then, node in zip(following, [*order[1:], None], strict=True):
        matchers = [event.named["event"].named["lifecycle_node_matcher"] for event in then]
        assert [matcher(node) for matcher in matchers] == [True] * (node is not None)
    with pytest.raises(InputError, match="respawn:=true given with lifecycle:=true"):
        launched("run.launch.py", mode="realtime", lifecycle="true", respawn="true")


def test_run_of_ones_own_is_started_with_mode_and_without_recorder(launched: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("controllers: [{name: HBsWC, namespace: here, link: delay_100ms}]")
    actions = launched("run.launch.py", run=str(path), output="", mode="realtime")
    assert places(actions) == {
        ("plant_sim", "", "plant_sim", None),
        ("wan_link", "here", "wan_link", 0),
        ("controller", "here", "controller_0_HBsWC", 0),
        ("identifier", "here", "identifier_0_ANFGuMoI", 0),
    }
    common = {"run": str(path), "mode": "realtime", "recorder": False}
    assert all(node.parameters.items() >= common.items() for node in nodes(actions))


def test_node_of_ones_own_is_started_by_its_command_or_not_at_all(launched: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    row = "name: mine, link: delay_100ms, namespace: here, parameters: {gain: 3}"
    path.write_text(f"controllers: [{{{row}, command: [my_node, -v]}}]")
    actions = launched("run.launch.py", run=str(path), namespace="grid")
    (started,) = [action.named["cmd"] for action in actions if type(action).__name__ == "ExecuteProcess"]
    assert started[:3] == ["my_node", "-v", "--ros-args"]
    arguments = set(zip(started[3::2], started[4::2], strict=True))
    names = {"__node:=controller_0_mine", "__ns:=/grid/here", "pmu/delivered:=/grid/here/pmu/delivered"}
    assert arguments == {*(("-r", name) for name in names), ("-p", "gain:=3.0")}
    assert "controller" not in {executable for executable, *_ in places(actions)}
    path.write_text(f"controllers: [{{{row}, external: true}}]")
    actions = launched("run.launch.py", run=str(path))
    assert not any(type(action).__name__ == "ExecuteProcess" for action in actions)
    assert "controller" not in {executable for executable, *_ in places(actions)}


def test_nodes_that_may_join_are_started_again_where_that_is_wanted(launched: Any) -> None:
    again = nodes(launched("run.launch.py", run="two_area_decentralised", mode="realtime", respawn="true"))
    for node in again:
        joins = node.executable in ("wan_link", "controller", "identifier")
        assert (node.respawn, node.parameters.get("join", False)) == (joins, joins)
    assert not any(node.respawn for node in nodes(launched("run.launch.py", run="two_area_decentralised")))
    with pytest.raises(InputError, match="respawn:=true given with mode:=lockstep"):
        launched("run.launch.py", respawn="true")


def test_streams_stand_in_for_the_plant_where_they_are_given(launched: Any) -> None:
    started = nodes(launched("run.launch.py", mode="realtime", streams="tcp://127.0.0.1:4712/1"))
    (client,) = (node for node in started if node.executable == "c37118_client")
    assert client.parameters["streams"] == "tcp://127.0.0.1:4712/1"
    assert "plant_sim" not in {node.executable for node in started}


def handlers(actions: list[Any]) -> list[Any]:
    return [action.given[0].named for action in actions if type(action).__name__ == "RegisterEventHandler"]


def test_end_of_the_plant_is_the_end_of_the_launch(launched: Any) -> None:
    ends = [handler for handler in handlers(launched("run.launch.py")) if isinstance(handler["on_exit"], list)]
    assert [handler["target_action"].named["name"] for handler in ends] == ["plant_sim"]
    assert [type(action).__name__ for action in ends[0]["on_exit"]] == ["Shutdown"]


def test_node_that_fails_has_the_launch_fail(launched: Any) -> None:
    watched = [handler for handler in handlers(launched("run.launch.py")) if not isinstance(handler["on_exit"], list)]
    assert {handler["target_action"].named["executable"] for handler in watched} == {
        *("plant_sim", "wan_link", "controller", "recorder")
    }
    ended = watched[0]["on_exit"]
    running, over = SimpleNamespace(is_shutdown=False), SimpleNamespace(is_shutdown=True)
    died, done = (SimpleNamespace(process_name="recorder-4", returncode=status) for status in (1, 0))
    with pytest.raises(RuntimeError, match="recorder-4 ended with status 1"):
        ended(died, running)
    ended(died, over)
    ended(done, running)
    again = handlers(launched("run.launch.py", mode="free", respawn="true"))
    assert {handler["target_action"].named["executable"] for handler in again} == {"plant_sim", "recorder"}


def test_arguments_change_the_run_of_all_nodes(launched: Any, tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    arguments = {"set": "[controllers.0.name=HBsWC, seed=3]", "link": "pdci", "duration": "5", "params_file": str(file)}
    started = launched("run.launch.py", namespace="/lab", foxglove="8765", cockpit="8766", output="none", **arguments)
    node_actions = nodes(started)
    kinds = {"plant_sim", "wan_link", "controller", "identifier", "live_view", "cockpit"}
    assert {node.executable for node in node_actions} == kinds
    for node in node_actions:
        assert node.namespace == "lab"
        assert node.parameters["set"] == ["link=pdci", "duration=5", "controllers.0.name=HBsWC", "seed=3"]
    named = [action.named for action in started if type(action).__name__ == "Node"]
    assert [keywords["parameters"][-1] for keywords in named if len(keywords["parameters"]) > 1] == [str(file)] * 4
    assert {keywords["output"] for keywords in named} == {"screen"}  # there the cockpit has its address
    assert nodes(launched("run.launch.py", set="seed=3"))[0].parameters["set"] == ["seed=3"]


def test_recording_has_a_folder_of_its_own(launched: Any) -> None:
    (recorder,) = (node for node in nodes(launched("run.launch.py")) if node.executable == "recorder")
    assert re.fullmatch(r"recording_\d{8}_\d{6}", recorder.parameters["output"])


def test_arguments_that_are_not_there_are_refused(launched: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "facts_damping", "run.launch.py", "runn:=two_area_large"])
    with pytest.raises(InputError, match="runn:= given; allowed: run, set, system, scenario, link, "):
        launched("run.launch.py")
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "mine", "all.launch.py", "theirs:=1"])  # that includes ours
    launched("run.launch.py")


@pytest.mark.parametrize("name", ["centralised", "decentralised"])
def test_graph_launched_in_a_namespace_gives_the_in_process_run(
    capsys: Any, launched: Any, loopback: Any, tmp_path: Path, name: str
) -> None:
    """As `launch` would start it in a group with a namespace pushed."""
    run, short = f"two_area_{name}", "duration=4.0"
    running = {}
    for node in nodes(launched("run.launch.py", run=run, set=short, output=str(tmp_path / "bag"))):
        place = "/".join(part for part in ("", "grid", node.namespace) if part is not None)
        arguments = ["--ros-args", "-r", f"__node:={node.name}", "-r", f"__ns:={place}"]
        for key, value in node.parameters.items():
            arguments += ["-p", f"{key}:={value}"]
        main = importlib.import_module(module_of(node.executable)).main
        running[node.name, place] = loopback.start(node.name, main, arguments)
    for node in running.values():
        node.join(PATIENCE_S)
        assert node.exitcode == 0
    assert capsys.readouterr() == ("", "")
    assert_same(load(tmp_path / "bag"), loop.run(load_case(run, [short])))
