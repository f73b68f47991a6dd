# SPDX-License-Identifier: Apache-2.0
"""Procedure and calibration as processes against the simulated cell, asked as an operator would."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from geometry_msgs.msg import PoseStamped
from irec_calibration.cell import read_cell
from irec_calibration.effects import find_effect
from irec_calibration.model import Estimate, Model, Term
from irec_calibration.model.file import save_model
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import read_poses, write_poses
from irec_calibration.recertification.store import Store
from irec_calibration.recording import BagReader
from irec_calibration.session import read_session
from irec_ros.seen import SeenBy
from quick_cell import quick_cell
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from irec_msgs.action import RunProcedure
from irec_msgs.msg import CorrectionState, ProcedureStatus, RobotState
from irec_msgs.srv import PutInForce, Recalibrate, SolveCompliances

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.timeout(900)]
CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
SPRING = Term(find_effect("joint_torsion"))
PATIENCE = 600.0  # s of the machine's clock
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def node(module: str, **parameters: object) -> list[str]:
    settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", module, "--ros-args", *settings]


class Operator:
    """Asks for runs and services, and looks at the robot."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("operator")
        self.action = ActionClient(self.node, RunProcedure, "irec/run_procedure")
        self.feedback: list[RunProcedure.Feedback] = []
        self.handle: Any = None  # of the run that was started last
        self.robot: RobotState | None = None
        self.measures = False  # a run of the procedure is under way
        self.seen = SeenBy.of_action(self.node, "irec/run_procedure")
        self.p_tcp = np.full(3, np.nan)
        self.node.create_subscription(RobotState, "robot/state", self._on_state, 10)
        self.node.create_subscription(PoseStamped, "tcp_pose", self._on_tcp, 1)
        self.node.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, 10)

    def _on_state(self, message: RobotState) -> None:
        self.robot = message

    def _on_status(self, message: ProcedureStatus) -> None:
        self.measures = bool(message.session_path)

    def _on_tcp(self, message: PoseStamped) -> None:
        p = message.pose.position
        self.p_tcp = np.array([p.x, p.y, p.z])

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail(f"not within {PATIENCE:.0f} s; last feedback: {self.feedback[-1:]}")
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def start(self, **goal: Any) -> Any:
        """Handle of an accepted run."""
        self.until(self.action.server_is_ready)
        self.until(self.seen)
        self.feedback.clear()
        future = self.action.send_goal_async(
            RunProcedure.Goal(**goal), feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        self.until(future.done)
        self.handle = future.result()
        return self.handle

    def end(self, handle: Any) -> Any:
        """Status and result of a run."""
        future = handle.get_result_async()
        self.until(future.done)
        return future.result()

    def in_state(self, state: str, pose: int = 1) -> None:
        def there() -> bool:
            if any(f.state == state and f.pose == pose for f in self.feedback):
                return True
            if any(f.state == "finished" for f in self.feedback):  # it can't come any more
                pytest.fail(f"the run ended before {state} of pose {pose}: {self.end(self.handle).result.message}")
            return False

        self.until(there)

    def call(self, kind: Any, name: str, **request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        self.until(SeenBy(self.node, name))
        future = client.call_async(kind.Request(**request))
        self.until(future.done)
        return future.result()


    def pace(self, speed_factor: float) -> None:
        """Let the cell run faster, or slower: while a session is computed on, nothing that happens there is asked for."""
        speed = Parameter("speed_factor", value=speed_factor).to_parameter_msg()
        assert self.call(SetParameters, "cell/set_parameters", parameters=[speed]).results[0].successful

    def recalibrate(self, **request: Any) -> Any:
        """Answer of a recalibration; the cell is slow after each run of the procedure, as what follows needs the machine."""
        client = self.node.create_client(Recalibrate, "irec/recalibrate")
        self.until(client.service_is_ready)
        self.until(SeenBy(self.node, "irec/recalibrate"))
        future = client.call_async(Recalibrate.Request(**request))
        while not future.done():
            self.until(lambda: future.done() or self.measures)
            self.pace(8.0)
            self.until(lambda: future.done() or not self.measures)
            self.pace(0.5)
        return future.result()


@pytest.fixture
def operator(ros_domain: int, start_process: Start, tmp_path: Path) -> Iterator[Operator]:
    cell = quick_cell(tmp_path)
    start_process(node("irec_sim.nodes.cell_node", cell=cell, speed_factor=8.0, max_lead=0.1), name="cell")
    procedure = node("irec_calibration.nodes.procedure_node", cell=cell, session_folder=tmp_path, use_sim_time="true")
    start_process(procedure, name="procedure")
    rclpy.init()
    operator = Operator()
    operator.until(lambda: operator.robot is not None)
    yield operator
    operator.node.destroy_node()
    rclpy.shutdown()


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    cell = read_cell(CELL)
    plan = make_plan(cell, 2, pool_size=40)
    return write_poses(pose_list(cell, plan), tmp_path_factory.mktemp("plan") / "poses.yaml")


def is_retracted(operator: Operator, poses: Path) -> bool:
    """Position control, and the TCP well away from both contact points, as soon as the newest readings are in."""
    from irec_calibration.poses.store import read_poses

    touched = [p.p_tool_in_base for p in read_poses(poses).poses]

    def retracted() -> bool:
        away = min(np.linalg.norm(operator.p_tcp - p) for p in touched)
        return operator.robot is not None and operator.robot.mode == RobotState.MODE_POSITION and away > 0.1

    operator.until(retracted)
    return retracted()


def test_a_run_through_the_nodes_gives_a_session_that_can_be_solved(
    operator: Operator, poses: Path, tmp_path: Path, start_process: Start
) -> None:
    start_process(node("irec_calibration.nodes.calibration_node", cell=CELL, calibration_folder=tmp_path / "cal"), "calibration")
    end = operator.end(operator.start(poses_path=str(poses), session_path=str(tmp_path / "s.mcap")))
    assert end.status == SUCCEEDED and end.result.poses_recorded == 2, end.result.message
    assert is_retracted(operator, poses)
    assert {f.pose for f in operator.feedback} == {1, 2} and operator.feedback[0].poses == 2
    session = read_session(tmp_path / "s.mcap")
    cell = read_cell(CELL)
    assert len(session) == 12 and session.marker_seen.all()
    for row in np.flatnonzero(session.load_case):
        np.testing.assert_allclose(session.force_in_tool[row], cell.forces_in_tool[session.load_case[row] - 1], atol=16.0)
    np.testing.assert_allclose(session.p_tcp_in_base, session.robot.kinematics(session.q).p_tcp, atol=1e-5)
    bag = BagReader(tmp_path / "s.mcap")
    topics = {m.topic.name for m in bag.messages()}
    assert {"/wrench", "/wrench_raw", "/joint_states", "/tracker/point", "/tcp_pose", "/temperature/ambient"} <= topics
    assert {"session.yaml", "robot.urdf", "cell.yaml", "parameters.json", "versions.json"} <= bag.attachments.keys()

    operator.pace(0.5)
    solved = operator.call(SolveCompliances, "irec/solve", session_path=str(tmp_path / "s.mcap"), effects=["joint_torsion"])
    assert solved.success, solved.message
    assert Path(solved.model_path).is_file()
    assert solved.residual_rms < 2e-4
    refused = operator.call(SolveCompliances, "irec/solve", session_path=str(tmp_path / "none.mcap"))
    assert not refused.success and "no such file" in refused.message
    recorded = (tmp_path / "s.mcap").read_bytes()
    mistyped = {"session_path": str(tmp_path / "s.mcap"), "model_path": str(tmp_path / "s.mcap")}
    refused = operator.call(SolveCompliances, "irec/solve", **mistyped)
    assert not refused.success and "s.mcap: exists and is not a model" in refused.message
    assert (tmp_path / "s.mcap").read_bytes() == recorded
    nowhere = {"session_path": str(tmp_path / "s.mcap"), "model_path": "/proc/nowhere/model.yaml"}
    refused = operator.call(SolveCompliances, "irec/solve", **nowhere)
    assert not refused.success and "/proc/nowhere/model.yaml: the model can't be written" in refused.message

    refused = operator.call(Recalibrate, "irec/recalibrate", operator_name="M. Muster", poses_path=str(poses))
    assert not refused.success and "correction_node: does not answer" in refused.verdict, "before anything has moved"
    operator.pace(8.0)
    request = {"operator_name": "M. Muster", "poses_path": str(poses), "dry_run": True}
    short = operator.recalibrate(**request)
    assert short.success and not short.activated, short.verdict
    assert "failed: 2 poses were measured, at least 12 are needed" in short.verdict
    assert math.isnan(short.held_out_rms_old)
    assert Store(tmp_path / "cal", cell.serial).in_force() is None


def test_a_recalibration_puts_a_better_model_in_force_and_keeps_the_old_one(
    operator: Operator, tmp_path: Path, start_process: Start
) -> None:
    cell = read_cell(CELL)
    four = write_poses(pose_list(cell, make_plan(cell, 4, pool_size=60)), tmp_path / "poses.yaml")
    text = CELL.read_text().replace("../robots", str(CELL.parents[1] / "robots")).replace("min_poses: 12", "min_poses: 4")
    (tmp_path / "cell.yaml").write_text(text)
    stiff = replace(SPRING, estimates={f"c_{k}": Estimate(1e-8, lower=0.0) for k in range(1, 7)})
    (tmp_path / "old").mkdir()
    bending = Term(find_effect("link_bending"), {f"c_{k}{s}": Estimate(1e-9, lower=0.0) for k in range(1, 7) for s in "ab"})
    save_model(Model((stiff, bending), cell.serial, urdf_sha256=cell.robot.sha256), tmp_path / "old" / "model.yaml")
    store = Store(tmp_path / "cal", cell.serial)
    old = store.put_in_force(store.add(tmp_path / "old", "recalibrated", "M. Muster").calibration, "M. Muster")
    arguments = {"cell": tmp_path / "cell.yaml", "calibration_folder": tmp_path / "cal"}
    start_process(node("irec_calibration.nodes.calibration_node", **arguments), name="calibration")
    correction = {"cell": CELL, "autostart": "true", "use_sim_time": "true", "rate": 50.0}  # it only has to take the model
    start_process(node("irec_correction.nodes.correction_node", **correction), name="correction")
    answer = operator.recalibrate(operator_name="M. Muster", poses_path=str(four))
    assert answer.success and answer.activated, answer.verdict
    assert answer.previous_model_path == str(store.model_path(old.calibration))
    assert answer.held_out_rms_old > 3 * answer.held_out_rms_new > 0
    assert f"{1e6 * answer.held_out_rms_new:.1f} um" in answer.verdict and "now in force" in answer.verdict
    current = store.in_force()
    assert current is not None and str(current[1]) == answer.model_path
    back = operator.call(PutInForce, "irec/put_in_force", operator_name="M. Muster")
    assert not back.success and "envelope" in back.message, "a model of no stated range is refused"
    assert [e.event for e in store.entries()] == ["added", "put_in_force"] * 2


def test_a_cancelled_run_ends_retracted_and_goes_on_after_a_restart_without_measuring_again(
    operator: Operator, poses: Path, tmp_path: Path
) -> None:
    goal = {"poses_path": str(poses), "session_path": str(tmp_path / "s.mcap")}
    handle = operator.start(**goal)
    operator.in_state("establish", pose=2)
    handle.cancel_goal_async()
    end = operator.end(handle)
    assert end.status == CANCELED and end.result.poses_recorded == 1, end.result.message
    assert is_retracted(operator, poses)
    again = operator.end(operator.start(**goal))
    assert again.status == ABORTED and "exists already" in again.result.message
    end = operator.end(operator.start(**goal, resume=True))
    assert end.status == SUCCEEDED and end.result.poses_recorded == 2, end.result.message
    session = read_session(tmp_path / "s.mcap")
    assert len(session) == 12
    assert session.stamp[session.pose == 2].min() > session.stamp[session.pose == 1].max()


def test_a_paused_run_leaves_the_contact_and_ends_complete(operator: Operator, poses: Path, tmp_path: Path) -> None:
    harder = write_poses(replace(read_poses(poses), lateral_factor=1.25), tmp_path / "harder.yaml")
    handle = operator.start(poses_path=str(harder), session_path=str(tmp_path / "s.mcap"))
    operator.in_state("establish")
    assert operator.call(Trigger, "irec/procedure/pause").success
    operator.in_state("paused")
    assert is_retracted(operator, poses)
    assert operator.call(Trigger, "irec/procedure/resume").success
    end = operator.end(handle)
    assert end.status == SUCCEEDED and end.result.poses_recorded == 2, end.result.message
    session = read_session(tmp_path / "s.mcap")
    assert len(session) == 12
    assert session.load_cases[2] == (350.0, 0.0, -1100.0), "as the pose file asks for"
    np.testing.assert_allclose(session.force_in_tool[session.load_case == 2, 0], 350.0, atol=15.0)
    assert not operator.call(Trigger, "irec/procedure/pause").success


@pytest.mark.parametrize(
    ("module", "parameters", "message"),
    [
        ("procedure_node", {}, "parameter 'cell' is empty"),
        ("procedure_node", {"cell": "/nowhere/cell.yaml"}, "the cell file is not there"),
        ("calibration_node", {"cell": "/nowhere/cell.yaml"}, "the cell file is not there"),
        ("procedure_node", {"cell": CELL, "session_foldr": "x"}, "no such parameter (but session_folder): ['session_foldr']"),
        ("calibration_node", {"cell": "5"}, "'cell' to '5' of type 'INTEGER'"),
    ],
)
def test_a_node_with_a_bad_parameter_refuses_to_start_and_says_why(
    ros_domain: int, module: str, parameters: dict[str, str], message: str
) -> None:
    done = subprocess.run(
        node(f"irec_calibration.nodes.{module}", **parameters), capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 2
    assert message in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("module", ["procedure_node", "calibration_node", "recorder_node"])
def test_ros_arguments_that_cannot_be_read_are_a_line_and_no_trace(ros_domain: int, module: str) -> None:
    arguments = [sys.executable, "-m", f"irec_calibration.nodes.{module}", "--ros-args", "--params-file", "/nowhere/params.yaml"]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    assert "/nowhere/params.yaml" in done.stderr and "Traceback" not in done.stderr


def test_nothing_is_measured_while_a_correction_is_at_work(operator: Operator, poses: Path) -> None:
    correction = operator.node.create_publisher(CorrectionState, "irec/correction/state", 10)
    operator.node.create_timer(0.1, lambda: correction.publish(CorrectionState(state=CorrectionState.ACTIVE)))
    operator.until(lambda: correction.get_subscription_count() > 0 and bool(np.isfinite(operator.p_tcp).all()))
    p_before = operator.p_tcp
    end = operator.end(operator.start(poses_path=str(poses)))
    assert end.status == ABORTED
    assert "correction is at work" in end.result.message and "deactivate" in end.result.message
    np.testing.assert_allclose(operator.p_tcp, p_before, atol=1e-4)
