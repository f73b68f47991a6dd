# SPDX-License-Identifier: Apache-2.0
"""Joint offsets move the TCP as the offset does, and stay small where a joint would have to move far."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.cell import read_cell
from irec_correction.joint_offset import LARGEST, joint_offset

CELL = read_cell(Path(__file__).parents[2] / "config" / "cells" / "afp.yaml")
small = st.floats(-1e-3, 1e-3)


@given(st.tuples(small, small, small), st.tuples(small, small, small))
def test_a_joint_offset_moves_the_tcp_as_the_offset_does(translation: tuple[float, ...], rotation: tuple[float, ...]) -> None:
    dq = joint_offset(CELL.robot, CELL.home, np.array(translation), np.array(rotation))
    at = CELL.robot.kinematics(np.array([CELL.home, CELL.home + dq]))
    np.testing.assert_allclose(at.p_tcp[1] - at.p_tcp[0], translation, atol=1e-5)
    turn = at.R_tool[1] @ at.R_tool[0].T
    np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], rotation, atol=1e-5)


def test_no_joint_is_asked_to_move_far_in_a_singularity() -> None:
    stretched = CELL.home.copy()
    stretched[4] = 0.0  # axes 4 and 6 in one line
    for turn in np.eye(3):
        assert np.abs(joint_offset(CELL.robot, stretched, np.array([0.003, 0.003, 0.0]), 0.005 * turn)).max() <= LARGEST


def test_no_offset_is_no_offset() -> None:
    assert not joint_offset(CELL.robot, CELL.home, np.zeros(3), np.zeros(3)).any()
