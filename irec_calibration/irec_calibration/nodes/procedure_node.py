# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 as a node: action irec/run_procedure, status, pause and resume, and the session recording."""

from __future__ import annotations

import json
import signal
import sys
import time
from array import array
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Vector3, Wrench
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import Trigger

from irec_msgs.action import RunProcedure
from irec_msgs.msg import LoadCaseRecord, ProcedureStatus, RobotState

from ..cell import read_cell
from ..errors import CellError, IrecError
from ..poses.store import read_poses
from ..procedure.checks import plan_targets
from ..procedure.commands import Event, Row
from ..procedure.machine import Procedure
from ..procedure.recorder import SessionRecorder
from ..procedure.settings import read_settings
from ..procedure.settle import Streams
from ..session.data import Station
from .cdr import exact_cdr
from .correction_watch import CorrectionWatch
from .instruments import Instruments
from .robot_link import RobotLink
from .startup import begin, refuse_unknown_parameters

STEP_PERIOD = 0.01  # s of the machine's clock between looks at the readings
STATUS_PERIOD = 0.5  # s of the machine's clock
ROBOT_WAIT = 15.0  # s of the machine's clock that the robot's driver may take to appear
SHUTDOWN_WAIT = 30.0  # s of the machine's clock for the robot to leave the contact when the node is stopped
FAREWELL = 0.5  # s after that, in which whoever asked for the run gets the answer
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVENTS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class ProcedureNode(Node):
    """Parameters: cell (cell file), session_folder (where recordings go)."""

    def __init__(self) -> None:
        super().__init__("procedure_node")
        path = self._text("cell", "", "cell file (irec-cell/1)")
        if not path:
            raise CellError("parameter 'cell' is empty; name a cell file, e.g. -p cell:=config/cells/afp.yaml")
        self.cell = read_cell(path)
        self.settings = read_settings(self.cell)
        self.session_folder = Path(self._text("session_folder", "sessions", "folder for recordings")).absolute()
        refuse_unknown_parameters(self)
        self._link = RobotLink(self, self.cell.robot.joint_names)
        self._instruments = Instruments(self, Streams(5.0 + self.settings.window_s), self._on_robot_state)
        self._robot_state: RobotState | None = None
        self._correction = CorrectionWatch(self)
        self._status = self.create_publisher(ProcedureStatus, "irec/procedure/status", LATCHED)
        self._rows = self.create_publisher(LoadCaseRecord, "irec/procedure/load_case", EVENTS)
        self._events = self.create_publisher(String, "irec/procedure/event", EVENTS)
        self.create_service(Trigger, "irec/procedure/pause", self._on_pause)
        self.create_service(Trigger, "irec/procedure/resume", self._on_resume)
        self._action = ActionServer(
            self, RunProcedure, "irec/run_procedure", execute_callback=self._conclude,
            goal_callback=self._on_goal, handle_accepted_callback=self._begin, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STEP_PERIOD, self._step, clock=steady)
        self.create_timer(STATUS_PERIOD, self._report, clock=steady)
        self._procedure: Procedure | None = None
        self._recorder: SessionRecorder | None = None
        self._goal: Any = None
        self._busy = False
        self._answer = RunProcedure.Result()
        self._begun = 0.0
        self._session_start = 0.0
        self._last_state = ""

    def _text(self, name: str, default: str, description: str) -> str:
        return str(self.declare_parameter(name, default, ParameterDescriptor(description=description)).value)

    # --- one run ----------------------------------------------------------------------------------------------------

    def _on_goal(self, _: RunProcedure.Goal) -> GoalResponse:
        if self._busy:
            self.get_logger().error("a run is under way; cancel it before starting another")
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    def _begin(self, goal: Any) -> None:
        """Start a run. The goal is executed when the run has ended: an executor polls a callback that waits."""
        self._goal = goal
        try:
            self._open(goal.request)
        except IrecError as error:
            self.get_logger().error(str(error))
            self._finish(RunProcedure.Result(success=False, message=str(error)))

    def _finish(self, answer: RunProcedure.Result) -> None:
        """Close the recording and answer the goal."""
        goal = self._goal
        try:
            self._close()
        except IrecError as error:  # the disk is full, ...
            self.get_logger().error(str(error))
            answer.success, answer.message = False, f"{answer.message}; {error}"
        self._answer = answer
        goal.execute()
        self._busy = False

    def _conclude(self, goal: Any) -> RunProcedure.Result:
        answer = self._answer
        if goal.is_cancel_requested:
            goal.canceled()
        elif answer.success:
            goal.succeed()
        else:
            goal.abort()
        return answer

    def _open(self, request: RunProcedure.Goal) -> None:
        """Read the poses, open the recording, set the machine up."""
        poses_path = request.poses_path or str(self.cell.poses_path)
        poses = read_poses(poses_path, self.cell.serial, self.cell.robot.sha256).poses
        targets = plan_targets(
            self.cell, self.settings, np.array([p.q for p in poses]),
            np.array([p.ext.get("rail", 0.0) for p in poses]), [p.index for p in poses],
        )  # fmt: skip
        parameters = {name: self.get_parameter(name).value for name in self._parameters}
        self._recorder = SessionRecorder(self._new_path(request), self.cell, parameters, resume=request.resume)
        for loss in self._recorder.losses:
            self.get_logger().warning(f"of the earlier part of the recording is lost: {loss}")
        self._procedure = Procedure(
            targets, self.cell.forces_in_tool, self.cell.home, self.settings, self._instruments.streams,
            {s["name"]: _station(s).R_in_base for s in self.cell.raw["stations"]},
            repeats=int(request.repeats), done=frozenset(self._recorder.done),
        )  # fmt: skip
        self._link.attach(self._procedure)
        self._instruments.find_temperatures()
        self._instruments.record_to(self._recorder)
        self._begun = time.monotonic()
        self._session_start = 0.0
        where = f"going on after {len(self._recorder.done)} complete poses" if self._recorder.done else "from the beginning"
        self.get_logger().info(f"{len(targets)} poses from {poses_path}, {where}; recording to {self._recorder.path}")

    def _new_path(self, request: RunProcedure.Goal) -> Path:
        if request.session_path:
            return Path(request.session_path)
        return self.session_folder / f"{self.cell.name}_{datetime.now().astimezone():%Y%m%d_%H%M%S}.mcap"

    def _result(self, procedure: Procedure, recorder: SessionRecorder) -> RunProcedure.Result:
        counts, reason = procedure.counts, procedure.stopped_because
        complete = counts.complete + len(recorder.done)
        text = (
            f"{complete} poses complete, {counts.skipped} skipped, {counts.rejected} load cases rejected"
            f"{f'; stopped: {reason}' if reason else ''}"
        )
        self.get_logger().info(text)
        return RunProcedure.Result(
            success=not reason, message=text, session_path=str(recorder.path), poses_recorded=complete,
            poses_skipped=counts.skipped,
        )  # fmt: skip

    def _close(self) -> None:
        self._instruments.record_to(None)
        recorder, self._recorder, self._goal = self._recorder, None, None
        self._report(recorder)
        self._procedure = None
        if recorder is not None:
            recorder.close()

    # --- what happens during a run ----------------------------------------------------------------------------------

    def _step(self) -> None:
        procedure = self._procedure
        if procedure is None:
            return
        now = self.get_clock().now().nanoseconds * 1e-9
        if procedure.state == "idle" and not procedure.stopped_because and not self._robot_is_ready(procedure):
            return
        if self._goal is not None and self._goal.is_cancel_requested:
            procedure.stop("cancelled by the operator")
        elif corrected := self._correction.problem(self._robot_state):
            procedure.stop(corrected)
        for command in procedure.step(now, time.monotonic()):
            if isinstance(command, Row):
                self._record(command)
            elif isinstance(command, Event):
                self._note(command)
            else:
                self._link.do(command)
        if procedure.state != self._last_state:
            self._last_state = procedure.state
            self._report()
        if procedure.finished and self._recorder is not None:
            self._finish(self._result(procedure, self._recorder))

    def _robot_is_ready(self, procedure: Procedure) -> bool:
        """Start once driver and readings are there; give up after ROBOT_WAIT."""
        missing = self._link.missing
        if self._robot_state is None:
            missing += f"{', ' if missing else ''}topic robot/state"
        silent = {"force": "wrench", "joints": "joint_states", "TCP": "tcp_pose"}
        for stream, topic in silent.items():
            if stream not in self._instruments.streams.newest():
                missing += f"{', ' if missing else ''}readings on {topic}"
        if corrected := self._correction.problem(self._robot_state):
            procedure.stop(corrected)
            return True
        if not missing:
            self._session_start = self.get_clock().now().nanoseconds * 1e-9
            procedure.start()
            return True
        procedure.message = f"waits for {missing}"
        if time.monotonic() - self._begun > ROBOT_WAIT:
            procedure.stop(f"the robot's driver does not offer {missing} after {ROBOT_WAIT:g} s; start it")
            return True
        return False

    def _on_robot_state(self, state: RobotState) -> None:
        self._robot_state = state
        if state.mode == RobotState.MODE_FAULT and self._procedure is not None:
            self._procedure.fault(state.message or "no reason given")

    def _record(self, row: Row) -> None:
        recorder, window = self._recorder, row.window
        if recorder is None:
            return
        middle = 0.5 * (window.begin + window.end)
        message = LoadCaseRecord()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(middle * 1e9), 1_000_000_000)
        message.header.frame_id = "base_link"
        message.time = float(middle - self._session_start + recorder.time_offset)
        message.pose, message.load_case, message.repeat = row.pose, row.load_case, row.repeat
        message.joint_names = list(row.joint_names)
        message.joint_position = array("d", window.q.mean(axis=0))
        message.p_tcp_in_base = _point(window.p_tcp_in_base.mean(axis=0))
        message.p_marker_in_station = _point(window.p_marker_in_station.mean(axis=0))
        message.station = window.station
        message.wrench_in_tool = Wrench(
            force=_vector(window.force_in_tool.mean(axis=0)), torque=_vector(window.torque_in_tool.mean(axis=0))
        )
        message.temperature_names = [f"temp_{name}" for name in sorted(row.temperature)]
        message.temperature = array("d", [row.temperature[name] for name in sorted(row.temperature)])
        message.samples = len(window.p_marker_in_station)
        message.marker_std, message.force_std = window.marker_std, window.force_std
        data = exact_cdr(message)
        recorder.write_row(data, self.get_clock().now().nanoseconds)
        self._rows.publish(message)

    def _note(self, event: Event) -> None:
        content = {
            "kind": event.kind, "pose": event.pose, "repeat": event.repeat, "load_case": event.load_case, "text": event.text
        }  # fmt: skip
        if self._recorder is not None:
            self._recorder.write_event(content, self.get_clock().now().nanoseconds)
        self._events.publish(String(data=json.dumps(content)))
        if event.kind in ("skipped", "rejected", "stopped"):
            self.get_logger().warning(f"{event.kind}: pose {event.pose}, load case {event.load_case}: {event.text}")

    def _report(self, recorder: SessionRecorder | None = None) -> None:
        """Publish status and feedback."""
        self._instruments.find_temperatures()
        recorder = recorder or self._recorder
        status = ProcedureStatus()
        status.header.stamp = self.get_clock().now().to_msg()
        status.header.frame_id = "base_link"
        status.state = "idle"
        procedure = self._procedure
        if procedure is not None:
            status.state = procedure.state
            status.pose, status.poses = procedure.place, procedure.total
            status.load_cases = len(procedure.forces)
            status.load_case = min(procedure.case, status.load_cases)
            status.rejected = procedure.counts.rejected
            status.paused = procedure.state == "paused"
            status.remaining = _duration(procedure.remaining_s(self.get_clock().now().nanoseconds * 1e-9))
            status.message = procedure.stopped_because or procedure.message
            status.session_path = str(recorder.path) if recorder else ""
        self._status.publish(status)
        if self._goal is not None and procedure is not None and self._goal.is_active:
            feedback = RunProcedure.Feedback(
                state=status.state, pose=status.pose, poses=status.poses, load_case=status.load_case,
                load_cases=status.load_cases, remaining=status.remaining,
            )  # fmt: skip
            self._goal.publish_feedback(feedback)

    # --- the operator -----------------------------------------------------------------------------------------------

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._procedure is None or self._procedure.finished:
            response.success, response.message = False, "no run is under way"
            return response
        self._procedure.pause()
        response.success, response.message = True, "leaving the contact; the pose under way will be measured again"
        return response

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._procedure is None or not self._procedure.when_pausing():
            response.success, response.message = False, "no run is paused"
            return response
        self._procedure.resume()
        response.success, response.message = True, "going on"
        return response

    def stop(self, reason: str) -> bool:
        """End the run under way, if any; True once nothing moves any more."""
        if self._procedure is not None:
            self._procedure.stop(reason)
        return not self._busy


def _station(entry: dict[str, Any]) -> Station:
    return Station(str(entry["name"]), tuple(entry["xyz"]), tuple(entry["quat_xyzw"]))


def _point(p: np.ndarray) -> Point:
    return Point(x=float(p[0]), y=float(p[1]), z=float(p[2]))


def _vector(v: np.ndarray) -> Vector3:
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _duration(seconds: float) -> Duration:
    whole = int(seconds)
    return Duration(sec=whole, nanosec=int((seconds - whole) * 1e9))


def main() -> int:
    """Run until SIGINT or SIGTERM; a run under way is ended retracted first."""
    if not begin("procedure_node", signal_handler_options=SignalHandlerOptions.NO):
        return 2
    asked_at: list[float] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked_at.append(time.monotonic()))
    try:
        node = ProcedureNode()
        executor = EventsExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.2)
            if asked_at and (node.stop("the node was stopped") or time.monotonic() - asked_at[0] > SHUTDOWN_WAIT):
                break
        until = time.monotonic() + FAREWELL
        while rclpy.ok() and time.monotonic() < until:
            executor.spin_once(timeout_sec=0.1)
    except (IrecError, ParameterException) as error:
        print(f"procedure_node: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
