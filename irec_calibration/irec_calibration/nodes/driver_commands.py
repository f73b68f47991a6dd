# SPDX-License-Identifier: Apache-2.0
"""What the driver for ros2_control robots takes of the contract: moves, control mode, force set points, offsets, clear_fault."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_ros.moves import RESULT_KEPT, answer_move
from irec_ros.senders import other_senders
from rclpy.action import ActionServer, CancelResponse
from scipy.spatial.transform import Rotation
from std_srvs.srv import Trigger

from irec_msgs.action import Move
from irec_msgs.srv import SetControlMode

from ..drivers.moves import Motion, MoveError, Planner
from ..drivers.position_robot import FORCE, Order, PositionRobot

FEEDBACK = 0.1  # s between two reports of a move


class DriverCommands:
    """Hands what others ask for to the robot, or refuses it with the reason."""

    def __init__(
        self, node: Any, robot: PositionRobot, planner: Planner, now: Callable[[], float], no_controller: Callable[[], str],
        no_force: Callable[[], str], changed: Callable[[], None],
    ) -> None:  # fmt: skip
        """As a driver hears others.

        Args:
            now: clock of leases and moves, s. changed: the control mode may have changed.
            no_controller, no_force: why nothing moves the robot, and why the force is not known; empty where all is well.
        """
        self._node, self._robot, self._planner = node, robot, planner
        self._now, self._changed = now, changed
        self._no_controller, self._no_force = no_controller, no_force
        self._outcome: dict[bytes, tuple[float, str]] = {}
        node.create_subscription(WrenchStamped, "robot/force_setpoint", self._on_force, 10)
        self._offset_topic = node.create_subscription(TransformStamped, "irec/offset", self._on_offset, 10).topic_name
        node.create_service(SetControlMode, "robot/set_control_mode", self._on_mode)
        node.create_service(Trigger, "robot/clear_fault", self._on_clear)
        self._action = ActionServer(
            node, Move, "robot/move", execute_callback=node.guarded("action robot/move", self._answer_move),
            handle_accepted_callback=node.guarded("goal of robot/move", self._accepted),
            cancel_callback=lambda _: CancelResponse.ACCEPT, result_timeout=RESULT_KEPT,
        )  # fmt: skip

    # --- moves ------------------------------------------------------------------------------------------------------------

    def _accepted(self, handle: Any) -> None:
        def ended(fraction: float, problem: str) -> None:
            self._outcome[bytes(handle.goal_id.uuid)] = fraction, problem
            handle.execute()

        told = [-1.0]

        def feedback(fraction: float) -> None:
            if self._now() - told[0] > FEEDBACK:
                told[0] = self._now()
                handle.publish_feedback(Move.Feedback(fraction=float(fraction)))

        try:
            self._robot.refuse_unless_free()
            _refuse_where(self._no_controller())
            motion = self._planned(handle.request)
            self._robot.begin(Order(motion, lambda: bool(handle.is_cancel_requested), feedback, ended), self._now())
        except MoveError as error:
            ended(0.0, str(error))

    def _planned(self, goal: Move.Goal) -> Motion:
        """The whole move from where the robot is. MoveError: it can't be made."""
        start = self._robot.commanded
        if goal.kind == Move.Goal.JOINT:
            if len(goal.joint_names) != len(goal.joint_position):
                raise MoveError(f"{len(goal.joint_names)} joint names with {len(goal.joint_position)} positions")
            wanted = dict(zip(goal.joint_names, goal.joint_position, strict=True))
            return self._planner.joint(start, wanted, goal.speed)
        if goal.kind == Move.Goal.LINEAR:
            p, o = goal.pose.position, goal.pose.orientation
            return self._planner.linear(start, np.array([p.x, p.y, p.z]), (o.x, o.y, o.z, o.w), goal.speed)
        raise MoveError(f"kind of move {goal.kind} is not known; 0 is JOINT, 1 is LINEAR")

    def _answer_move(self, handle: Any) -> Move.Result:
        return answer_move(handle, *self._outcome.pop(bytes(handle.goal_id.uuid)))

    # --- force, offset, fault ---------------------------------------------------------------------------------------------

    def _on_mode(self, request: SetControlMode.Request, response: SetControlMode.Response) -> SetControlMode.Response:
        f = request.force_in_tool

        def switch() -> None:
            if request.mode not in (SetControlMode.Request.POSITION, SetControlMode.Request.FORCE):
                raise MoveError(f"control mode {request.mode} is not known; 0 is POSITION, 1 is FORCE")
            force = request.mode == SetControlMode.Request.FORCE
            if force:
                _refuse_where(self._no_controller() or self._no_force())
            self._robot.switch(force, (f.x, f.y, f.z), self._now())

        response.force_lease, response.retract_distance = self._robot.settings.lease, self._robot.settings.retract
        response.success, response.message = self._try(switch)
        self._changed()
        return response

    @staticmethod
    def _try(action: Callable[[], None]) -> tuple[bool, str]:
        try:
            action()
        except MoveError as error:
            return False, str(error)
        return True, ""

    def _on_force(self, m: WrenchStamped) -> None:
        f = m.wrench.force
        if m.header.frame_id != "tool0":
            problem = f"its frame is '{m.header.frame_id}', tool0 is needed"
        elif self._robot.mode != FORCE:
            problem = "the robot is not in force control"
        else:
            _, problem = self._try(lambda: self._robot.set_force((f.x, f.y, f.z), self._now()))
        if problem:
            self._node.get_logger().warning(f"force set point ignored: {problem}", throttle_duration_sec=5.0)

    def _on_offset(self, m: TransformStamped) -> None:
        t, r = m.transform.translation, m.transform.rotation
        quat = np.array([r.x, r.y, r.z, r.w])
        problem = other_senders(self._node, self._offset_topic, 1)
        if problem:
            self._robot.fade_offset()
        elif m.header.frame_id != "base_link" or m.child_frame_id != "tool0":
            problem = f"its frames are '{m.header.frame_id}' and '{m.child_frame_id}', base_link and tool0 are needed"
        elif not abs(float(np.linalg.norm(quat)) - 1.0) <= 1e-3:
            problem = f"its rotation {quat} is no unit quaternion"
        else:
            turn = Rotation.from_quat(quat).as_rotvec()
            _, problem = self._try(lambda: self._robot.set_offset((t.x, t.y, t.z), turn.tolist(), self._now()))
        if problem:
            self._node.get_logger().warning(f"offset ignored: {problem}", throttle_duration_sec=5.0)

    def _on_clear(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        was = self._robot.message
        self._robot.clear_fault()
        response.success, response.message = True, f"position control; it was: {was or 'no fault'}"
        return response


def _refuse_where(problem: str) -> None:
    if problem:
        raise MoveError(problem)
