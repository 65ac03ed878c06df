"""The controllers of both devices at one place, over one link.

`ros2 launch facts_damping centralised.launch.py output:=recording` starts the run `two_area_centralised`;
`mode` and `output` are those of `run.launch.py`.
"""

from __future__ import annotations

from pathlib import Path

from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchDescription

RUN = "two_area_centralised"


def generate_launch_description() -> LaunchDescription:
    """The launch description that `ros2 launch` asks for."""
    source = PythonLaunchDescriptionSource(str(Path(__file__).with_name("run.launch.py")))
    return LaunchDescription([IncludeLaunchDescription(source, launch_arguments={"run": RUN}.items())])
