# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 as processes in a cell that states that it has no tracker: to a session that a model is identified from."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from geometry_msgs.msg import PointStamped
from irec_calibration.cell import read_cell
from irec_calibration.cli import main
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import write_poses
from irec_calibration.recording import BagReader
from irec_calibration.session import read_session
from quick_cell import quick_cell
from test_loop_ros import SUCCEEDED, Operator, node

from irec_msgs.srv import Recalibrate, SolveCompliances

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.timeout(900)]
POSES = 4


def untracked_cell(folder: Path) -> Path:
    """`quick_cell`, which states that it has no tracker."""
    path = quick_cell(folder)
    text = path.read_text()
    path.write_text(text.replace("\nprocedure: ", "\nprocedure:\n  without_tracker: true\n#", 1))
    if not read_cell(path).without_tracker:
        raise ValueError(f"{path}: without_tracker was not put in")
    return path


@pytest.fixture
def place(ros_domain: int, start_process: Start, tmp_path: Path) -> Iterator[tuple[Operator, Path]]:
    """Who asks for runs, and the cell file; the simulated cell has no tracker."""
    cell = untracked_cell(tmp_path)
    simulated = {"cell": cell, "speed_factor": 8.0, "max_lead": 0.1, "rate.tracker": 0.0}
    start_process(node("irec_sim.nodes.cell_node", **simulated), name="cell")
    start_process(node("irec_calibration.nodes.procedure_node", cell=cell, use_sim_time="true"), name="procedure")
    rclpy.init()
    operator = Operator()
    operator.until(lambda: operator.robot is not None)
    yield operator, cell
    operator.node.destroy_node()
    rclpy.shutdown()


def test_a_run_without_a_tracker_gives_a_session_that_a_model_is_identified_from(
    place: tuple[Operator, Path], tmp_path: Path, start_process: Start, capsys: pytest.CaptureFixture[str]
) -> None:
    operator, cell_file = place
    cell = read_cell(cell_file)
    poses = write_poses(pose_list(cell, make_plan(cell, POSES, pool_size=60)), tmp_path / "poses.yaml")
    recording = tmp_path / "s.mcap"
    end = operator.end(operator.start(poses_path=str(poses), session_path=str(recording)))
    assert end.status == SUCCEEDED and end.result.poses_recorded == POSES, end.result.message
    assert "0 load cases rejected" in end.result.message
    said = (tmp_path / "procedure.log").read_text()
    assert "without a tracker" in said and "line of sight" not in said

    session = read_session(recording)
    assert len(session) == 6 * POSES and not session.marker_seen.any()
    assert session.meta["without_tracker"] is True and "recorded without a tracker" in " ".join(session.notes)
    pressed = session.load_case > 0
    asked = cell.forces_in_tool[session.load_case[pressed] - 1]
    np.testing.assert_allclose(session.force_in_tool[pressed], asked, atol=16.0)

    assert main(["check", str(recording)]) == 0
    assert main(["solve", str(recording), "-o", str(tmp_path / "no.yaml")]) == 2
    refused = capsys.readouterr().err
    assert "was recorded without a tracker" in refused and "--without-tracker" in refused
    assert main(["export", str(recording), "-o", str(tmp_path / "table")]) == 0
    capsys.readouterr()
    figures = []
    for form in (recording, tmp_path / "table"):
        assert main(["solve", str(form), "--without-tracker", "--dof", "6", "-o", str(tmp_path / "m.yaml"), "--json"]) == 0
        figures.append(json.loads(capsys.readouterr().out))
    assert figures[0]["effects"] == ["joint_torsion", "disc_compliance"]
    assert figures[0]["cv_rms_m"] == pytest.approx(figures[1]["cv_rms_m"], rel=1e-6)
    assert figures[0]["cv_rms_m"] < 1e-4

    calibrations = {"cell": cell_file, "calibration_folder": tmp_path / "c"}
    start_process(node("irec_calibration.nodes.calibration_node", **calibrations), name="calibration")
    answer = operator.call(SolveCompliances, "irec/solve", session_path=str(recording), effects=["joint_torsion"])
    assert not answer.success and "--without-tracker" in answer.message
    answer = operator.call(Recalibrate, "irec/recalibrate", operator_name="M. Muster", poses_path=str(poses))
    assert not answer.success and "failed: tracker" in answer.verdict and "procedure.without_tracker" in answer.verdict


def test_a_tracker_that_talks_all_the_same_is_recorded_and_not_read(place: tuple[Operator, Path], tmp_path: Path) -> None:
    operator, cell_file = place
    cell = read_cell(cell_file)
    poses = write_poses(pose_list(cell, make_plan(cell, 1, pool_size=40)), tmp_path / "poses.yaml")
    tracker = operator.node.create_publisher(PointStamped, "tracker/point", 10)
    operator.node.create_timer(0.05, lambda: tracker.publish(PointStamped()))  # no stamp, no station, (0, 0, 0)
    operator.until(lambda: tracker.get_subscription_count() > 0)
    end = operator.end(operator.start(poses_path=str(poses), session_path=str(tmp_path / "s.mcap")))
    assert end.status == SUCCEEDED and end.result.poses_recorded == 1, end.result.message
    assert not read_session(tmp_path / "s.mcap").marker_seen.any()
    assert "/tracker/point" in {m.topic.name for m in BagReader(tmp_path / "s.mcap").messages()}
