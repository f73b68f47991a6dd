# SPDX-License-Identifier: Apache-2.0
"""How the robot came to a reference, where several markers are read there."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.travel import travel_to_reference
from irec_calibration.session.data import Marker

MARKERS = 3


def with_markers(apart_s: float):
    """A session and the same read by three markers, the second and third so much later."""
    one = synthetic.session(poses=5, seed=2)
    rows = np.repeat(np.arange(len(one)), MARKERS)
    marker = np.tile(np.arange(MARKERS), len(one))
    many = replace(
        one.select(rows), marker=marker, stamp=one.stamp[rows] + apart_s * marker,
        markers=tuple(Marker(f"M{i}", "tool0", (0.01 * i, 0.0, 0.05)) for i in range(MARKERS)),
    )  # fmt: skip
    return scene_of(one), scene_of(many), rows


@pytest.mark.parametrize("apart_s", [0.0, 1.0])
def test_each_marker_of_a_reference_has_the_motion_from_the_pose_before(apart_s: float) -> None:
    one, many, rows = with_markers(apart_s)
    travel = travel_to_reference(one)
    assert (np.abs(travel).max(axis=1) > 0.1).sum() == 4, "no example"
    np.testing.assert_array_equal(travel_to_reference(many), travel[rows])


@pytest.mark.parametrize("effect_id", ["joint_settling", "joint_hysteresis", "joint_backlash"])
def test_what_gears_keep_of_the_motion_before_is_the_same_whichever_marker_sees_it(effect_id: str) -> None:
    one, many, rows = with_markers(1.0)
    effect = find_effect(effect_id)
    values = {"a_2": 0.01, "travel": 1.0, "over": 1.5, "h_2": 1e-4, "r": 0.05, "arrived": 1.0, "freed": 2.0}
    values |= {"b_2": 1e-4, "w": 0.05, "held": 1.0}
    theta = np.array([values.get(p.name, 0.0) for p in effect.parameters(one)])
    at_tcp = (scene.seen_at(scene.p_tcp) for scene in (one, many))
    moved = [scene.change(effect.displacement(scene, theta)) for scene in at_tcp]
    assert np.abs(moved[0]).max() > 1e-7, "no example"
    np.testing.assert_allclose(moved[1], moved[0][rows], atol=1e-9 * np.abs(moved[0]).max())


@pytest.mark.parametrize("over", [1000.0, 0.2])
def test_what_is_left_of_a_long_travel_grows_no_further_than_its_range(over: float) -> None:
    scene = with_markers(0.0)[0]
    travel = travel_to_reference(scene)[:, 1]
    longest = int(np.abs(travel).argmax())
    assert abs(travel[longest]) > 0.4, "no example"
    effect = find_effect("joint_settling")
    theta = np.array([{"a_2": 0.01, "travel": 1.0, "over": over}.get(p.name, 0.0) for p in effect.parameters(scene)])
    left = 0.01 * (travel[longest] if over > 10.0 else 0.2 * np.tanh(travel[longest] / 0.2))
    np.testing.assert_allclose(effect.displacement(scene, theta)[longest], left * scene.J[longest, :, 1], rtol=1e-5)


@pytest.mark.parametrize(
    ("kind", "a", "over", "possible"),
    [
        ("absolute", -1.7e-4, 0.25, False),
        ("absolute", 1.7e-4, 0.25, True),  # ahead of what was reported, as one that settles is
        ("absolute", -1.7e-4, 2.0, True),
        ("loaded", -1.7e-4, 0.25, True),  # there the travel to the reference is another one
    ],
)
def test_an_arm_that_is_behind_by_no_more_after_a_longer_step_does_not_settle(
    kind: str, a: float, over: float, possible: bool
) -> None:
    """Friction that turns over a quarter of a radian had `joint_settling` beside it, of two simulators."""
    scene = scene_of(absolute_sessions.session(poses=4) if kind == "absolute" else synthetic.session(poses=2))
    values = {"a_2": (a, 1e-6), "a_3": (-0.1 * a, 1e-6), "over": (over, 0.01)}
    assert (find_effect("joint_settling").why_impossible(values, {}, scene) == "") == possible
