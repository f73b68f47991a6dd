# SPDX-License-Identifier: Apache-2.0
"""`irec links`: from a recording without process to the table that the correction reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_correction.link_angles import read_dry_drive
from mcap_ros2.writer import Writer

JOINT_STATE = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + "=" * 80
    + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def dry(q: np.ndarray) -> np.ndarray:
    """What no process causes, rad."""
    return np.stack([1e-3 * np.cos(q[:, 0]), 2e-4 * np.sin(5.0 * q[:, 1])], axis=1)


def record(path: Path, links: str = "link_states", wrong: float = 0.0, names: tuple[str, str] = ("joint_2", "joint_1")) -> Path:
    """Motor-side angles at 250 Hz, link-side ones at 200 Hz, in another order."""
    rng = np.random.default_rng(3)
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/JointState", JOINT_STATE)
        for t, topic in sorted(
            [(0.004 * k, "joint_states") for k in range(1500)] + [(0.0011 + 0.005 * k, links) for k in range(1190)]
        ):
            at = 1_700_000_000_000_000_000 + round(1e9 * t)
            q = np.array([0.3 + 0.1 * t, -0.2 + 0.05 * t])
            sent, order = q.tolist(), ["joint_1", "joint_2"]
            if topic != "joint_states":
                sent, order = (q + dry(q[None])[0] + rng.normal(0.0, 2e-6, 2) + wrong)[::-1].tolist(), list(names)
            header = {"stamp": {"sec": at // 10**9, "nanosec": at % 10**9}, "frame_id": ""}
            message = {"header": header, "name": order, "position": sent, "velocity": [], "effort": []}
            writer.write_message(topic, schema, message, at, at)
        writer.finish()
    return path


def test_the_table_tells_what_both_sides_differ_by_without_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, table = record(tmp_path / "dry.mcap"), tmp_path / "links.csv"
    assert main(["links", str(bag), "-o", str(table)]) == 0
    told = capsys.readouterr().out
    assert "links.topic: link_states" in told and "joint_1: +0.6" in told
    read = read_dry_drive(table, ["joint_1", "joint_2"])  # as the correction reads it
    assert 500 < len(read.q) < 700  # 0.6 rad in steps of a milliradian
    np.testing.assert_allclose(read.windup, dry(read.q), atol=8e-6)


@pytest.mark.parametrize(
    ("changes", "arguments", "word"),
    [
        ({"links": "other"}, [], "0 messages on 'link_states'"),
        ({"wrong": 0.2}, [], "differ by 0.20"),
        ({"names": ("joint_2", "joint_9")}, [], "joint_9"),
        ({}, ["--joints", "nothing"], "0 messages on 'nothing'"),
    ],
)
def test_recordings_that_tell_nothing_are_refused(
    changes: dict, arguments: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    bag = record(tmp_path / "dry.mcap", **changes)
    assert main(["links", str(bag), "-o", str(tmp_path / "links.csv"), *arguments]) == 2
    assert word in capsys.readouterr().err
    assert not (tmp_path / "links.csv").exists()
