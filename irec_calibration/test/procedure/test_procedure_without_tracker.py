# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 in a cell that states that it has no tracker: joints, tcp_pose and force say whether the robot stands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from fake_robot import FakeRobot, keys, settings
from irec_calibration.cell import Cell, read_cell
from irec_calibration.errors import CellError, SessionError, SolveError
from irec_calibration.identification.observe import observe
from irec_calibration.poses.store import read_poses
from irec_calibration.procedure.axes import read_axes
from irec_calibration.procedure.by_encoders import LEAST_LEVER, commanded_problem, levers, slip_problem, unsettled_by_encoders
from irec_calibration.procedure.checks import plan_targets
from irec_calibration.procedure.inputs import Inputs
from irec_calibration.procedure.recorder import SessionRecorder, session_header
from irec_calibration.procedure.settings import read_settings
from irec_calibration.procedure.standstill import Streams, Window
from irec_calibration.session import read_session, record_message, write_table
from irec_calibration.session.plausible import judged

AFP = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
STILL = settings().settling
TARGET = np.array([280.0, 0.0, -1100.0])
NAMES = tuple(f"joint_{k + 1}" for k in range(6))
LEVER = np.array([2.0, 1.5, 1.0, 0.3, 0.2, 0.1])


def without(**changed: object) -> FakeRobot:
    robot = FakeRobot(**changed, settings={"without_tracker": True})  # type: ignore[arg-type]
    robot.sees_marker, robot.joint_noise, robot.yields = False, 2e-6, np.array([-4e-7, 0.0, -4e-7])
    return robot


def cell_file(folder: Path, value: object = True) -> Path:
    data = yaml.safe_load(AFP.read_text())
    data["procedure"]["without_tracker"] = value
    data["robot"]["urdf"] = str(AFP.parents[1] / "robots" / Path(data["robot"]["urdf"]).name)
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    return read_cell(cell_file(tmp_path))


def window(
    joint_sd: float = 2e-6, tcp_sd: float = 5e-6, force_sd: float = 1.0, n: int = 40, tcp_n: int = 40, **steps: np.ndarray
) -> Window:
    rng = np.random.default_rng(1)
    q, tcp = rng.normal(0.0, joint_sd, (n, 6)), rng.normal(0.0, tcp_sd, (tcp_n, 3))
    force = TARGET + rng.normal(0.0, force_sd, (100, 3))
    for values, step in ((q, steps.get("q")), (tcp, steps.get("tcp")), (force, steps.get("force"))):
        if step is not None:
            values[len(values) // 2 :] += step
    return Window(0.0, 0.4, force, np.zeros((100, 3)), np.empty((0, 3)), "", q, tcp)


def unsettled(found: Window, target: np.ndarray | None = TARGET) -> str:
    return unsettled_by_encoders(found, STILL, 20, target, LEVER, NAMES)


# --- the criterion ------------------------------------------------------------------------------------------------------


def test_a_robot_stands_where_force_tcp_and_every_joint_stand() -> None:
    assert unsettled(window()) == "" and unsettled(window(), None) == ""


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"tcp_sd": 2e-4}, "the TCP moves along"),
        ({"tcp": np.array([0.0, 2e-5, 0.0])}, "the TCP moves along y (tcp_pose): drift"),
        ({"joint_sd": 1e-4}, "joint_1 moves (joint_states): standard deviation"),
        ({"q": np.array([0, 0, 0, 0, 1e-4, 0.0])}, "joint_5 moves (joint_states): drift of"),
        ({"force": np.array([0.0, 0.0, 12.0])}, "force drifts"),
        ({"n": 10}, "joint_states delivers 10 samples per window, 20 are needed"),
        ({"tcp_n": 10}, "tcp_pose delivers 10 samples per window, 20 are needed"),
    ],
)
def test_a_window_in_which_something_moves_says_what(changed: dict, reason: str) -> None:
    assert reason in unsettled(window(**changed))


def test_a_force_off_its_set_point_is_not_settled() -> None:
    assert "set point" in unsettled(window(), TARGET + [0, 20, 0])


def test_a_joint_counts_with_what_it_moves_the_tcp_by() -> None:
    step = 5e-6  # rad; 10 um with joint 1, half a micrometre with joint 6
    quiet = {"joint_sd": 1e-8, "tcp_sd": 1e-8}
    assert "joint_1" in unsettled(window(**quiet, q=step * np.eye(6)[0]))
    assert unsettled(window(**quiet, q=step * np.eye(6)[5])) == ""


