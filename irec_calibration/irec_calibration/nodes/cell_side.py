# SPDX-License-Identifier: Apache-2.0
"""The cell as a recertification sees it through ROS: preconditions, runs of the procedure, the model of the correction."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from action_msgs.srv import CancelGoal
from irec_ros.results import GoalResult, is_unknown
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from irec_msgs.action import RunProcedure
from irec_msgs.msg import ProcedureStatus
from irec_msgs.srv import ActivateModel

from ..cell import Cell, Section
from ..errors import Cancelled, IrecError
from ..poses.store import PoseList
from ..procedure.loads import largest_lateral
from ..procedure.settings import read_settings
from ..recertification.judgement import Missing
from ..recertification.plausible import check_before_force
from ..recertification.preconditions import Precondition
from ..recertification.readings import judged_readings
from ..session import Session
from .analyses import run_command
from .look import look

ANSWER_WAIT = 10.0  # s of the machine's clock for another node to answer
START_WAIT = 60.0  # s of the machine's clock for procedure_node to accept a run
ACTIVATE_WAIT = 60.0  # s of the machine's clock for correction_node to take a model
CANCEL_WAIT = 60.0  # s of the machine's clock for the robot to leave the contact
Report = Callable[[str, str, int, int, float], None]


@dataclass(frozen=True)
class Limits:
    """What a recertification may do.

    Attributes:
        predicted: m, that a model may predict over its envelope before it is put in force.
        lateral: multiple of the forces across the tool up to which the quick check may press.
    """

    predicted: float
    lateral: float


class RosCell:
    """Implements `recertification.flow.CellSide` for one run.

    Args:
        procedure, activate: clients of procedure_node and correction_node. runs: folder of the recordings of recertifications.
    """

    def __init__(
        self, node: Node, cell: Cell, procedure: ActionClient, activate: Any, runs: Path, group: Any, limits: Limits
    ) -> None:
        """group: callback group of its subscriptions and clients."""
        self._node, self._cell, self._limits = node, cell, limits
        self._procedure, self._activate = procedure, activate
        self._runs = runs
        self._recording = ""  # of the run of procedure_node that is under way
        self._measuring = self._ending = False
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, latched, callback_group=group)
        self._cancel = node.create_client(CancelGoal, "irec/run_procedure/_action/cancel_goal", callback_group=group)
        self._report: Report = lambda *_: None
        self._cancelled: Callable[[], str] = lambda: ""
        self._confirmed: tuple[str, ...] = ()
        self._before: Session | None = None
        self._activates = True
        self._stage = ""

    def for_run(
        self, report: Report, cancelled: Callable[[], str], confirmed: Sequence[str], before: Session | None, activates: bool
    ) -> RosCell:
        """Set up for one run. Returns itself.

        Args:
            report: stage, sentence, pose, poses, seconds left. cancelled: why the run has to end, asked often; empty: go on.
            confirmed: what the operator has looked at. before: session of the calibration in force.
            activates: it may put a model in force.
        """
        self._report, self._cancelled, self._confirmed = report, cancelled, tuple(confirmed)
        self._before, self._activates = before, activates
        return self

    def report(self, stage: str, text: str) -> None:
        """Progress without a pose."""
        self._stage = stage
        self._report(stage, text, 0, 0, 0.0)

    def _on_status(self, status: ProcedureStatus) -> None:
        """End a run that a killed predecessor of this node has left behind: nobody waits for it, and it keeps the robot."""
        self._recording = status.session_path
        ours = bool(status.session_path) and self._runs in Path(status.session_path).parents
        if ours and not self._measuring and not self._ending and self._cancel.service_is_ready():
            self._ending = True
            self._node.get_logger().warning(f"a run that nobody waits for is under way ({status.session_path}); ending it")
            self._cancel.call_async(CancelGoal.Request())  # of no goal in particular: of all
        if not ours:
            self._ending = False

    # --- before anything moves --------------------------------------------------------------------------------------

    def preconditions(self) -> Sequence[Precondition]:
        """Which nodes answer, and what the instruments read now."""
        begun = time.monotonic()
        while self._ending and time.monotonic() - begun < CANCEL_WAIT:
            self._report("preconditions", "waits for the end of the run that was left behind", 0, 0, 0.0)
            self._stop_if_cancelled()
            time.sleep(0.5)
        begun = time.monotonic()
        sensor = Section(self._cell.path, "", self._cell.raw).section("force_sensor")
        stations = [str(s["name"]) for s in self._cell.raw["stations"]]
        range_n, noise = sensor.number("range_n", 1.0), self._cell.noise
        seen = look(self._node, self._cell.noise, self._stop_if_cancelled)
        found = judged_readings(seen, range_n, stations, self._confirmed, self._before, noise)
        wait = max(0.0, ANSWER_WAIT - (time.monotonic() - begun))  # they had the time of the look to be found, too
        nodes = [self._answers("procedure_node", self._procedure.wait_for_server, wait)]
        if self._activates:
            nodes.append(self._answers("correction_node", self._activate.wait_for_service, wait, "start and configure it"))
        return (*nodes, *found)

    def _answers(self, name: str, wait_for: Callable[..., bool], wait: float, advice: str = "start it") -> Precondition:
        there = bool(wait_for(timeout_sec=wait))
        return Precondition(name, there, "answers" if there else f"does not answer; {advice}")

    def lateral_factor(self, poses: PoseList, most: float) -> float:
        """See `CellSide.lateral_factor`."""
        return largest_lateral(self._cell, read_settings(self._cell), poses, min(most, self._limits.lateral))

    # --- measuring --------------------------------------------------------------------------------------------------

    def run(self, poses_path: Path, session_path: Path, resume: bool, enough: Callable[[], bool]) -> str:
        """Measure the poses of a file; see `CellSide.run`."""
        self._measuring = True
        try:
            return self._run(poses_path, session_path, resume, enough)
        finally:
            self._measuring = False

    def _run(self, poses_path: Path, session_path: Path, resume: bool, enough: Callable[[], bool]) -> str:
        if not self._procedure.wait_for_server(timeout_sec=ANSWER_WAIT):
            raise IrecError("procedure_node does not answer on irec/run_procedure; start it")
        news: list[RunProcedure.Feedback] = []
        repeats = 1 if self._stage == "quick_check" else 0  # its visits are listed one by one; else as the cell file says
        goal = RunProcedure.Goal(poses_path=str(poses_path), session_path=str(session_path), resume=resume, repeats=repeats)
        sent = self._procedure.send_goal_async(goal, feedback_callback=lambda m: news.append(m.feedback))
        handle = self._accepted(sent)
        result = GoalResult(handle)
        pose = 0
        while (answer := result.poll()) is None:
            if not self._node.context.ok():
                raise IrecError("the node is being shut down")
            if why := self._cancelled():
                self._end(handle, result)
                raise Cancelled(f"{why}; the robot has left the contact, what was measured is kept")
            if not self._procedure.server_is_ready():
                raise IrecError("procedure_node has gone in the middle of the run")
            if news:
                result.heard()
                last = news[-1]
                left = last.remaining.sec + 1e-9 * last.remaining.nanosec
                self._report(self._stage, f"pose {last.pose} of {last.poses}", last.pose, last.poses, left)
                if last.pose > pose:
                    pose = last.pose
                    if pose > 1 and enough():
                        self._end(handle, result)
                        return ""
                news.clear()
            time.sleep(0.1)
        if is_unknown(answer):
            return "procedure_node was started anew in the middle of the run"
        return "" if answer.result.success else str(answer.result.message)

    def _accepted(self, sent: Any) -> Any:
        """Handle of the goal. A node that has more readings to work off than it can answers late; a run that it begins after that
        is ended by `_on_status`."""
        begun = time.monotonic()
        while (handle := waited(sent, 1.0)) is None and time.monotonic() - begun < START_WAIT:
            self._stop_if_cancelled()
        if handle is None:
            raise IrecError(f"procedure_node gave no answer within {START_WAIT:.0f} s; end it and start it again")
        if not handle.accepted:
            if self._recording:
                other = f"another run is under way (it records to {self._recording}); end that one first"
            else:
                other = "it is not active, or another run is under way; its log says which"
            raise IrecError(f"procedure_node refused to start: {other}")
        return handle

    def _end(self, handle: Any, result: GoalResult) -> None:
        """Cancel, and wait until the robot has left the contact."""
        handle.cancel_goal_async()
        begun = time.monotonic()
        while result.poll() is None and time.monotonic() - begun < CANCEL_WAIT:
            time.sleep(0.1)

    def _stop_if_cancelled(self) -> None:
        if why := self._cancelled():
            raise Cancelled(f"{why} before anything was measured")

    # --- afterwards -------------------------------------------------------------------------------------------------

    def diagnose(self, session_path: Path, model_path: Path, folder: Path) -> Missing:
        """`irec diagnose` in a process of its own; what could not be evaluated is no reason to stop."""
        self._report("judgement", "looking for effects that the model lacks", 0, 0, 0.0)
        try:
            found = run_command(["diagnose", str(session_path), "--model", str(model_path), "--json", "-o", str(folder)])
            verdict = found["verdict"]
            parts = {
                str(e): tuple(str(p) for p in (known or {}).get("proven", []))
                for e, known in (verdict.get("parts") or {}).items()
            }  # fmt: skip
            size = float(verdict.get("size_m") or found.get("remaining_m") or 0.0)
            effects = tuple(str(e) for e in verdict.get("effects", []))
            return Missing(str(verdict["status"]), effects, parts, size, str(verdict["text"]))
        except (IrecError, KeyError, TypeError, ValueError, AttributeError) as error:
            self._node.get_logger().warning(f"the diagnosis could not be made: {error}")
            return Missing(text=f"The diagnosis could not be made ({error}).")

    def activate(self, model_path: Path) -> str:
        """Empty where the model is plausible and the correction has taken it, else the reason."""
        try:
            check_before_force(model_path, self._cell, self._limits.predicted)
        except IrecError as error:
            return str(error)
        if not self._activate.wait_for_service(timeout_sec=ANSWER_WAIT):
            return "correction_node does not answer; start and configure it"
        answer = self._asked_again(ActivateModel.Request(model_path=str(model_path)))
        if answer is None:
            return f"correction_node gave no answer within {ACTIVATE_WAIT:.0f} s; end it and start it again"
        return "" if answer.success else str(answer.message)

    def _asked_again(self, request: ActivateModel.Request) -> ActivateModel.Response | None:
        """Answer of correction_node; None where there is none.

        An answer comes late where the node has more readings to work off than it can (a simulation faster than real time on a
        busy machine), and is lost where it was started just now and has not found this node yet. Asking twice does no harm.
        """
        futures: list[Any] = []
        for _ in range(round(ACTIVATE_WAIT / ANSWER_WAIT)):
            futures.append(self._activate.call_async(request))
            waited(futures[-1], ANSWER_WAIT)
            for future in futures:
                if future.done():
                    return future.result()  # type: ignore[no-any-return]
        return None


def waited(future: Any, timeout: float) -> Any:
    """Result of a future that another thread of the executor completes; None after the timeout, s."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    waited_s = 0.0
    while not done.wait(0.2):
        waited_s += 0.2
        if waited_s >= timeout:
            return None
    return future.result()
