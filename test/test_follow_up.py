# SPDX-License-Identifier: Apache-2.0
"""A session that does not tell which effect it is, poses planned to tell, measured on the same robot: then it is named."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from irec_calibration.cli import main as irec
from irec_sim.cellfile import read_cell
from irec_sim.cli import main as irec_sim
from irec_sim.errors import SimError
from irec_sim.poses import poses_of_file

CELL = Path(__file__).parents[1] / "config" / "cells" / "afp.yaml"
ROBOT = ["--effect", "tool_compliance", "--truth-seed", "2", "--strength", "0.2"]  # only the simulator knows


def verdict(session: Path, out: Path) -> dict:
    irec(["diagnose", str(session), "-o", str(out)])
    return json.loads((out / "diagnosis.json").read_text())["verdict"]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("follow-up") / "first"
    assert irec_sim(["session", *ROBOT, "--poses", "8", "--seed", "6", "-o", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def planned(first: Path) -> Path:
    path = first.parent / "next_poses.yaml"
    assert irec(["plan", str(CELL), "--to-tell", str(first), "-o", str(path)]) == 0
    return path


@pytest.mark.slow
@pytest.mark.long
def test_what_a_session_does_not_tell_is_told_by_the_poses_that_are_planned_for_it(first: Path, planned: Path, tmp_path) -> None:
    before = verdict(first, tmp_path / "before")
    assert (before["status"], before["effects"]) == ("unexplained", [])
    assert before["one_of"] == [["tool_compliance", "base_compliance"]]
    later, both = tmp_path / "later", tmp_path / "both"
    assert irec_sim(["session", *ROBOT, "--seed", "3", "--at", str(planned), "-o", str(later)]) == 0
    assert irec(["join", str(first), str(later), "-o", str(both)]) == 0
    after = verdict(both, tmp_path / "after")
    assert (after["status"], after["effects"], after["one_of"]) == ("missing_effect", ["tool_compliance"], [])


@pytest.mark.long
@pytest.mark.slow
def test_the_plan_says_what_it_is_expected_to_tell(first: Path, tmp_path, capsys) -> None:
    capsys.readouterr()
    path = tmp_path / "poses.yaml"
    assert irec(["plan", str(CELL), "--to-tell", str(first), "-n", "3", "-o", str(path), "--json"]) in (0, 1)
    told = json.loads(capsys.readouterr().out)["to_tell"]
    assert [t["names"] for t in told] == [["tool_compliance", "base_compliance"]]
    assert all(0.0 < t["chance"] < 1.0 for t in told)
    assert len(yaml.safe_load(path.read_text())["poses"]) == 3


@pytest.mark.slow
def test_poses_planned_for_another_robot_are_refused(first: Path, tmp_path, capsys) -> None:
    cell = CELL.with_name("milling.yaml")
    assert irec(["plan", str(cell), "--to-tell", str(first), "-o", str(tmp_path / "p.yaml")]) == 2
    assert "KR120-0001" in capsys.readouterr().err and not (tmp_path / "p.yaml").exists()


@pytest.mark.slow
def test_a_session_that_leaves_nothing_open_gets_no_plan(tmp_path, capsys) -> None:
    clean = tmp_path / "clean"
    assert irec_sim(["session", "--poses", "31", "--seed", "11", "-o", str(clean)]) == 0
    assert irec(["plan", str(CELL), "--to-tell", str(clean), "-n", "2", "-o", str(tmp_path / "p.yaml")]) == 2
    assert "leaves nothing open" in capsys.readouterr().err and not (tmp_path / "p.yaml").exists()


def test_options_of_other_plans_are_refused_beside_it(tmp_path, capsys) -> None:
    assert irec(["plan", str(CELL), "--to-tell", "S", "--method", "random", "-o", str(tmp_path / "p.yaml")]) == 2
    assert "--to-tell chooses poses by itself" in capsys.readouterr().err


def test_promises_are_held_against_what_was_said(tmp_path) -> None:
    new = tmp_path / "new"
    for folder in (new, tmp_path / "new-truth", tmp_path / "new-said" / "a", tmp_path / "new-said" / "b"):
        folder.mkdir(parents=True)
    (new / "promised.csv").write_text(
        "name,question,chance,nats,needed\na,creep/joint_hysteresis,0.9,9,1\nb,creep/joint_hysteresis,0.1,1,9\n"
    )
    (tmp_path / "new-truth" / "matrix.csv").write_text("name,effects,background\na,joint_hysteresis,\nb,creep,\n")
    for name, effects, one_of in (("a", ["creep"], []), ("b", [], [["creep", "joint_hysteresis"]])):
        said = {"verdict": {"effects": effects, "one_of": one_of}}
        (tmp_path / "new-said" / name / "diagnosis.json").write_text(json.dumps(said))
    run = [sys.executable, str(CELL.parents[2] / "tools" / "hidden" / "promised.py"), str(new)]
    printed = subprocess.run(run, capture_output=True, text=True, check=True, timeout=60).stdout
    assert (
        "80 to 100 of 100 cases: 1 of 1 answered, 1 wrong" in printed
        and "0 to 30 of 100 cases: 0 of 1 answered, 0 wrong" in printed
    )


def test_the_simulator_measures_at_the_poses_of_a_file(planned: Path) -> None:
    cell = read_cell("afp")
    poses = poses_of_file(planned, cell)
    stated = yaml.safe_load(planned.read_text())["poses"]
    assert np.allclose(poses.p, [p["p_tool0_in_base"] for p in stated], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "irec-cell/1"}, "no pose file"),
        ({"poses": []}, "no pose file"),
        ({"poses": [{"joints": [0.0]}]}, "6 joint angles"),
    ],
)
def test_a_file_without_poses_of_this_robot_is_refused_by_the_simulator(change: dict, words: str, tmp_path) -> None:
    good = {"format": "irec-poses/1", "poses": [{"joints": [0.0] * 6, "ext": {"rail": 0.0}}]}
    path = tmp_path / "p.yaml"
    path.write_text(yaml.safe_dump(good | change))
    with pytest.raises(SimError, match=words):
        poses_of_file(path, read_cell("afp"))
