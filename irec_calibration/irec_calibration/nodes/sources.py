# SPDX-License-Identifier: Apache-2.0
"""Whether each reading of a run comes from one sender: those of two, one after the other, pass for one sensor that jumps."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from irec_ros.senders import other_senders

LOOK_EVERY = 1.0  # s of the machine's clock
PATIENCE = 25.0  # s, likewise, in a run, for what decides nothing at once; DDS takes 20 s to forget a driver that was killed
AT_ONCE = ("wrench", "joint_states", "tcp_pose")  # what says how hard the robot presses, and where it is


class SourceWatch:
    """Counts the publishers of the topics that a run reads, about once a second.

    Args:
        topics: relative name -> publishers that belong there.
    """

    def __init__(self, node: Any, topics: Mapping[str, int]) -> None:
        self._node, self._topics = node, dict(topics)
        self._found: dict[str, str] = {}  # topic -> who sends there
        self._since: dict[str, float] = {}  # machine's clock
        self._looked = -LOOK_EVERY

    def look(self) -> None:
        """Count again, where the last time is long enough ago."""
        now = time.monotonic()
        if now - self._looked < LOOK_EVERY:
            return
        self._looked = now
        for topic, own in self._topics.items():
            found = other_senders(self._node, self._node.resolve_topic_name(topic), own)
            if found:
                self._found[topic] = found
                self._since.setdefault(topic, now)
            else:
                self._found.pop(topic, None)
                self._since.pop(topic, None)

    @property
    def before_a_run(self) -> str:
        """Why none may begin now, in a sentence; empty where each topic has its sender, or none yet."""
        self.look()
        return _sentence(next(iter(self._found.values()), ""))

    @property
    def in_a_run(self) -> str:
        """Why the run under way has to end; empty where it may go on."""
        self.look()
        for topic, found in self._found.items():
            if topic in AT_ONCE or self._looked - self._since[topic] >= PATIENCE:
                return _sentence(found)
        return ""


def of_cell(without_tracker: bool, stations: int) -> dict[str, int]:
    """Topics that a run reads or records, and how many may send there: each tracker station may have a driver of its own."""
    topics = {"wrench": 1, "joint_states": 1, "tcp_pose": 1, "robot/state": 1, "wrench_raw": 1}
    return topics if without_tracker else {**topics, "tracker/point": max(1, stations)}


def _sentence(found: str) -> str:
    if not found:
        return ""
    return (
        f"{found}: the readings of several, one after the other, would be taken for those of one instrument; end all but the one"
        " that measures (a driver that was killed is forgotten after 20 s), or give the others another topic"
    )
