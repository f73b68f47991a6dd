# SPDX-License-Identifier: Apache-2.0
"""Play and stiffening of just the same axes are one curve that neither has; of other axes they are two causes."""

from __future__ import annotations

import pytest
from irec_calibration.diagnose.one_curve import mends_the_other, of_one_curve
from irec_calibration.diagnose.part_sets import Parts

PLAY, STIFFENS, FRICTION = "joint_backlash", "joint_stiffening", "joint_hysteresis"


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
