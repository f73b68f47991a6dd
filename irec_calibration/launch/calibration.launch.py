# SPDX-License-Identifier: Apache-2.0
"""Procedure and calibration services for one cell; the robot's driver (or irec_sim) is started by itself.

    ros2 launch irec_calibration calibration.launch.py cell:=/path/to/cell.yaml [namespace:=cell_a]
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

RETRACT_TIME = "40.0"  # s; launch kills 5 s after an interrupt if nobody objects, with the robot pressing on the tooling


def generate_launch_description() -> LaunchDescription:
    """Nodes with the parameters given on the command line."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", description="cell file (irec-cell/1)"),
            DeclareLaunchArgument("namespace", default_value="", description="of this cell, where several share one graph"),
            DeclareLaunchArgument("session_folder", default_value="sessions", description="where recordings go"),
            DeclareLaunchArgument("calibration_folder", default_value="", description="empty: beside the cell file"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="true with irec_sim"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):
    def text(name: str) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=str)

    namespace = LaunchConfiguration("namespace").perform(context).strip("/")
    use_sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    clock = [("/clock", f"/{namespace}/clock")] if namespace else []  # that of a simulated cell; ROS would share one
    return [
        Node(
            package="irec_calibration",
            executable="procedure_node",
            name="procedure_node",
            namespace=namespace,
            remappings=clock,
            output="screen",
            sigterm_timeout=RETRACT_TIME,
            parameters=[{"cell": text("cell"), "session_folder": text("session_folder"), "use_sim_time": use_sim_time}],
        ),
        Node(
            package="irec_calibration",
            executable="calibration_node",
            name="calibration_node",
            namespace=namespace,
            output="screen",
            parameters=[{"cell": text("cell"), "calibration_folder": text("calibration_folder")}],
        ),
    ]
