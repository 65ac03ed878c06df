"""A controller beside each device, in a namespace and over a link of its own.

`ros2 launch facts_damping decentralised.launch.py output:=recording` starts the run `two_area_decentralised`;
`mode` and `output` are those of `run.launch.py`.
"""

from __future__ import annotations

from pathlib import Path

from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchDescription

RUN = "two_area_decentralised"


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` asks for."""
    source = PythonLaunchDescriptionSource(str(Path(__file__).with_name("run.launch.py")))
    return LaunchDescription([IncludeLaunchDescription(source, launch_arguments={"run": RUN}.items())])
