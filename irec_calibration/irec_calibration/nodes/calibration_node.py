# SPDX-License-Identifier: Apache-2.0
"""Solving, recertifying and analysing. What takes long runs in the thread of its own call."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import numpy as np
from irec_ros.guard import GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process, spin_until
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from irec_msgs.msg import ProcedureStatus
from irec_msgs.srv import AnalyseSession, SolveCompliances

from ..cell import read_cell
from ..diagnose import solved
from ..errors import CellError, IrecError, SessionError
from ..model import EIGHTEEN_DOF, Model, blank_model
from ..model.file import check_model_target, save_model
from ..model.plausibility import LARGEST_OFFSET
from ..recertification.quick_plan import MOST_LATERAL
from ..recertification.store import calibration_folder
from ..session import read_session
from .analyses import READERS, arguments_of, run_command
from .cell_side import Limits
from .recertification_server import RecertificationServer

PARAMETERS = (
    P("cell", "", "cell file (irec-cell/1)"),
    P(
        "calibration_folder", "",
        "models, sessions, journal and certificates; relative to the folder of the cell file; empty: `calibrations` there",
    ),  # fmt: skip
    P("predicted_limit", LARGEST_OFFSET, "largest deflection that a model may predict within its envelope", 1e-4, 0.5, unit="m"),
    P("quick_lateral", MOST_LATERAL,
      "most forces across the tool in the quick check, times those of the load cases, where the limits of the cell file let it",
      1.0, MOST_LATERAL),
)  # fmt: skip


class CalibrationNode(GuardedNode):
    """Solves, analyses and recertifies. Parameters: see PARAMETERS."""

    def __init__(self) -> None:
        super().__init__("calibration_node")
        self._p = Parameters(self, PARAMETERS)
        refuse_unknown_parameters(self)
        path = self._p["cell"]
        if not path:
            raise CellError("parameter 'cell' is empty; name a cell file, e.g. -p cell:=config/cells/afp.yaml")
        self.cell = read_cell(path)
        self.folder = calibration_folder(path, self._p["calibration_folder"])
        self._last_session = ""
        group = ReentrantCallbackGroup()
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, latched, callback_group=group)
        self.create_service(SolveCompliances, "irec/solve", self._on_solve, callback_group=group)
        limits = Limits(self._p["predicted_limit"], self._p["quick_lateral"])
        self._recertification = RecertificationServer(self, self.cell, self.folder, group, limits)
        self.get_logger().info(self._recertification.start_text())
        self.create_service(AnalyseSession, "irec/analyse", self._on_analyse, callback_group=group)

    def _on_status(self, status: ProcedureStatus) -> None:
        self._last_session = status.session_path or self._last_session

    # --- solve ------------------------------------------------------------------------------------------------------

    def _on_solve(self, request: SolveCompliances.Request, response: SolveCompliances.Response) -> SolveCompliances.Response:
        try:
            path = request.session_path or self._last_session
            if not path:
                raise SessionError("no session has been recorded since the node started; give session_path")
            target = check_model_target(request.model_path or Path(path).with_suffix(".model.yaml"))
            session = read_session(path)
            model, _ = solved(session, blank_model(list(request.effects) or list(EIGHTEEN_DOF)))
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
            current = self._recertification.store.in_force()
            model_path = "" if current is None else str(current[1])
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


def main() -> int:
    """Serve until SIGINT, SIGTERM or SIGHUP."""
    return run_process("calibration_node", _work, IrecError)


def _work(asked_to_stop: threading.Event) -> None:
    executor = MultiThreadedExecutor(num_threads=6)
    executor.add_node(CalibrationNode())
    try:
        spin_until(asked_to_stop, executor.spin_once)
    finally:
        executor.shutdown(timeout_sec=1.0)


if __name__ == "__main__":
    sys.exit(main())
