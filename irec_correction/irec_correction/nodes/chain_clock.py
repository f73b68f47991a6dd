# SPDX-License-Identifier: Apache-2.0
"""The time by which a node runs its chain: steady, so that a clock that is set does nothing; simulated only where ROS is.

A simulated clock that stands still for long (the simulator, or the way to it, is lost) goes on with the steady one, so that an
offset is not sent for ever on inputs that no longer come.
"""

from __future__ import annotations

import time

from builtin_interfaces.msg import Time
from rclpy.node import Node

from .messages import ros_time, seconds

STEP = 0.01  # s between steady and system clock: the system clock was set
AHEAD = 0.1  # s: a simulated clock comes in steps, stamps between them are newer
STANDS = 3.0  # s of the steady clock for which a simulated one may stand still: longer is not a busy machine's pause
LOOK = 0.05  # s between two looks that count at most: while this node itself was stopped it could not see the clock go on


class ChainClock:
    """Seconds on one clock for inputs and ticks."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._shift = time.time() - time.monotonic()  # system time - steady time
        self._latest = 0.0
        self._ros, self._stood, self._looked = 0.0, 0.0, 0.0

    @property
    def simulated(self) -> bool:
        """ROS time is that of a simulation."""
        return self._simulated

    def now(self, stamp: float = -1.0) -> float:
        """Time of the chain, s; a simulated clock may be a little behind the stamp that has just come in (`of`)."""
        if not self._simulated:
            return time.monotonic()
        clock = self._simulated_now()
        if clock < stamp <= clock + AHEAD:
            clock = stamp
        if clock < self._latest <= clock + AHEAD:
            clock = self._latest
        self._latest = clock
        return clock

    def _simulated_now(self) -> float:
        """The simulated clock; after it has stood still for STANDS, that goes on by the steady one."""
        clock, steady = self._node.get_clock().now().nanoseconds * 1e-9, time.monotonic()
        if clock == self._ros and clock > 0.0:
            self._stood += min(steady - self._looked, LOOK)
        else:
            self._ros, self._stood = clock, 0.0
        self._looked = steady
        return clock + max(0.0, self._stood - STANDS)

    def of(self, stamp: Time) -> float:
        """A stamp of now on the clock of the chain, s."""
        t = seconds(stamp)
        return t if self._simulated else t - self._to_system()

    def stamp(self, now: float) -> Time:
        """A time of the chain as a stamp."""
        return ros_time(max(0.0, now if self._simulated else now + self._to_system()))

    def _to_system(self) -> float:
        """The same to the last bit as long as the system clock is not set, so that equal stamps stay equal."""
        shift = time.time() - time.monotonic()
        if abs(shift - self._shift) > STEP:
            self._shift = shift
        return self._shift
