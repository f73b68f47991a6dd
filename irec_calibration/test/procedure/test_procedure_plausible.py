# SPDX-License-Identifier: Apache-2.0
"""Readings of the standing robot that do not agree are told, with what is wrong with what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.procedure.arrival import joint_problem, tcp_problem
from irec_calibration.procedure.commands import MoveLinear
from irec_calibration.procedure.plausible import Plausibility, Standing, what_is_read
from irec_calibration.procedure.weighing import sensor_in_tool
from irec_calibration.robot import Payload, Robot
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


# --- the scale of the force sensor ----------------------------------------------------------------------------------------------

TURNED = [np.array([0.0, 0.0, 0.0, 0.0, a, b]) for a, b in ((0.0, 0.0), (0.4, 0.0), (-0.5, 0.3), (0.1, -0.8), (0.6, 0.2))]
SENSOR = sensor_in_tool(CELL.robot, "ft_sensor")


def run_of(gain: float, mass: float = 120.0, noise: float = 1.0, cell: Cell = CELL, zeroed: bool = False) -> str:
    """What is told over five places; zeroed: the sensor's bias is set anew at each."""
    return after_run(gain, mass, noise, cell, zeroed)[0]


def after_run(
    gain: float, mass: float = 120.0, noise: float = 1.0, cell: Cell = CELL, zeroed: bool = False
) -> tuple[str, str]:  # fmt: skip
    """The same, and why the scale is not known after it."""
    rng = np.random.default_rng(2)
    raw = np.zeros(3)
    judge = Plausibility(cell, lambda: raw)
    for turn in TURNED:
        R = CELL.robot.kinematics((CELL.home + turn)[None]).R_tool[0]
        weight = np.zeros(3) if zeroed else SENSOR.T @ R.T @ [0.0, 0.0, -9.81 * mass] + [18.0, -11.0, 25.0]
        raw = gain * (weight + rng.normal(0.0, noise, 3))
        if problem := judge.weight_problem(R):
            return problem, judge.scale.doubt()
    return "", judge.scale.doubt()


@pytest.mark.parametrize(
    ("gain", "likely"),
    [(0.2248, "pounds (lbf)"), (0.102, "kilograms (kgf)"), (0.5, "gain seems to be 0.5"), (2.0, "gain seems to be 2"),
     (4.448, "N that were taken for pounds")],
)  # fmt: skip
def test_a_force_sensor_of_another_scale_is_told_from_the_weight_of_the_tool(gain: float, likely: str) -> None:
    told = run_of(gain)
    assert "kg of tool (wrench_raw in" in told and "120 kg are stated" in told and likely in told


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.3])
def test_a_sensor_of_about_the_right_scale_is_believed(gain: float) -> None:
    assert not run_of(gain)


def test_what_is_not_known_well_is_not_told() -> None:
    assert not run_of(1.0, zeroed=True), "a sensor that is set to zero at each place weighs nothing"
    assert not run_of(0.2248, noise=300.0), "what does not turn with the tool is no weight"
    assert not Plausibility(CELL).weight_problem(np.eye(3)), "wrench_raw does not come"
    assert not run_of(0.2248, cell=replace(CELL, robot=Robot(CELL.robot.urdf_text.replace('value="120"', 'value="0"'))))


def test_one_orientation_tells_nothing() -> None:
    judge = Plausibility(CELL, lambda: np.array([0.0, 0.0, -260.0]))
    R = CELL.robot.kinematics(CELL.home[None]).R_tool[0]
    assert not any(judge.weight_problem(R) for _ in range(5))


BARE = replace(CELL, robot=Robot(CELL.robot.urdf_text.replace('value="120"', 'value="0"')))
HOME = CELL.robot.kinematics(CELL.home[None]).R_tool


def test_a_scale_that_was_seen_to_be_right_is_verified() -> None:
    assert after_run(1.0) == ("", "")


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"cell": BARE, "gain": 0.2248}, "state no mass"),
        ({"zeroed": True}, "is the sensor set to zero at each pose"),
        ({"noise": 300.0}, "does not turn as a weight and a bias do"),
        ({"gain": 1e-3}, "too little to tell the scale"),
        ({"mass": 0.8, "noise": 0.5, "cell": replace(BARE, payload=Payload(0.8))}, "is the tool light"),
    ],
)
def test_a_scale_that_could_not_be_verified_is_said_to_be_unknown(arguments: dict, why: str) -> None:
    problem, doubt = after_run(**{"gain": 1.0, **arguments})
    assert not problem and doubt.startswith("the scale of the force could not be verified") and why in doubt


def test_readings_that_do_not_come_leave_the_scale_unknown() -> None:
    judge = Plausibility(CELL)
    judge.weight_problem(HOME[0])
    assert "no readings of wrench_raw in 'ft_sensor'" in judge.scale.doubt()


def test_a_tool_that_hangs_alike_everywhere_leaves_the_scale_unknown_and_that_is_known_before() -> None:
    judge = Plausibility(CELL, lambda: np.array([0.0, 0.0, -260.0]))
    for _ in range(5):
        judge.weight_problem(HOME[0])
    assert "the tool hangs alike in all 5 places" in judge.scale.doubt()
    about_z = Rotation.from_euler("z", [[0.0], [1.0], [2.0]]).as_matrix()  # a tool that points down turns about the vertical
    assert "alike in all 4 places" in judge.scale_doubt_before(about_z @ HOME[0])
    tilted = Rotation.from_euler("x", [[0.0], [0.5], [-0.5]]).as_matrix()
    assert not judge.scale_doubt_before(tilted @ HOME[0])
    assert "state no mass" in Plausibility(BARE).scale_doubt_before(tilted @ HOME[0])
