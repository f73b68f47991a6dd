# SPDX-License-Identifier: Apache-2.0
"""What ends a run in any state that moves or presses: silence, a clock that was set, force, a robot that does otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..typing import Array
from .arrival import force_rises, too_fast, touches_on_the_way
from .inputs import LARGEST_LAG
from .nearer import met_the_tooling
from .plausible import what_is_read
from .pressing import LATE_S, MODE_GRACE, PressingWatch
from .table import PRESSING, WAY_IN, WAY_OUT

if TYPE_CHECKING:
    from .machine import Procedure

SILENCE_S = 3.0  # s of the machine's clock; what says nothing for longer has stopped
SILENCE_PRESSING_S = 1.5  # s, likewise while the robot presses: it is to be out of the contact within 3 s
# s of the machine's clock between two looks: nobody watched the robot meanwhile, and what came is not read yet or too old to be
HELD_UP_S, HELD_UP_PRESSING_S = LARGEST_LAG, LATE_S
NOTED_S, NOTED_FOR_S = 0.3, 3.0  # s between two looks that are worth a word where the run ends within so many s
TOPICS = {"force": "wrench", "joints": "joint_states", "TCP": "tcp_pose"}  # what must never fall silent
POSITION, FORCE = 0, 1  # RobotState.MODE_POSITION, MODE_FORCE


@dataclass
class RobotSays:
    """The newest robot/state."""

    mode: int
    retreating: bool
    message: str


class Watch:
    """Looks at each step of one procedure."""

    def __init__(self, procedure: Procedure) -> None:
        self._p = procedure
        self._received = {name: (-1, 0.0) for name in TOPICS}  # readings so far, machine's clock when they last grew
        self._robot: RobotSays | None = None
        self._robot_news = False
        self._robot_received = 0.0  # machine's clock
        self._looked = 0.0  # machine's clock
        self._held_up = (0.0, 0.0)  # s between two looks, when it was noted last, and machine's clock then
        self._pressing = PressingWatch(procedure)

    def robot_said(self, mode: int, retreating: bool = False, message: str = "") -> None:
        """A message on robot/state."""
        self._robot, self._robot_news = RobotSays(mode, retreating, message), True

    def silent_for(self, name: str) -> float:
        """How long nothing of a stream (a key of TOPICS) had come when this last looked, s of the machine's clock."""
        return self._looked - self._received[name][1]

    def held_up(self, steady: float) -> str:
        """Why a run can't go on after this process was held up since the last look; empty: it was not. steady: as of look.

        To be asked before any reading is judged: those that came meanwhile are old, and some are read before others.
        """
        p, gap = self._p, steady - self._looked if self._looked else 0.0
        limit = HELD_UP_PRESSING_S if p.state in PRESSING else HELD_UP_S
        if gap <= limit or p.state in ("idle", "paused", "finished", "failed"):
            return ""
        left = ", and the robot may have left the contact by its lease" if p.state in PRESSING else ""
        return (
            f"this process was held up: it has not watched the robot for {gap:.1f} s, limit {limit:g} s{left}; does this computer"
            " have too much to do, was the process stopped, or did the computer sleep?"
        )

    @property
    def robot_presses(self) -> bool:
        """The robot is in force control, or on its way out of the contact."""
        return self._robot is not None and (self._robot.mode == FORCE or self._robot.retreating)

    def look(self, steady: float) -> None:
        """End the run where there is a reason. steady: the machine's clock, s."""
        p, held_up = self._p, self.held_up(steady)
        gap = steady - self._looked if self._looked else 0.0
        self._looked = steady
        if gap > NOTED_S:  # while nobody looked nobody was silent
            self._held_up = gap, steady
            self._received = {name: (count, received + gap) for name, (count, received) in self._received.items()}
            self._robot_received += gap if self._robot_received else 0.0
        for name, (count, _) in self._received.items():
            if p.streams.counts[name] != count:
                self._received[name] = p.streams.counts[name], steady
        if self._robot_news or not self._robot_received:
            self._robot_news, self._robot_received = False, steady
        if p.state in WAY_OUT and (reason := force_rises(p)):  # also where the run is ending already
            p.fail(reason)
            return
        if p.state in ("idle", "paused", "finished", "failed") or p.stopped_because:
            return
        if held_up:
            p.stop(held_up)
            return
        if p.state in WAY_IN and (reason := touches_on_the_way(p)):
            met_the_tooling(p, reason)
            return
        if reason := too_fast(p):
            p.stop(reason)
            return
        reason = self._clock() or self._silence(steady) or self._force() or self._robot_state() or self._pressing.problem()
        if reason:
            gap, noted = self._held_up
            recent = gap > 0.0 and steady - noted <= NOTED_FOR_S
            p.stop(f"{reason} (before that this process was held up for {gap:.1f} s)" if recent else reason)

    def _clock(self) -> str:
        time = self._p.time
        if time.still:
            return "the cell's clock stands still"
        if time.jump:
            return f"the cell's clock was set by {time.jump:+.1f} s: who publishes on /clock, or who has set the time?"
        return ""

    def _silence(self, steady: float) -> str:
        longest = SILENCE_PRESSING_S if self._p.state in PRESSING else SILENCE_S
        for name, (_, received) in self._received.items():
            if steady - received > longest:
                return f"no {name} readings for {longest:g} s: {TOPICS[name]} is silent"
        if self._robot is not None and steady - self._robot_received > longest:
            return f"robot/state is silent for {longest:g} s: nobody says what the robot does"
        return ""

    def _force(self) -> str:
        newest, s = self._p.streams.last_forces(2), self._p.settings  # zeros between may be of somebody else
        if not len(newest):
            return ""
        force = newest[int(np.linalg.norm(newest, axis=1).argmax())]
        if not np.linalg.norm(force) <= s.force_abort_n:
            return f"force is {np.linalg.norm(force):.0f} N, limit {s.force_abort_n:.0f} N{self._beside_set_point(force)}"
        if not np.abs(force).max() <= s.sensor_range_n:
            return f"force sensor reads {np.abs(force).max():.0f} N, its range is {s.sensor_range_n:.0f} N"
        return ""

    def _beside_set_point(self, force: Array) -> str:
        """Which axis of a force, (3,), N, is furthest from what was asked for while the robot presses, for a sentence."""
        p = self._p
        if p.state not in PRESSING:
            return ""
        off = force - p.setpoint
        k = int(np.abs(off).argmax())
        return (
            f" (procedure.force_abort_n): {what_is_read(p.setpoint, force)}, {abs(off[k]):.0f} N off along {'xyz'[k]}; does the"
            " force control of the robot hold each axis, and are axes of the wrench exchanged?"
        )

    def _robot_state(self) -> str:
        """Does the robot do what was asked of it?"""
        p, robot = self._p, self._robot
        if robot is None or p.state not in PRESSING:
            return ""
        if robot.retreating:
            return f"the robot has left the contact by itself{': ' if robot.message else ''}{robot.message}"
        if robot.mode != FORCE and p.time.elapsed - p.switched_at > MODE_GRACE:
            reason = f": {robot.message}" if robot.message else ""
            return f"robot/state says that the robot is not in force control, which set_control_mode had confirmed{reason}"
        return ""
