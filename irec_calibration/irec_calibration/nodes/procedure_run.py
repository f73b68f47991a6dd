# SPDX-License-Identifier: Apache-2.0
"""One run of Procedure 1: the state machine and its recording, stepped by the node that offers it."""

from __future__ import annotations

import json
import secrets
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from irec_ros.cdr import exact_cdr

from irec_msgs.action import RunProcedure
from irec_msgs.msg import LoadCaseRecord, ProcedureStatus

from ..cell import Cell
from ..errors import PlanError
from ..poses.store import read_poses
from ..procedure.checks import plan_targets
from ..procedure.commands import Event, Row
from ..procedure.loads import loaded_as_asked
from ..procedure.machine import Procedure
from ..procedure.plausible import Plausibility
from ..procedure.recorder import SessionRecorder, refuse_changed
from ..procedure.settings import MOST_REPEATS, Settings
from .instruments import Instruments
from .robot_link import RobotLink
from .rows import duration, row_message


class ProcedureRun:
    """From the goal to the closed recording.

    Raises:
        IrecError: poses that can't be read or driven to, a recording that can't be opened.
    """

    def __init__(
        self, request: RunProcedure.Goal, cell: Cell, settings: Settings, parameters: dict[str, Any],
        instruments: Instruments, link: RobotLink, simulated: bool,
    ) -> None:  # fmt: skip
        if request.repeats > MOST_REPEATS:
            raise PlanError(f"repeats is {request.repeats}; 1 to {MOST_REPEATS} are possible, 0 for that of the cell file")
        refuse_changed(cell)
        self._instruments, self._link = instruments, link
        poses_path = request.poses_path or str(cell.poses_path)
        listed = read_poses(poses_path, cell.serial, cell.robot.sha256)
        poses, cell = listed.poses, loaded_as_asked(cell, settings, listed, poses_path)
        rails = np.array([p.ext.get("rail", 0.0) for p in poses])
        targets = plan_targets(cell, settings, np.array([p.q for p in poses]), rails, [p.index for p in poses])
        folder = Path(parameters["session_folder"])
        path = Path(request.session_path) if request.session_path else _new_path(folder, cell, link.namespace)
        seed = parameters["order_seed"] if parameters["order_seed"] >= 0 else secrets.randbelow(2**31)
        planned = {p.index: np.array([*p.q, *([] if cell.rail is None else [p.ext.get("rail", 0.0)])]) for p in poses}
        self.recorder = SessionRecorder(path, cell, parameters, resume=request.resume, order_seed=seed, planned=planned)
        self.procedure = Procedure(
            targets, cell.forces_in_tool, cell.home, settings, instruments.inputs.streams,
            {station.name: station.R_in_cell for station in cell.stations},
            repeats=int(request.repeats), done=frozenset(self.recorder.done), seed=self.recorder.order_seed,
            plausibility=Plausibility(cell, partial(instruments.raw_force, cell.raw["force_sensor"]["frame"])),
            simulated=simulated,
        )  # fmt: skip
        done = self.recorder.done
        where = f"going on after {len(done)} complete poses" if done else "from the beginning"
        blind = " without a tracker (tracker/point is not read)," if settings.without_tracker else ""
        self.begun = f"{len(targets)} poses from {poses_path},{blind} {where}; recording to {self.recorder.path}"
        self.started_at = 0.0  # cell's clock
        instruments.find_temperatures()
        instruments.record_to(self.recorder)
        link.attach(self.procedure)

    def start(self, now: float) -> None:
        """Driver and readings are there: begin. now: the cell's clock, s."""
        self.started_at = now
        self.procedure.start()

    def step(self, now: float, steady: float) -> tuple[list[LoadCaseRecord], list[Event]]:
        """Advance; returns what is to be told to the world. now: the cell's clock, s; steady: the machine's, s."""
        procedure = self.procedure
        problem = self._instruments.inputs.problem or self._instruments.recording_problem
        if problem and not procedure.watch.held_up(steady):  # else readings are old for that reason, which the step below tells
            procedure.stop(problem)
        rows, events = [], []
        log_time = round(1e9 * now)
        for command in procedure.step(now, steady):
            if isinstance(command, Row):
                row = row_message(command, self.started_at - self.recorder.time_offset)
                data = exact_cdr(row)
                self._instruments.record(partial(SessionRecorder.write_row, data=data, log_time=log_time))
                rows.append(row)
            elif isinstance(command, Event):
                self._instruments.record(partial(SessionRecorder.write_event, event=as_json(command), log_time=log_time))
                events.append(command)
            else:
                self._link.do(command)
        return rows, events

    def result(self) -> RunProcedure.Result:
        """Why it ended."""
        counts, reason, doubt = self.procedure.counts, self.procedure.stopped_because, self.procedure.scale_doubt
        complete = counts.complete + len(self.recorder.done)
        text = (
            f"{complete} poses complete, {counts.skipped} skipped, {counts.rejected} load cases rejected"
            f"{f'; stopped: {reason}' if reason else ''}"
            f"{f'; {doubt}' if doubt and doubt not in reason else ''}"
        )
        return RunProcedure.Result(
            success=not reason, message=text, session_path=str(self.recorder.path), poses_recorded=complete,
            poses_skipped=counts.skipped,
        )  # fmt: skip

    def close(self) -> None:
        """Finish the recording. RecordingError if not everything could be written."""
        self._instruments.record_to(None)
        self.recorder.close()

    def fill(self, status: ProcedureStatus) -> None:
        """What the run is doing."""
        p = self.procedure
        status.state = p.state
        status.pose, status.poses = p.place, p.total
        status.load_case, status.load_cases = p.load_case, len(p.forces)
        status.rejected = p.counts.rejected
        status.paused = p.state == "paused"
        status.remaining = duration(p.remaining_s())
        doubt = "the scale of the force is not verified" if p.scale_doubt else ""
        status.message = p.stopped_because or "; ".join(text for text in (p.message, doubt) if text)
        status.session_path = str(self.recorder.path)

    @staticmethod
    def feedback(status: ProcedureStatus) -> RunProcedure.Feedback:
        """The part of the status that the action tells."""
        return RunProcedure.Feedback(
            state=status.state, pose=status.pose, poses=status.poses, load_case=status.load_case, load_cases=status.load_cases,
            remaining=status.remaining,
        )  # fmt: skip


def as_json(event: Event) -> dict[str, Any]:
    """For the recording and for irec/procedure/event."""
    return {"kind": event.kind, "pose": event.pose, "repeat": event.repeat, "load_case": event.load_case, "text": event.text}


def event_text(event: Event) -> str:
    """One std_msgs/String."""
    return json.dumps(as_json(event))


def _new_path(folder: Path, cell: Cell, namespace: str) -> Path:
    """Two cells that share a folder differ by their namespace."""
    name = "_".join([part for part in (namespace.strip("/").replace("/", "_"), cell.name) if part])
    return folder.absolute() / f"{name}_{datetime.now().astimezone():%Y%m%d_%H%M%S}.mcap"
