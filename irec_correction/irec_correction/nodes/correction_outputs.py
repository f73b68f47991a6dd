# SPDX-License-Identifier: Apache-2.0
"""What the correction publishes: offset, process wrench, state, diagnostics, and to a simulated cell that it keeps up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_ros.diagnostics import Diagnostics
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from irec_msgs.msg import CorrectionState

from ..correction import Correction, Output
from ..joint_offset import joint_offset
from ..state import State
from .chain_clock import ChainClock
from .messages import correction_status, fill_offset, fill_state, fill_wrench
from .model_checks import CheckedModel
from .offset_topics import JOINT_OFFSET, OFFSET, OffsetTopics

OUT_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
STATE_PERIOD = 0.1  # s
FOLLOW_PERIOD = 0.015  # s of the cell's clock between two messages to a simulated cell; by time, as a wrench may get lost


class CorrectionOutputs:
    """Publishers of one node.

    Attributes:
        entities: (destroy function, entity) of each.
        in_force: model that the state names.
        offsets: topics of the offset, open while one is asked for.
    """

    def __init__(
        self, node: Node, correction: Correction, clock: ChainClock, serial: str, offset_frame: str, diagnostics: Diagnostics,
        outputs: tuple[bool, bool] = (True, False), joint_names: Sequence[str] = (),
    ) -> None:  # fmt: skip
        """outputs: whether irec/offset and irec/joint_offset are sent; joint_names: as the driver calls them."""
        self._node, self._correction, self._clock = node, correction, clock
        self._serial, self._offset_frame = serial, offset_frame
        self._offset, self._state, self._process = TransformStamped(), CorrectionState(), WrenchStamped()
        self._follower = Header(frame_id=node.get_name())
        self._followed = -1.0
        self._state_sent: tuple[float, State | None] = (-1.0, None)
        self.entities: list[tuple[Any, Any]] = []
        self.in_force: CheckedModel | None = None
        kinds = {OFFSET: TransformStamped} if outputs[0] else {}
        self.offsets = OffsetTopics(node, kinds | ({JOINT_OFFSET: JointTrajectory} if outputs[1] else {}), OUT_QOS)
        self._with_joints = outputs[1]
        self._joints = JointTrajectory(joint_names=list(joint_names), points=[JointTrajectoryPoint()])
        self._state_out = self._publisher(CorrectionState, "irec/correction/state")
        self._process_out = self._publisher(WrenchStamped, "irec/wrench_process")
        self._follower_out = self._publisher(Header, "sim/follower") if clock.simulated else None
        self._diagnostics = diagnostics

    def _publisher(self, kind: Any, topic: str) -> Any:
        made = self._node.create_publisher(kind, topic, OUT_QOS)
        self.entities.append((self._node.destroy_publisher, made))
        return made

    def publish(self, now: float, out: Output) -> None:
        """One tick."""
        stamp = self._clock.stamp(now)
        self._offset.header.stamp = stamp
        fill_offset(self._offset, out, self._offset_frame)
        self.offsets.publish(OFFSET, self._offset)
        if self._with_joints and self.offsets.is_open:
            step = joint_offset(self._correction.robot, self._correction.joint_angles, out.translation, out.rotation)
            self._joints.header.stamp = stamp
            self._joints.points[0].positions = step.tolist()
            self.offsets.publish(JOINT_OFFSET, self._joints)
        self.offsets.close_after(self._correction.at_rest, now)
        fill_wrench(self._process, stamp, out.wrench_at_tcp)
        self._process_out.publish(self._process)
        self._publish_state(now, out)
        if self._follower_out is not None and not 0.0 <= now - self._followed < FOLLOW_PERIOD:
            self._followed = now
            self._follower.stamp = stamp
            self._follower_out.publish(self._follower)

    def _publish_state(self, now: float, out: Output) -> None:
        at, state = self._state_sent
        if state is out.state and 0.0 <= now - at < STATE_PERIOD:
            return
        if state is not out.state:
            text = f"{out.state.name}{': ' + out.reason if out.reason else ''}"
            if out.state in (State.HOLD, State.FADE, State.FAULT):
                self._node.get_logger().warning(text)
            else:  # rclpy wants one place in the code per severity
                self._node.get_logger().info(text)
        self._state_sent = (now, out.state)
        digest = self.in_force.sha256 if self.in_force is not None else ""
        fill_state(self._state, self._offset.header.stamp, out, self._correction.counts, self._serial, digest)
        self._state_out.publish(self._state)

    def publish_diagnostics(self, errors: str) -> None:
        """State, reason and counters. Args: errors: that no check has foreseen, since the last activation."""
        model = self.in_force
        about = [] if model is None else [model.changed(), *(f"model {model.path}: {doubt}" for doubt in model.doubts)]
        note = "; ".join(t for t in (errors, *about) if t)
        self._diagnostics.publish(correction_status(self._node, self._serial, self._correction, note))
