# SPDX-License-Identifier: Apache-2.0
"""Solving, recalibrating and analysing as services. What takes long runs in the thread of its own call."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from irec_msgs.action import RunProcedure
from irec_msgs.msg import ProcedureStatus
from irec_msgs.srv import ActivateModel, AnalyseSession, Recalibrate, SolveCompliances

from ..cell import read_cell
from ..errors import CellError, IrecError, SessionError
from ..identify import identify
from ..model import EIGHTEEN_DOF, Model, blank_model
from ..model_file import check_belongs, save_model
from ..procedure.settings import read_acceptance
from ..provenance import model_of
from ..recalibration import Register, judge
from ..session import read_session
from .analyses import READERS, arguments_of, diagnosed, run_command
from .startup import begin, refuse_unknown_parameters

ANSWER_WAIT = 10.0  # s for another node to answer


class CalibrationNode(Node):
    """Parameters: cell (cell file), calibration_folder (models and the register of what is in force)."""

    def __init__(self) -> None:
        super().__init__("calibration_node")
        path = self._text("cell", "", "cell file (irec-cell/1)")
        if not path:
            raise CellError("parameter 'cell' is empty; name a cell file, e.g. -p cell:=config/cells/afp.yaml")
        self.cell = read_cell(path)
        self.acceptance = read_acceptance(self.cell)
        self.folder = Path(self._text("calibration_folder", "calibrations", "folder for models and their register")).absolute()
        refuse_unknown_parameters(self)
        self.register = Register(self.folder)
        self._busy = threading.Lock()
        self._last_session = ""
        group = ReentrantCallbackGroup()
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, latched, callback_group=group)
        self._procedure = ActionClient(self, RunProcedure, "irec/run_procedure", callback_group=group)
        self._activate = self.create_client(ActivateModel, "irec/correction/activate_model", callback_group=group)
        self.create_service(SolveCompliances, "irec/solve", self._on_solve, callback_group=group)
        self.create_service(Recalibrate, "irec/recalibrate", self._on_recalibrate, callback_group=group)
        self.create_service(AnalyseSession, "irec/analyse", self._on_analyse, callback_group=group)

    def _text(self, name: str, default: str, description: str) -> str:
        return str(self.declare_parameter(name, default, ParameterDescriptor(description=description)).value)

    def _on_status(self, status: ProcedureStatus) -> None:
        self._last_session = status.session_path or self._last_session

    # --- solve ------------------------------------------------------------------------------------------------------

    def _on_solve(self, request: SolveCompliances.Request, response: SolveCompliances.Response) -> SolveCompliances.Response:
        try:
            path = request.session_path or self._last_session
            if not path:
                raise SessionError("no session has been recorded since the node started; give session_path")
            session = read_session(path)
            model = model_of(identify(session, blank_model(list(request.effects) or list(EIGHTEEN_DOF))))
            target = Path(request.model_path) if request.model_path else Path(path).with_suffix(".model.yaml")
            save_model(model, target)
        except IrecError as error:
            response.success, response.message = False, str(error)
            return response
        _fill(response, model)
        response.success, response.model_path = True, str(target)
        response.message = (
            f"{len(model.effects)} effects from {model.figures['poses']} poses, residual {1e6 * response.residual_rms:.1f} um,"
            f" held-out poses {1e6 * response.cross_validated_rms:.1f} um, noise {1e6 * response.noise_floor:.1f} um"
        )
        return response

    # --- recalibrate ------------------------------------------------------------------------------------------------

    def _on_recalibrate(self, request: Recalibrate.Request, response: Recalibrate.Response) -> Recalibrate.Response:
        response.held_out_rms_new = response.held_out_rms_old = response.noise_floor = float("nan")
        response.diagnosis_status = "not_evaluated"
        if not self._busy.acquire(blocking=False):
            response.verdict = "A recalibration is under way already. Nothing was done."
            return response
        try:
            self._recalibrate(request, response)
        except IrecError as error:
            response.success = False
            response.verdict = f"The recalibration was not finished: {error}. The calibration in force was not changed."
        finally:
            self._busy.release()
        self.get_logger().info(response.verdict)
        return response

    def _recalibrate(self, request: Recalibrate.Request, response: Recalibrate.Response) -> None:
        if not request.operator_name:
            raise IrecError("operator_name is empty; give the name of the person who answers for it")
        current = self.register.current(self.cell.serial)
        old = None if current is None else current[1]
        if old is not None:
            check_belongs(old, self.cell.robot, self.cell.serial, "the cell")
        response.previous_model_path = "" if current is None else str(current[0])
        run = self._run_procedure(request.poses_path)
        response.session_path = run.session_path
        session = read_session(run.session_path)
        judgement = judge(session, old, self.acceptance)
        stamp = datetime.now().astimezone().strftime("%Y%m%d_%H%M%S")
        path = save_model(judgement.model, self.folder / f"{self.cell.serial}_{stamp}.yaml")
        response.success, response.model_path = True, str(path)
        response.held_out_rms_new, response.held_out_rms_old = float(judgement.rms_new), float(judgement.rms_old)
        response.noise_floor = float(judgement.noise_floor)
        status, effects, words = self._diagnose(Path(run.session_path), path)
        response.diagnosis_status, response.missing_effects = status, effects
        response.verdict = f"{judgement.text} {words} {run.message[0].upper()}{run.message[1:]}."
        if not judgement.accepted:
            response.verdict += " The calibration in force stays as it is."
        elif request.dry_run:
            response.verdict += " This was a dry run: nothing was put in force."
        else:
            self._put_in_force(path, run.session_path, request.operator_name, response)

    def _run_procedure(self, poses_path: str) -> Any:
        """Result of a complete run. IrecError where it did not come to its end."""
        if not self._procedure.wait_for_server(timeout_sec=ANSWER_WAIT):
            raise IrecError("procedure_node does not answer on irec/run_procedure; start it")
        handle = _wait(self._procedure.send_goal_async(RunProcedure.Goal(poses_path=poses_path)), ANSWER_WAIT)
        if handle is None or not handle.accepted:
            raise IrecError("procedure_node refused to start: a run is under way already")
        result = _wait(handle.get_result_async(), None).result
        if not result.success:
            raise IrecError(result.message.rstrip("."))
        return result

    def _put_in_force(self, path: Path, session_path: str, who: str, response: Recalibrate.Response) -> None:
        if not self._activate.wait_for_service(timeout_sec=ANSWER_WAIT):
            response.verdict += " It was not put in force: correction_node does not answer; start and configure it."
            return
        answer = _wait(self._activate.call_async(ActivateModel.Request(model_path=str(path))), ANSWER_WAIT)
        if answer is None or not answer.success:
            reason = "no answer" if answer is None else answer.message
            response.verdict += f" It was not put in force: {reason}."
            return
        self.register.put_in_force(self.cell.serial, path, session_path, who)
        response.activated = True
        response.verdict += " It is now in force; the one before it was kept."

    def _diagnose(self, session_path: Path, model_path: Path) -> tuple[str, list[str], str]:
        """Status, effects and a sentence for the operator."""
        try:
            found = run_command(["diagnose", str(session_path), "--json", "-o", str(model_path.with_suffix(".diagnosis"))])
            status, effects, _, words = diagnosed(found)
        except (IrecError, KeyError, TypeError) as error:
            return "not_evaluated", [], f"The diagnosis could not be made ({error})."
        if status == "adequate":
            return status, [], "The model explains this robot as far as the instruments can see."
        return status, effects, f"The model no longer explains this robot: {words}"

    # --- analyse ----------------------------------------------------------------------------------------------------

    def _on_analyse(self, request: AnalyseSession.Request, response: AnalyseSession.Response) -> AnalyseSession.Response:
        response.status = "not_evaluated"
        response.cross_validated_rms = response.noise_floor = float("nan")
        try:
            self._analyse(request, response)
        except IrecError as error:
            response.success, response.message = False, str(error)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            response.success, response.message = False, f"irec {request.command} answered without {error!r}"
        return response

    def _analyse(self, request: AnalyseSession.Request, response: AnalyseSession.Response) -> None:
        if request.command not in READERS:
            raise IrecError(f"command is '{request.command}', one of {', '.join(READERS)} is needed")
        session_path = request.session_path or self._last_session
        if not session_path:
            raise SessionError("no session has been recorded since the node started; give session_path")
        model_path = request.model_path
        if not model_path:
            current = self.register.current(self.cell.serial)
            model_path = "" if current is None else str(current[0])
        output = request.output_path or str(Path(session_path).with_suffix(f".{request.command}"))
        found = run_command(arguments_of(request.command, session_path, model_path, request.effect, output))
        response.status, response.effects, response.cross_validated_rms, response.message = READERS[request.command](found)
        response.noise_floor = float(found.get("noise_floor_m") or "nan")
        response.success = True
        made = Path(f"{output}.yaml") if request.command == "add" else Path(output)
        response.files = [str(p) for p in sorted(made.iterdir())] if made.is_dir() else [str(made)] if made.exists() else []


def _fill(response: SolveCompliances.Response, model: Model) -> None:
    estimates = [(f"{t.effect.id}.{name}", e) for t in model.terms for name, e in t.estimates.items()]
    response.parameter_names = [name for name, _ in estimates]
    response.values = [float(e.value) for _, e in estimates]
    response.standard_errors = [float(e.se) for _, e in estimates]
    response.units = [e.unit for _, e in estimates]
    response.identified = [bool(e.identified) for _, e in estimates]
    response.rank = int(model.figures["rank"])
    response.residual_rms = float(model.figures["fit_rms_m"])
    response.cross_validated_rms = float(np.float64(model.figures["cv_rms_m"]))
    response.noise_floor = float(model.figures["noise_floor_m"])


def _wait(future: Any, timeout: float | None) -> Any:
    """Result of a future that another thread of the executor completes; None after the timeout or at shutdown."""
    done = threading.Event()
    register: Callable[[Callable[[Any], None]], None] = future.add_done_callback
    register(lambda _: done.set())
    waited = 0.0
    while not done.wait(0.5):
        waited += 0.5
        if not rclpy.ok() or (timeout is not None and waited >= timeout):
            return None
    return future.result()


def main() -> int:
    """Serve until SIGINT or SIGTERM."""
    if not begin("calibration_node"):
        return 2
    try:
        node = CalibrationNode()
        executor = MultiThreadedExecutor(num_threads=4)
        executor.add_node(node)
        try:
            executor.spin()
        finally:
            executor.shutdown(timeout_sec=1.0)
    except (IrecError, ParameterException) as error:
        print(f"calibration_node: {error}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
