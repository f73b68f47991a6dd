# SPDX-License-Identifier: Apache-2.0
"""Larger forces across the tool only as far as contact, sensor and drives bear them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from irec_calibration.cell import Cell, read_cell
from irec_calibration.errors import PlanError
from irec_calibration.poses.checker import overloaded
from irec_calibration.poses.store import PoseList, read_poses, write_poses
from irec_calibration.procedure.loads import largest_lateral, loaded_as_asked, with_lateral
from irec_calibration.procedure.recorder import session_header
from irec_calibration.procedure.settings import read_settings

CELLS = Path(__file__).parents[3] / "config" / "cells"


@pytest.fixture(scope="module")
def cell() -> Cell:
    return read_cell(CELLS / "afp.yaml")


@pytest.fixture(scope="module")
def poses(cell: Cell) -> PoseList:
    return read_poses(cell.poses_path, cell.serial, cell.robot.sha256)


def test_the_largest_factor_is_the_one_with_which_no_row_can_be_rejected(cell: Cell, poses: PoseList) -> None:
    """Friction 0.5 / 1.5 and 2 %, the force anywhere within 15 N of its set point: 353.9 N across hold, 1.25 times 280 is 350."""
    settings = read_settings(cell)
    assert largest_lateral(cell, settings, poses, 1.3) == 1.25
    assert largest_lateral(cell, settings, poses, 1.1) == 1.1, "no more than is asked for"
    slippery = replace(settings, friction=0.26)
    assert largest_lateral(cell, slippery, poses, 1.3) == 1.0
    assert largest_lateral(cell, replace(settings, force_abort_n=1165.0), poses, 1.3) == 1.15


def test_the_run_takes_the_factor_that_was_found_however_exact_the_force_controller_is(cell: Cell, poses: PoseList) -> None:
    """The run looks at the contact without a margin: 0.5 / 1.5 of 1100 N hold 366.7 N, 1.3 times 280 are 364, 1.35 times 378."""
    settings = read_settings(cell)
    exact = replace(settings, settling=replace(settings.settling, force_n=0.1), friction=1.0)
    factor = largest_lateral(cell, exact, poses, 1.5)
    assert factor == 1.3
    loaded_as_asked(cell, exact, replace(poses, lateral_factor=factor), "x")


def test_no_axis_gets_more_than_its_continuous_torque_at_any_pose(cell: Cell, poses: PoseList) -> None:
    q = np.array([p.q for p in poses.poses])
    kin = cell.robot.kinematics(q)

    def weak(share: float) -> Cell:
        """Axis 1, which gravity does not load."""
        return replace(cell, continuous_torque=cell.continuous_torque * np.array([share, 1.0, 1.0, 1.0, 1.0, 1.0]))

    share = next(s for s in np.arange(1.0, 0.0, -0.002) if overloaded(with_lateral(weak(s), 1.2), q, kin).any())
    assert not overloaded(with_lateral(weak(share), 1.1), q, kin).any()
    assert 1.1 <= largest_lateral(weak(share), read_settings(cell), poses, 1.3) < 1.2


def test_a_pose_file_says_the_factor_and_what_slips_is_refused(cell: Cell, poses: PoseList, tmp_path: Path) -> None:
    settings = read_settings(cell)
    assert loaded_as_asked(cell, settings, poses, "x") is cell, "nothing is asked for"
    asked = read_poses(write_poses(replace(poses, lateral_factor=1.25), tmp_path / "poses.yaml"))
    loaded = loaded_as_asked(cell, settings, asked, "x")
    np.testing.assert_allclose(loaded.forces_in_tool[1], [350.0, 0.0, -1100.0])
    assert session_header(loaded, "s")["load_cases"][4] == [0.0, -350.0, -1100.0]
    too_much = replace(poses, lateral_factor=1.4)
    with pytest.raises(PlanError, match=r"mine\.yaml: lateral_factor is 1\.4: .* 392 N across at 1100 N normal would slip"):
        loaded_as_asked(cell, settings, too_much, "mine.yaml")


@pytest.mark.parametrize("value", ["a lot", 0.0, -1.25, 11.0, float("nan")])
def test_a_factor_that_can_not_be_is_refused_by_its_key(poses: PoseList, tmp_path: Path, value: object) -> None:
    path = write_poses(replace(poses, lateral_factor=1.25), tmp_path / "poses.yaml")
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"lateral_factor": value}))
    with pytest.raises(PlanError, match="lateral_factor"):
        read_poses(path)
