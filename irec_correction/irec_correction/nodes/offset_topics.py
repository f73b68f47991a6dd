# SPDX-License-Identifier: Apache-2.0
"""The topics by which a robot gets its offset, and who else sends on them: a publisher exists only while an offset is asked for.

A node that waits has none, so whoever takes the offset sees two publishers only where two nodes want to correct one robot.
"""

from __future__ import annotations

import time
from typing import Any

from irec_ros.senders import other_senders
from rclpy.node import Node

OFFSET, JOINT_OFFSET = "irec/offset", "irec/joint_offset"
DISCOVERY = 1.0  # s from the start of a node until it knows who else is on the graph
LINGER = 0.2  # s of zeros, for those who take the offset: before it follows the model, as a new topic has to be found; at the end


class OffsetTopics:
    """Publishers of one node on these topics, from `open` to `close`."""

    def __init__(self, node: Node, kinds: dict[str, Any], qos: Any) -> None:
        """kinds: topics that this node sends on, with the type of each."""
        self._node, self._kinds, self._qos = node, kinds, qos
        self._names = {topic: node.resolve_topic_name(topic) for topic in (OFFSET, JOINT_OFFSET)}
        self._publishers: dict[str, Any] = {}
        self._rests_since: float | None = None

    @property
    def is_open(self) -> bool:
        return bool(self._publishers)

    def others(self) -> str:
        """Who else sends an offset, on any of the topics; empty where nobody does."""
        found = [other_senders(self._node, name, int(topic in self._publishers)) for topic, name in self._names.items()]
        return "; ".join(text for text in found if text)

    def open(self) -> None:
        """Create the publishers; nothing where they are there."""
        self._rests_since = None
        if not self.is_open:
            self._publishers = {topic: self._node.create_publisher(kind, topic, self._qos) for topic, kind in self._kinds.items()}

    def publish(self, topic: str, message: Any) -> None:
        """Send, where this node sends on the topic now."""
        if topic in self._publishers:
            self._publishers[topic].publish(message)

    def close_after(self, at_rest: bool, now: float) -> None:
        """Close LINGER s after the offset has come to rest. now: s."""
        if not (self.is_open and at_rest):
            self._rests_since = None
        elif self._rests_since is None or now < self._rests_since:
            self._rests_since = now
        elif now - self._rests_since >= LINGER:
            self.close()

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self._publishers = {}


def wait_for_discovery(began: float) -> None:
    """Until a node that was made at `began` (CLOCK_MONOTONIC, s) knows who is there."""
    time.sleep(max(0.0, began + DISCOVERY - time.monotonic()))


def refusal(others: str) -> str:
    """Why a correction is not begun beside another sender."""
    return (
        f"an offset is sent by others already: {others}; end that one first"
        " (one that was killed is forgotten after half a minute at most)"
    )
