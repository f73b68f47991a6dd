# SPDX-License-Identifier: Apache-2.0
"""A recertification whose caller or whose nodes are killed in the middle goes on after its last complete pose."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from builtin_interfaces.msg import Time
from irec_calibration.cell import Cell, read_cell
from irec_calibration.effects import find_effect
from irec_calibration.model import Estimate, Model, Term
from irec_calibration.model.file import save_model
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import write_poses
from irec_calibration.recertification.run_state import interrupted
from irec_calibration.recertification.store import Store
from irec_calibration.session import read_session
from irec_ros.seen import SeenBy
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

from irec_msgs.action import Recertify
from irec_msgs.msg import CorrectionState, ProcedureStatus, RobotState
from irec_msgs.srv import ActivateModel

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.long]
CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
PATIENCE = 300.0  # s of the machine's clock
POSES = 9
FEW = 6  # that suffice for a new model to be better than one of a robot that hardly gives way, whatever the noise
# Hz: a machine that has other work to do keeps up with these when two more processes are started; robot/state often, since it is
# published by simulated time and judged by the machine's: a cell held back by its followers must not look like a dead driver
SELDOM = {
    "rate.clock": 50.0, "rate.joint_states": 50.0, "rate.tcp_pose": 50.0, "rate.wrench": 125.0, "rate.wrench_raw": 0.0,
    "rate.tracker": 62.5, "rate.state": 50.0,
}  # fmt: skip
CALLER = """
import sys, rclpy
from rclpy.action import ActionClient
from irec_ros.seen import SeenBy
from irec_msgs.action import Recertify
rclpy.init()
node = rclpy.create_node("caller")
client = ActionClient(node, Recertify, "irec/recertify")
client.wait_for_server()
seen = SeenBy.of_action(node, "irec/recertify")
while not seen():
    rclpy.spin_once(node, timeout_sec=0.05)
goal = Recertify.Goal(operator_name="M", poses_path=sys.argv[1], full=True, dry_run=True, confirmed=["area", "disc", "tool"])
client.send_goal_async(goal)
rclpy.spin(node)
"""


def node(module: str, **parameters: object) -> list[str]:
    settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", module, "--ros-args", *settings]


class Person:
    """Looks at the procedure and the robot, and asks for runs."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("person")
        self.status = ProcedureStatus()
        self.robot = RobotState()
        self.correction = CorrectionState()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, latched)
        self.node.create_subscription(RobotState, "robot/state", self._on_robot, 10)
        self.node.create_subscription(CorrectionState, "irec/correction/state", self._on_correction, 10)
        self.client: ActionClient | None = None
        self._followers = self.node.create_publisher(Header, "sim/follower", QoSProfile(depth=100))

    def kill_follower(self, process: subprocess.Popen[bytes], name: str) -> None:
        """Kill a node that the simulation waits for, and say that it need not.

        No clock stands still where a node of a real cell is killed; here it would for a second, which beside a busy machine is
        more than the 1.5 s without a word of the robot for which a procedure lets it press.
        """
        kill(process)
        self._followers.publish(Header(frame_id=name, stamp=Time(sec=2**31 - 1)))

    def _on_status(self, message: ProcedureStatus) -> None:
        self.status = message

    def _on_robot(self, message: RobotState) -> None:
        self.robot = message

    def _on_correction(self, message: CorrectionState) -> None:
        self.correction = message

    def until(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f"not within {PATIENCE:.0f} s: {what}; procedure: {self.status.state} {self.status.message}")
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def presses(self, after: int = 0) -> int:
        """Number of the pose, later than `after`, in which the robot presses now."""
        self.until(lambda: self.status.pose > after and self.status.state == "establish", f"pressing after pose {after}")
        return int(self.status.pose)

    def stands_retracted(self) -> None:
        self.status = ProcedureStatus(state="unknown")
        self.until(lambda: self.status.state == "idle", "end of the procedure")
        self.until(lambda: self.robot.mode == RobotState.MODE_POSITION and not self.robot.in_motion, "robot at rest")

    def ask(self, **goal: Any) -> Any:
        """Future of the result of a recertification."""
        self.client = self.client or ActionClient(self.node, Recertify, "irec/recertify")
        self.until(self.client.server_is_ready, "irec/recertify")
        self.until(SeenBy.of_action(self.node, "irec/recertify"), "the server finds this client")
        asked = Recertify.Goal(**{"operator_name": "M", "dry_run": True, "confirmed": ["area", "disc", "tool"], **goal})
        sent = self.client.send_goal_async(asked)
        self.until(sent.done, "the goal is accepted")
        return sent.result().get_result_async()

    def answer(self, future: Any) -> Any:
        self.until(future.done, "an answer")
        return future.result().result


def kill(process: subprocess.Popen[bytes]) -> None:
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(20)


