# SPDX-License-Identifier: Apache-2.0
"""Record what a cell publishes.

    ros2 launch irec_calibration recorder.launch.py output:=/path/to/folder [params:=/path/to/recorder.yaml] [namespace:=cell_a]
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PARAMS = ["config", "nodes", "recorder.yaml"]
CLOSE_TIME = "20.0"  # s for what has arrived to be written; launch would kill 5 s after an interrupt


def generate_launch_description() -> LaunchDescription:
    """The recorder with its topics from a parameter file."""
    params = PathJoinSubstitution([FindPackageShare("irec_calibration"), *PARAMS])
    return LaunchDescription(
        [
            DeclareLaunchArgument("output", description="folder to write; it must not exist"),
            DeclareLaunchArgument("namespace", default_value="", description="of the cell, where several share one graph"),
            DeclareLaunchArgument("params", default_value=params, description="parameter file with the topics"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="true with irec_sim"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):
    value = LaunchConfiguration
    namespace = value("namespace").perform(context).strip("/")
    return [
        Node(
            package="irec_calibration",
            executable="recorder_node",
            name="recorder",
            namespace=namespace,
            remappings=[("/clock", f"/{namespace}/clock")] if namespace else [],
            output="screen",
            sigterm_timeout=CLOSE_TIME,
            parameters=[
                value("params"),
                {
                    "output": ParameterValue(value("output"), value_type=str),
                    "use_sim_time": ParameterValue(value("use_sim_time"), value_type=bool),
                },
            ],
        ),
    ]
