# SPDX-License-Identifier: Apache-2.0
"""A client of a robot's driver that asks one thing after the other and keeps every message, for check_driver."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, WrenchStamped
from irec_ros.guard import GuardedNode
from rclpy.action import ActionClient
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from irec_msgs.action import Move
from irec_msgs.msg import RobotState
from irec_msgs.srv import SetControlMode

from ..driver_check.observed import Answer, Observation, Stream
from ..errors import IrecError
from ..typing import Array
from .rows import vector

STATUS_CANCELED = 5
PATIENCE = 90.0  # s of the machine's clock for an answer
RENEW = 0.1  # s of the cell's clock between force set points, and 0.05 between two words to a simulated cell
FOLLOW = 0.05
EITHER = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches every publisher
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
Values = Callable[[Any], Sequence[float]]


class NoAnswerError(IrecError):
    """The driver did not answer in time."""


def _pose(m: PoseStamped) -> Sequence[float]:
    p, o = m.pose.position, m.pose.orientation
    return (p.x, p.y, p.z, o.x, o.y, o.z, o.w)


def _wrench(m: WrenchStamped) -> Sequence[float]:
    f, t = m.wrench.force, m.wrench.torque
    return (f.x, f.y, f.z, t.x, t.y, t.z)


def _state(m: RobotState) -> Sequence[float]:
    return (m.mode, m.in_motion, m.offset.x, m.offset.y, m.offset.z, m.retreating, m.expired_leases)


READ: dict[str, tuple[type, Values]] = {
    "joint_states": (JointState, lambda m: m.position),
    "tcp_pose": (PoseStamped, _pose),
    "wrench": (WrenchStamped, _wrench),
    "wrench_raw": (WrenchStamped, _wrench),
    "tracker/point": (PointStamped, lambda m: (m.point.x, m.point.y, m.point.z)),
    "robot/state": (RobotState, _state),
}


class DriverClient:
    """Subscriptions, moves, modes, forces and offsets of one driver. `wait` spins; all else returns when it is done."""

    def __init__(self, node: GuardedNode) -> None:
        self.node = node
        self._executor = EventsExecutor()
        self._executor.add_node(node)
        self._received: dict[str, list[tuple[float, float, Sequence[float], str, tuple[str, ...]]]] = defaultdict(list)
        self.description, self._said = "", dict[str, None]()
        for topic, (kind, values) in READ.items():
            node.create_subscription(kind, topic, lambda m, t=topic, v=values: self._receive(t, m, v), EITHER)
        node.create_subscription(String, "robot_description", self._on_description, LATCHED)
        self._move = ActionClient(node, Move, "robot/move")
        self._mode = node.create_client(SetControlMode, "robot/set_control_mode")
        self._force = node.create_publisher(WrenchStamped, "robot/force_setpoint", 10)
        self._offset = node.create_publisher(TransformStamped, "irec/offset", 10)
        self.simulated = bool(node.get_parameter("use_sim_time").value)
        self._follower = node.create_publisher(Header, "sim/follower", 10) if self.simulated else None
        self.pressing: Array | None = None  # set point that is renewed while waiting, N
        self.correcting: Array | None = None  # offset that is sent with each wrench, m
        self._corrected: list[float] = []  # when one was sent, s of the cell's clock
        self.cancelled_at: Array | None = None  # TCP when the last cancel was sent, (3,), m in base_link
        self._followed = self._renewed = 0.0

    @property
    def now(self) -> float:
        """The cell's clock, s."""
        return float(self.node.get_clock().now().nanoseconds * 1e-9)

    def _on_description(self, m: String) -> None:
        self.description = m.data

    def _receive(self, topic: str, m: Any, values: Values) -> None:
        now, stamp = self.now, m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        names = tuple(m.name) if isinstance(m, JointState) else ()
        self._received[topic].append((stamp, now, values(m), m.header.frame_id, names))
        if isinstance(m, RobotState) and m.message:
            self._said[m.message] = None
        if topic != "wrench":
            return
        if self._follower is not None and now - self._followed > FOLLOW:
            self._followed = now
            self._follower.publish(Header(stamp=m.header.stamp, frame_id=self.node.get_fully_qualified_name()))
        if self.pressing is not None and now - self._renewed > RENEW:
            self._renewed = now
            message = WrenchStamped()
            message.header.frame_id, message.header.stamp = "tool0", m.header.stamp
            message.wrench.force = vector(self.pressing)
            self._force.publish(message)
        if self.correcting is not None:
            offset = TransformStamped(child_frame_id="tool0")
            offset.header.frame_id, offset.header.stamp = "base_link", self.node.get_clock().now().to_msg()
            offset.transform.translation = vector(self.correcting)
            self._offset.publish(offset)
            self._corrected.append(self.now)

    def longest_without_offset(self, begin: float, end: float) -> float:
        """The longest time between two times of the cell's clock in which no offset was sent, s."""
        sent = [t for t in self._corrected if begin < t < end]
        return max(b - a for a, b in pairwise([begin, *sent, end]))

    def wait(self, until: Callable[[], bool], what: str, patience: float = PATIENCE) -> None:
        """Spin until it holds. NoAnswerError after `patience` s of the machine's clock."""
        end = time.monotonic() + patience
        while not until():
            if time.monotonic() > end:
                raise NoAnswerError(f"no {what} within {patience:g} s")
            self._executor.spin_once(timeout_sec=0.05)

    def pause(self, seconds: float) -> tuple[float, float]:
        """Listen for a time of the cell's clock; returns its begin and end, s."""
        begin = self.now
        self.wait(lambda: self.now >= begin + seconds, f"time on the clock (use_sim_time? {seconds:g} s)")
        return begin, self.now

    def discover(self, patience: float = 15.0) -> list[str]:
        """Wait for action and service; returns what is missing."""
        parts = {"action robot/move": self._move.server_is_ready, "service robot/set_control_mode": self._mode.service_is_ready}
        try:
            self.wait(lambda: all(ready() for ready in parts.values()), "driver", patience)
        except NoAnswerError:
            pass
        return [name for name, ready in parts.items() if not ready()]

    def seen(self, begin: float, end: float) -> Observation:
        """What arrived between two times of the cell's clock, s."""
        o = Observation({}, self.description, self._is_latched(), tuple(self._said))
        for topic, received in self._received.items():
            part = [h for h in received if begin < h[1] <= end]
            if not part:
                continue
            names, size = part[-1][4], len(part[-1][2])
            same = [h for h in part if len(h[2]) == size]
            o.streams[topic] = Stream(
                np.array([h[0] for h in same]), np.array([h[1] for h in same]),
                np.array([h[2] for h in same], dtype=float).reshape(len(same), size), tuple(h[3] for h in same), names,
                self._is_reliable(topic),
            )  # fmt: skip
        return o

    def _is_reliable(self, topic: str) -> bool:
        offers = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(topic))
        return all(o.qos_profile.reliability == ReliabilityPolicy.RELIABLE for o in offers)

    def _is_latched(self) -> bool:
        offers = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name("robot_description"))
        return all(o.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)

    def last(self, topic: str) -> Array:
        """Newest values of a topic. NoAnswerError where there are none."""
        self.wait(lambda: bool(self._received[topic]), f"message on {topic}")
        return np.array(self._received[topic][-1][2], dtype=float)

    def newest(self, topic: str, n: int) -> Array:
        """Values of the newest n messages of a topic, oldest first, (n, m) or fewer."""
        return np.array([values for _, _, values, _, _ in self._received[topic][-n:]], dtype=float)

    def joints(self, names: Sequence[str]) -> Array:
        """Newest positions in this order."""
        self.wait(lambda: bool(self._received["joint_states"]), "message on joint_states")
        _, _, position, _, given = self._received["joint_states"][-1]
        return np.array([position[given.index(name)] for name in names])

    def tcp(self) -> tuple[Array, Array]:
        """Newest TCP in base_link: (3,), m, and rotation (3, 3)."""
        value = self.last("tcp_pose")
        return value[:3], Rotation.from_quat(value[3:]).as_matrix()

    def move_joints(self, names: Sequence[str], q: Array, speed: float, cancel_after: float | None = None) -> Answer:
        """Point to point; cancel_after: s of the cell's clock."""
        goal = Move.Goal(kind=Move.Goal.JOINT, joint_names=list(names), joint_position=[float(v) for v in q], speed=speed)
        return self._do(goal, cancel_after)

    def move_line(
        self, p: Array, R: Array, speed: float, cancel_after: float | None = None, cancel_when: Callable[[], bool] | None = None
    ) -> Answer:
        """Straight; m, rotation matrix, m/s. cancel_when: asked with every message that comes while it moves."""
        goal = Move.Goal(kind=Move.Goal.LINEAR, speed=speed)
        goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = (float(v) for v in p)
        o = goal.pose.orientation
        o.x, o.y, o.z, o.w = (float(v) for v in Rotation.from_matrix(np.array(R)).as_quat())
        return self._do(goal, cancel_after, cancel_when)

    def _do(self, goal: Move.Goal, cancel_after: float | None, cancel_when: Callable[[], bool] | None = None) -> Answer:
        begin, self.cancelled_at = self.now, None
        sent = self._move.send_goal_async(goal)
        self.wait(sent.done, "answer to a goal of robot/move")
        handle = sent.result()
        if not handle.accepted:
            return Answer(False, "the goal was rejected; accept it and abort it with the reason", self.now - begin)
        result = handle.get_result_async()
        if cancel_after is not None:
            self.pause(cancel_after)
        elif cancel_when is not None:
            self.wait(lambda: result.done() or cancel_when(), "end of a move")
        if cancel_after is not None or (cancel_when is not None and not result.done()):
            begin, self.cancelled_at = self.now, self.tcp()[0]
            handle.cancel_goal_async()
        self.wait(result.done, "end of a move")
        answer = result.result()
        return Answer(answer.result.success, answer.result.message, self.now - begin, answer.status == STATUS_CANCELED)

    def switch(self, mode: int, force: Array) -> tuple[Answer, float, float]:
        """Control mode; returns the answer, the lease, s, and the way back, m."""
        begin = self.now
        future = self._mode.call_async(SetControlMode.Request(mode=mode, force_in_tool=vector(force)))
        self.wait(future.done, "answer of robot/set_control_mode")
        r = future.result()
        return Answer(r.success, r.message, self.now - begin), float(r.force_lease), float(r.retract_distance)
