# SPDX-License-Identifier: Apache-2.0
"""What the node looks at beside its inputs: who else sends an offset or an input, and whether the driver does what it is sent."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from irec_ros.senders import other_senders
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from irec_msgs.msg import RobotState

from ..correction import Correction, Output
from ..errors import ActivationError
from ..obedience import LATENCY, Obedience
from ..watchdog import Fault
from .chain_clock import ChainClock
from .input_senders import InputSenders, two_senders
from .offset_topics import OffsetTopics, refusal

QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LOOK = 0.02  # s between two looks for others that send an offset
NOBODY = 5.0  # s of correction without a message on robot/state: its driver reports nothing
# s of simulated time, which a busy machine may not follow: a cell is ahead of this node; it fades, as offsets come late
BEHIND, SIMULATED_LASTS = 0.3, 5.0


class CorrectionWatch:
    """Of one chain.

    Attributes:
        entities: (destroy function, entity) of what it takes.
        senders: of the inputs.
    """

    def __init__(
        self, node: Node, correction: Correction, clock: ChainClock, offsets: OffsetTopics, alone: Sequence[str], reports: bool
    ) -> None:  # fmt: skip
        """alone: inputs, beside joint_states, that one node may publish. reports: irec/offset is sent."""
        self._node, self._correction, self._clock, self._offsets, self._reports = node, correction, clock, offsets, reports
        self._looked = -1.0
        self._obedience = Obedience(LATENCY + BEHIND, SIMULATED_LASTS) if clock.simulated else Obedience()
        self._heard = self._told = False
        self._began: float | None = None

        def others(topic: str, own: int) -> str:
            return other_senders(node, node.resolve_topic_name(topic), own)

        self.senders = InputSenders(others, alone, "joint_states")
        state = node.create_subscription(RobotState, "robot/state", self._on_state, QOS)
        self.entities: list[tuple[Any, Any]] = [(node.destroy_subscription, state)]

    def check_start(self) -> None:
        """Raises ActivationError: another node sends an offset or an input."""
        if others := self._offsets.others():
            raise ActivationError(refusal(others))
        if others := self.senders.found_at_start():
            raise ActivationError(two_senders(others))

    def look(self, now: float) -> None:
        """Before a tick: two senders of an offset make it jump between theirs, each of them fades out; of two senders of an input
        nobody knows whom to believe. now: s."""
        if 0.0 <= now - self._looked < LOOK:
            return
        self._looked = now
        self._note("other sender", Fault.OTHER_SENDER, self._offsets.others() if self._offsets.is_open else "")
        self._note("sender of an input", Fault.OTHER_SENDER, self.senders.found())

    def sent(self, now: float, out: Output) -> None:
        """After a tick: what the driver was sent."""
        if self._correction.at_rest:
            if self._began is not None:
                self._rest()
            return
        if self._began is None:
            self._began = time.monotonic()
        self._obedience.sent(now, out.translation)
        if not (self._heard or self._told) and time.monotonic() - self._began > NOBODY:
            self._told = True
            self._node.get_logger().info("nobody publishes robot/state: whether the driver applies the offset is not seen")

    def _rest(self) -> None:
        self._began = None
        self._obedience.reset()
        self._correction.watchdog.clear("obedience")

    def _on_state(self, message: RobotState) -> None:
        self._heard = True
        fault = ""
        if message.mode == RobotState.MODE_FAULT:
            fault = f"the driver reports a fault: {message.message or 'it gives no reason'}; clear it, then activate again"
        self._note("robot", Fault.ROBOT_FAULT, fault)
        if self._began is None or not self._reports:
            return
        if message.mode != RobotState.MODE_POSITION or message.retreating:  # then it applies none, as it should
            self._obedience.reset()
            return
        stamp = self._clock.of(message.header.stamp)
        o = message.offset
        wrong = self._obedience.wrong(stamp, self._clock.now(stamp), np.array([o.x, o.y, o.z]))
        self._note("obedience", Fault.NOT_OBEYED, wrong)

    def _note(self, source: str, fault: Fault, text: str) -> None:
        watchdog = self._correction.watchdog
        if text:
            watchdog.refuse(source, fault, text)
        else:
            watchdog.clear(source)
