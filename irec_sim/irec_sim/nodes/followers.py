# SPDX-License-Identifier: Apache-2.0
"""Keeps simulated time from running away from the nodes that asked not to be outrun."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header

# s of the machine's clock; a follower that is silent for longer is gone. Shorter than the 1.5 s of silence for which a
# procedure lets the robot press: a node that was killed while it was waited for must not look like a dead driver
PATIENCE = 1.0


class Followers:
    """Followers publish what they have worked off; `may_go_on` holds the simulation until all are near enough."""

    def __init__(self, node: Node, max_lead: float) -> None:
        """max_lead: s of simulated time."""
        self._node, self._max_lead = node, max_lead
        self._seen: dict[str, tuple[float, float]] = {}
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        node.create_subscription(Header, "sim/follower", self._on_follower, qos)

    def may_go_on(self, now: float) -> bool:
        """Whether every living follower has worked off everything up to `max_lead` before now (s)."""
        for name, (done, since) in list(self._seen.items()):
            if now - done > self._max_lead:
                if time.monotonic() - since < PATIENCE:
                    return False
                del self._seen[name]
                self._node.get_logger().warning(f"follower {name} is silent for {PATIENCE:g} s and not waited for any more")
        return True

    def _on_follower(self, message: Header) -> None:
        self._seen[message.frame_id] = (message.stamp.sec + 1e-9 * message.stamp.nanosec, time.monotonic())
