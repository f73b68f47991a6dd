# SPDX-License-Identifier: Apache-2.0
"""An arm with more joints than it needs is drawn to where it should be without moving the tool."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irec_calibration.poses.ik import Chain, solve_tool_axis
from irec_calibration.robot import Robot

ROBOT = Robot.from_urdf(Path(__file__).resolve().parents[3] / "config" / "robots" / "wam7.urdf")


def test_a_seven_axis_arm_reaches_the_tool_and_lies_nearer_to_its_rest():
    rng = np.random.default_rng(1)
    lower, upper = np.maximum(ROBOT.lower, -np.pi), np.minimum(ROBOT.upper, np.pi)
    goal = rng.uniform(0.5 * lower, 0.5 * upper, (40, 7))
    kin = ROBOT.kinematics(goal)
    rest = np.tile(0.5 * (lower + upper), (40, 1))
    start = goal + rng.normal(0.0, 0.3, goal.shape)
    chain = Chain.of(ROBOT)
    drawn, reached = solve_tool_axis(chain, kin.p_tcp, kin.R_tool[:, :, 2], start, rest=rest)
    plain, reached_plain = solve_tool_axis(chain, kin.p_tcp, kin.R_tool[:, :, 2], start)
    both = reached & reached_plain
    assert both.sum() > 25
    p, R, _ = chain.forward(drawn[both])
    np.testing.assert_allclose(p, kin.p_tcp[both], atol=1e-8)
    np.testing.assert_allclose(R[:, :, 2], kin.R_tool[both, :, 2], atol=1e-7)
    distance = [np.linalg.norm(q[both] - rest[both], axis=1) for q in (drawn, plain)]
    assert np.median(distance[0]) < 0.8 * np.median(distance[1])
