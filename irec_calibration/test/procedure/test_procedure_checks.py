# SPDX-License-Identifier: Apache-2.0
"""What is checked before the robot moves, and the settings of the cell file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.cell.surface import Block
from irec_calibration.errors import CellError, PlanError
from irec_calibration.poses.ik import Chain, solve_pose
from irec_calibration.poses.pool import generate_pool
from irec_calibration.procedure.checks import plan_targets
from irec_calibration.procedure.settings import read_acceptance, read_settings

CELLS = Path(__file__).parents[3] / "config" / "cells"


@pytest.fixture(scope="module")
def cell() -> Cell:
    return read_cell(CELLS / "afp.yaml")


@pytest.fixture(scope="module")
def poses(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    pool = generate_pool(cell, 12)
    return pool.q, pool.rail


def test_planned_poses_may_be_driven_to(cell: Cell, poses: tuple) -> None:
    targets = plan_targets(cell, read_settings(cell), *poses, numbers=list(range(1, 13)))
    assert [t.problem for t in targets] == [""] * 12
    for t in targets:
        at = cell.robot.kinematics(t.q_approach[None])
        if not t.problem:
            np.testing.assert_allclose(at.p_tcp[0], t.p_approach, atol=1e-8)
            np.testing.assert_allclose(at.R_tool[0], t.R_tool_in_base, atol=1e-8)


def test_the_reference_lies_between_approach_and_contact(cell: Cell, poses: tuple) -> None:
    for t in plan_targets(cell, read_settings(cell), *poses, numbers=list(range(1, 13))):
        z = t.R_tool_in_base[:, 2]
        assert z @ (t.p_reference - t.p_approach) == pytest.approx(cell.approach_distance - cell.reference_distance)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda cell, q: np.r_[cell.robot.upper[0], q[1:]], "joint limits"),
        (lambda cell, q: np.r_[q[:4], 0.0, q[5]], "singularity|tooling|station|limits|torque"),
        (lambda cell, q: np.r_[q[0] + 1.2, q[1:]], ""),
    ],
)
def test_a_bad_pose_is_not_driven_to_and_says_why(cell: Cell, poses: tuple, change: object, problem: str) -> None:
    q = np.array([change(cell, poses[0][0])])  # type: ignore[operator]
    found = plan_targets(cell, read_settings(cell), q, poses[1][:1], numbers=[1])[0].problem
    assert found
    assert any(word in found for word in problem.split("|"))


def test_a_pose_outside_the_workspace_is_refused(cell: Cell, poses: tuple) -> None:
    small = replace(read_settings(cell), workspace=np.array([[0.0, 5.0, 0.0], [1.0, 6.0, 1.0]]))
    targets = plan_targets(cell, small, *poses, numbers=list(range(1, 13)))
    assert all("workspace" in t.problem for t in targets)


def test_poses_of_another_robot_are_refused(cell: Cell) -> None:
    with pytest.raises(PlanError, match="joints"):
        plan_targets(cell, read_settings(cell), np.zeros((2, 7)), np.zeros(2), [1, 2])


def test_a_point_out_of_reach_has_no_joint_angles(cell: Cell) -> None:
    kin = cell.robot.kinematics(cell.home[None])
    _, reached = solve_pose(Chain.of(cell.robot), np.array([[9.0, 0.0, 0.0]]), kin.R_tool, cell.home[None])
    assert not reached[0]


def changed_cell(tmp_path: Path, old: str, new: str) -> Path:
    text = (CELLS / "afp.yaml").read_text().replace("../robots", str(CELLS.parent / "robots"))
    assert old in text
    path = tmp_path / "cell.yaml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("home_speed: 0.5", "home_speed: 25", r"procedure\.home_speed is 25"),
        ("  force_abort_n: 1600.0", "  force_abort_n: 1000.0", "must be more than the largest"),
        ("  force_abort_n: 1600.0", "  force_abrot_n: 1600.0", "write force_abort_n"),
        ("    settle: 15.0", "    settle: 0.0", r"timeouts\.settle"),
        ("    slip_m: 1.0e-3", "    slip_m: 1.0e-3\n    hold_s: -1.0", r"settling\.hold_s"),
        ("    slip_m: 1.0e-3", "    slip_m: 1.0e-3\n    hold_s: 14.8", r"timeouts\.settle is 15 s, must be more than .* 15\.2 s"),
        ("  fx: 280.0", "  fx: 800.0", "would slip"),
        ("  min_samples: 20", "", "min_samples is missing"),
        ("  lower: [0.2,", "  lower: [9.2,", r"workspace\.upper"),
    ],
)
def test_a_wrong_cell_file_names_file_field_value_and_limit(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = changed_cell(tmp_path, old, new)
    with pytest.raises(CellError, match=message) as error:
        read_settings(read_cell(path))
    assert "cell.yaml" in str(error.value)


def test_a_last_stretch_that_takes_longer_than_half_of_its_time_out_is_refused_where_it_is_stated(tmp_path: Path) -> None:
    stated = changed_cell(tmp_path, "  min_samples: 20", "  min_samples: 20\n  checks: {near_m: 0.05, near_speed: 0.003}")
    with pytest.raises(CellError, match=r"procedure\.checks\.near_m is 0\.05 m, at 0\.003 m/s \(near_speed\) this takes 16\.7 s"):
        read_settings(read_cell(stated))


def test_a_cell_file_that_states_none_is_valid_whatever_its_time_out(tmp_path: Path) -> None:
    short = read_settings(read_cell(changed_cell(tmp_path, "    advance: 20.0", "    advance: 2.0")))
    assert short.checks.near_m == pytest.approx(0.003) and short.near_speed == 0.003
    assert read_settings(read_cell(CELLS / "afp.yaml")).checks.near_m == 0.01


@pytest.mark.parametrize("name", ["afp", "milling"])
def test_the_cells_that_come_with_it_are_complete(name: str) -> None:
    cell = read_cell(CELLS / f"{name}.yaml")
    assert read_settings(cell).timeouts.keys() >= {"home", "settle", "retract"}
    assert read_acceptance(cell).min_poses >= 2


def test_the_tool_stays_out_of_the_block_on_the_way_from_home_to_every_planned_approach() -> None:
    cell = read_cell(CELLS / "milling.yaml")
    pool = generate_pool(cell, 25)
    targets = plan_targets(cell, read_settings(cell), pool.q, pool.rail, list(range(1, len(pool) + 1)))
    block = cell.surface
    assert isinstance(block, Block)
    assert {tuple(n.round()) for n in pool.normal_in_cell} > {(0.0, 0.0, 1.0)}  # not only from above
    for target in targets:
        assert not target.problem
        q = cell.home + np.linspace(0.0, 1.0, 100)[:, None] * (target.q_approach - cell.home)
        local = (cell.robot.kinematics(q).p_tcp - block.p_in_cell) @ block.R_in_cell
        assert (np.abs(local) > 0.5 * np.array(block.size)).any(axis=1).all()
