# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 as a node: action irec/run_procedure, status, pause and resume, and the session recording."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

from irec_ros.guard import GuardedLifecycleNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process, spin_until
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from irec_msgs.action import RunProcedure
from irec_msgs.msg import RobotState

from ..cell import read_cell
from ..errors import CellError, IrecError
from ..procedure.axes import read_axes
from ..procedure.elapsed import SLACK, STEP_BACK
from ..procedure.inputs import LARGEST_LAG, Inputs, lag_limit
from ..procedure.settings import read_settings
from ..procedure.standstill import Streams
from .correction_at_work import CorrectionAtWork
from .instruments import Instruments
from .procedure_reports import ProcedureReports
from .procedure_run import ProcedureRun
from .procedure_start import StartCheck
from .robot_link import RobotLink
from .sources import SourceWatch, of_cell

STEP_PERIOD = 0.01  # s of the machine's clock between looks at the readings
STEP_CELL = 0.02  # s of the cell's clock after which a wrench makes a look, where the cell is faster than real time
STATUS_PERIOD = 0.5  # s of the machine's clock
SHUTDOWN_WAIT = 30.0  # s of the machine's clock for the robot to leave the contact when the node is stopped
ANSWER_TIME = 0.5  # s after that, in which whoever asked for the run gets the answer
MOST_ERRORS = 3  # unexpected errors one after the other, after which the run is given up
PARAMETERS = (
    P("cell", "", "cell file (irec-cell/1)"),
    P("autostart", True, "active at once; false: wait for the lifecycle services"),
    P("session_folder", "sessions", "folder for recordings"),
    P("order_seed", -1, "draws the order of the load cases; -1: another one in each run, recorded with it", -1, 2**31 - 1),
)