def test_a_run_goes_on_whoever_is_killed_in_its_middle(ros_domain: int, start_process: Start, tmp_path: Path) -> None:
    cell = read_cell(CELL)
    poses = write_poses(pose_list(cell, make_plan(cell, POSES, pool_size=60)), tmp_path / "poses.yaml")
    store = Store(tmp_path / "cal", cell.serial)
    calibration_node = node("irec_calibration.nodes.calibration_node", cell=CELL, calibration_folder=tmp_path / "cal")
    procedure_node = node("irec_calibration.nodes.procedure_node", cell=CELL, session_folder=tmp_path, use_sim_time="true")
    start_process(node("irec_sim.nodes.cell_node", cell=CELL, speed_factor=3.0, max_lead=0.1), name="cell")
    procedure = start_process(procedure_node, name="procedure")
    calibration = start_process(calibration_node, name="calibration")
    rclpy.init()
    person = Person()
    try:
        caller = start_process([sys.executable, "-c", CALLER, str(poses)], name="caller")
        person.presses()
        kill(caller)
        person.stands_retracted()
        person.until(
            lambda: "whoever asked for it has gone" in (tmp_path / "calibration.log").read_text(), "the reason in the log"
        )
        assert "procedure" in interrupted(store)

        person.ask(resume=True)
        first = person.presses()
        last = person.presses(after=first)
        kill(calibration)
        calibration = start_process(calibration_node, name="calibration_2")
        person.stands_retracted()
        assert "an interrupted run waits" in (tmp_path / "calibration_2.log").read_text()

        future = person.ask(resume=True)
        person.presses(after=last - 1)
        kill(procedure)
        lost = person.answer(future)
        assert not lost.success and "Do this now" in lost.text and "resume" in lost.text, lost.text
        procedure = start_process(procedure_node, name="procedure_2")
        person.until(lambda: person.status.state == "idle", "the new procedure_node")

        result = person.answer(person.ask(resume=True))
        assert result.success and result.verdict.startswith(f"failed: {POSES} poses were measured"), result.verdict
        session = read_session(result.session_path)
        assert len(session) == 6 * POSES, "each pose once"
        stamp = [session.stamp[session.pose == p] for p in range(1, POSES + 1)]
        assert all(a.max() < b.min() for a, b in itertools.pairwise(stamp)), "complete poses were not measured again"
        assert len(list((store.folder / "runs").iterdir())) == 1 and interrupted(store) == ""
    finally:
        person.node.destroy_node()
        rclpy.shutdown()


def store_with_a_stiff_robot(folder: Path, cell: Cell) -> Store:
    """A calibration in force that says the robot hardly gives way."""
    spring = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(1e-8, lower=0.0) for k in range(1, 7)})
    bending = Term(find_effect("link_bending"), {f"c_{k}{s}": Estimate(1e-9, lower=0.0) for k in range(1, 7) for s in "ab"})
    (folder / "old").mkdir()
    save_model(Model((spring, bending), cell.serial, urdf_sha256=cell.robot.sha256), folder / "old" / "model.yaml")
    store = Store(folder / "cal", cell.serial)
    store.put_in_force(store.add(folder / "old", "recalibrated", "M").calibration, "M")
    return store


def test_a_recalibration_goes_on_while_correction_and_recorder_are_killed_and_come_back(
    ros_domain: int, start_process: Start, tmp_path: Path
) -> None:
    path = tmp_path / "cell.yaml"
    text = CELL.read_text().replace("../robots", str(CELL.parents[1] / "robots"))
    path.write_text(text.replace("min_poses: 12", "min_poses: 4"))
    cell = read_cell(path)
    poses = write_poses(pose_list(cell, make_plan(cell, FEW, pool_size=60)), tmp_path / "poses.yaml")
    store = store_with_a_stiff_robot(tmp_path, cell)
    correction_node = node(
        "irec_correction.nodes.correction_node", cell=path, calibrations="cal", autostart="true", use_sim_time="true"
    )

    def recorder_node(name: str) -> list[str]:
        topics = "['joint_states', 'wrench', 'robot/state', 'irec/procedure/status']"
        return node("irec_calibration.nodes.recorder_node", output=tmp_path / name, topics=topics, use_sim_time="true")

    start_process(node("irec_sim.nodes.cell_node", cell=path, speed_factor=4.0, max_lead=0.1, **SELDOM), name="cell")
    start_process(
        node("irec_calibration.nodes.procedure_node", cell=path, session_folder=tmp_path, use_sim_time="true"), name="procedure"
    )
    start_process(node("irec_calibration.nodes.calibration_node", cell=path, calibration_folder="cal"), name="calibration")
    correction, recorder = start_process(correction_node, "correction"), start_process(recorder_node("recording"), "recorder")
    rclpy.init()
    person = Person()
    try:
        offered = person.node.create_client(ActivateModel, "irec/correction/activate_model")
        person.until(offered.service_is_ready, "a correction_node that was started")
        future = person.ask(full=True, dry_run=False, poses_path=str(poses))
        person.presses(after=1)
        person.kill_follower(correction, "correction_node")
        correction = start_process(correction_node, "correction_2")
        person.presses(after=2)
        kill(recorder)
        start_process(recorder_node("recording_2"), "recorder_2")

        result = person.answer(future)
        assert (result.success, result.activated, result.verdict) == (True, True, "recalibrated"), result.text
        session = read_session(result.session_path)
        assert len(session) == 6 * FEW and interrupted(store) == "", "each pose once"
        entry = store.in_force_entry()
        assert entry is not None and entry.calibration == result.calibration

        kill(correction)
        start_process(correction_node, "correction_3")

        def follows_without_correcting() -> bool:
            """Told by the new node: the killed one was active, and its last messages may come late."""
            told = person.correction
            return told.model_sha256 == entry.model_sha256 and told.state == CorrectionState.INACTIVE

        person.until(follows_without_correcting, "that a restarted node follows the calibration in force and is inactive")
    finally:
        person.node.destroy_node()
        rclpy.shutdown()
