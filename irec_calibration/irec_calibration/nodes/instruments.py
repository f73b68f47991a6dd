# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to everything that the cell measures: serialized to the recording, decoded, checked, into the streams."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Header

from irec_msgs.msg import RobotState

from ..errors import RecordingError
from ..procedure.inputs import Inputs
from ..procedure.recorder import SessionRecorder
from ..typing import Array

RAW_READINGS, RAW_AGE = 12, 0.5  # of wrench_raw that are averaged, decoded only when asked for; s, the oldest of them
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
    """Feeds `inputs` always and the recording while there is one.

    A recording that fails, because the disk is full, is left alone from then on; `recording_problem` says so.
    """

    def __init__(
        self, node: Node, inputs: Inputs, on_robot_state: Callable[[RobotState], None], on_wrench: Callable[[], None]
    ) -> None:
        """on_wrench: called after each wrench that was taken, so that the procedure keeps up with a cell of any speed.

        In a cell without a tracker points that come all the same are recorded, for whoever wants to compare, and not read.
        """
        self._node, self.inputs, self._on_robot_state, self._on_wrench = node, inputs, on_robot_state, on_wrench
        self._recorder: SessionRecorder | None = None
        self.recording_problem = ""
        self._channels: dict[str, int] = {}
        self._types: dict[str, str] = {}
        self._wrenches = 0
        self._raw: deque[bytes] = deque(maxlen=RAW_READINGS)
        # a simulated cell that runs faster than real time waits for those who tell it how far they are
        simulated = bool(node.get_parameter("use_sim_time").value)
        self._follower = node.create_publisher(Header, "sim/follower", 10) if simulated else None
        self._raw_topic = node.resolve_topic_name("wrench_raw")
        self._subscribe("joint_states", JointState, self._joints)
        self._subscribe("tcp_pose", PoseStamped, self._tcp)
        self._subscribe("wrench", WrenchStamped, self._wrench)
        self._subscribe("wrench_raw", WrenchStamped, None)
        self._subscribe("tracker/point", PointStamped, self._marker if "marker" in inputs.streams.needed else None)
        self._subscribe("robot/state", RobotState, lambda _, m: self._on_robot_state(m))

    def raw_force(self, frame: str) -> Array | None:
        """Mean of the newest readings of wrench_raw, (3,), N; None where fewer came, they are old, or are not in this frame."""
        now = 1e-9 * self._node.get_clock().now().nanoseconds
        if len(self._raw) < RAW_READINGS:
            return None
        readings = [deserialize_message(data, WrenchStamped) for data in self._raw]
        if any(m.header.frame_id != frame or abs(now - _seconds(m)) > RAW_AGE for m in readings):
            return None
        force = np.array([[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z] for m in readings]).mean(axis=0)
        return force if np.isfinite(force).all() else None

    def find_temperatures(self) -> None:
        """Subscribe to every temperature/<name> that has appeared."""
        prefix = self._node.resolve_topic_name("temperature") + "/"
        for topic, types in self._node.get_topic_names_and_types():
            if topic.startswith(prefix) and topic not in self._types and TYPES[Temperature] in types:
                self._subscribe(topic, Temperature, partial(self._temperature, topic.removeprefix(prefix)))

    def record_to(self, recorder: SessionRecorder | None) -> None:
        """Write everything that comes in to this recording; None: to none."""
        self._recorder, self.recording_problem = recorder, ""
        self._channels = {} if recorder is None else {t: recorder.add_topic(t, name) for t, name in self._types.items()}

    def record(self, write: Callable[[SessionRecorder], None]) -> None:
        """Write something to the recording, if there is one that still works."""
        if self._recorder is None:
            return
        try:
            write(self._recorder)
        except RecordingError as error:
            self._recorder, self.recording_problem = None, f"the recording has failed: {error}"

    def _subscribe(self, topic: str, kind: Any, handle: Callable[[float, Any], None] | None) -> None:
        name = self._node.resolve_topic_name(topic)
        self._types[name] = TYPES[kind]

        def register(recorder: SessionRecorder) -> None:
            self._channels[name] = recorder.add_topic(name, TYPES[kind])

        self.record(register)
        qos = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        self._node.create_subscription(kind, name, partial(self._on_message, name, kind, handle), qos, raw=True)

    def _on_message(self, topic: str, kind: Any, handle: Callable[[float, Any], None] | None, data: bytes) -> None:
        now = self._node.get_clock().now().nanoseconds
        if topic in self._channels:
            self.record(lambda recorder: recorder.write_raw(self._channels[topic], data, now))
        if topic == self._raw_topic:
            self._raw.append(data)
        if handle is not None:
            handle(1e-9 * now, deserialize_message(data, kind))

    def _joints(self, now: float, m: JointState) -> None:
        self.inputs.joints(now, _seconds(m), m.name, m.position)

    def _tcp(self, now: float, m: PoseStamped) -> None:
        p, o = m.pose.position, m.pose.orientation
        self.inputs.tcp(now, _seconds(m), m.header.frame_id, (p.x, p.y, p.z), (o.x, o.y, o.z, o.w))

    def _wrench(self, now: float, m: WrenchStamped) -> None:
        f, t = m.wrench.force, m.wrench.torque
        self.inputs.wrench(now, _seconds(m), m.header.frame_id, (f.x, f.y, f.z), (t.x, t.y, t.z))
        self._wrenches += 1
        if self._follower is not None and self._wrenches % FOLLOW_EVERY == 0:
            self._follower.publish(Header(stamp=m.header.stamp, frame_id=self._node.get_fully_qualified_name()))
        self._on_wrench()

    def _marker(self, now: float, m: PointStamped) -> None:
        self.inputs.marker(now, _seconds(m), m.header.frame_id, (m.point.x, m.point.y, m.point.z))

    def _temperature(self, name: str, _: float, m: Temperature) -> None:
        self.inputs.temperature(name, m.temperature)


def _seconds(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec)
