# SPDX-License-Identifier: Apache-2.0
"""Files that no person writes, found by `make fuzz`: each is refused in one line that names it."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic
import yaml
from irec_calibration.errors import CellError, RobotError
from irec_calibration.poses.check import cell_problems
from irec_calibration.session import read_session, write_table
from irec_sim.cellfile import read_cell as read_simulated
from irec_sim.errors import SimError

CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"


def cell(folder: Path, **changed: object) -> Path:
    """The AFP cell with other sections."""
    data = yaml.safe_load(CELL.read_text())
    data["robot"]["urdf"] = str(CELL.parents[1] / "robots" / Path(data["robot"]["urdf"]).name)
    (folder / "cell.yaml").write_text(yaml.safe_dump(data | changed))
    return folder / "cell.yaml"


def test_a_section_that_is_wrong_behind_more_problems_than_are_said_is_no_trace(tmp_path):
    path = cell(tmp_path, stations=[1.0] * 300, workspace=-1)
    try:
        problems, _ = cell_problems(path)
    except CellError as error:
        problems = [str(error)]
    assert problems and all("\n" not in p and str(path) in p for p in problems)


def test_a_name_that_no_file_can_have_is_a_file_that_is_not_there(tmp_path):
    _, notes = cell_problems(cell(tmp_path, poses="x" * 300))
    assert any("is not there yet" in n for n in notes)


def test_the_file_that_names_a_robot_description_is_named_where_that_can_not_be_read(tmp_path):
    folder = write_table(synthetic.session(poses=2), tmp_path / "s")
    text = (folder / "session.yaml").read_text()
    (folder / "session.yaml").write_text(text.replace("urdf: robot.urdf", "urdf: /dev/zero"))
    with pytest.raises(RobotError, match=r"session\.yaml: robot\.urdf: /dev/zero: the robot description is a device"):
        read_session(folder)


def test_a_number_beyond_all_floats_in_a_simulated_cell_is_refused(tmp_path):
    station = {"name": "A", "xyz": [0.0, -4.0, 2.2], "quat_xyzw": [0, 0, 10**400, 1]}
    with pytest.raises(SimError, match=r"cell\.yaml"):
        read_simulated(cell(tmp_path, stations=[station]))
