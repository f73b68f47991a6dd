# SPDX-License-Identifier: Apache-2.0
"""What the RSI loop reports through shared memory, as messages: measurements, offset, process wrench, state, diagnostics."""

from __future__ import annotations

import time
from array import array
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped
from irec_calibration.typing import Array
from irec_ros.diagnostics import ERROR, WARN, Diagnostics, status
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from irec_msgs.msg import CorrectionState

from ..rsi.report import KEPT, REPORT_SIZE, WHERE, counts
from ..shared import SharedValues
from ..state import State
from .messages import LEVELS, fill_quaternion, fill_vector, fill_wrench
from .offset_topics import OFFSET, OffsetTopics

OUT_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
MONITOR_RATE = 100.0  # Hz
STATE_PERIOD = 0.1  # s
SILENT = 0.5  # s without a packet


class RsiMonitor:
    """Publishes on behalf of a node; no parameters, no subscriptions.

    Attributes:
        digest: SHA-256 of the model file in force.
        state: of the offset, as the loop has told it last.
        entities: how each publisher is destroyed, and the publisher.
    """

    def __init__(
        self, node: Node, report: SharedValues, latency: SharedValues, joint_names: list[str], serial: str, computes: bool,
        diagnostics: Diagnostics,
    ) -> None:  # fmt: skip
        """Args: computes: the offset comes from the loop; otherwise a correction node publishes offset, wrench and state."""
        self._node, self._report, self._latency, self._serial, self._computes = node, report, latency, serial, computes
        self._values = np.zeros(REPORT_SIZE)
        self._version = 0
        self.state, self._reason, self._problem, self.digest = State.INACTIVE, "not started", "", ""
        self._state_sent = -1.0
        self._joints, self._pose = JointState(name=joint_names), PoseStamped()
        self._pose.header.frame_id = "base_link"
        self._offset, self._process, self._state_message = TransformStamped(), WrenchStamped(), CorrectionState()
        self._offset.header.frame_id, self._offset.child_frame_id = "base_link", "tool0"
        self._joints_out = node.create_publisher(JointState, "joint_states", OUT_QOS)
        self._pose_out = node.create_publisher(PoseStamped, "tcp_pose", OUT_QOS)
        self._diagnostics = diagnostics
        self._offsets = OffsetTopics(node, {OFFSET: TransformStamped} if computes else {}, OUT_QOS)
        if computes:
            self._process_out = node.create_publisher(WrenchStamped, "irec/wrench_process", OUT_QOS)
            self._state_out = node.create_publisher(CorrectionState, "irec/correction/state", OUT_QOS)
        else:  # irec/correction/state is that of the correction node
            self._state_out = node.create_publisher(CorrectionState, "~/state", OUT_QOS)
        made = [self._joints_out, self._pose_out, self._state_out]
        made += [self._process_out] if computes else []
        self.entities = [(node.destroy_publisher, publisher) for publisher in made]
        self.entities.append((OffsetTopics.close, self._offsets))

    def take(self, kind: str, content: Any) -> None:
        """A message of the loop: ("state", (number, reason)) or ("problem", text, empty when it is over)."""
        log = self._node.get_logger()
        if kind == "problem":
            self._problem = content
            if content:
                log.error(f"RSI: {content}")
            else:
                log.info("RSI: the packets of the controller are in order again")
            return
        self.state, self._reason = State(content[0]), content[1]
        self._state_sent = -1.0
        if self.state in (State.HOLD, State.FADE, State.FAULT):
            log.warning(self._text)
        else:  # rclpy wants one place in the code per severity
            log.info(self._text)

    @property
    def others(self) -> str:
        """Who else sends an offset, where it is computed here; the robot gets ours by RSI all the same."""
        return self._offsets.others() if self._computes else ""

    @property
    def silence(self) -> float:
        """s since the newest packet of the controller; the time since the machine's start where there was none."""
        return time.monotonic() - float(self._values[WHERE["now"]][0])

    @property
    def _text(self) -> str:
        return f"{self.state.name}{': ' + self._reason if self._reason else ''}"

    def publish(self) -> None:
        """Publish what is new."""
        if self._report.version == self._version or not self._report.read(self._values):
            return
        self._version = self._report.version
        v, stamp = self._values, self._node.get_clock().now().to_msg()
        self._joints.header.stamp = self._pose.header.stamp = stamp
        self._joints.position = array("d", v[WHERE["q"]].tolist()[: len(self._joints.name)])
        self._joints_out.publish(self._joints)
        fill_vector(self._pose.pose.position, v[WHERE["p_tcp"]])
        fill_quaternion(self._pose.pose.orientation, Rotation.from_euler("ZYX", v[WHERE["abc"]]).as_rotvec())
        self._pose_out.publish(self._pose)
        if self._computes:
            at_rest = self.state in (State.INACTIVE, State.FAULT)
            if not at_rest:
                self._offsets.open()
            self._offsets.close_after(at_rest, time.monotonic())
            self._offset.header.stamp = stamp
            fill_vector(self._offset.transform.translation, v[WHERE["translation"]])
            fill_quaternion(self._offset.transform.rotation, v[WHERE["rotation"]])
            self._offsets.publish(OFFSET, self._offset)
            fill_wrench(self._process, stamp, v[WHERE["wrench"]])
            self._process_out.publish(self._process)
        if time.monotonic() - self._state_sent > STATE_PERIOD:
            self._state_sent = time.monotonic()
            self._publish_state(v, stamp)

    def _publish_state(self, v: Array, stamp: Any) -> None:
        s = self._state_message
        s.header.stamp, s.header.frame_id = stamp, "base_link"
        s.state, s.reason = int(self.state), self._reason
        fill_vector(s.deflection, v[WHERE["deflection"]])
        fill_vector(s.offset, v[WHERE["translation"]])
        fill_vector(s.wrench_process.force, v[WHERE["wrench"]][:3])
        fill_vector(s.wrench_process.torque, v[WHERE["wrench"]][3:])
        s.model_serial, s.model_sha256 = self._serial, self.digest
        _, limited, held, late = (int(x) for x in v[WHERE["chain"]])
        s.limited, s.held, s.late = limited, held, late
        self._state_out.publish(s)

    def publish_diagnostics(self, note: str = "") -> None:
        """State, reason, counters and latency. Args: note: what is not used of the inputs, and unexpected errors."""
        known: dict[str, float] = dict(counts(self._values))
        latency = self._latency.numbers[: max(1, min(int(known["answered"]), KEPT))]
        for name, share in (("p50", 50), ("p99", 99), ("max", 100)):
            known[f"latency_{name}_s"] = float(np.percentile(latency, share))
        level, text = LEVELS[self.state], self._text
        if self.silence > SILENT:
            level, text = WARN, f"no packet of the controller; {text}"
        if note:
            level, text = max(level, WARN), f"{text}; {note}"
        if self._problem:
            level, text = ERROR, self._problem
        self._diagnostics.publish(status(self._node, "link", level, text, known, self._serial))
