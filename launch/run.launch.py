"""All nodes of a run: `ros2 launch facts_damping run.launch.py run:=two_area_small link:=pdci`.

Controllers, identifiers and links are started in the namespaces that the run gives them, below that of the launch.
The launch ends when the plant has simulated its run; a node that fails ends it with a status that is not 0.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from facts_damping.case.loading import load_case
from facts_damping.case.names import (
    Address,
    controller_addresses,
    identifier_addresses,
    link_addresses,
    supervisor_addresses,
)
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError
from facts_damping.nodes.base.warmup import compile_once
from facts_damping.nodes.launching.commands import command
from facts_damping.parameters.files import read_value
from launch import LaunchContext, LaunchDescription

# Ctrl-C while Python itself starts waits until the node takes it: else the node dies of it, with a traceback.
PREFIX = "env --block-signal=INT"
RESPAWN_S = 1.0  # before a node that ended is started again
FIELDS = ("system", "scenario", "link", "frame_rate", "duration", "seed")  # of a run; empty: as the run has it

VIEWS = {"cockpit": "cockpit", "foxglove": "live_view"}  # nodes that only listen, by the argument that gives their port

ARGUMENTS = {
    "run": ("two_area_small", "name under config/runs, or path of a YAML file"),
    "set": ("", "changes to the run: key.path=value, or several in a list, [a=1, b=2]"),
    **{name: ("", f"{name} of the run; empty: as the run has it") for name in FIELDS},
    "mode": ("lockstep", "lockstep, realtime or free"),
    "output": (time.strftime("recording_%Y%m%d_%H%M%S"), "folder of the new recording; none: no recorder"),
    "namespace": ("", "namespace of the whole graph; empty: none"),
    "cockpit": ("", "port of a page that shows and changes the run, such as 8766; empty: none"),
    "foxglove": ("", "port of a live view for Foxglove, such as 8765; empty: none"),
    "params_file": ("", "YAML file of parameters, a section a node; empty: none"),
    "streams": ("", "in place of the plant, not in lockstep: YAML file of streams, or an address; empty: none"),
    "lifecycle": ("false", "true: configure all nodes, then activate them in order, the plant last"),
    "respawn": ("false", "true, unless in lockstep: start links, controllers, supervisors, identifiers again"),
}
NOTHING = ("none", "''", '""')  # for an empty argument, which `ros2 launch` does not take
CHOICES = {"mode": ["lockstep", "realtime", "free"], "lifecycle": ["false", "true"], "respawn": ["false", "true"]}


def check_arguments(given: list[str]) -> None:
    """Refuse arguments of a command line that are not declared here, which `ros2 launch` ignores."""
    unknown = [text.partition(":=")[0] for text in given if ":=" in text and text.partition(":=")[0] not in ARGUMENTS]
    if unknown and any(text.endswith("run.launch.py") for text in given):
        raise InputError(f"{unknown[0]}:= given; allowed: {', '.join(ARGUMENTS)}")


def changes(asked: dict[str, str]) -> list[str]:
    """Changes of the run by the arguments, for the parameter `set` of its nodes."""
    listed = read_value(asked["set"], "set") if asked["set"] else []
    sets = listed if isinstance(listed, list) else [asked["set"]]
    return [*(f"{name}={asked[name]}" for name in FIELDS if asked[name]), *map(str, sets)]


def ended(event: Any, context: LaunchContext) -> None:
    """Let the launch fail if a node has failed."""
    if event.returncode != 0 and not context.is_shutdown:
        raise RuntimeError(f"{event.process_name} ended with status {event.returncode}")


def in_order(managed: list[LifecycleNode]) -> list[RegisterEventHandler | EmitEvent]:
    """Configure all nodes, then activate them one after another."""

    def ask(node: LifecycleNode, transition: int) -> EmitEvent:
        matcher = lambda one: one is node  # noqa: E731 (as launch_ros asks for it)
        return EmitEvent(event=ChangeState(lifecycle_node_matcher=matcher, transition_id=transition))

    activate = [ask(node, Transition.TRANSITION_ACTIVATE) for node in managed]
    configured: set[int] = set()

    def when_configured(_: LaunchContext, number: int) -> list[EmitEvent]:
        configured.add(number)
        return activate[:1] if len(configured) == len(managed) else []

    made: list[RegisterEventHandler | EmitEvent] = []
    for i, node in enumerate(managed):
        count = OpaqueFunction(function=when_configured, args=[i])
        for start, goal, then in (
            ("configuring", "inactive", [count]),
            ("activating", "active", activate[i + 1 : i + 2]),
        ):
            handler = OnStateTransition(target_lifecycle_node=node, start_state=start, goal_state=goal, entities=then)
            made.append(RegisterEventHandler(handler))
    return [*made, *(ask(node, Transition.TRANSITION_CONFIGURE) for node in managed)]


def nodes(context: LaunchContext) -> list[Node | ExecuteProcess | RegisterEventHandler]:
    """Plant and recorder, a node for each link that is used, for each controller of the run, for each identifier."""
    check_arguments(sys.argv)
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    asked = {name: "" if value in NOTHING else value for name, value in asked.items()}
    sets, again, ordered = changes(asked), asked["respawn"] == "true", asked["lifecycle"] == "true"
    if again and asked["mode"] == "lockstep":
        raise InputError("respawn:=true given with mode:=lockstep; allowed: with mode:=realtime or free")
    if again and ordered:
        raise InputError("respawn:=true given with lifecycle:=true; allowed: one of them")
    case, namespace = load_case(asked["run"], sets), asked["namespace"].strip("/")
    compile_once()
    run: dict[str, object] = {"run": asked["run"], "set": sets or [""]}
    common = {"mode": asked["mode"], "recorder": bool(asked["output"]), "view": any(asked[name] for name in VIEWS)}

    def node(executable: str, address: Address, **parameters: object) -> Node:
        joins = again and "index" in parameters
        if joins:
            parameters["join"] = asked["mode"] == "realtime"
        if ordered:
            parameters["autostart"] = False
        action = (LifecycleNode if ordered else Node)(
            package="facts_damping",
            executable=executable,
            name=address.name,
            namespace="/".join(filter(None, (namespace, address.namespace))) or ("" if ordered else None),
            parameters=[{**run, **common, **parameters}, *filter(None, [asked["params_file"]])],
            respawn=joins,
            respawn_delay=RESPAWN_S if joins else None,
            prefix=PREFIX,
            output="screen",
        )
        if not joins:
            watched.append(action)
        return action

    watched: list[Node | ExecuteProcess] = []
    if asked["streams"]:
        plant = node("c37118_client", Address("", "c37118_client"), streams=asked["streams"])
    else:
        plant = node("plant_sim", Address("", "plant_sim"))
    started: list[Node | ExecuteProcess] = [plant]
    started += [node("wan_link", address, index=i) for i, address in enumerate(link_addresses(case))]
    for i, address in enumerate(controller_addresses(case)):
        controller = case.controllers[i]
        if not kind_of(controller).node:
            started.append(node("controller", address, index=i))
        elif controller.command is not None:
            cmd = command(case, i, namespace)
            watched.append(ExecuteProcess(cmd=cmd, name=address.name, output="screen"))
            started.append(watched[-1])
    started += [node("identifier", address, index=i) for i, address in identifier_addresses(case).items()]
    started += [node("supervisor", address, index=i) for i, address in supervisor_addresses(case).items()]
    if asked["output"]:
        started.append(node("recorder", Address("", "recorder"), output=asked["output"]))
    started += [view(name, asked[name], namespace, run) for name in VIEWS if asked[name]]
    failures = [RegisterEventHandler(OnProcessExit(target_action=one, on_exit=ended)) for one in watched]
    end = RegisterEventHandler(OnProcessExit(target_action=plant, on_exit=[Shutdown(reason="the run is over")]))
    if not ordered:
        return [*failures, end, *started]
    managed = [one for one in started if isinstance(one, LifecycleNode)]
    return [*failures, end, *started, *in_order([*managed[:0:-1], managed[0]])]


def view(argument: str, port: str, namespace: str, run: dict[str, object]) -> Node:
    """A node that shows the run at a port."""
    if not port.isdecimal():
        raise InputError(f"{argument}:={port} given; allowed: a port, such as 8765")
    return Node(
        package="facts_damping",
        executable=VIEWS[argument],
        name=VIEWS[argument],
        namespace=namespace or None,
        parameters=[{**run, "port": int(port)}],
        prefix=PREFIX,
        output="screen",  # the address of the page has a token
    )


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text, choices=CHOICES.get(name))
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
