"""All nodes of a run: `ros2 launch facts_damping run.launch.py run:=two_area_small output:=recording`.

The launch ends when the plant has simulated its run; the others are stopped then.
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from facts_damping.configuration import load_case
from facts_damping.parts import controller_names, identifier_names
from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "run": ("two_area_small", "name under config/runs, or path of a YAML file"),
    "mode": ("lockstep", "lockstep or realtime"),
    "output": ("recording", "folder of the new recording; empty: no recorder"),
}


def nodes(context: LaunchContext) -> list[Node | RegisterEventHandler]:
    """One node of each kind, and a controller for each entry of the run."""
    run, mode, output = (LaunchConfiguration(name).perform(context) for name in ARGUMENTS)
    common = {"run": run, "mode": mode, "recorder": bool(output)}

    def node(executable: str, name: str, **parameters: object) -> Node:
        return Node(
            package="facts_damping",
            executable=executable,
            name=name,
            parameters=[{**common, **parameters}],
            output="screen",
        )

    plant = node("plant_sim", "plant_sim")
    started = [plant, node("wan_link", "wan_link")]
    case = load_case(run)
    started += [node("controller", name, index=i) for i, name in enumerate(controller_names(case))]
    started += [node("identifier", name, index=i) for i, name in identifier_names(case).items()]
    if output:
        started.append(node("recorder", "recorder", output=output))
    end = RegisterEventHandler(OnProcessExit(target_action=plant, on_exit=[Shutdown(reason="the run is over")]))
    return [*started, end]


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
