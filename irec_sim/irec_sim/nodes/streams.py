# SPDX-License-Identifier: Apache-2.0
"""What the cell publishes, each stream at its own rate of simulated time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

SENSOR_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def ros_time(t: float) -> Time:
    """Seconds as a stamp."""
    nanoseconds = round(t * 1e9)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


@dataclass
class Stream:
    """Calls `publish` so that it happens `rate` times per second of simulated time, on the grid of the steps."""

    rate: float
    publish: Callable[[], Any]

    def due(self, step: int, period: float) -> bool:
        """Whether one more publication falls into step number `step` of length `period` s."""
        per_step = self.rate * period
        return int(step * per_step + 1e-9) > int((step - 1) * per_step + 1e-9)


class Streams:
    """Publishes what is due after each step."""

    def __init__(self, streams: Sequence[Stream], period: float) -> None:
        self._streams, self._period = streams, period
        self._steps = 0

    def after_step(self) -> None:
        self._steps += 1
        for stream in self._streams:
            if stream.due(self._steps, self._period):
                stream.publish()
