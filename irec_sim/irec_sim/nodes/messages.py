# SPDX-License-Identifier: Apache-2.0
"""Stamped messages of the instruments from plain numbers, the stamp left at zero."""

from __future__ import annotations

from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, Quaternion, Vector3, Wrench, WrenchStamped
from std_msgs.msg import Header


def pose_message(v: list[float]) -> PoseStamped:
    """Position (m) and quaternion (x, y, z, w) in base_link."""
    pose = Pose(position=Point(x=v[0], y=v[1], z=v[2]), orientation=Quaternion(x=v[3], y=v[4], z=v[5], w=v[6]))
    return PoseStamped(header=Header(frame_id="base_link"), pose=pose)


def wrench_message(frame: str, v: list[float]) -> WrenchStamped:
    """Force (N) and torque (N m) in `frame`, environment on robot."""
    wrench = Wrench(force=Vector3(x=v[0], y=v[1], z=v[2]), torque=Vector3(x=v[3], y=v[4], z=v[5]))
    return WrenchStamped(header=Header(frame_id=frame), wrench=wrench)


def point_message(station: str, v: list[float]) -> PointStamped:
    """Marker (m) in the frame of the station that measured."""
    return PointStamped(header=Header(frame_id=station), point=Point(x=v[0], y=v[1], z=v[2]))
