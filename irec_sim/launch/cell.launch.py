# SPDX-License-Identifier: Apache-2.0
"""The simulated cell, and a recorder of its topics where `record` names a folder.

ros2 launch irec_sim cell.launch.py cell:=afp speed_factor:=4.0 record:=out/cell
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

CLOSE_TIME = "20.0"  # s for what has arrived to be written; launch would kill 5 s after an interrupt


def generate_launch_description() -> LaunchDescription:
    """Arguments: see `ros2 launch irec_sim cell.launch.py --show-args`."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", default_value="afp", description="cell file, or its name in config/cells"),
            DeclareLaunchArgument("namespace", default_value="", description="of this cell, where several share one graph"),
            DeclareLaunchArgument("truth", default_value="", description="truth file with hidden effects; empty: elastic"),
            DeclareLaunchArgument("speed_factor", default_value="1.0", description="simulated per real seconds"),
            DeclareLaunchArgument("seed", default_value="1", description="of all noise"),
            DeclareLaunchArgument("record", default_value="", description="folder to record to; empty: no recording"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):
    value = LaunchConfiguration
    namespace = value("namespace").perform(context).strip("/")
    clock = [("/clock", f"/{namespace}/clock")] if namespace else []  # two simulated cells have two clocks
    topics = PathJoinSubstitution([FindPackageShare("irec_calibration"), "config", "nodes", "recorder.yaml"])
    return [
        Node(
            package="irec_sim",
            executable="cell_node",
            name="cell",
            namespace=namespace,
            remappings=clock,
            output="screen",
            on_exit=Shutdown(reason="the cell has ended"),  # there is nothing to record without it
            parameters=[
                {
                    "cell": ParameterValue(value("cell"), value_type=str),
                    "truth": ParameterValue(value("truth"), value_type=str),
                    "speed_factor": ParameterValue(value("speed_factor"), value_type=float),
                    "seed": ParameterValue(value("seed"), value_type=int),
                }
            ],
        ),
        Node(
            package="irec_calibration",
            executable="recorder_node",
            name="recorder",
            namespace=namespace,
            remappings=clock,
            output="screen",
            sigterm_timeout=CLOSE_TIME,
            condition=IfCondition(NotEqualsSubstitution(value("record"), "")),
            parameters=[
                topics,
                {"output": ParameterValue(value("record"), value_type=str), "use_sim_time": True},
            ],
        ),
    ]
