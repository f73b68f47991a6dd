# SPDX-License-Identifier: Apache-2.0
"""What is asked of a recertification, and of which robot with which tool."""

from __future__ import annotations

from dataclasses import dataclass

from ..procedure.settings import Acceptance
from ..robot import Payload, Robot
from ..typing import Array


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes:
        operator: name of the person who answers for it.
        poses_path: pose file of the full procedure.
        full: go straight to the full procedure. check_only: never go on to it. dry_run: put nothing in force.
        resume: go on with the run that was interrupted.
    """

    operator: str
    poses_path: str
    full: bool = False
    check_only: bool = False
    dry_run: bool = False
    resume: bool = False


@dataclass(frozen=True)
class Place:
    """Where it happens: robot, serial, tolerance (m), acceptance criteria, name of the cell.

    Attributes:
        tool: what the cell file states of it; None: not known.
        operators: who may answer for a recertification; empty: whoever gives a name.
        without_tracker: the cell has none.
    """

    cell: str
    robot: Robot
    serial: str
    tolerance: float
    acceptance: Acceptance
    tool: Tool | None = None
    operators: tuple[str, ...] = ()
    without_tracker: bool = False


@dataclass(frozen=True)
class Tool:
    """A tool: its name (empty: none is stated), its mass beyond the robot's description, its marker in tool0, (3,), m."""

    name: str
    payload: Payload
    marker_in_tool: Array
