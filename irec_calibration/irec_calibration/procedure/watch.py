# SPDX-License-Identifier: Apache-2.0
"""What ends a run in any state that moves or presses: silence, a clock that was set, force, a robot that does otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .plausible import what_is_read
from .table import PRESSING

if TYPE_CHECKING:
    from .machine import Procedure

SILENCE_S = 3.0  # s of the machine's clock; what says nothing for longer has stopped
SILENCE_PRESSING_S = 1.5  # s, likewise while the robot presses: it is to be out of the contact within 3 s
LATE_S = 1.0  # s by which a wrench may be behind the cell's clock while the robot presses
LEFT_S, LEFT_TOLERANCES = 1.0, 4.0  # s for which the force may be so many settling tolerances off a set point it had reached
TOPICS = {"force": "wrench", "joints": "joint_states", "TCP": "tcp_pose"}  # what must never fall silent
MODE_GRACE = 1.0  # s for robot/state to say the mode that was switched to
WRONG_SIGN_N = 40.0  # N, and WRONG_SIGN_SHARE of the set point: a force in the other direction is no noise
WRONG_SIGN_SHARE = 0.04
SIGN_WINDOW = 0.04  # s
AWAY = 3e-3  # m against the direction of pressing
MISSED = 0.02  # m beyond where the surface should be
TOUCH_N = 30.0  # N along the tool: there is contact
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
        self._near_at = 0.0  # cell's elapsed time when the force was last near its set point, or on the way to it

    def robot_said(self, mode: int, retreating: bool = False, message: str = "") -> None:
        """A message on robot/state."""
        self._robot, self._robot_news = RobotSays(mode, retreating, message), True

    def silent_for(self, name: str) -> float:
        """How long nothing of a stream (a key of TOPICS) had come when this last looked, s of the machine's clock."""
        return self._looked - self._received[name][1]

    @property
    def robot_presses(self) -> bool:
        """The robot is in force control, or on its way out of the contact."""
        return self._robot is not None and (self._robot.mode == FORCE or self._robot.retreating)

    def look(self, steady: float) -> None:
        """End the run where there is a reason. steady: the machine's clock, s."""
        p = self._p
        self._looked = steady
        for name, (count, _) in self._received.items():
            if p.streams.counts[name] != count:
                self._received[name] = p.streams.counts[name], steady
        if self._robot_news or not self._robot_received:
            self._robot_news, self._robot_received = False, steady
        if p.state in ("idle", "paused", "finished", "failed") or p.stopped_because:
            return
        reason = self._clock() or self._silence(steady) or self._force() or self._robot_state() or self._pressing()
        if reason:
            p.stop(reason)

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
        force, s = self._p.streams.newest_force, self._p.settings
        if force is None:
            return ""
        if not np.linalg.norm(force) <= s.force_abort_n:
            return f"force is {np.linalg.norm(force):.0f} N, limit {s.force_abort_n:.0f} N"
        if not np.abs(force).max() <= s.sensor_range_n:
            return f"force sensor reads {np.abs(force).max():.0f} N, its range is {s.sensor_range_n:.0f} N"
        return ""

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

    def _pressing(self) -> str:
        """Sign of the force and direction of the way, from the first moment of contact on."""
        p, target = self._p, self._p.target
        if p.state not in PRESSING or target is None:
            return ""
        if reason := self._late() or self._left():
            return reason
        mean = p.streams.mean_force(p.window_from, SIGN_WINDOW)
        if mean is None:
            return ""
        wanted = float(p.setpoint[2])
        against = -float(mean[2]) * np.sign(wanted)
        if against > max(WRONG_SIGN_N, WRONG_SIGN_SHARE * abs(wanted)):
            return (
                f"the force has the wrong sign: {what_is_read(p.setpoint, mean)}; the contract: what the environment exerts on"
                " the robot, in tool0, so that pressing reads a negative z"
            )
        tcp = p.streams.newest_tcp
        if p.state != "contact" or tcp is None or p.reference is None or abs(mean[2]) > TOUCH_N:
            return ""
        way = float((tcp[0] - p.reference.p_tcp_in_base.mean(axis=0)) @ target.R_tool_in_base[:, 2])
        if way < -AWAY:
            return (
                f"the robot moves away from the surface ({-1e3 * way:.1f} mm) when it is to press with z = {wanted:.0f} N: the"
                " driver takes set points with the other sign; the contract: what the environment exerts on the robot, in tool0"
            )
        if way > p.settings.reference_distance + MISSED:
            return (
                f"no contact: the tool has advanced {1e3 * way:.0f} mm, the surface should be after"
                f" {1e3 * p.settings.reference_distance:.0f} mm, and the wrench still reads {mean[2]:.0f} N along the tool; is"
                " the surface where the cell file says, and is it the process force that wrench reports?"
            )
        return ""

    def _late(self) -> str:
        p = self._p
        behind = p.now - p.streams.newest().get("force", p.now)
        if behind <= LATE_S or p.time.elapsed - p.switched_at < MODE_GRACE:
            return ""
        return (
            f"no force readings of the last {behind:.1f} s, limit {LATE_S:g} s: wrench is late or silent, and nobody knows how"
            " hard the robot presses now"
        )

    def _left(self) -> str:
        """A force that had reached its set point has to stay there."""
        p = self._p
        limit = LEFT_TOLERANCES * p.settings.settling.force_n
        mean = p.streams.mean_force(-np.inf, SIGN_WINDOW)
        if p.state != "settle" or mean is None or float(np.abs(mean - p.setpoint).max()) <= limit:
            self._near_at = p.time.elapsed
            return ""
        if p.time.elapsed - self._near_at <= LEFT_S:
            return ""
        return (
            f"the force has left its set point for {LEFT_S:g} s: {what_is_read(p.setpoint, mean)}; is the contact lost, or has"
            " the sensor's bias changed?"
        )
