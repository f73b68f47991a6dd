# SPDX-License-Identifier: Apache-2.0
"""Whether a run of Procedure 1 may begin: driver and readings are there, nothing corrects, and nobody else drives the robot."""

from __future__ import annotations

import time
from dataclasses import dataclass

from irec_msgs.msg import RobotState

from ..procedure.inputs import Inputs
from .correction_at_work import CorrectionAtWork
from .robot_link import RobotLink
from .sources import SourceWatch

LATE = 0.3  # s of the machine's clock in which a message that was sent before the run was asked for may still come
DISCOVERY = 0.5  # s of the machine's clock for another procedure on this graph to be seen
ROBOT_WAIT = 15.0  # s of the machine's clock that the robot's driver may take to appear
RIVAL_WAIT = 25.0  # s that another procedure may take to disappear; DDS takes 20 s to forget one that was killed
SILENT = {"force": "wrench", "joints": "joint_states", "TCP": "tcp_pose"}


@dataclass(frozen=True)
class Start:
    """What is to be done now: begin, stop for this reason, or go on waiting for this."""

    begin: bool = False
    stop: str = ""
    waits: str = ""


class StartCheck:
    """Asked again and again from when a run was asked for until it begins or is given up."""

    def __init__(self, link: RobotLink, inputs: Inputs, correction: CorrectionAtWork, sources: SourceWatch) -> None:
        self._link, self._inputs, self._correction, self._sources = link, inputs, correction, sources
        self._robot: RobotState | None = None
        self._robot_told = False
        self._asked = 0.0
        self._listens = False
        self._before: dict[str, int] = {}

    def run_asked_for(self) -> None:
        """Nothing counts for LATE, what was stamped before that not at all: it may be of a driver that has ended since."""
        self._asked, self._listens = time.monotonic(), False

    def _listen(self, now: float) -> None:
        self._listens, self._robot, self._robot_told = True, None, False
        self._inputs.begin_run(now)
        self._before = dict(self._inputs.streams.counts)

    def believes(self, now: float, state: RobotState) -> bool:
        """Whether robot/state is of the run that was asked for. now: the cell's clock, s."""
        stamp = state.header.stamp
        return self._listens and not self._inputs.of_before(now, stamp.sec + 1e-9 * stamp.nanosec)

    def robot_said(self, state: RobotState) -> None:
        """robot/state has come."""
        self._robot, self._robot_told = state, True

    @property
    def correction(self) -> str:
        """Why nothing may be measured now as a correction is at work; empty where none is."""
        return self._correction.problem(self._robot)

    @property
    def disturbed(self) -> str:
        """Why the run under way has to end: a correction is at work, or readings come from several senders."""
        return self.correction or self._sources.in_a_run

    def look(self, now: float) -> Start:
        """Give up after ROBOT_WAIT, or RIVAL_WAIT where somebody else drives this robot. now: the cell's clock, s."""
        waited = time.monotonic() - self._asked
        if waited < LATE:
            return Start(waits="waits for readings of now")
        if not self._listens:
            self._listen(now)
        missing = [self._link.missing] if self._link.missing else []
        if not self._robot_told:
            missing.append("topic robot/state")
        counts = self._inputs.streams.counts
        missing += [f"readings on {topic}" for stream, topic in SILENT.items() if counts[stream] == self._before[stream]]
        rivals = self._link.rivals
        if senders := self._sources.before_a_run:  # first: what two say together is no fault of one
            return Start(stop=senders if waited > RIVAL_WAIT else "", waits=senders)
        if problem := self._inputs.problem or self.correction:
            return Start(stop=problem)
        if missing:
            late = f"the robot's driver does not offer {', '.join(missing)} after {ROBOT_WAIT:g} s; start it"
            return Start(stop=late if waited > ROBOT_WAIT else "", waits=f"waits for {', '.join(missing)}")
        if rivals:
            text = f"{rivals}: another procedure may be driving this robot; end it"
            return Start(stop=text if waited > RIVAL_WAIT else "", waits=text)
        return Start(begin=waited > DISCOVERY)
