# SPDX-License-Identifier: Apache-2.0
"""Whether a correction is at work: what it adds to the pose would be measured as if the robot gave way by that."""

from __future__ import annotations

import math
import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from irec_msgs.msg import CorrectionState, RobotState

RECENT = 1.0  # s of the machine's clock; the state comes at 10 Hz
NO_OFFSET = 5e-6  # m, what the last step of a fade may leave
AT_REST = (CorrectionState.INACTIVE, CorrectionState.FAULT)
NAMES = {getattr(CorrectionState, name): name for name in ("RAMP_IN", "ACTIVE", "HOLD", "FADE")}


class CorrectionAtWork:
    """Listens to irec/correction/state; is told the robot's own state by whoever has it."""

    def __init__(self, node: Node) -> None:
        self._state, self._received = CorrectionState.INACTIVE, -math.inf
        either = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches reliable publishers too
        node.create_subscription(CorrectionState, "irec/correction/state", self._on_state, either)

    def _on_state(self, message: CorrectionState) -> None:
        self._state, self._received = message.state, time.monotonic()

    def problem(self, robot: RobotState | None) -> str:
        """Why nothing may be measured now, and what to do; empty where nothing corrects."""
        if self._state not in AT_REST and time.monotonic() - self._received < RECENT:
            what = f"irec/correction/state is {NAMES.get(self._state, self._state)}"
        elif robot is not None and math.hypot(robot.offset.x, robot.offset.y, robot.offset.z) > NO_OFFSET:
            offset = 1e3 * math.hypot(robot.offset.x, robot.offset.y, robot.offset.z)
            what = f"robot/state says that an offset of {offset:.3f} mm is applied"
        else:
            return ""
        return (
            f"a correction is at work: {what}. It would be measured as if the robot gave way by that; deactivate it "
            "(ros2 lifecycle set /correction_node deactivate) and start again"
        )
