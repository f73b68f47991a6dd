# SPDX-License-Identifier: Apache-2.0
"""Play and stiffening of just the same axes are one curve that neither has; of other axes they are two causes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import synthetic
from irec_calibration.diagnose.one_curve import mends_the_other, of_one_curve, of_one_step
from irec_calibration.diagnose.part_sets import Parts
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of

PLAY, STIFFENS, FRICTION = "joint_backlash", "joint_stiffening", "joint_hysteresis"
SETTLES = "joint_settling"


@pytest.mark.parametrize(
    ("play", "stiffens", "added", "found"),
    [
        (("axis 4",), ("axis 4",), (), (PLAY, STIFFENS, FRICTION)),
        (("axis 4",), ("axis 4",), (FRICTION,), (PLAY, STIFFENS)),
        (("axis 4",), ("axis 1",), (), ()),
        (("axis 4",), ("axis 1", "axis 4"), (), ()),
        ((), (), (), ()),
    ],
)
def test_two_laws_of_the_same_axes_are_told_as_one_of_all_laws(play, stiffens, added, found) -> None:
    parts = {PLAY: Parts(proven=play), STIFFENS: Parts(proven=stiffens), "creep": Parts(proven=play)}
    assert of_one_curve(("creep", PLAY, STIFFENS), parts, (PLAY, STIFFENS, *added)) == found


def test_a_balancer_is_no_law_of_the_torque_alone() -> None:
    parts = {PLAY: Parts(proven=("axis 2",)), "counterbalance": Parts(proven=("axis 2",))}
    assert of_one_curve((PLAY, "counterbalance"), parts, ()) == ()


@pytest.mark.parametrize(
    ("bounds", "mends"),
    [({STIFFENS: PLAY}, STIFFENS), ({PLAY: STIFFENS}, PLAY), ({STIFFENS: PLAY, PLAY: STIFFENS}, ""), ({}, "")],
)
def test_of_two_laws_of_one_curve_that_which_came_to_where_the_other_begins_mends_it(bounds: dict[str, str], mends: str) -> None:
    assert mends_the_other((PLAY, STIFFENS, FRICTION), bounds) == mends


@pytest.mark.parametrize(
    ("friction", "settles", "found"),
    [
        (("axis 1",), ("axis 1",), (SETTLES, FRICTION)),
        (("axis 1",), ("axis 1", "axis 2"), (SETTLES, FRICTION)),
        (("axis 1",), ("axis 2",), ()),
        ((), ("axis 2",), ()),
    ],
)
def test_two_effects_that_turn_the_same_axes_by_the_step_are_one_curve_of_it(friction, settles, found) -> None:
    parts = {FRICTION: Parts(proven=friction), SETTLES: Parts(proven=settles), PLAY: Parts(proven=friction)}
    assert of_one_step((PLAY, SETTLES, FRICTION), parts) == found


@pytest.mark.parametrize(("over", "ends"), [(0.16, SETTLES), (0.08, "")])
def test_friction_that_turns_over_as_much_travel_as_it_may_is_where_settling_begins(over: float, ends: str) -> None:
    absolute = scene_of(replace(synthetic.session(poses=6), kind="absolute"))
    friction = find_effect(FRICTION)
    assert friction.ends_at({"lag_1": 1e-4, "over": over}, absolute) == ends
    assert friction.ends_at({"h_1": 1e-6}, scene_of(synthetic.session(poses=6))) == ""
