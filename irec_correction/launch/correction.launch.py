# SPDX-License-Identifier: Apache-2.0
"""The correction of a cell: `ros2 launch irec_correction correction.launch.py cell:=/path/cell.yaml
[params:=/path/params.yaml]`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", description="cell file (irec-cell/1)"),
            DeclareLaunchArgument("params", description="parameter file, see config/nodes/correction.yaml"),
            DeclareLaunchArgument("autostart", default_value="false", description="configure and activate without a manager"),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            LifecycleNode(
                package="irec_correction",
                executable="correction_node",
                name="correction_node",
                namespace="",
                output="screen",
                parameters=[
                    LaunchConfiguration("params"),
                    {
                        "cell": LaunchConfiguration("cell"),
                        "autostart": LaunchConfiguration("autostart"),
                        "use_sim_time": LaunchConfiguration("use_sim_time"),
                    },
                ],
            ),
        ]
    )
