# SPDX-License-Identifier: Apache-2.0
"""`irec course-filter`: from recordings of courses and of swept offsets to the table that the correction reads."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.cli import main
from irec_calibration.effects import find_effect
from irec_calibration.model import Estimate, Model, Term
from irec_calibration.model.file import save_model
from irec_correction.deflection import Deflection
from irec_correction.filters import low_pass
from irec_correction.fir import Fir, read_taps
from mcap_ros2.writer import Writer
from scipy import signal
from scipy.spatial.transform import Rotation
from test_profile_command import POSE
from tool_load_bag import JOINTS, WRENCH

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))
from case_parts.bag import _TYPES  # noqa: E402

CELL = ROOT / "config" / "cells" / "afp.yaml"
RATE, LATE, RAIL = 250.0, 0.028, 0.4
LINE = "=" * 80
OFFSET = (
    f"std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n{LINE}\nMSG: std_msgs/Header\n"
    f"builtin_interfaces/Time stamp\nstring frame_id\n{LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n{LINE}\n"
    f"MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n{LINE}\n"
    f"MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{LINE}\n"
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
KINDS = {
    "joint_states": ("sensor_msgs/msg/JointState", JOINTS),
    "tcp_pose": ("geometry_msgs/msg/PoseStamped", POSE),
    "wrench": ("geometry_msgs/msg/WrenchStamped", WRENCH),
    "tracker/point": ("geometry_msgs/msg/PointStamped", _TYPES["geometry_msgs/msg/PointStamped"]),
    "irec/offset": ("geometry_msgs/msg/TransformStamped", OFFSET),
}
BEGIN = np.array([0.1, -1.5, 1.4, 0.2, 0.9, -0.3])
TURN = np.array([0.02, 0.005, -0.004, 0.0, 0.003, 0.0])  # rad/s


def xyz(v: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", map(float, v), strict=True))


def write(path: Path, columns: dict[str, list[dict]], frames: dict[str, str]) -> Path:
    """Messages 4 ms apart; frames: of each topic."""
    with path.open("wb") as file:
        writer = Writer(file)
        kinds = {t: writer.register_msgdef(*KINDS[t]) for t in columns}
        for k in range(len(next(iter(columns.values())))):
            at = 1_700_000_000_000_000_000 + k * 4_000_000
            for topic, rows in columns.items():
                header = {"stamp": {"sec": at // 10**9, "nanosec": at % 10**9}, "frame_id": frames.get(topic, "")}
                writer.write_message(topic, kinds[topic], {"header": header, **rows[k]}, at, at)
        writer.finish()
    return path


def unsteady(seed: int, n: int) -> np.ndarray:
    sos = signal.butter(2, 5.0, fs=RATE, output="sos")
    return 40.0 * signal.sosfilt(sos, np.random.default_rng(seed).standard_normal((n, 3)), axis=0)


def swings(x: np.ndarray) -> np.ndarray:
    """What an arm of 9 Hz makes of a quasi-static deflection (k, 3)."""
    w = 2.0 * np.pi * 9.0
    b, a, _ = signal.cont2discrete(([w * w], [1.0, 0.1 * w, w * w]), 1.0 / RATE)
    return np.stack([signal.lfilter(np.ravel(b), a, y) for y in x.T], axis=1)


def late(x: np.ndarray) -> np.ndarray:
    t = np.arange(len(x)) / RATE
    return np.stack([np.interp(t - LATE, t, y) for y in x.T], axis=1)


@pytest.fixture(scope="module")
def cell() -> Cell:
    return read_cell(CELL)


@pytest.fixture(scope="module")
def model(cell: Cell) -> Model:
    terms = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(c) for k, c in enumerate((3, 2, 3, 10, 12, 18), 1)})
    scaled = replace(terms, estimates={n: Estimate(1e-7 * e.value) for n, e in terms.estimates.items()})
    return Model((scaled,), serial=cell.serial, urdf_sha256=cell.robot.sha256)


def course(cell: Cell, model: Model, path: Path, seed: int, process: bool = True, told: float | None = None) -> Path:
    """16 s; contact from 1 s to 15 s; the robot misses its path by a wave that has nothing to do with the force.

    told: share of an offset that is sent meanwhile, by which the controller says that the TCP moves; None: no offset is sent.
    """
    n = round(16.0 * RATE)
    t = np.arange(n) / RATE
    q = BEGIN + t[:, None] * TURN
    kin = cell.robot.kinematics(q)
    contact = ((t > 1.0) & (t < 15.0))[:, None] * float(process)
    force = (unsteady(seed, n) + np.array([60.0, -70.0, -850.0])) * contact
    deflection = Deflection(model, cell.robot)
    static = np.array([deflection(a, f, np.zeros(3), 0.004, RAIL)[0].copy() for a, f in zip(q, force, strict=True)])
    missed = 4e-5 * np.sin(2.0 * np.pi * 2.0 * t)[:, None] * np.ones(3)
    rng = np.random.default_rng(seed + 100)
    sent = np.zeros((n, 3)) if told is None else 2e-6 * unsteady(seed + 50, n) - 1e-6 * force
    marker = kin.p_tcp + kin.R_tool @ cell.marker_in_tool + swings(static) + late(sent) + missed + rng.normal(0.0, 1e-5, (n, 3))
    station = cell.stations[0]
    seen = (marker + cell.base_in_cell(np.array([RAIL])) - station.p_in_cell) @ station.R_in_cell
    turn = Rotation.from_matrix(kin.R_tool).as_quat()
    read = force + rng.normal(0.0, 1.5, force.shape)
    names = [*cell.robot.joint_names, "ext_rail"]
    rest = {"velocity": [], "effort": []}
    turned = {"rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    offset = {"irec/offset": [{"child_frame_id": "tool0", "transform": {"translation": xyz(o), **turned}} for o in sent]}
    return write(path, {
        **({} if told is None else offset),
        "joint_states": [{"name": names, "position": [*map(float, a), RAIL], **rest} for a in q],
        "tcp_pose": [{"pose": {"position": xyz(p), "orientation": {**xyz(o[:3]), "w": float(o[3])}}}
                     for p, o in zip(kin.p_tcp + (told or 0.0) * sent, turn, strict=True)],
        "wrench": [{"wrench": {"force": xyz(f), "torque": xyz(np.zeros(3))}} for f in read],
        "tracker/point": [{"point": xyz(p)} for p in seen],
    }, {"tracker/point": station.name, "wrench": "tool0", "tcp_pose": "base_link", "irec/offset": "base_link"})  # fmt: skip


def sweep(cell: Cell, path: Path, axes: int = 3, turned: float = 0.0) -> Path:
    """An offset along each axis in turn, 3 to 28 Hz in 8 s; the TCP follows late."""
    n, part = round(24.0 * RATE), 8.0
    t = np.arange(n) / RATE
    u = (t % part) / part
    offset = np.zeros((n, 3))
    which = np.minimum((t / part).astype(int), 2)
    offset[np.arange(n), which] = 1e-4 * np.sin(2.0 * np.pi * part * (3.0 * u + 12.5 * u * u)) * (which < axes)
    seen = np.array([1.0, 2.0, 3.0]) + late(offset) + np.random.default_rng(5).normal(0.0, 5e-6, (n, 3))
    rest = {"velocity": [], "effort": []}
    turn = {"rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return write(path, {
        "joint_states": [{"name": list(cell.robot.joint_names), "position": (BEGIN + turned * k / n).tolist(), **rest}
                         for k in range(n)],
        "irec/offset": [{"child_frame_id": "tool0", "transform": {"translation": xyz(o), **turn}} for o in offset],
        "tracker/point": [{"point": xyz(p)} for p in seen],
    }, {"tracker/point": "base_link", "irec/offset": "base_link"})  # fmt: skip


@pytest.fixture(scope="module")
def bags(cell: Cell, model: Model, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    place = tmp_path_factory.mktemp("bags")
    save_model(model, place / "model.yaml")
    return {
        "model": [str(place / "model.yaml"), str(CELL)],
        "courses": [str(course(cell, model, place / f"course_{i}.mcap", i)) for i in (1, 2, 3)],
        "dry": [str(course(cell, model, place / f"dry_{i}.mcap", i, process=False)) for i in (1, 2, 3)],
        "corrected": [
            str(course(cell, model, place / f"corrected_{i}.mcap", i, told=told)) for i, told in ((1, 0.0), (2, 1.0), (3, 0.0))
        ],
        "swept": [str(sweep(cell, place / "swept.mcap"))],
    }


def missed(cell: Cell, model: Model, stage: Fir | object, seed: int = 9) -> float:
    """Lateral deviation that a filter leaves on a course that it was not learnt from, m RMS."""
    n = 5000
    q = BEGIN + np.arange(n)[:, None] / RATE * TURN
    force = unsteady(seed, n) + np.array([60.0, -70.0, -850.0])
    read = force + np.random.default_rng(seed).normal(0.0, 1.5, force.shape)
    seen = np.empty((n, 3))
    for k in range(n):
        if isinstance(stage, Fir):
            stage.place(q[k])
        seen[k] = stage.step(np.r_[read[k], np.zeros(3)])[:3]  # type: ignore[union-attr, attr-defined]
    deflection, still = Deflection(model, cell.robot), np.zeros(3)
    true, sent = (np.array([deflection(a, f, still, 0.004)[0].copy() for a, f in zip(q, x, strict=True)]) for x in (force, seen))
    kin = cell.robot.kinematics(q)
    along = np.gradient(kin.p_tcp, axis=0)
    across = np.cross(kin.R_tool[:, :, 2], along / np.linalg.norm(along, axis=1, keepdims=True))
    rest = ((swings(true) - late(sent)) * across).sum(axis=1)[500:]
    return float(rest.std())


@pytest.mark.parametrize("answer", [pytest.param("swept", marks=pytest.mark.long), "delay"])
def test_the_table_is_a_filter_that_misses_less_on_another_course(
    answer: str, cell: Cell, model: Model, bags: dict[str, list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "filter.csv"
    how = ["--swept", *bags["swept"]] if answer == "swept" else ["--delay", str(LATE)]
    given = [*bags["model"], *bags["courses"], "--dry", *bags["dry"], *how, "--acceleration", "6", "-o", str(table)]
    assert main(["course-filter", *given, "--postures", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["left_m"] < 0.6 * told["before_m"]
    assert told["acceleration_m_s2"] <= 2.0
    assert told["postures"] == 2
    read = read_taps(table, cell.robot.joint_names)  # as the correction reads it
    learnt = missed(cell, model, Fir(read.taps, RATE, read.postures))
    assert learnt < 0.75 * missed(cell, model, low_pass(40.0, 2, RATE))


def test_dry_courses_take_off_what_the_robot_misses_its_path_by(
    bags: dict[str, list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = []
    for dry in ([], ["--dry", *bags["dry"]]):
        given = [*bags["model"], *bags["courses"], *dry, "--delay", "0.028", "--acceleration", "6", "--postures", "1"]
        assert main(["course-filter", *given, "-o", str(tmp_path / "filter.csv"), "--json"]) == 0
        left.append(json.loads(capsys.readouterr().out)["left_m"])
    assert left[1] < 0.8 * left[0]


def test_courses_that_were_corrected_tell_the_same_where_their_offset_is_recorded(
    bags: dict[str, list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whether the controller counts the offset in or not."""
    left = []
    for name in ("courses", "corrected"):
        given = [*bags["model"], *bags[name], "--dry", *bags["dry"], "--swept", *bags["swept"], "--acceleration", "6"]
        assert main(["course-filter", *given, "--postures", "1", "-o", str(tmp_path / f"{name}.csv"), "--json"]) == 0
        left.append(json.loads(capsys.readouterr().out)["left_m"])
    assert left[1] < 1.3 * left[0]  # 10 um; the offset alone moves the TCP by 80 um RMS
    taps = [read_taps(tmp_path / f"{name}.csv").taps for name in ("courses", "corrected")]
    assert float(np.abs(taps[1] - taps[0]).sum(axis=1).max()) < 0.35 * float(np.abs(taps[0]).sum(axis=1).max())


