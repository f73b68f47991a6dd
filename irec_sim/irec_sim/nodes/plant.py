# SPDX-License-Identifier: Apache-2.0
"""What the nodes need of a cell."""

from __future__ import annotations

from typing import Protocol

from ..kinematics import Array, Chain


class Plant(Protocol):
    """A cell in steps of `period` s. SI units; forces on the robot by the environment in tool0.

    Attributes:
        time: simulated time, s.
        mode: MODE_ constant of irec_msgs/RobotState.
        commanded: joint angles (n,), rad, and rail position, m, that the servo goes to.
        rail_names: empty where there is no rail; rail_range: m.
        offset: translation of the TCP applied now, in base_link, (3,), m.
        late_offsets: offsets that came late so far.
    """

    period: float
    time: float
    mode: int
    chain: Chain
    rail_names: tuple[str, ...]
    rail_range: tuple[float, float]
    commanded: tuple[Array, float]
    offset: Array
    late_offsets: int

    def step(self) -> None:
        """Advance by one period."""

    def command(self, q: Array, rail: float) -> None:
        """Position set point of the servo."""

    def control_force(self, force: Array) -> None:
        """Switch to force control with this set point."""

    def control_position(self) -> None:
        """Switch to position control where the robot is."""

    def set_force(self, force: Array) -> None:
        """New set point; SimError in position control."""

    def set_offset(self, translation: Array, turn: Array, stamp: float) -> None:
        """Correction to apply: m and rotation vector in base_link, computed at `stamp` s."""

    def joints(self) -> tuple[Array, float]:
        """Reported joint angles and rail position."""

    def tcp(self) -> tuple[Array, Array]:
        """tool0 in base_link by the controller: position (3,), rotation (3, 3)."""

    def wrench_raw(self) -> Array:
        """Reading of the sensor in its own frame, (6,), N and N m."""

    def wrench(self) -> Array:
        """Process wrench at the TCP in tool0, (6,), N and N m."""

    def tracker(self) -> tuple[str, Array] | None:
        """Station and marker in its frame, or None without line of sight."""

    def temperatures(self) -> dict[str, float]:
        """degC by name."""
