# SPDX-License-Identifier: Apache-2.0
"""`irec profile`: from recordings of courses to the table that the correction reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_correction.preview import read_profile
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation
from tool_load_bag import JOINTS, WRENCH

LINE = "=" * 80
POSE = f"""std_msgs/Header header
geometry_msgs/Pose pose
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
STOOD = 0.6  # s, before and after the course
TURN = Rotation.from_euler("z", 30.0, degrees=True)  # of the tool against the path, which is base_link's x axis


def expected(t: np.ndarray, seconds: float) -> np.ndarray:
    """Force along the path's axes, (k, 3), N."""
    pressed = 1.0 / (1.0 + np.exp(-(t - 0.6) / 0.05)) - 1.0 / (1.0 + np.exp(-(t - seconds + 0.4) / 0.04))
    return np.stack([-60.0 * pressed, -80.0 * pressed, 850.0 * pressed], axis=1)


def write_course(path: Path, seconds: float, seed: int, wrench: bool = True, moving: bool = True) -> Path:
    """A course of 0.1 m/s; its joints turn evenly."""
    rng, o = np.random.default_rng(seed), TURN.as_quat()
    with path.open("wb") as file:
        writer = Writer(file)
        kinds = [writer.register_msgdef(f"{package}/msg/{name}", text) for package, name, text in (
            ("sensor_msgs", "JointState", JOINTS), ("geometry_msgs", "PoseStamped", POSE),
            ("geometry_msgs", "WrenchStamped", WRENCH))]  # fmt: skip
        for k in range(round((seconds + 2.0 * STOOD) / 0.004)):
            at = 1_000_000_000_000 + k * 4_000_000
            header = {"stamp": {"sec": at // 10**9, "nanosec": at % 10**9}, "frame_id": ""}
            s = float(np.clip(k * 0.004 - STOOD, 0.0, seconds)) if moving else 0.0
            joints = {"name": ["joint_1", "joint_2"], "position": [0.1 * s, -0.05 * s], "velocity": [], "effort": []}
            writer.write_message("joint_states", kinds[0], {"header": header, **joints}, at, at)
            pose = {
                "position": {"x": 0.1 * s, "y": 0.5, "z": 0.2},
                "orientation": dict(zip("xyzw", map(float, o), strict=True)),
            }
            writer.write_message("tcp_pose", kinds[1], {"header": header, "pose": pose}, at, at)
            if wrench:
                f = TURN.inv().apply(expected(np.array([s]), seconds)[0]) + rng.normal(0.0, 3.0, 3)
                body = {"force": dict(zip("xyz", map(float, f), strict=True)), "torque": {"x": 0.0, "y": 0.0, "z": 0.0}}
                writer.write_message("wrench", kinds[2], {"header": header, "wrench": body}, at, at)
        writer.finish()
    return path


@pytest.fixture(scope="module")
def courses(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("courses")
    return [write_course(folder / f"course_{i}.mcap", s, i) for i, s in enumerate((5.0, 6.0, 7.0))]


def test_the_table_of_a_dry_course_holds_the_force_that_the_others_had(
    courses: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dry, table = write_course(tmp_path / "dry.mcap", 6.5, 9, wrench=False), tmp_path / "profile.csv"
    given = ["profile", *map(str, courses), "--course", str(dry), "-o", str(table)]
    assert main([*given, "--smooth", "0", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["courses"] == 3 and told["slack_s"] < 0.02 and told["left_n"] == pytest.approx(3.0, abs=3.0)
    profile = read_profile(table, ["joint_1", "joint_2"])  # as the correction reads it
    wanted = TURN.inv().apply(expected(profile.q[:, 0] / 0.1, 6.5))
    middle = slice(round(1.2 / 0.004), round(5.5 / 0.004))
    np.testing.assert_allclose(profile.wrench[middle, :3], wanted[middle], atol=12.0)
    assert float(np.abs(profile.wrench[:, :3] - wanted).max()) < 90.0  # within 10 ms of the touch-down
    steepest = [float(np.abs(np.diff(profile.wrench[:, :3], axis=0)).max())]
    for smooth in ([], ["--smooth", "0.2"]):
        assert main([*given, *smooth]) == 0
        steepest.append(float(np.abs(np.diff(read_profile(table, ["joint_1", "joint_2"]).wrench[:, :3], axis=0)).max()))
    assert steepest[1] < 0.9 * steepest[0] and steepest[2] < 0.4 * steepest[0]  # the touch-down takes 0.1 s


def test_the_text_says_what_to_set(courses: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "profile.csv"
    assert main(["profile", *map(str, courses), "-o", str(table)]) == 0
    assert f"preview.file: {table}, preview.slack: " in capsys.readouterr().out


def test_recordings_that_tell_no_profile_are_refused(
    courses: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dry = write_course(tmp_path / "dry.mcap", 5.0, 1, wrench=False)
    standing = write_course(tmp_path / "standing.mcap", 5.0, 1, moving=False)
    for given, word in (
        ([courses[0]], "give two or more"),
        ([courses[0], dry], "0 messages on 'wrench'"),
        ([courses[0], standing], "the TCP moves for 0.0 s"),
        ([*courses, "--head", "9"], "samples; "),
        ([*courses, "--tail", "-1"], "--tail is -1 s"),
        ([*courses, "--smooth", "2"], "--smooth is 2 s"),
        ([*courses, "--joints", "axes"], "0 messages on 'axes'"),
    ):
        assert main(["profile", *map(str, given), "-o", str(tmp_path / "p.csv")]) == 2
        assert word in capsys.readouterr().err
    assert not (tmp_path / "p.csv").exists()
