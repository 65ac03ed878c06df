"""All nodes of a run: `ros2 launch facts_damping run.launch.py run:=two_area_small output:=recording`.

Controllers, identifiers and links are started in the namespaces that the run gives them, below that of the launch.
The launch ends when the plant has simulated its run; the others are stopped then.
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from facts_damping.case.loading import load_case
from facts_damping.case.names import Address, controller_addresses, identifier_addresses, link_addresses
from facts_damping.errors import InputError
from launch import LaunchContext, LaunchDescription

RESPAWN_S = 1.0  # before a node that ended is started again

ARGUMENTS = {
    "run": ("two_area_small", "name under config/runs, or path of a YAML file"),
    "mode": ("lockstep", "lockstep or realtime"),
    "output": ("recording", "folder of the new recording; empty: no recorder"),
    "respawn": ("false", "true, in real time: links, controllers and identifiers that end are started again, and join"),
}


def nodes(context: LaunchContext) -> list[Node | RegisterEventHandler]:
    """Plant and recorder, a node for each link that is used, for each controller of the run, for each identifier."""
    run, mode, output, respawn = (LaunchConfiguration(name).perform(context) for name in ARGUMENTS)
    common = {"run": run, "mode": mode, "recorder": bool(output)}
    again = respawn.lower() == "true"
    if again and mode != "realtime":
        raise InputError(f"respawn:=true given with mode:={mode}; allowed: with mode:=realtime")

    def node(executable: str, address: Address, **parameters: object) -> Node:
        joins = again and "index" in parameters
        return Node(
            package="facts_damping",
            executable=executable,
            name=address.name,
            namespace=address.namespace or None,
            parameters=[{**common, **parameters, **({"join": True} if joins else {})}],
            respawn=joins,
            respawn_delay=RESPAWN_S if joins else None,
            output="screen",
        )

    plant, case = node("plant_sim", Address("", "plant_sim")), load_case(run)
    started = [plant]
    started += [node("wan_link", address, index=i) for i, address in enumerate(link_addresses(case))]
    started += [node("controller", address, index=i) for i, address in enumerate(controller_addresses(case))]
    started += [node("identifier", address, index=i) for i, address in identifier_addresses(case).items()]
    if output:
        started.append(node("recorder", Address("", "recorder"), output=output))
    end = RegisterEventHandler(OnProcessExit(target_action=plant, on_exit=[Shutdown(reason="the run is over")]))
    return [*started, end]


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
