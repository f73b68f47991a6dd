# SPDX-License-Identifier: Apache-2.0
"""Readings of the standing robot that do not agree are told, with what is wrong with what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.procedure.arrival import joint_problem, tcp_problem
from irec_calibration.procedure.commands import MoveLinear
from irec_calibration.procedure.plausible import Plausibility, Standing, what_is_read
from scipy.spatial.transform import Rotation

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
STATION = CELL.stations[0]


def standing(q: np.ndarray, rail: float = 0.0, sag: float = 0.0) -> Standing:
    """Readings of a true robot whose arm sags by `sag` m."""
    at = CELL.robot.kinematics(q[None])
    p, R = at.p_tcp[0], at.R_tool[0]
    in_cell = p + R @ CELL.marker_in_tool + CELL.base_in_cell(np.array([rail]))[0] - [0, 0, sag]
    return Standing(q, rail, p, R, STATION.name, STATION.R_in_cell.T @ (in_cell - STATION.p_in_cell))


NEAR, FAR = standing(CELL.home, 0.3, 1e-3), standing(CELL.home + [0.3, 0.2, -0.2, 0.1, 0.1, 0.5], -0.4, 2e-3)


def test_a_true_robot_is_plausible_from_pose_to_pose() -> None:
    judge = Plausibility(CELL)
    assert [judge.problem(s) for s in (NEAR, FAR, NEAR)] == ["", "", ""]


def test_what_the_tracker_does_not_see_is_not_judged() -> None:
    judge = Plausibility(CELL)
    assert not judge.problem(replace(NEAR, p_marker=None)) and not judge.problem(FAR)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda s: replace(s, q=np.degrees(s.q)), "the joint angles are in degrees"),
        (lambda s: replace(s, p_tcp=1e3 * s.p_tcp), "tcp_pose is in mm"),
        (lambda s: replace(s, p_tcp=s.p_tcp + CELL.base_in_cell(np.array([s.rail]))[0]), "does not move with the rail"),
        (lambda s: replace(s, p_tcp=s.p_tcp + [0.0, 0.0, 0.8]), "800.0 mm apart, limit 5 mm"),
        (lambda s: replace(s, q=s.q[[1, 0, 2, 3, 4, 5]]), "are the joints in the order of their names"),
        (lambda s: replace(s, R_tool=s.R_tool @ np.diag([-1.0, -1.0, 1.0])), "turned by 180.0 deg against the joint angles"),
    ],
)
def test_joint_angles_and_tcp_pose_are_held_against_each_other(wrong: object, message: str) -> None:
    assert message in Plausibility(CELL).problem(wrong(NEAR))  # type: ignore[operator]


TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda s: replace(s, p_marker=1e3 * s.p_marker), "the tracker's points are in mm"),
        (lambda s: replace(s, p_marker=TURN @ s.p_marker), "the way is as long but has another direction"),
        (lambda s: replace(s, p_marker=NEAR.p_marker), "the marker stands"),
    ],
)
def test_the_marker_has_to_move_as_the_tcp_does(wrong: object, message: str) -> None:
    judge = Plausibility(CELL)
    judge.problem(wrong(NEAR))  # type: ignore[operator]
    problem = judge.problem(wrong(FAR))  # type: ignore[operator]
    assert "the marker does not move as the TCP does" in problem and message in problem


def test_a_marker_in_millimetres_is_told_the_first_time_it_is_seen() -> None:
    assert "points are in mm" in Plausibility(CELL).problem(replace(NEAR, p_marker=1e3 * NEAR.p_marker))  # type: ignore[operator]


def test_a_move_that_was_not_carried_out_is_noticed() -> None:
    assert "joint_states says -1.9000 rad" in joint_problem(NEAR.q, NEAR.q + [0, 0.1, 0, 0, 0, 0], NEAR.rail, None)
    assert "0.3" in joint_problem(NEAR.q, NEAR.q, NEAR.rail, 0.1)
    assert not joint_problem(NEAR.q, NEAR.q, NEAR.rail, 0.3)


def test_the_end_of_a_straight_move_is_held_against_tcp_pose() -> None:
    quat = Rotation.from_matrix(NEAR.R_tool).as_quat()
    asked = MoveLinear(NEAR.p_tcp + [0.0, 0.0, 0.15], NEAR.R_tool, 0.1)
    assert "150.0 mm apart, limit 3 mm" in tcp_problem(NEAR.p_tcp, quat, asked, 0.003)
    assert not tcp_problem(NEAR.p_tcp + [0.0, 0.0, 0.149], quat, asked, 0.003)
    turned = replace(asked, R_in_base=NEAR.R_tool @ TURN)
    assert "turned by 90.0 deg" in tcp_problem(NEAR.p_tcp + [0.0, 0.0, 0.15], quat, turned, 0.003)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        ([0.0, 280.0, -1100.0], "axes or signs are exchanged (x is y, y is x)"),
        ([-280.0, 0.0, 1100.0], "(x is -x, z is -z)"),
        ([0.28, 0.0, -1.1], "it is in kN"),
        ([280.0, 0.0, -1099.0], "the wrench reads (280, 0, -1099) N"),
        ([100.0, 0.0, -400.0], "the wrench reads (100, 0, -400) N"),
    ],
)
def test_what_turns_the_force_asked_for_into_the_one_that_is_read_is_told(read: list[float], message: str) -> None:
    assert message in what_is_read(np.array([280.0, 0.0, -1100.0]), np.array(read))
