# SPDX-License-Identifier: Apache-2.0
"""A client of a cell for tests: keeps the last message of each stream and waits with a bound."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, Vector3, WrenchStamped
from rclpy.action import ActionClient
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

from irec_msgs.action import Move
from irec_msgs.msg import RobotState
from irec_msgs.srv import SetControlMode

STREAMS = {
    "joint_states": JointState,
    "tcp_pose": PoseStamped,
    "wrench": WrenchStamped,
    "wrench_raw": WrenchStamped,
    "tracker/point": PointStamped,
    "temperature/ambient": Temperature,
    "robot/state": RobotState,
    "/clock": Clock,
}
HEARD = (*STREAMS, "robot_description")
FOLLOWING = 0.05  # s of simulated time between two words to the cell
PATIENCE = 90.0  # s of the machine's clock


def seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


class Client:
    """Node with subscriptions to all streams of a cell. `got[topic]` are the messages so far, oldest first.

    While `follows` it tells the cell how far it is, so that a busy machine makes a test slower and not wrong.
    """

    def __init__(self) -> None:
        self.node = rclpy.create_node("client")
        self.follows = True
        self.told = 0.0
        self.pressing: tuple[float, float, float] | None = None  # set point that is renewed while waiting, N
        self.got: dict[str, list[Any]] = defaultdict(list)
        self.move = ActionClient(self.node, Move, "robot/move")
        self.mode = self.node.create_client(SetControlMode, "robot/set_control_mode")
        self.course = self.node.create_client(Trigger, "sim/run_course")
        self.clear = self.node.create_client(Trigger, "sim/clear_fault")
        # after the clients: a cell whose streams come in here has found the clients too, and they get its answers
        for topic, kind in STREAMS.items():
            self.node.create_subscription(kind, topic, self.got[topic].append, 2000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(String, "robot_description", self.got["robot_description"].append, latched)
        self.offset = self.node.create_publisher(TransformStamped, "irec/offset", 10)
        self.force = self.node.create_publisher(WrenchStamped, "robot/force_setpoint", 10)
        self.follower = self.node.create_publisher(Header, "sim/follower", 10)
        self._executor = EventsExecutor()
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leave the domain: a client that stays would be a listener in the tests that come after."""
        self._executor.shutdown()
        self.node.destroy_node()

    def wait(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
        """Spin until the condition is true; the test fails, saying what did not come, after `patience` s."""
        until = time.monotonic() + patience
        while not condition():
            if time.monotonic() > until:
                raise AssertionError(f"within {patience} s there was no {what}")
            self._executor.spin_once(timeout_sec=0.05)
            if self.follows and self.got["/clock"] and self.now > self.told + FOLLOWING:
                self.told = self.now
                self.follower.publish(Header(stamp=self.got["/clock"][-1].clock, frame_id="client"))
                self._renew()
        return condition()

    def _renew(self) -> None:
        if self.pressing is not None:
            message = WrenchStamped()
            message.header.frame_id = "tool0"
            message.wrench.force = Vector3(**dict(zip("xyz", self.pressing, strict=True)))
            self.force.publish(message)

    def wait_for_cell(self) -> None:
        ready = (self.move.server_is_ready, self.mode.service_is_ready, lambda: all(self.got[topic] for topic in HEARD))
        self.wait(lambda: all(condition() for condition in ready), "complete cell")

    @property
    def now(self) -> float:
        """Simulated time, s."""
        return seconds(self.got["/clock"][-1].clock)

    def wait_until(self, t: float) -> None:
        self.wait(lambda: self.now >= t, f"simulated time {t:.1f} s")

    def last(self, topic: str) -> Any:
        return self.got[topic][-1]

    def start_move(self, goal: Move.Goal) -> Any:
        """Send a goal; returns its handle."""
        future = self.move.send_goal_async(goal)
        self.wait(future.done, "answer to the goal")
        return future.result()

    def end_of(self, handle: Any) -> Any:
        """Wait for the end of a move; returns status and result."""
        future = handle.get_result_async()
        self.wait(future.done, "end of the move")
        return future.result()

    def go(self, q: Sequence[float], rail: float, speed: float = 1.0) -> Any:
        """Joint move to q (rad) and rail (m); returns the result."""
        names = [f"joint_{k + 1}" for k in range(6)] + ["ext_rail"]
        goal = Move.Goal(kind=Move.Goal.JOINT, joint_names=names, joint_position=[*map(float, q), float(rail)], speed=speed)
        return self.end_of(self.start_move(goal)).result

    def line(self, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0, speed: float = 0.1) -> Move.Goal:
        """Goal of a straight move from where the TCP is, in base_link, m."""
        pose = deepcopy(self.last("tcp_pose").pose)
        pose.position.x, pose.position.y, pose.position.z = (
            pose.position.x + dx,
            pose.position.y + dy,
            pose.position.z + dz,
        )
        return Move.Goal(kind=Move.Goal.LINEAR, pose=pose, speed=speed)

    def switch(self, mode: int, force: Sequence[float] = (0.0, 0.0, 0.0)) -> Any:
        self.pressing = tuple(map(float, force)) if mode == RobotState.MODE_FORCE else None  # type: ignore[assignment]
        request = SetControlMode.Request(mode=mode, force_in_tool=Vector3(**dict(zip("xyz", map(float, force), strict=True))))
        return self.call(self.mode, request)

    def call(self, client: Any, request: Any, patience: float = PATIENCE) -> Any:
        self.wait(client.service_is_ready, f"service {client.srv_name}")
        future = client.call_async(request)
        self.wait(future.done, f"answer of {client.srv_name}", patience)
        return future.result()

    def send_offset(self, x: float, y: float, z: float) -> None:
        message = TransformStamped(child_frame_id="tool0")
        message.header.frame_id = "base_link"
        message.header.stamp = self.got["/clock"][-1].clock
        translation = message.transform.translation
        translation.x, translation.y, translation.z = x, y, z
        self.offset.publish(message)


@contextmanager
def client() -> Iterator[Client]:
    rclpy.init()
    made = Client()
    try:
        yield made
    finally:
        made.close()
        rclpy.try_shutdown()