@pytest.mark.long
def test_a_force_that_is_known_is_not_left_to_the_filter(
    cell: Cell, bags: dict[str, list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Here all of it is known: what passes the filter is noise, and no taps can do anything with that."""
    n = round(16.0 * RATE)
    t = np.arange(n) / RATE
    profiles = []
    for seed in (1, 2, 3):
        known = (unsteady(seed, n) + np.array([60.0, -70.0, -850.0])) * ((t > 1.0) & (t < 15.0))[:, None]
        table = np.column_stack([t, BEGIN + t[:, None] * TURN, known])
        profiles.append(str(tmp_path / f"profile_{seed}.csv"))
        header = ",".join(["stamp", *cell.robot.joint_names, "force_x", "force_y", "force_z"])
        np.savetxt(profiles[-1], table, delimiter=",", header=header, comments="")
    share = []
    for extra in ([], ["--profile", *profiles, "--lead", str(LATE)]):
        given = [*bags["model"], *bags["courses"], "--dry", *bags["dry"], "--delay", str(LATE), "--acceleration", "6"]
        assert main(["course-filter", *given, *extra, "--postures", "1", "-o", str(tmp_path / "filter.csv"), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        share.append(told["left_m"] / told["before_m"])
    assert share[0] < 0.7 and share[1] > 0.95


def test_crossed_taps_are_written_for_each_axis_from_each(bags: dict[str, list[str]], tmp_path: Path) -> None:
    table = tmp_path / "filter.csv"
    given = [*bags["model"], *bags["courses"], "--delay", str(LATE), "--acceleration", "6", "--postures", "1", "-o", str(table)]
    assert main(["course-filter", *given, "--crossed", "--taps", "20"]) == 0
    taps = read_taps(table).taps
    assert taps.shape == (1, 20, 3, 3)
    np.testing.assert_allclose(taps.sum(axis=1)[0], np.eye(3), atol=1e-8)


def test_recordings_and_options_that_tell_no_filter_are_refused(
    cell: Cell, bags: dict[str, list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, (one, *_) = tmp_path / "filter.csv", bags["courses"]
    delay = ["--delay", "0.028"]
    for given, word in (
        ([one], "give one of both"),
        ([one, *delay, "--swept", *bags["swept"]], "give one of both"),
        ([one, *delay, "--acceleration", "0"], "--acceleration is 0"),
        ([one, *delay, "--dry", *bags["dry"]], "--dry names 3 files for 1 courses"),
        ([one, *delay, "--profile", "a.csv", "b.csv"], "--profile names 2 files for 1 courses"),
        ([one, *delay, "--lead", "0.03"], "--lead and --slack are about"),
        ([one, *delay, "--postures", "31"], "--postures is 31"),
        ([one, *delay, "--postures", "6"], "too few to learn"),
        ([one, *delay, "--tracker", "nothing"], "0 messages on 'nothing'"),
        ([one, "--swept", str(sweep(cell, tmp_path / "two.mcap", axes=2))], "sweep all three"),
        ([one, "--swept", str(sweep(cell, tmp_path / "moves.mcap", turned=0.3))], "the arm has to stand"),
        ([one, "--swept", one], "0 messages on 'irec/offset'"),
        ([bags["corrected"][0], *delay, "--postures", "1"], "was driven with correction"),
    ):
        assert main(["course-filter", *bags["model"], *given, "-o", str(table)]) == 2, given
        assert word in capsys.readouterr().err
    assert not table.exists()
