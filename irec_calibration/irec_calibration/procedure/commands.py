# SPDX-License-Identifier: Apache-2.0
"""What the state machine asks for, and what it reports."""

from __future__ import annotations

from dataclasses import dataclass

from ..typing import Array
from .standstill import Window

LONGEST_LEASE = 2.0  # s for which a driver may take a force set point to hold: so long a robot presses on after a crash


@dataclass(frozen=True)
class MoveJoint:
    """Point to point to joint angles (k,), rad, and rail position, m (None: leave it); speed is a share of the limits."""

    q: Array
    rail: float | None
    speed: float


@dataclass(frozen=True)
class MoveLinear:
    """Straight to a pose of tool0 in base_link; m, rotation matrix, m/s."""

    p_in_base: Array
    R_in_base: Array
    speed: float


@dataclass(frozen=True)
class CancelMove:
    """Stop on the path."""


@dataclass(frozen=True)
class SwitchMode:
    """Position control, or force control with a first set point (environment on robot, tool0, N)."""

    force: bool
    force_in_tool: Array


@dataclass(frozen=True)
class ForceSetpoint:
    """Environment on robot, in tool0, (3,), N. It is a lease: sent again and again while the robot is to press."""

    force_in_tool: Array


@dataclass(frozen=True)
class Row:
    """One averaged row of the session: means over the window; `window.end` and `.begin` are stamps of the readings."""

    pose: int
    load_case: int
    repeat: int
    window: Window
    joint_names: tuple[str, ...]
    temperature: dict[str, float]


@dataclass(frozen=True)
class Event:
    """For the record.

    `kind` is complete, skipped, nearer (the tooling; measured again), rejected, discarded (rows that do not count), unverified
    (the scale of the force), paused, stopped or finished.
    """

    kind: str
    pose: int
    repeat: int
    load_case: int
    text: str


Command = MoveJoint | MoveLinear | CancelMove | SwitchMode | ForceSetpoint | Row | Event
