# SPDX-License-Identifier: Apache-2.0
"""`irec inspect` on a real foreign recording, whole and cut, and on what is no recording."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from irec_calibration.cli import main

ROOT = Path(__file__).parents[3]
DATA = Path(os.environ.get("IREC_REAL_DATA", ROOT.parent / "shared" / "data"))
BAG = DATA / "akig_ur5_tracker_bag" / "rotateBaseBFspeed1Pts10hzLAN_ros2_mcap"
FILE = f"{BAG.name}.mcap"


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    if not BAG.is_dir():
        pytest.skip(f"no real data at {BAG}; set IREC_REAL_DATA")
    return Path(shutil.copytree(BAG, tmp_path / "bag", copy_function=shutil.copyfile))


def inspect(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main(["inspect", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_real_recording_is_described_by_topic(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = inspect(capsys, bag, "--json")
    topics = {topic["name"]: topic for topic in json.loads(out)["topics"]}
    assert code == 0
    counts = [topics[name]["count"] for name in ("/joint_states", "/wrench", "/tracker_points")]
    assert counts == [2489, 2491, 200]
    assert topics["/joint_states"]["rate"] == pytest.approx(125.0, rel=0.01)
    assert 0.0 < topics["/joint_states"]["skew"]["median"] < 0.005


def test_a_tracker_that_stamps_on_arrival_is_noticed(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = inspect(capsys, bag)
    assert "/tracker_points: messages come in bursts" in out


def test_what_the_recording_lacks_to_be_a_session_is_listed(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = inspect(capsys, bag)
    lacking = out.split("It lacks:")[1]
    for item in ("joint_1", "robot description", "LoadCaseRecord", "tracker station"):
        assert item in lacking


def test_of_a_cut_recording_the_loss_is_named_and_the_exit_code_is_1(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open(bag / FILE, "r+b") as file:
        file.truncate(1_500_000)
    code, out, _ = inspect(capsys, bag)
    assert code == 1
    assert f"{FILE}: it is cut at byte 1500000" in out


def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.mcap").write_text("hello")
    code, out, err = inspect(capsys, tmp_path / "x.mcap")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "x.mcap" in err
