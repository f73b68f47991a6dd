# SPDX-License-Identifier: Apache-2.0
"""What the cell publishes, each stream at its own rate of simulated time, and quick serialization of what comes often."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from irec_ros.cdr import exact_cdr
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


class Template:
    """A message that begins with a stamp and holds a row of numbers, serialized once; both are then written over.

    Several times as quick as filling a message and serializing it. A message that is not laid out so is refused.
    """

    _STAMP = 4  # bytes before it: the CDR header

    def __init__(self, message: Any, numbers: Sequence[float]) -> None:
        """numbers: the float64 numbers that stand one after the other in this message and nowhere else in it."""
        self._data = bytearray(exact_cdr(message))
        self._numbers = struct.Struct(f"<{len(numbers)}d")
        pattern = self._numbers.pack(*numbers)
        self._at = self._data.find(pattern)
        if self._data[1] != 1 or self._data.count(pattern) != 1:
            raise TypeError(f"{type(message).__name__} is not serialized as little-endian CDR with these numbers in a row")

    def serialized(self, stamp: Time, numbers: Sequence[float]) -> bytes:
        """The message with this stamp and these numbers."""
        struct.pack_into("<iI", self._data, self._STAMP, stamp.sec, stamp.nanosec)
        self._numbers.pack_into(self._data, self._at, *numbers)
        return bytes(self._data)
