# SPDX-License-Identifier: Apache-2.0
"""`irec check` says everything that is wrong in files of ours, before any program starts."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import synthetic
import yaml
from irec_calibration.cli import main
from irec_calibration.model import EIGHTEEN_DOF, Model, blank_model
from irec_calibration.model.file import save_model
from irec_calibration.session.table import write_table

ROOT = Path(__file__).resolve().parents[3]
CELLS = ROOT / "config" / "cells"


@pytest.fixture
def cell(tmp_path):
    """A copy of the AFP cell with description and poses; `edit` changes and writes it."""
    for folder in ("cells", "robots"):
        shutil.copytree(ROOT / "config" / folder, tmp_path / folder)
    path = tmp_path / "cells" / "afp.yaml"

    def edit(change=lambda c: None):
        content = yaml.safe_load(path.read_text())
        change(content)
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return edit


def said(capsys, *arguments):
    code = main(["check", *map(str, arguments)])
    return code, capsys.readouterr().out


@pytest.mark.parametrize("name", ["afp", "milling"])
def test_our_own_cells_have_nothing_wrong(name, capsys):
    code, out = said(capsys, CELLS / f"{name}.yaml", CELLS / f"{name}_poses.yaml")
    assert code == 0, out
    assert out.count("nothing wrong") == 2


def test_our_profiles_have_nothing_wrong(capsys):
    code, out = said(capsys, *sorted((ROOT / "docs" / "real-data").glob("*.profile.yaml")))
    assert code == 0, out


def test_several_mistakes_of_a_cell_are_said_in_one_run_one_line_each(cell, capsys):
    def change(c):
        c["robot"]["home"][1] = -110.0
        c["load_cases"]["fx"] = 900.0
        c["force_sensor"]["frame"] = "nowhere"
        c["surface"]["quat_xyzw"] = [0, 0, 0, 2]
        c["reference_distance"] = 3.0
        del c["procedure"]["window_s"], c["workspace"]

    code, out = said(capsys, cell(change))
    lines = out.splitlines()
    assert code == 2
    assert all("afp.yaml" in line for line in lines)
    for part in (
        "robot.home[1] is -110 rad, must lie between -100 and 100 rad; are these degrees?", "load_cases.fx is 900 N across",
        "force_sensor.frame is 'nowhere', the robot description has no link", "surface.quat_xyzw[3] is 2",
        "reference_distance is 3 m, must lie between", "procedure.window_s is missing", "workspace is missing",
    ):  # fmt: skip
        assert any(part in line for line in lines), (part, out)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda c: c["robot"].update(urdf="../robots/none.urdf"), "robot.urdf can't be used: "),
        (lambda c: c["robot"].update(urdf="/dev/zero"), "is a device; a regular file is needed"),
        (lambda c: c["robot"].update(urdf="../robots/kr300_r2500_ultra.urdf"), "robot description has changed"),
        (lambda c: c["robot"].update(serial="other"), "planned for the robot 'KR120-0001', this one is 'other'"),
        (lambda c: c["robot"].update(home=[0.0] * 5), "robot.home has 5 values, the description has 6 joints"),
        (lambda c: c["robot"].update(home=[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), r"robot.home[1] is 1, joint_2 has the limits"),
        (lambda c: c["stations"][0].update(name="B"), "names the station 'A', the cell has B"),
        (lambda c: c["robot"]["rail"].update(range=[-0.1, 0.1]), "has the rail at"),
        (lambda c: c["surface"].update(quat_xyzw=[0.93969262, 0.0, 0.34202014, 0.0]), "turns its back to every tracker station"),
        (lambda c: c["procedure"].update(force_abort_n=1000.0), "must be more than the largest load case, 1135 N"),
        (lambda c: c["force_sensor"].update(range_n=1000.0), "the load cases need more: 1100 N"),
        (lambda c: c["course"].update(tool_x=[0.0, 0.0, 0.0]), "course.tool_x is [0.0, 0.0, 0.0], a direction must not be 0"),
        (lambda c: c["course"].update(tool_x="ahead"), "course.tool_x is 'ahead'"),
    ],
)
def test_what_a_cell_names_is_there_and_agrees(cell, capsys, change, part):
    code, out = said(capsys, cell(change))
    assert code == 2
    assert part in out


def test_poses_that_are_not_planned_yet_are_a_note(cell, capsys):
    code, out = said(capsys, cell(lambda c: c.update(poses="later.yaml")))
    assert code == 0
    assert "is not there yet; irec plan" in out


def test_sessions_and_models_are_checked_and_json_holds_the_same(tmp_path, capsys):
    session = synthetic.session(poses=3)
    folder = write_table(session, tmp_path / "s")
    model = save_model(Model(blank_model(EIGHTEEN_DOF)), tmp_path / "m.yaml")
    code = main(["check", str(folder), str(model), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert code == 0, printed
    assert [f["format"] for f in printed["files"]] == ["irec-session/1", "irec-model/1"]
    model.write_text(model.read_text().replace("joint_torsion", "joint_torsoin"))
    assert main(["check", str(model), "--json"]) == 2
    assert "joint_torsoin" in json.loads(capsys.readouterr().out)["files"][0]["problems"][0]


def test_a_file_of_no_known_format_is_named(tmp_path, capsys):
    (tmp_path / "x.yaml").write_text("a: 1")
    code, out = said(capsys, tmp_path / "x.yaml", tmp_path / "none.yaml")
    assert code == 2
    assert "x.yaml: format is not stated; checked are irec-align/1" in out
    assert "none.yaml: the file is not there" in out
