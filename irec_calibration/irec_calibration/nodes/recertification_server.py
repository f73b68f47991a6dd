# SPDX-License-Identifier: Apache-2.0
"""Recertification as an action and as a service, putting calibrations in force and going back, for one cell."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Duration
from irec_ros.guard import GuardedNode
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse

from irec_msgs.action import Recertify, RunProcedure
from irec_msgs.srv import ActivateModel, PutInForce, Recalibrate

from ..cell import Cell
from ..errors import Cancelled, IrecError
from ..procedure.settings import read_acceptance
from ..recertification.advice import RESUME, apart, with_advice
from ..recertification.flow import Outcome, recertify
from ..recertification.preconditions import not_an_operator
from ..recertification.readings import MANNED
from ..recertification.request import Place, Request, Tool
from ..recertification.run_state import interrupted
from ..recertification.store import Store
from ..session import read_session
from .caller_watch import CallerWatch
from .cell_side import Limits, Report, RosCell

UNCHANGED = "The calibration in force was not changed."
GO_ON_LATER = f"to go on after the last complete pose, {RESUME}."


class RecertificationServer:
    """`irec/recertify` (action), `irec/recalibrate` and `irec/put_in_force` (services) of a node."""

    def __init__(self, node: GuardedNode, cell: Cell, folder: Path, group: Any, limits: Limits) -> None:
        """group: callback group of its services and clients."""
        self._node, self._cell = node, cell
        tool = Tool(cell.tool_name, cell.payload, cell.marker_in_tool)
        operators = tuple(str(name) for name in cell.raw.get("operators", ()))
        self.place = Place(
            cell.name, cell.robot, cell.serial, cell.tolerance, read_acceptance(cell), tool, operators, cell.without_tracker
        )
        self.store = Store(folder, cell.serial)
        procedure = ActionClient(node, RunProcedure, "irec/run_procedure", callback_group=group)
        activate = node.create_client(ActivateModel, "irec/correction/activate_model", callback_group=group)
        self._side = RosCell(node, cell, procedure, activate, self.store.folder / "runs", group, limits)
        self._busy = threading.Lock()
        self._action = ActionServer(
            node, Recertify, "irec/recertify", callback_group=group,
            execute_callback=node.guarded("action irec/recertify", self._on_goal, _not_answered),
            goal_callback=lambda _: GoalResponse.ACCEPT, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        node.create_service(Recalibrate, "irec/recalibrate", self._on_recalibrate, callback_group=group)
        node.create_service(PutInForce, "irec/put_in_force", self._on_put_in_force, callback_group=group)

    def start_text(self) -> str:
        """For the log: what is in force, and whether a run waits to go on."""
        entry = self.store.in_force_entry()
        text = "no calibration is in force" if entry is None else f"calibration {entry.calibration} is in force since {entry.at}"
        waiting = interrupted(self.store)
        return text + (f"; an interrupted run waits ({waiting}): recertify with resume to go on" if waiting else "")

    # --- one run ----------------------------------------------------------------------------------------------------

    def _carry_out(
        self, request: Request, confirmed: list[str], report: Report, cancelled: Callable[[], str]
    ) -> tuple[Outcome, Path | None]:
        """Outcome and certificate of a run. IrecError and Cancelled as `recertify`; IrecError where one is under way."""
        if not self._busy.acquire(blocking=False):
            raise IrecError("a recertification is under way already; nothing was done")
        try:
            entry = self.store.in_force_entry()
            session = None if entry is None else self.store.session_path(entry.calibration)
            before = None if session is None else read_session(session)
            side = self._side.for_run(report, cancelled, confirmed, before, not (request.dry_run or request.check_only))
            outcome = recertify(self.place, self.store, request, side)
            return outcome, self._certificate(outcome, request.operator)
        finally:
            self._busy.release()

    def _certificate(self, outcome: Outcome, operator: str) -> Path | None:
        if outcome.folder is None:
            return None
        from ..report.certificate import write_certificate  # draws: only when it is needed
        from ..report.recertification import certificate_of

        try:
            return write_certificate(certificate_of(outcome, self.place, self.store, operator), outcome.folder)[0]
        except (IrecError, OSError) as error:  # the verdict stands without its page
            self._node.get_logger().error(f"the certificate can't be written: {error}")
            return None

    def _poses(self, path: str) -> str:
        return path or str(self._cell.poses_path)

    def _on_goal(self, goal: Any) -> Recertify.Result:
        asked = goal.request
        request = Request(
            asked.operator_name, self._poses(asked.poses_path), asked.full, asked.check_only, asked.dry_run, asked.resume
        )
        last = ""

        def report(stage: str, text: str, pose: int, poses: int, left: float) -> None:
            nonlocal last
            if text != last:
                self._node.get_logger().info(f"{stage}: {text}")
                last = text
            remaining = Duration(sec=int(left), nanosec=int(1e9 * (left % 1.0)))
            goal.publish_feedback(Recertify.Feedback(stage=stage, message=text, pose=pose, poses=poses, remaining=remaining))

        result = Recertify.Result()
        try:
            watch = CallerWatch(self._node, "irec/recertify/_action/send_goal")

            def cancelled() -> str:
                return "cancelled by the operator" if goal.is_cancel_requested else watch.gone()

            outcome, certificate = self._carry_out(request, list(asked.confirmed), report, cancelled)
            result.success, result.verdict, result.text = True, outcome.verdict, outcome.text
            result.activated, result.calibration = outcome.activated, outcome.calibration
            result.session_path, result.certificate_path = outcome.session_path, str(certificate or "")
            goal.succeed()
        except Cancelled as error:
            result.verdict, result.text = "failed: cancelled", with_advice(f"{error}. {UNCHANGED}", GO_ON_LATER)
            if goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
        except Exception as error:  # the caller is always answered
            if not isinstance(error, IrecError):
                self._node.get_logger().error(f"unexpected error in irec/recertify: {type(error).__name__}: {error}")
            result.verdict, result.text = (
                f"failed: {str(error).partition('. ')[0]}",
                _ended(str(error), interrupted(self.store)),
            )
            goal.abort()
        result.model_path = self._in_force_path()
        self._node.get_logger().info(f"{result.verdict}. {result.text}")
        return result

    def _in_force_path(self) -> str:
        try:
            entry = self.store.in_force_entry()
        except IrecError:
            return ""
        return "" if entry is None else str(self.store.model_path(entry.calibration))

    # --- services ---------------------------------------------------------------------------------------------------

    def _on_recalibrate(self, asked: Recalibrate.Request, response: Recalibrate.Response) -> Recalibrate.Response:
        """The full procedure as one call; whoever calls it stands for area, disc and tool with the name."""
        response.held_out_rms_new = response.held_out_rms_old = response.noise_floor = float("nan")
        response.diagnosis_status = "not_evaluated"
        response.previous_model_path = self._in_force_path()
        request = Request(asked.operator_name, self._poses(asked.poses_path), full=True, dry_run=asked.dry_run)
        try:
            watch = CallerWatch(self._node, "irec/recalibrate")
            outcome, _ = self._carry_out(request, list(MANNED), lambda *_: None, watch.gone)
        except Exception as error:  # the caller is always answered
            response.verdict = f"The recalibration was not finished: {_ended(str(error), interrupted(self.store))}"
            self._node.get_logger().error(response.verdict)
            return response
        response.success = outcome.judgement is not None
        response.verdict = f"{outcome.verdict}. {outcome.text}" + ("" if outcome.activated else f" {UNCHANGED}")
        response.activated, response.session_path = outcome.activated, outcome.session_path
        if outcome.judgement is not None:
            j = outcome.judgement
            response.model_path = str(self.store.model_path(outcome.calibration))
            response.held_out_rms_new, response.held_out_rms_old = float(j.rms_new), float(j.rms_old)
            response.noise_floor = float(j.noise_floor)
            response.diagnosis_status, response.missing_effects = j.missing.status, list(j.missing.effects)
        self._node.get_logger().info(response.verdict)
        return response

    def _on_put_in_force(self, asked: PutInForce.Request, response: PutInForce.Response) -> PutInForce.Response:
        if not self._busy.acquire(blocking=False):
            response.message = "a recertification is under way; wait for its end"
            return response
        try:
            response.success, response.message = self._put_in_force(asked.operator_name.strip(), asked.calibration)
        except Exception as error:
            response.message = f"{str(error).rstrip('.')}. {UNCHANGED}"
        finally:
            self._busy.release()
        entry = self.store.in_force_entry()
        response.calibration, response.model_path = ("" if entry is None else entry.calibration), self._in_force_path()
        self._node.get_logger().info(response.message)
        return response

    def _put_in_force(self, operator: str, calibration: str) -> tuple[bool, str]:
        if wrong := not_an_operator(operator, self.place.operators):
            return False, f"operator_name: {wrong}. {UNCHANGED}"
        wanted = calibration or self.store.former()
        path = self.store.checked_path(wanted)
        refused = self._side.activate(path)
        if refused:
            return False, f"{refused.rstrip('.')}. {UNCHANGED}"
        entry = self.store.put_in_force(wanted, operator) if calibration else self.store.roll_back(operator)
        return True, f"Calibration {entry.calibration} is in force now."


def _not_answered(error: Exception, _: Any) -> Recertify.Result:
    text = f"unexpected error: {type(error).__name__}: {error}"
    return Recertify.Result(verdict=f"failed: {text}", text=_ended(text, ""))


def _ended(error: str, waiting: str) -> str:
    """An error that ended a run, for the person at the cell: what is in force, then what to do now.

    Args:
        waiting: the run that can be gone on with; empty: none.
    """
    what, now = apart(error)
    otherwise = f"mend that, then {RESUME if waiting else 'start again'}"
    return with_advice(f"{what.rstrip('.')}. {UNCHANGED}", f"{now or otherwise}.")