def test_levers_of_a_target_are_what_its_joints_move_the_tcp_by(cell: Cell) -> None:
    poses = read_poses(AFP.with_name("afp_poses.yaml")).poses[:2]
    q, rails = np.array([p.q for p in poses]), np.array([p.ext["rail"] for p in poses])
    found = plan_targets(cell, read_settings(cell), q, rails, [1, 2])
    for target, at in zip(found, q, strict=True):
        for k in range(6):
            nudged = cell.robot.kinematics(np.stack([at, at + 1e-6 * np.eye(6)[k]])).p_tcp
            moved = float(np.linalg.norm(nudged[1] - nudged[0])) / 1e-6
            assert target.lever[k] == pytest.approx(max(moved, LEAST_LEVER), rel=1e-4)
        assert len(target.lever) == 7 and target.lever[6] == 1.0


def test_a_prismatic_axis_has_no_least_lever() -> None:
    J = np.array([[0.0, 0.02], [0.0, 0.0], [0.01, 0.0]])
    np.testing.assert_allclose(levers(J, np.array([True, False]), 1), [LEAST_LEVER, 0.02, 1.0])


def test_slip_is_the_way_across_the_tool_and_not_along_it() -> None:
    R = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # tool0 z is x of base_link
    at = window().p_tcp_in_base.mean(axis=0)
    assert slip_problem(window(), at + [5e-3, 0.0, 0.0], R, 1e-3) == ""
    told = slip_problem(window(), at + [0.0, 1.5e-3, 0.0], R, 1e-3)
    assert "tcp_pose moved by 1.50 mm across the tool" in told and "settling.slip_m; raise it" in told


def test_commanded_angles_are_told_from_measured_ones() -> None:
    at = np.array([1.0, 0.0, 0.5])
    assert "commanded" in commanded_problem([at, at + 1e-6, at])
    assert commanded_problem([at, at + 1e-5]) == "" and commanded_problem([at]) == ""


# --- the machine ---------------------------------------------------------------------------------------------------------


def test_a_run_without_a_tracker_records_every_load_case_with_no_marker() -> None:
    robot = without(n_poses=2).start().run()
    assert keys(robot) == [(p, 0, j) for p in (1, 2) for j in range(4)] and robot.is_safe
    assert robot.procedure.stopped_because == ""
    assert all(len(r.window.p_marker_in_station) == 0 and r.window.station == "" for r in robot.rows)
    assert all(np.isnan(r.window.marker_std) for r in robot.rows)


def test_the_same_silence_ends_a_run_that_has_not_stated_it() -> None:
    robot = without()
    tracked = FakeRobot(1).start()
    tracked.sees_marker = False
    tracked.run()
    assert "tracker/point has not sent a single point" in tracked.procedure.stopped_because
    robot.start().run(stop_when="reference")
    assert "marker" not in robot.procedure.message and "line of sight" not in robot.procedure.message


def test_points_that_come_all_the_same_are_not_in_the_rows() -> None:
    robot = without(n_poses=1)
    robot.sees_marker, robot.marker = True, np.array([9.0, 9.0, 9.0])
    robot.start().run()
    assert len(robot.rows) == 4 and all(len(r.window.p_marker_in_station) == 0 for r in robot.rows)


def test_a_joint_that_creeps_keeps_a_row_from_being_recorded() -> None:
    robot = without(n_poses=1).start()
    robot.run(stop_when="settle")
    robot.creeping = np.array([0, 0, 0, 1e-4, 0, 0])
    for _ in range(300):
        robot.tick()
    assert keys(robot) == [(1, 0, 0)] and "joint_4 moves" in robot.procedure.message
    robot.creeping = np.zeros(6)
    robot.run()
    assert len(robot.rows) == 4


def test_a_contact_that_slips_is_rejected_whichever_load_case_comes_first() -> None:
    robot = without(n_poses=1, order_seed=3).start()
    robot.run(stop_when="settle")
    robot.tcp = robot.tcp + [2e-3, 0.0, 0.0]
    robot.run()
    assert len(robot.rows) == 1
    texts = [e.text for e in robot.events if e.kind == "rejected"]
    assert len(texts) == 3 and all("the contact slipped" in t and "tracker" not in t for t in texts)


