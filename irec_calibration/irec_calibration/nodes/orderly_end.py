# SPDX-License-Identifier: Apache-2.0
"""The end of a driver that force control may have left in contact: first out of it, in bounded time, then out of the process."""

from __future__ import annotations

import signal
import sys
import threading
import time
from typing import Protocol

from irec_ros.startup import ending_signals, spin_until
from rclpy.experimental import EventsExecutor

from ..drivers.moves import RAMP
from ..drivers.position_robot import RETREAT_SPEED, PositionRobot

SLACK = 2.0  # s beyond what ramp and way back take


class Driver(Protocol):
    """A node that drives a robot."""

    @property
    def robot(self) -> PositionRobot: ...

    def end(self) -> None:
        """Leave a contact of force control; nothing that is asked is taken any more."""


def longest_end(robot: PositionRobot) -> float:
    """Time that the way out of the contact may take, s of the machine's clock."""
    s = robot.settings
    return s.ramp + s.retract / RETREAT_SPEED + 2.0 * RAMP + SLACK


def work_until_ended(node: Driver, asked: threading.Event) -> None:
    """Let a driver work until a signal has come, then until its robot has left the contact; a second signal ends at once.

    Args:
        asked: set by the first signal.
    """
    again = threading.Event()

    def ask(*_: object) -> None:
        (again if asked.is_set() else asked).set()

    for number in ending_signals():
        signal.signal(number, ask)
    executor = EventsExecutor()
    executor.add_node(node)  # type: ignore[arg-type]
    spin_until(asked, executor.spin_once)
    node.end()
    until = time.monotonic() + longest_end(node.robot)
    spin_until(again, executor.spin_once, 0.05, lambda: node.robot.at_rest or time.monotonic() > until)
    if not node.robot.at_rest:
        why = "by a second signal" if again.is_set() else f"after {longest_end(node.robot):.1f} s"
        print(f"ros2_control_driver: ended {why} before the robot was out of the contact: it may still press", file=sys.stderr)
