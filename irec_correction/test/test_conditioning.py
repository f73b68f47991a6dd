# SPDX-License-Identifier: Apache-2.0
"""From the raw reading to the process wrench at the TCP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoad
from irec_correction.conditioning import (
    Cable,
    Conditioner,
    FilterSettings,
    make_filters,
    sensor_in_tool,
    to_tcp,
    without_load,
)
from irec_correction.errors import SettingsError
from scipy.spatial.transform import Rotation

ROBOT = Robot.from_urdf(Path(__file__).parents[2] / "config/robots/kr120_r2700_extra_ha.urdf")
G = np.array([0.0, 0.0, -9.81])
LOAD = ToolLoad(120.0, (0.01, -0.02, 0.2), (18.0, -11.0, 25.0), (1.2, -0.8, 0.5))
vectors = st.tuples(*(st.floats(-3, 3) for _ in range(3)))


@given(vectors, st.tuples(*(st.floats(-1000, 1000) for _ in range(6))))
def test_what_is_left_without_bias_weight_and_cable_is_the_process_wrench(turn, process):
    R = Rotation.from_rotvec(turn).as_matrix()
    cable = Cable((0.0, 30.0, 60.0), (0.1, 0.0, 0.3))
    pull = R.T @ np.array(cable.force_in_base)
    reading = np.array(process) + LOAD.reading(R, G) + np.concatenate([pull, np.cross(cable.point_in_sensor, pull)])
    np.testing.assert_allclose(without_load(reading, LOAD, cable, R, G), process, atol=1e-9)


@given(vectors, vectors, st.tuples(*(st.floats(-1000, 1000) for _ in range(6))))
def test_the_same_wrench_at_the_tcp_does_the_same_work(turn, p, wrench):
    R, p, wrench = Rotation.from_rotvec(turn).as_matrix(), np.array(p), np.array(wrench)
    v_tcp, w = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.02, -0.04])
    v_sensor = v_tcp + np.cross(w, p)
    at_tcp = to_tcp(wrench, R, p)
    work_there = wrench[:3] @ (R.T @ v_sensor) + wrench[3:] @ (R.T @ w)
    assert at_tcp[:3] @ v_tcp + at_tcp[3:] @ w == pytest.approx(work_there, abs=1e-8)


def test_sensor_frame_comes_from_the_robot_description():
    R, p = sensor_in_tool(ROBOT, "ft_sensor")
    np.testing.assert_allclose(R, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(p, [0.0, 0.0, -0.45], atol=1e-9)


@pytest.mark.parametrize(("frame", "text"), [("nowhere", "no link 'nowhere'"), ("link_3", "not fixed to tool0")])
def test_a_sensor_frame_that_can_not_be_is_refused(frame, text):
    with pytest.raises(SettingsError, match=text):
        sensor_in_tool(ROBOT, frame)


def test_stages_act_in_the_order_median_notch_low_pass():
    names = [f.name for f in make_filters(FilterSettings(median=3, spindle_speed=30.0, harmonics=1))]
    assert names == ["median of 3", "notch 30 Hz", "low-pass 40 Hz"]


def test_wrench_at_the_tcp_passes_unchanged_where_nothing_is_asked_for():
    wrench = np.arange(6.0)
    np.testing.assert_array_equal(Conditioner([]).step(wrench, np.eye(3)), wrench)
