# SPDX-License-Identifier: Apache-2.0
"""No command overwrites what it reads, nor a file of another kind than it writes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_calibration.errors import IrecError, ModelError, PlanError
from irec_calibration.files import check_no_input, check_replaceable
from irec_calibration.files.outputs import TAPS, beginning, of_format
from irec_calibration.model import SIX_DOF, Model, blank_model
from irec_calibration.model.file import load_model, save_model
from irec_calibration.poses.store import EngagementPose, PoseList, read_poses, write_poses
from irec_calibration.session import read_session
from irec_calibration.session.mcap_io import write_mcap
from workbench_server import write_hidden

MODEL = (of_format("irec-model/1"),)
UP = np.array([0.0, 0.0, 1.0])
POSE = EngagementPose(1, np.zeros(1), {}, UP, np.array([0.0, 0.0, 0.0, 1.0]), UP, 0.1, "a")
POSES = PoseList("cell", "S-1", "0" * 64, ("joint_1",), (POSE,))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The same session as a table and as a recording, and a model."""
    folder = tmp_path_factory.mktemp("measured")
    table = write_hidden(folder / "table")
    write_mcap(read_session(table), folder / "first.mcap")
    return SimpleNamespace(folder=folder, table=table, mcap=folder / "first.mcap")


def refused(arguments, path, capsys, says="name another file"):
    before = path.read_bytes()
    assert main([str(a) for a in arguments]) == 2
    assert says in capsys.readouterr().err
    assert path.read_bytes() == before


def test_the_recording_that_is_solved_is_not_overwritten(measured, capsys):
    refused(["solve", measured.mcap, "-o", measured.mcap], measured.mcap, capsys, "is read by this command")


def test_nor_under_another_name_of_the_same_file(measured, tmp_path, capsys):
    link = tmp_path / "link.yaml"
    link.symlink_to(measured.mcap)
    refused(["solve", measured.mcap, "-o", link], measured.mcap, capsys, "is read by this command")


@pytest.mark.parametrize("name", ["session.yaml", "samples.csv", "robot.urdf"])
def test_no_file_of_a_session_is_overwritten_by_a_model(measured, name, capsys):
    refused(["solve", measured.table, "-o", measured.table / name], measured.table / name, capsys, "exists and is not a model")


def test_samples_are_not_overwritten_by_predictions(measured, tmp_path, capsys):
    model = tmp_path / "model.yaml"
    assert main(["solve", str(measured.table), "--dof", "6", "-o", str(model)]) == 0
    samples = measured.table / "samples.csv"
    refused(["predict", model, measured.table, "-o", samples], samples, capsys, "is not a table of predictions")
    for _ in range(2):  # a table of predictions may be written again
        assert main(["predict", str(model), str(measured.table), "-o", str(tmp_path / "p.csv")]) == 0
    refused(["predict", model, measured.table, "-o", model], model, capsys, "is read by this command")


def test_an_improved_model_does_not_overwrite_the_one_that_it_begins_from(measured, tmp_path, capsys):
    model = tmp_path / "model.yaml"
    assert main(["solve", str(measured.table), "--dof", "6", "-o", str(model)]) == 0
    refused(["improve", measured.table, "--model", model, "-o", tmp_path], model, capsys, "is read by this command")


@pytest.mark.parametrize("command", ["import", "export"])
def test_no_session_is_written_over_another(measured, tmp_path, capsys, command):
    there = tmp_path / "there"
    there.mkdir()
    (there / "samples.csv").write_text("mine")
    given = measured.mcap if command == "export" else measured.table
    refused([command, given, "-o", there], there / "samples.csv", capsys, "a session is never overwritten")


def test_a_cell_file_is_not_overwritten_by_its_poses(tmp_path, capsys):
    cell = tmp_path / "mine.yaml"
    cell.write_text("format: irec-cell/1\n")
    refused(["plan", cell, "-o", cell], cell, capsys, "is read by this command")
    with pytest.raises(PlanError, match="exists and is not a pose file"):
        write_poses(POSES, cell)
    assert cell.read_text() == "format: irec-cell/1\n"


def test_a_model_replaces_a_model_and_nothing_else(tmp_path):
    model = Model(blank_model(SIX_DOF))
    path = tmp_path / "m.yaml"
    for text in ("", "# copied\nformat: irec-model/1\n", "'format': \"irec-model/2\"\n"):
        path.write_text(text)
        save_model(model, path)
        assert load_model(path).effects == ("joint_torsion",)
    for text in ("format: irec-cell/1\n", "note: |\n  format irec-model/1\n", "\x89MCAP0\n", "mine"):
        path.write_text(text)
        with pytest.raises(ModelError, match="m.yaml: exists and is not a model"):
            save_model(model, path)
        assert path.read_text() == text and list(tmp_path.iterdir()) == [path]


def test_poses_replace_poses(tmp_path):
    for _ in range(2):
        write_poses(POSES, tmp_path / "poses.yaml")
    assert read_poses(tmp_path / "poses.yaml").serial == "S-1"


def test_what_is_no_file_is_no_place_to_write_to(tmp_path):
    with pytest.raises(IrecError, match="is a folder"):
        check_replaceable(tmp_path, "a model", MODEL)
    with pytest.raises(IrecError, match="not a regular file"):
        check_replaceable("/dev/zero", "a model", MODEL)
    with pytest.raises(ModelError, match="can't be written"):
        save_model(Model(blank_model(SIX_DOF)), "/" + "x" * 100_000)
    assert check_replaceable(tmp_path / "new.yaml", "a model", MODEL).name == "new.yaml"


def test_a_table_is_known_by_its_first_names(tmp_path):
    table = tmp_path / "t.csv"
    table.write_text("pose,load_case,force_x,force_y,force_z\n")
    with pytest.raises(IrecError, match="is not a filter"):
        check_replaceable(table, "a filter", TAPS)
    table.write_text("joint_1,joint_2,force_x,force_y,force_z\n")
    check_replaceable(table, "a filter", TAPS)
    check_replaceable(table, "a table", (beginning("joint_1,"),))


def test_what_is_no_path_is_no_input(tmp_path):
    out = tmp_path / "out.yaml"
    out.write_text("")
    check_no_input(out, [None, 3, "", "axis 1: c * tau", tmp_path, "\0", True, tmp_path / "none"])
    with pytest.raises(IrecError, match="is read by this command"):
        check_no_input(out, [str(out)])