class ProcedureNode(GuardedLifecycleNode):
    """Procedure 1 for one cell, a managed node: runs begin while it is active. Parameters: see PARAMETERS.

    It listens from the beginning, so that all is known of the robot when it is activated.
    """

    def __init__(self) -> None:
        super().__init__("procedure_node")
        self.parameters = Parameters(self, PARAMETERS)
        refuse_unknown_parameters(self)
        if not self.parameters["cell"]:
            raise CellError("parameter 'cell' is empty; name a cell file, e.g. -p cell:=config/cells/afp.yaml")
        self.cell = read_cell(self.parameters["cell"])
        self.settings = read_settings(self.cell)
        axes = read_axes(self.cell)
        streams = Streams(5.0 + self.settings.window_s, tracker=not self.settings.without_tracker)
        simulated = bool(self.get_parameter("use_sim_time").value)
        largest_lag = LARGEST_LAG if simulated else lag_limit(self.settings.window_s)
        self._inputs = Inputs(streams, axes, [station.name for station in self.cell.stations], largest_lag)
        self._link = RobotLink(self, axes)
        self._starting = StartCheck(
            self._link, self._inputs, CorrectionAtWork(self),
            SourceWatch(self, of_cell(self.settings.without_tracker, len(self.cell.stations))),
        )  # fmt: skip
        self._instruments = Instruments(self, self._inputs, self._on_robot_state, self._keep_up)
        self._reports = ProcedureReports(self, self.cell.serial)
        self.create_service(Trigger, "irec/procedure/pause", self._on_pause)
        self.create_service(Trigger, "irec/procedure/resume", self._on_resume)
        self._action = ActionServer(
            self, RunProcedure, "irec/run_procedure",
            execute_callback=self.guarded("action irec/run_procedure", self._conclude, lambda *_: self._answer),
            goal_callback=self.guarded("goal of irec/run_procedure", self._on_goal, lambda *_: GoalResponse.REJECT),
            handle_accepted_callback=self.guarded("goal of irec/run_procedure", self._begin, self._not_begun),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STEP_PERIOD, self._step, clock=steady)
        self.create_timer(STATUS_PERIOD, self._report, clock=steady)
        forward, back = Duration(seconds=SLACK), Duration(seconds=-STEP_BACK)
        threshold = JumpThreshold(min_forward=forward, min_backward=back, on_clock_change=False)
        self._jumps = self.get_clock().create_jump_callback(threshold, post_callback=self._on_jump)
        self._run: ProcedureRun | None = None
        self._goal: Any = None
        self._busy = False
        self._answer = RunProcedure.Result()
        self._stepped = 0.0
        self._errors_in_a_row = 0
        self._last_state = ""
        self._active = False
        if self.parameters["autostart"]:
            self.trigger_configure()
            self.trigger_activate()

    @property
    def _now(self) -> float:
        """The cell's clock, s."""
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _on_jump(self, _: TimeJump) -> None:
        """A clock that is set and set back between two steps is seen here alone."""
        if self._run is not None:
            self._run.procedure.time.was_set(self._now, time.monotonic())

    # --- lifecycle: what is read and subscribed is so from the beginning ----------------------------------------------

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """A run under way is ended retracted, first of all; its goal is answered as usual."""
        self._active = False
        if self._run is not None:
            self._run.procedure.stop("procedure_node was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self._busy:
            self.get_logger().error("not cleaned up: the robot is still leaving the contact")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        if self._run is not None:
            self._run.procedure.stop("procedure_node was shut down")
        return TransitionCallbackReturn.SUCCESS

    # --- one run ----------------------------------------------------------------------------------------------------

    def _on_goal(self, _: RunProcedure.Goal) -> GoalResponse:
        if not self._active:
            name = self.get_fully_qualified_name()
            self.get_logger().error(f"no run while the node is not active: ros2 lifecycle set {name} activate")
            return GoalResponse.REJECT
        if self._busy:
            self.get_logger().error("a run is under way; cancel it before starting another")
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    def _begin(self, goal: Any) -> None:
        """Start a run. The goal is executed when the run has ended: an executor polls a callback that waits."""
        self._goal, self._errors_in_a_row = goal, 0
        values = {name: self.parameters[name] for name in (p.name for p in PARAMETERS)}
        simulated = bool(self.get_parameter("use_sim_time").value)
        try:
            run = ProcedureRun(
                goal.request, self.cell, self.settings, values, self._instruments, self._link, simulated
            )
        except IrecError as error:
            self.get_logger().error(str(error))
            self._finish(RunProcedure.Result(success=False, message=str(error)))
            return
        self._starting.run_asked_for()  # only now: readings queue up while an earlier recording is copied, for seconds
        self._run = run
        for loss in run.recorder.losses:
            self.get_logger().warning(f"of the earlier part of the recording is lost: {loss}")
        self.get_logger().info(run.begun)

    def _not_begun(self, error: Exception, goal: Any) -> None:
        self._goal = goal
        self._finish(RunProcedure.Result(success=False, message=f"unexpected error: {type(error).__name__}: {error}"))

    def _finish(self, answer: RunProcedure.Result) -> None:
        """Close the recording and answer the goal."""
        self._report()
        goal, run = self._goal, self._run
        self._goal = self._run = None
        try:
            if run is not None:
                run.close()
        except IrecError as error:  # the disk is full, ...
            answer.success, answer.message = False, f"{answer.message}; {error}"
        finally:
            self.get_logger().info(answer.message)
            self._answer, self._busy = answer, False
            goal.execute()

    def _conclude(self, goal: Any) -> RunProcedure.Result:
        answer = self._answer
        if goal.is_cancel_requested:
            goal.canceled()
        elif answer.success:
            goal.succeed()
        else:
            goal.abort()
        return answer

    # --- what happens during a run ----------------------------------------------------------------------------------

    def _keep_up(self) -> None:
        if self._run is not None and self._now - self._stepped > STEP_CELL:
            self._step()

    def _step(self) -> None:
        run, now = self._run, self._now
        if run is None:
            return
        self._stepped = now
        procedure = run.procedure
        if procedure.state == "idle" and not procedure.stopped_because and not self._may_begin(run):
            return
        if self._goal is not None and self._goal.is_cancel_requested:
            procedure.stop("cancelled by the operator")
        elif disturbed := self._starting.disturbed:
            procedure.stop(disturbed)
        rows, events = run.step(now, time.monotonic())
        self._reports.happened(rows, events)
        self._errors_in_a_row = 0
        if procedure.state != self._last_state:
            self._last_state = procedure.state
            self._report()
        if procedure.finished:
            self._finish(run.result())

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        """Leave the contact first, by the procedure; without it where it is the procedure that fails."""
        run = self._run
        if run is None:
            return
        run.procedure.stop(f"unexpected error in {where}: {type(error).__name__}: {error}")
        self._errors_in_a_row += 1
        if self._errors_in_a_row == MOST_ERRORS:
            self._link.leave_contact()
            self._finish(run.result())

    def _may_begin(self, run: ProcedureRun) -> bool:
        """Begin once driver and readings are there; False while it waits for them."""
        procedure, now = run.procedure, self._starting.look(self._now)
        if now.waits:
            procedure.message = now.waits
        if now.stop:
            procedure.stop(now.stop)
        elif now.begin:
            run.start(self._now)
        return procedure.started or bool(procedure.stopped_because)

    def _on_robot_state(self, state: RobotState) -> None:
        if self._run is not None and not self._starting.believes(self._now, state):
            return
        self._starting.robot_said(state)
        if self._run is not None:
            self._run.procedure.watch.robot_said(int(state.mode), bool(state.retreating), state.message)
            if state.mode == RobotState.MODE_FAULT:
                self._run.procedure.fault(state.message or "no reason given")

    def _report(self) -> None:
        """Publish status, feedback and diagnostics."""
        self._instruments.find_temperatures()
        message = self._reports.tell(self._run, "" if self._answer.success else self._answer.message)
        if self._goal is not None and self._run is not None and self._goal.is_active:
            self._goal.publish_feedback(self._run.feedback(message))

    # --- the operator -----------------------------------------------------------------------------------------------

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._run is None or self._run.procedure.finished:
            response.success, response.message = False, "no run is under way"
            return response
        self._run.procedure.pause()
        response.success, response.message = True, "leaving the contact; the pose under way will be measured again"
        return response

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._run is None or not self._run.procedure.pausing:
            response.success, response.message = False, "no run is paused"
            return response
        self._run.procedure.resume()
        response.success, response.message = True, "going on"
        return response

    def stop(self, reason: str) -> bool:
        """End the run under way, if any; True once nothing moves any more."""
        if self._run is not None:
            self._run.procedure.stop(reason)
        return not self._busy


def main() -> int:
    """Run until SIGINT, SIGTERM or SIGHUP; a run under way is ended retracted first."""
    return run_process("procedure_node", _work, IrecError)


def _work(asked_to_stop: threading.Event) -> None:
    node = ProcedureNode()
    executor = EventsExecutor()
    executor.add_node(node)
    spin_until(asked_to_stop, executor.spin_once)
    deadline = time.monotonic() + SHUTDOWN_WAIT
    while not node.stop("the node was stopped") and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    until = time.monotonic() + ANSWER_TIME
    while time.monotonic() < until:
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    sys.exit(main())
