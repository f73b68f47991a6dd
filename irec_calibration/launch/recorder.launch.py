# SPDX-License-Identifier: Apache-2.0
"""Record everything that a cell publishes.

    ros2 launch irec_calibration recorder.launch.py output:=/path/to/folder params:=config/nodes/recorder.yaml
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """The recorder with its topics from a parameter file."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("output", description="folder to write; it must not exist"),
            DeclareLaunchArgument("params", description="parameter file with the topics, e.g. config/nodes/recorder.yaml"),
            Node(
                package="irec_calibration",
                executable="recorder_node",
                name="recorder",
                namespace="",
                output="screen",
                parameters=[
                    LaunchConfiguration("params"),
                    {"output": ParameterValue(LaunchConfiguration("output"), value_type=str)},
                ],
            ),
        ]
    )