def test_commanded_angles_end_the_run_at_the_first_pose_out_of_contact() -> None:
    robot = without(n_poses=3)
    robot.yields = np.zeros(3)
    robot.start().run()
    assert {r.pose for r in robot.rows} == {1} and robot.is_safe
    assert "seem to be commanded ones" in robot.procedure.stopped_because


def test_silence_of_the_joints_still_ends_the_run() -> None:
    robot = without(n_poses=1).start()
    robot.run(stop_when="settle")
    robot.delivers_joints = False
    robot.run()
    assert "no joints readings" in robot.procedure.stopped_because and robot.is_safe


# --- cell file, boundary, session ---------------------------------------------------------------------------------------


def test_the_cell_file_states_it_and_older_ones_stay_valid(cell: Cell, tmp_path: Path) -> None:
    assert cell.without_tracker and read_settings(cell).without_tracker
    assert not read_cell(AFP).without_tracker and not read_settings(read_cell(AFP)).without_tracker
    with pytest.raises(CellError, match="procedure.without_tracker is 'yes please', must be true or false"):
        read_cell(cell_file(tmp_path, "yes please"))
    raw = {**cell.raw, "procedure": {**cell.raw["procedure"], "without_tracker": 1}}
    with pytest.raises(CellError, match="procedure.without_tracker is 1; true or false is needed"):
        read_settings(replace(cell, raw=raw))


def test_points_are_left_out_without_a_fault(cell: Cell) -> None:
    inputs = Inputs(Streams(5.0, tracker=False), read_axes(cell), ["A"])
    assert not inputs.marker(1.0, 0.0, "nowhere", (0.0, 0.0, 0.0))
    assert inputs.problem == "" and inputs.streams.newest_marker is None


def test_the_header_says_that_no_tracker_measured(cell: Cell) -> None:
    assert session_header(cell, "s")["without_tracker"] is True
    assert "without_tracker" not in session_header(read_cell(AFP), "s")


def recorded(path: Path, cell: Cell, marker: float = np.nan, resume: bool = False) -> None:
    r = SessionRecorder(path, cell, {}, record_message.Catalogue(), resume)
    at = cell.robot.kinematics(cell.home[None]).p_tcp[0]
    for j in range(6):
        force = [0.0, 0.0, 0.0] if j == 0 else cell.forces_in_tool[j - 1].tolist()
        data = record_message.encode(
            stamp_ns=0, time=1.0 + 0.1 * j, pose=1, load_case=j, repeat=0, joint_names=[*cell.robot.joint_names, "ext_rail"],
            joint_position=[*cell.home.tolist(), 0.1], joint_target=[], p_tcp_in_base=at.tolist(),
            p_marker_in_station=[marker] * 3, marker="", station="", wrench_in_tool=[*force, 0.0, 0.0, 0.0],
            temperature_names=[], temperature=[],
        )  # fmt: skip
        r.write_row(data, 0)
    r.close()


def test_a_session_of_it_has_empty_marker_columns_and_no_station_in_either_form(cell: Cell, tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap", cell)
    session = read_session(tmp_path / "s.mcap")
    assert not session.marker_seen.any() and not judged(session)[0]
    assert "recorded without a tracker: the marker columns are empty" in session.notes
    folder = write_table(session, tmp_path / "table")
    names, first, *_ = [line.split(",") for line in (folder / "samples.csv").read_text().splitlines()]
    row = dict(zip(names, first, strict=True))
    assert row["station"] == row["marker_x"] == row["marker_y"] == row["marker_z"] == ""
    again = read_session(folder)
    assert again.meta["without_tracker"] is True and not again.marker_seen.any()
    with pytest.raises(SolveError, match="was recorded without a tracker, .* give --without-tracker"):
        observe(session)


def test_marker_columns_that_are_filled_all_the_same_are_a_doubt(cell: Cell, tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap", cell, marker=1.0)
    found, _ = judged(read_session(tmp_path / "s.mcap"))
    assert any("without_tracker says that no tracker measured, marker_* has values in 6 rows" in d for d in found)


def test_a_run_is_not_gone_on_with_in_the_other_way(cell: Cell, tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap", cell)
    before = (tmp_path / "s.mcap").read_bytes()
    tracked = read_cell(cell_file(tmp_path, False))
    with pytest.raises(SessionError, match="recorded without a tracker, the cell is with one now"):
        recorded(tmp_path / "s.mcap", tracked, resume=True)
    assert (tmp_path / "s.mcap").read_bytes() == before
    recorded(tmp_path / "s.mcap", read_cell(cell_file(tmp_path)), resume=True)
