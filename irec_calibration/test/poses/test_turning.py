# SPDX-License-Identifier: Apache-2.0
"""Poses in which the load turns the torque of an axis: where they are, and that a plan has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.errors import PlanError
from irec_calibration.poses import plan as plan_module
from irec_calibration.poses.plan import make_plan
from irec_calibration.poses.pool import generate_pool
from irec_calibration.poses.store import read_poses
from irec_calibration.poses.turning import SHARE, exchanged, turned, wanted

AXIS = 1  # carries the arm
POSES = 31


@pytest.fixture(scope="module")
def cell():
    return read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")


@pytest.fixture(scope="module")
def pool(cell):
    return generate_pool(cell, 400, 2)


@pytest.fixture
def plan(cell, pool, monkeypatch):
    monkeypatch.setattr(plan_module, "generate_pool", lambda *_: pool)
    return lambda **options: make_plan(cell, POSES, **options)


def both_signs(cell, q):
    """Whether gravity and gravity with a load case have opposite signs, by virtual work along each axis, (n, k)."""
    h = 1e-6
    out = np.zeros(q.shape, dtype=bool)
    at = cell.robot.kinematics(q)
    gravity = cell.robot.gravity_torque(q, payload=cell.payload)
    for k in range(q.shape[1]):
        moved = (cell.robot.kinematics(q + h * np.eye(q.shape[1])[k]).p_tcp - at.p_tcp) / h
        work = [gravity[:, k]] + [gravity[:, k] + np.sum((at.R_tool @ f) * moved, axis=1) for f in cell.forces_in_tool]
        out[:, k] = (np.max(work, axis=0) > 0) & (np.min(work, axis=0) < 0)
    return out


def test_an_axis_is_turned_where_its_torque_has_both_signs(cell, pool):
    far = turned(cell, pool.q)
    clear = np.abs(far) > 1e-4
    np.testing.assert_array_equal((far > 0)[clear], both_signs(cell, pool.q)[clear])
    assert 0 < (far[:, AXIS] > SHARE).sum() < 0.05 * len(pool), "few places of this tooling turn it"


@pytest.mark.parametrize("method", ["cover", "ioops"])
def test_a_plan_has_poses_that_turn_each_axis_which_can_be_turned(cell, pool, plan, method):
    without, with_them = plan(method=method), plan(method=method, turn=2)
    can = (turned(cell, pool.q) > SHARE).sum(axis=0)
    assert without.figures["turned_joint_2"] < 2 <= can[AXIS], "nothing to show: the choice has them anyway"
    for k, name in enumerate(cell.robot.joint_names):
        assert with_them.figures[f"turned_{name}"] >= min(2, can[k])
        assert with_them.figures[f"turned_{name}"] == (turned(cell, pool.q[with_them.chosen])[:, k] > SHARE).sum()
    assert len(set(with_them.chosen.tolist())) == POSES
    if method == "cover":
        assert with_them.figures["cover_distance_m"] < 1.2 * without.figures["cover_distance_m"]


def test_the_poses_that_are_shipped_turn_every_axis_that_the_tooling_lets_them_turn(cell, pool):
    q = np.array([pose.q for pose in read_poses(cell.poses_path).poses])
    can, have = (turned(cell, pool.q) > SHARE).any(axis=0), (turned(cell, q) > SHARE).sum(axis=0)
    assert (have[can] >= 3).all(), dict(zip(cell.robot.joint_names, have, strict=True))


def test_cover_keeps_its_promise_with_poses_that_it_is_given(plan):
    stopped = plan(d_max=0.4, turn=2)
    assert len(stopped.chosen) < POSES and stopped.figures["cover_distance_m"] <= 0.4


def test_a_choice_that_lacks_nothing_is_left_as_it_is():
    far = np.array([[0.1, -1.0], [0.0, -1.0], [0.2, -1.0], [0.3, -1.0]])
    assert wanted(far, np.array([0, 2]), 2).tolist() == []
    assert wanted(far, np.array([0, 1]), 2).tolist() == [0, 3], "those that it has, then the one that is turned farthest"
    assert wanted(far, np.array([1]), 9).tolist() == [3, 2, 0]


def test_the_nearest_chosen_pose_gives_way():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2.1, 0, 0], [0.1, 0, 0]])
    assert exchanged(points, np.array([0, 1, 2]), np.array([3])).tolist() == [0, 1, 3]
    assert exchanged(points, np.array([0, 1, 2]), np.array([0, 4])).tolist() == [0, 4, 2], "what is needed stays"


def test_more_poses_that_turn_than_poses_are_refused(cell):
    with pytest.raises(PlanError, match="2 poses can't turn the torque of each axis in 5"):
        make_plan(cell, 2, pool_size=150, turn=5)
