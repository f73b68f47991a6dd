# SPDX-License-Identifier: Apache-2.0
"""Publishes /tf and /tf_static from joint states: the links of the robot, and with a cell file the cell, its rail and stations.

For machines where robot_state_publisher is not installed, and for the frames that it does not know: `cell` carries `base_link`
on the rail, a tracker station is `station_NAME` in `cell`.
"""

from __future__ import annotations

import math
import sys
from typing import Any

from geometry_msgs.msg import TransformStamped
from irec_ros.guard import GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters, run_node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ..cell import read_cell
from ..errors import IrecError, RobotError
from ..files.regular import URDF_LIMIT, read_text
from ..procedure.cell_frames import NO_CELL, cell_frames
from ..robot.transforms import LinkTree, Transform

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PARAMETERS = (
    P("robot_description_file", "", "URDF file; empty: the cell file's, or the topic robot_description"),
    P("cell", "", "cell file (irec-cell/1): frames of the cell, its rail and stations, and the driver's names of joints"),
    P("frame_prefix", "", "put before the name of every frame, e.g. left/ where two cells share a graph"),
)


class TfNode(GuardedNode):
    """Parameters: see PARAMETERS. Topics: joint_states -> /tf, /tf_static."""

    def __init__(self, message_type: Any) -> None:
        super().__init__("tf_node")
        self._message_type = message_type
        given = Parameters(self, PARAMETERS)
        path: str = given["robot_description_file"]
        cell: str = given["cell"]
        self._prefix: str = given["frame_prefix"]
        refuse_unknown_parameters(self)
        self._tree: LinkTree | None = None
        self._frames = cell_frames(read_cell(cell)) if cell else NO_CELL
        self._moving = self.create_publisher(message_type, "/tf", 100)
        self._fixed = self.create_publisher(message_type, "/tf_static", LATCHED)
        if path:
            self._use(read_text(path, "robot description", RobotError, URDF_LIMIT), path)
        elif cell:
            self._use(self._frames.urdf, cell)
        else:
            self.create_subscription(String, "robot_description", self._described, LATCHED)
        self.create_subscription(JointState, "joint_states", self._moved, qos_profile_sensor_data)

    def _described(self, message: String) -> None:
        try:
            self._use(message.data, "topic robot_description")
        except RobotError as error:
            self.get_logger().error(str(error))

    def _use(self, text: str, source: str) -> None:
        self._tree = LinkTree(text, source)
        stamp = self.get_clock().now().to_msg()
        self._publish(self._fixed, [*self._frames.fixed, *self._tree.fixed()], stamp)

    def _moved(self, message: JointState) -> None:
        if self._tree is None or len(message.name) != len(message.position):
            return
        names = self._frames.joints
        at = {names.get(n, n): q for n, q in zip(message.name, message.position, strict=True) if math.isfinite(q)}
        moved = [*self._frames.on_rail(at), *self._tree.at(at)]
        if moved:
            self._publish(self._moving, moved, message.header.stamp)

    def _publish(self, publisher: Any, transforms: list[Transform], stamp: Any) -> None:
        publisher.publish(self._message_type(transforms=[_message(t, stamp, self._prefix) for t in transforms]))


def _message(t: Transform, stamp: Any, prefix: str) -> TransformStamped:
    out = TransformStamped()
    out.header.stamp, out.header.frame_id, out.child_frame_id = stamp, prefix + t.parent, prefix + t.child
    out.transform.translation.x, out.transform.translation.y, out.transform.translation.z = map(float, t.xyz)
    r = out.transform.rotation
    r.x, r.y, r.z, r.w = map(float, t.quat_xyzw)
    return out


def main() -> int:
    """Entry point; 0 ended, 2 bad input."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        print("tf_node: the package tf2_msgs is missing: apt-get install ros-jazzy-tf2-msgs", file=sys.stderr)
        return 2
    return run_node("tf_node", lambda: TfNode(TFMessage), IrecError)


if __name__ == "__main__":
    sys.exit(main())
