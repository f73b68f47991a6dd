# SPDX-License-Identifier: Apache-2.0
"""The correction of a cell.

ros2 launch irec_correction correction.launch.py cell:=/path/to/cell.yaml [params:=/path/to/correction.yaml]
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PARAMS = ["config", "nodes", "correction.yaml"]


def generate_launch_description() -> LaunchDescription:
    """The lifecycle node; the arguments of the launch win over the parameter file."""

    def parameter(name: str, kind: type) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=kind)

    params = PathJoinSubstitution([FindPackageShare("irec_correction"), *PARAMS])
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", description="cell file (irec-cell/1)"),
            DeclareLaunchArgument("params", default_value=params, description="parameter file; the default has every default"),
            DeclareLaunchArgument("autostart", default_value="false", description="configure and activate without a manager"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="true with irec_sim"),
            LifecycleNode(
                package="irec_correction",
                executable="correction_node",
                name="correction_node",
                namespace="",
                output="screen",
                parameters=[
                    LaunchConfiguration("params"),
                    {
                        "cell": parameter("cell", str),
                        "autostart": parameter("autostart", bool),
                        "use_sim_time": parameter("use_sim_time", bool),
                    },
                ],
            ),
        ]
    )
