# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to everything that the cell measures: serialized to the recording, decoded into the streams."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Header

from irec_msgs.msg import RobotState

from ..procedure.recorder import SessionRecorder
from ..procedure.settle import Streams

FOLLOW_EVERY = 2  # wrenches
QUEUE_DEPTH = 5000  # messages; a node that is held up for seconds loses nothing of a recording
TYPES = {
    JointState: "sensor_msgs/msg/JointState",
    PoseStamped: "geometry_msgs/msg/PoseStamped",
    WrenchStamped: "geometry_msgs/msg/WrenchStamped",
    PointStamped: "geometry_msgs/msg/PointStamped",
    Temperature: "sensor_msgs/msg/Temperature",
    RobotState: "irec_msgs/msg/RobotState",
}


class Instruments:
    """Feeds `streams` while a run is under way and `recorder` while there is one."""

    def __init__(self, node: Node, streams: Streams, on_robot_state: Callable[[RobotState], None]) -> None:
        self._node, self.streams, self._on_robot_state = node, streams, on_robot_state
        self._recorder: SessionRecorder | None = None
        self._channels: dict[str, int] = {}
        self._types: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        # a simulated cell that runs faster than real time waits for those who tell it how far they are
        simulated = bool(node.get_parameter("use_sim_time").value)
        self._follower = node.create_publisher(Header, "sim/follower", 10) if simulated else None
        self._subscribe("joint_states", JointState, self._joints)
        self._subscribe("tcp_pose", PoseStamped, self._tcp)
        self._subscribe("wrench", WrenchStamped, self._wrench)
        self._subscribe("wrench_raw", WrenchStamped, None)
        self._subscribe("tracker/point", PointStamped, self._marker)
        self._subscribe("robot/state", RobotState, self._on_robot_state)

    def find_temperatures(self) -> None:
        """Subscribe to every temperature/<name> that has appeared."""
        prefix = self._node.resolve_topic_name("temperature") + "/"
        for topic, types in self._node.get_topic_names_and_types():
            if topic.startswith(prefix) and topic not in self._types and TYPES[Temperature] in types:
                self._subscribe(topic, Temperature, partial(self._temperature, topic.removeprefix(prefix)))

    def record_to(self, recorder: SessionRecorder | None) -> None:
        """Write everything that comes in to this recording; None: to none."""
        self._recorder = recorder
        self._channels = {} if recorder is None else {t: recorder.add_topic(t, name) for t, name in self._types.items()}

    def _subscribe(self, topic: str, kind: Any, handle: Callable[[Any], None] | None) -> None:
        name = self._node.resolve_topic_name(topic)
        self._types[name] = TYPES[kind]
        if self._recorder is not None:
            self._channels[name] = self._recorder.add_topic(name, TYPES[kind])
        qos = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        self._node.create_subscription(kind, name, partial(self._on_message, name, kind, handle), qos, raw=True)

    def _on_message(self, topic: str, kind: Any, handle: Callable[[Any], None] | None, data: bytes) -> None:
        self.counts[topic] = self.counts.get(topic, 0) + 1
        if self._recorder is not None:
            self._recorder.write_raw(self._channels[topic], data, self._node.get_clock().now().nanoseconds)
        if handle is not None:
            handle(deserialize_message(data, kind))

    def _joints(self, m: JointState) -> None:
        self.streams.add_joints(_seconds(m), tuple(m.name), tuple(m.position))

    def _tcp(self, m: PoseStamped) -> None:
        p = m.pose.position
        self.streams.add_tcp(_seconds(m), p.x, p.y, p.z)

    def _wrench(self, m: WrenchStamped) -> None:
        f, t = m.wrench.force, m.wrench.torque
        self.streams.add_wrench(_seconds(m), (f.x, f.y, f.z, t.x, t.y, t.z))
        if self._follower is not None and self.streams.counts["force"] % FOLLOW_EVERY == 0:
            self._follower.publish(Header(stamp=m.header.stamp, frame_id=self._node.get_name()))

    def _marker(self, m: PointStamped) -> None:
        self.streams.add_marker(_seconds(m), m.point.x, m.point.y, m.point.z, m.header.frame_id)

    def _temperature(self, name: str, m: Temperature) -> None:
        self.streams.temperature[name] = m.temperature


def _seconds(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)
