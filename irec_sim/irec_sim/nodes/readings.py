# SPDX-License-Identifier: Apache-2.0
"""What the cell says, as messages: readings of its instruments, the state of the robot, diagnostics."""

from __future__ import annotations

import math
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3
from irec_ros.diagnostics import ERROR, OK, status
from rclpy.node import Node
from sensor_msgs.msg import JointState, Temperature

from irec_msgs.msg import RobotState

from ..cell import Cell
from ..instruments import Delay, InstrumentSettings
from ..kinematics import quaternion_of_rotation
from .messages import point_message, pose_message, wrench_message
from .robot_side import FAULT_REASON, RobotSide
from .streams import Template, ros_time

_NUMBERS = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]  # to find their places in a serialized message
MODE_NAMES = {RobotState.MODE_POSITION: "position", RobotState.MODE_FORCE: "force", RobotState.MODE_FAULT: "fault"}


@dataclass
class Now:
    """The stamp of this step."""

    stamp: Time


class Readings:
    """Each method makes one message or serialized message of the cell as it is now; None where nothing is to be sent."""

    def __init__(self, node: Node, cell: Cell, robot: RobotSide, settings: InstrumentSettings, now: Now) -> None:
        self._node, self._cell, self._robot, self._now = node, cell, robot, now
        self._force_lag = cell.period * math.ceil(settings.force_delay / cell.period - 1e-9)
        self._tracker_stamps: Delay[Time] = Delay(settings.tracker_delay)
        axes = [*cell.chain.joint_names, *cell.rail_names]
        ones = [float(k + 1) for k in range(len(axes))]
        self._joints = Template(JointState(name=axes, position=ones), ones)
        self._pose = Template(pose_message(_NUMBERS[:7]), _NUMBERS[:7])
        six = _NUMBERS[:6]
        self._wrench, self._raw = (Template(wrench_message(frame, six), six) for frame in ("tool0", "ft_sensor"))
        self._point: dict[str, Template] = {}

    def joints(self) -> bytes:
        q, rail = self._cell.joints()
        return self._joints.serialized(self._now.stamp, [*q.tolist(), rail] if self._cell.rail_names else q.tolist())

    def pose(self) -> bytes:
        p, R = self._cell.tcp()
        return self._pose.serialized(self._now.stamp, [*p.tolist(), *quaternion_of_rotation(R).tolist()])

    def wrench(self) -> bytes:
        return self._wrench.serialized(self._force_stamp(), self._cell.wrench().tolist())

    def wrench_raw(self) -> bytes:
        return self._raw.serialized(self._force_stamp(), self._cell.wrench_raw().tolist())

    def _force_stamp(self) -> Time:
        """Of the reading, which came out of the sensor `force_delay` ago."""
        return ros_time(max(self._cell.time - self._force_lag, 0.0)) if self._force_lag else self._now.stamp

    def point(self) -> bytes | None:
        reading = self._cell.tracker()
        stamp = self._tracker_stamps.pass_through(self._cell.time, self._now.stamp)
        if reading is None:
            return None
        station, p = reading
        if station not in self._point:
            self._point[station] = Template(point_message(station, _NUMBERS[:3]), _NUMBERS[:3])
        return self._point[station].serialized(stamp, p.tolist())

    def temperatures(self) -> dict[str, Temperature]:
        messages = {}
        for name, value in self._cell.temperatures().items():
            messages[name] = Temperature(temperature=float(value))
            messages[name].header.stamp, messages[name].header.frame_id = self._now.stamp, name
        return messages

    def state(self) -> RobotState:
        x, y, z = self._cell.offset.tolist()
        fault = self._cell.mode == RobotState.MODE_FAULT
        message = RobotState(
            mode=int(self._cell.mode),
            in_motion=self._robot.in_motion,
            retreating=self._robot.retreating,
            expired_leases=self._robot.lease.expired,
            offset=Vector3(x=x, y=y, z=z),
            late_offsets=int(self._cell.late_offsets),
            message=FAULT_REASON if fault else self._robot.retreat_message,
        )
        message.header.stamp, message.header.frame_id = self._now.stamp, "base_link"
        return message

    def diagnostics(self, speed_factor: float) -> DiagnosticArray:
        values = {
            "mode": MODE_NAMES[self._cell.mode],
            "in motion": self._robot.in_motion,
            "late offsets": self._cell.late_offsets,
            "expired force leases": self._robot.lease.expired,
            "speed factor": f"{speed_factor:g}",
        }
        fault = self._cell.mode == RobotState.MODE_FAULT
        level, text = (ERROR, FAULT_REASON) if fault else (OK, self._robot.retreat_message or "simulated")
        message = DiagnosticArray(status=[status(self._node, "robot", level, text, values, "simulator")])
        message.header.stamp = self._now.stamp
        return message
