# SPDX-License-Identifier: Apache-2.0
"""What the robot takes: the Move action, the control mode, the force set point and the correction offset."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_ros.guard import GuardedNode
from irec_ros.moves import RESULT_KEPT, answer_move
from irec_ros.senders import other_senders
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.qos import QoSProfile, ReliabilityPolicy

from irec_msgs.action import Move
from irec_msgs.msg import RobotState
from irec_msgs.srv import SetControlMode

from ..cell import Cell
from ..errors import SimError
from ..kinematics import rotation_of_quaternion, rotation_vector
from ..lease import ForceLease, LeaseSettings
from ..motion import Move as Motion
from ..motion import joint_move, linear_move
from .loop import SimulationLoop

ARRIVAL_TIME = 0.15  # s that the servo is given to arrive at the end of the way: ten of its time constants
FEEDBACK_PERIOD = 0.1  # s of simulated time
FAULT_REASON = "the robot is in fault after a collision; the operator has to clear it"
LEAVING = "the robot is leaving the contact by itself: no force set point or no move came in time"
QUATERNION_TOLERANCE = 1e-3  # of the norm


@dataclass
class Order:
    """A move to be carried out; the callbacks run in the thread of the simulation.

    Attributes:
        cancelled: asked before each step. feedback: told the share of the way. ended: told the share when standing again,
            and the reason where the robot stopped by itself.
    """

    motion: Motion
    cancelled: Callable[[], bool]
    feedback: Callable[[float], None]
    ended: Callable[[float, str], None]
    since: float = 0.0
    fed_back: float = 0.0


class RobotSide:
    """Commands from topics, services and actions, carried to the plant between its steps."""

    def __init__(self, node: GuardedNode, cell: Cell, loop: SimulationLoop, rail_speed: float, lease: LeaseSettings) -> None:
        """rail_speed: velocity limit of the rail, m/s."""
        self._node, self._cell, self._loop, self.rail_speed = node, cell, loop, rail_speed
        self.lease = ForceLease(cell, lease)
        self.retreat_message = ""  # why the robot has left the contact by itself, until the next mode switch
        self._retreating = False
        self._running: Order | None = None
        self._outcome: dict[bytes, tuple[float, str]] = {}  # share of the way and problem, by id of the goal
        depth = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self._action = ActionServer(
            node,
            Move,
            "robot/move",
            execute_callback=node.guarded("action robot/move", self._answer_move, _not_answered),
            handle_accepted_callback=node.guarded("goal of robot/move", self._accepted, self._not_begun),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_KEPT,
        )
        node.create_service(SetControlMode, "robot/set_control_mode", self._on_mode)
        node.create_subscription(WrenchStamped, "robot/force_setpoint", self._on_force, depth)
        self._offset_topic = node.create_subscription(TransformStamped, "irec/offset", self._on_offset, depth).topic_name

    @property
    def in_motion(self) -> bool:
        return self._running is not None

    @property
    def retreating(self) -> bool:
        """The robot is on its way out of the contact by itself."""
        return self._retreating or self.lease.ramping

    def before_step(self) -> None:
        """Put the commanded position of the move under way; called in the thread of the simulation."""
        self._watch_lease()
        run = self._running
        if run is None:
            return
        if self._cell.mode == RobotState.MODE_FAULT:
            self._running = None
            run.ended(0.0, FAULT_REASON)
            return
        t = self._cell.time + self._cell.period - run.since
        if run.cancelled():
            run.motion.way.stop(t)
        self._cell.command(*run.motion.at(run.motion.way.distance(t)))
        fraction = run.motion.fraction(t)
        if t - run.fed_back >= FEEDBACK_PERIOD:
            run.fed_back = t
            run.feedback(fraction)
        if run.motion.way.done(t - ARRIVAL_TIME):
            self._running = None
            run.ended(fraction, "")

    def _watch_lease(self) -> None:
        try:
            way_out = self.lease.step(self.in_motion)
        except SimError as error:
            self.retreat_message = f"{self.lease.reason}; but the way back is barred: {error}"
            return
        if way_out is None:
            return
        self.retreat_message, self._retreating = self.lease.reason, True
        self._node.get_logger().warning(self.retreat_message)

        def ended(_: float, problem: str) -> None:
            self._retreating = False
            self.retreat_message += f"; {problem}" if problem else ""

        self._running = Order(way_out, lambda: False, lambda _: None, ended, self._cell.time)

    def begin(self, order: Order) -> None:
        """Start a move; from any thread. SimError in force control or while another move is under way."""

        def start() -> None:
            self._refuse_unless_free()
            order.since = self._cell.time
            self._running = order

        self._loop.call(start)

    def _accepted(self, handle: ServerGoalHandle) -> None:
        """Begin the move. The goal is executed when the move has ended: an executor polls a callback that waits."""

        def ended(fraction: float, problem: str) -> None:
            self._outcome[bytes(handle.goal_id.uuid)] = fraction, problem
            handle.execute()

        try:
            self._start(handle, ended)
        except SimError as error:
            ended(0.0, str(error))

    def _not_begun(self, error: Exception, handle: ServerGoalHandle) -> None:
        self._outcome[bytes(handle.goal_id.uuid)] = 0.0, f"unexpected error: {type(error).__name__}: {error}"
        handle.execute()

    def _answer_move(self, handle: ServerGoalHandle) -> Move.Result:
        return answer_move(handle, *self._outcome.pop(bytes(handle.goal_id.uuid)))

    def _start(self, handle: ServerGoalHandle, ended: Callable[[float, str], None]) -> None:
        self._refuse_unless_free()
        goal: Move.Goal = handle.request
        start = self._loop.call(lambda: self._cell.commanded)
        motion = self._joint(goal, start) if goal.kind == Move.Goal.JOINT else self._linear(goal, start)
        order = Order(
            motion,
            cancelled=lambda: bool(handle.is_cancel_requested),
            feedback=lambda fraction: handle.publish_feedback(Move.Feedback(fraction=float(fraction))),
            ended=ended,
        )
        self.begin(order)

    def _refuse_unless_free(self) -> None:
        if self._cell.mode == RobotState.MODE_FAULT:
            raise SimError(FAULT_REASON)
        if self.retreating:
            raise SimError(LEAVING)
        if self._cell.mode != RobotState.MODE_POSITION:
            raise SimError("moves are refused in force control; switch to position control first")
        if self._running is not None:
            raise SimError("another move is under way; cancel it first")

    def _joint(self, goal: Move.Goal, start: tuple[np.ndarray, float]) -> Motion:
        if not 0.0 < goal.speed <= 1.0:
            raise SimError(f"speed of a joint move is {goal.speed}, a share of the velocity limits in (0, 1] is needed")
        if len(goal.joint_names) != len(goal.joint_position):
            raise SimError(f"{len(goal.joint_names)} joint names with {len(goal.joint_position)} positions")
        wanted = dict(zip(goal.joint_names, goal.joint_position, strict=True))
        names = self._cell.chain.joint_names
        for name, value in wanted.items():
            if name not in names and name not in self._cell.rail_names:
                known = ", ".join((*names, *self._cell.rail_names))
                raise SimError(f"joint '{name}' is not known; this robot has {known}")
            if not math.isfinite(value):
                raise SimError(f"position of {name} is {value}, a finite number is needed")
        q, rail = start
        target = np.array([wanted.get(name, q[k]) for k, name in enumerate(names)])
        goal_rail = float(next((wanted[name] for name in self._cell.rail_names if name in wanted), rail))
        low, high = self._cell.rail_range
        if not low <= goal_rail <= high:
            raise SimError(f"the rail can't go to {goal_rail} m: its range is {low} to {high} m")
        return joint_move(self._cell.chain, start, (target, goal_rail), goal.speed, self.rail_speed)

    def _linear(self, goal: Move.Goal, start: tuple[np.ndarray, float]) -> Motion:
        if goal.kind != Move.Goal.LINEAR:
            raise SimError(f"kind of move {goal.kind} is not known; 0 is JOINT, 1 is LINEAR")
        if not (goal.speed > 0.0 and math.isfinite(goal.speed)):
            raise SimError(f"speed of a linear move is {goal.speed}, a positive number in m/s is needed")
        p, o = goal.pose.position, goal.pose.orientation
        p_goal, quaternion = np.array([p.x, p.y, p.z]), np.array([o.x, o.y, o.z, o.w])
        if not np.isfinite(p_goal).all() or abs(np.linalg.norm(quaternion) - 1.0) > QUATERNION_TOLERANCE:
            raise SimError(f"pose {p_goal}, {quaternion} is no pose: finite numbers and a unit quaternion are needed")
        return linear_move(self._cell.chain, *start, p_goal, rotation_of_quaternion(quaternion), goal.speed)

    def _on_mode(self, request: SetControlMode.Request, response: SetControlMode.Response) -> SetControlMode.Response:
        f = request.force_in_tool
        force = np.array([f.x, f.y, f.z])

        def switch() -> None:
            if self.retreating:
                raise SimError(LEAVING)
            if self._running is not None:
                raise SimError("a move is under way; cancel it before switching the control mode")
            if request.mode == SetControlMode.Request.FORCE:
                self._cell.control_force(_finite(force, "first set point"))
                self.lease.renew()
            elif request.mode != SetControlMode.Request.POSITION:
                raise SimError(f"control mode {request.mode} is not known; 0 is POSITION, 1 is FORCE")
            elif self._cell.mode != RobotState.MODE_POSITION:
                self._cell.control_position()
                self.lease.left_force_control()
            self.retreat_message = ""

        response.force_lease = float(self.lease.settings.hold)
        response.retract_distance = float(self.lease.settings.distance)
        return self._answer(response, switch)

    def _answer(self, response: Any, action: Callable[[], None]) -> Any:
        try:
            self._loop.call(action)
            response.success = True
        except SimError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_force(self, message: WrenchStamped) -> None:
        f = message.wrench.force
        force = np.array([f.x, f.y, f.z])

        def take() -> None:
            if message.header.frame_id != "tool0":
                raise SimError(f"its frame is '{message.header.frame_id}', tool0 is needed")
            if self.retreating:
                raise SimError("it came too late, the robot is leaving the contact")
            self._cell.set_force(_finite(force, "force set point"))
            self.lease.renew()

        try:
            self._loop.call(take)
        except SimError as error:
            self._node.get_logger().warning(f"force set point ignored: {error}", throttle_duration_sec=5.0)

    def _on_offset(self, message: TransformStamped) -> None:
        if others := other_senders(self._node, self._offset_topic, 1):
            self._loop.call(self._cell.fade_offset)
            self._node.get_logger().warning(f"offset ignored: {others}", throttle_duration_sec=5.0)
            return
        t, r = message.transform.translation, message.transform.rotation
        translation, quaternion = np.array([t.x, t.y, t.z]), np.array([r.x, r.y, r.z, r.w])
        if not np.isfinite(translation).all() or abs(np.linalg.norm(quaternion) - 1.0) > QUATERNION_TOLERANCE:
            self._node.get_logger().warning(
                f"offset ignored: {translation}, {quaternion} is no transform", throttle_duration_sec=5.0
            )
            return
        turn = rotation_vector(rotation_of_quaternion(quaternion))
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._loop.call(lambda: self._cell.set_offset(translation, turn, stamp))


def _not_answered(error: Exception, handle: ServerGoalHandle) -> Move.Result:
    return Move.Result(success=False, message=f"unexpected error: {type(error).__name__}: {error}")


def _finite(force: np.ndarray, what: str) -> np.ndarray:
    if not np.isfinite(force).all():
        raise SimError(f"{what} is {force}, finite numbers are needed")
    return force
