# SPDX-License-Identifier: Apache-2.0
"""The procedure's side of the robot contract: carries commands out one after the other and hands answers back."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile, ReliabilityPolicy
from scipy.spatial.transform import Rotation

from irec_msgs.action import Move
from irec_msgs.srv import SetControlMode

from ..procedure.axes import Axes
from ..procedure.commands import CancelMove, ForceSetpoint, MoveJoint, MoveLinear, SwitchMode
from ..procedure.machine import Procedure
from .rows import vector


class RobotLink:
    """Moves, control mode and force set points. A command waits until a cancelled move has come to rest."""

    def __init__(self, node: Any, axes: Axes) -> None:
        self._node, self._axes = node, axes
        self._move = ActionClient(node, Move, "robot/move")
        self._mode = node.create_client(SetControlMode, "robot/set_control_mode")
        depth = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self._force = node.create_publisher(WrenchStamped, "robot/force_setpoint", depth)
        self._queue: deque[Any] = deque()
        self._procedure: Procedure | None = None
        self._goal: Any = None  # handle of the move under way
        self._move_number = 0
        self._cancelling = False

    @property
    def namespace(self) -> str:
        """Of the node, e.g. /cell_a."""
        return str(self._node.get_namespace())

    @property
    def missing(self) -> str:
        """What the robot's driver does not offer yet, empty when all is there."""
        missing = []
        if not self._move.server_is_ready():
            missing.append("action robot/move")
        if not self._mode.service_is_ready():
            missing.append("service robot/set_control_mode")
        return ", ".join(missing)

    @property
    def rivals(self) -> str:
        """Who else sends force set points; empty where nobody does. Two procedures on one robot are one too many."""
        senders = self._node.get_publishers_info_by_topic(self._force.topic_name)
        if len(senders) < 2:
            return ""
        names = sorted({f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in senders})
        return f"{len(senders)} nodes publish {self._force.topic_name} ({', '.join(names)})"

    def leave_contact(self) -> None:
        """Without the procedure, which has failed: nothing more is sent but the way out of force control."""
        self._queue.clear()
        self._procedure = None
        self._cancel()
        self._mode.call_async(SetControlMode.Request(mode=SetControlMode.Request.POSITION))

    def attach(self, procedure: Procedure) -> None:
        """Answers go to this procedure from now on."""
        self._procedure, self._cancelling = procedure, False
        self._queue.clear()

    def do(self, command: Any) -> None:
        """Carry out one command of the procedure, after those before it."""
        self._queue.append(command)
        self._go_on()

    def _go_on(self) -> None:
        while self._queue and not self._cancelling:
            command = self._queue.popleft()
            if isinstance(command, CancelMove):
                self._cancel()
            elif isinstance(command, MoveJoint | MoveLinear):
                self._send_move(command)
            elif isinstance(command, SwitchMode):
                self._send_mode(command)
            elif isinstance(command, ForceSetpoint):
                self._send_force(command.force_in_tool)

    def _send_move(self, command: MoveJoint | MoveLinear) -> None:
        goal = Move.Goal(speed=float(command.speed))
        if isinstance(command, MoveJoint):
            goal.kind = Move.Goal.JOINT
            position = [*command.q, *([] if command.rail is None else [command.rail])]
            goal.joint_names = list(self._axes.driver[: len(position)])
            goal.joint_position = [float(v) for v in position]
        else:
            goal.kind = Move.Goal.LINEAR
            p, o = goal.pose.position, goal.pose.orientation
            p.x, p.y, p.z = (float(v) for v in command.p_in_base)
            o.x, o.y, o.z, o.w = (float(v) for v in Rotation.from_matrix(np.array(command.R_in_base)).as_quat())
        self._move_number += 1
        number = self._move_number
        accepted = self._node.guarded("action robot/move", lambda future: self._accepted(number, future))
        self._move.send_goal_async(goal).add_done_callback(accepted)

    def _accepted(self, number: int, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._ended(number, False, "refused by the robot")
            return
        self._goal = handle
        if self._cancelling:
            handle.cancel_goal_async()

        def ended(future: Any) -> None:
            result = future.result().result
            self._ended(number, result.success, result.message)

        handle.get_result_async().add_done_callback(self._node.guarded("action robot/move", ended))

    def _ended(self, number: int, success: bool, message: str) -> None:
        if number != self._move_number:
            return
        self._goal = None
        self._move_number += 1  # nothing more is expected of this move
        if self._cancelling:
            self._cancelling = False
            self._go_on()
        elif self._procedure is not None:
            self._procedure.move_finished(success, message)

    def _cancel(self) -> None:
        self._cancelling = True
        if self._goal is not None:
            self._goal.cancel_goal_async()

    def _send_mode(self, command: SwitchMode) -> None:
        mode = SetControlMode.Request.FORCE if command.force else SetControlMode.Request.POSITION
        request = SetControlMode.Request(mode=mode, force_in_tool=vector(command.force_in_tool))
        switched = self._node.guarded("service robot/set_control_mode", self._switched)
        self._mode.call_async(request).add_done_callback(switched)

    def _switched(self, future: Any) -> None:
        response = future.result()
        if self._procedure is not None:
            self._procedure.mode_switched(response.success, response.message, float(response.force_lease))

    def _send_force(self, force_in_tool: np.ndarray) -> None:
        message = WrenchStamped()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.header.frame_id = "tool0"
        message.wrench.force = vector(force_in_tool)
        self._force.publish(message)
