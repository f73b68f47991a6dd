# SPDX-License-Identifier: Apache-2.0
"""Play that a seal holds on whichever side it lies: an axis without weight comes to the next pose as its last load left it."""

from __future__ import annotations

import pytest
from irec_calibration.diagnose import improve
from irec_calibration.effects.scene import Scene
from irec_calibration.robot.ratings import rated_torque
from irec_calibration.typing import Array
from test_diagnose import session, turned

PLAY = 4e-4  # rad, of axis 1


def lies_where_it_was(scene: Scene) -> Array:
    """A tooth that goes over as soon as the torque is 1 % of the rated one, and lies where it was below."""
    free, side, angle = 0.01 * rated_torque(scene.robot)[0], 0.0, 0.0 * scene.tau
    torque = scene.tau[:, 0] + scene.tau_gravity[:, 0]
    for row in range(len(scene)):
        side = 1.0 if torque[row] > free else -1.0 if torque[row] < -free else side
        angle[row, 0] = 0.5 * PLAY * side
    return turned(scene, angle)


def goes_over_at_zero(scene: Scene) -> Array:
    """The same without a seal: without a load it lies in the middle."""
    angle = 0.0 * scene.tau
    angle[:, 0] = 0.5 * PLAY * ((scene.tau[:, 0] > 5.0) * 1.0 - (scene.tau[:, 0] < -5.0) * 1.0)
    return turned(scene, angle)


@pytest.mark.parametrize(("extra", "held"), [
    pytest.param(lies_where_it_was, 1.0, marks=pytest.mark.long), (goes_over_at_zero, 0.0),
])  # fmt: skip
def test_it_is_named_and_told_from_play_that_is_crossed_at_zero(extra, held) -> None:
    ladder = improve(session(extra))
    assert ladder.before.verdict.effects == ("joint_backlash",)
    assert ladder.before.verdict.parts["joint_backlash"].proven == ("axis 1",)
    model = ladder.rungs[-1].model
    play = next(t for t in model.terms if t.effect.id == "joint_backlash").estimates
    assert play["held"].value == held and play["b_1"].value == pytest.approx(PLAY, rel=0.1)
    assert ladder.rungs[-1].cv_rms_m < 0.3 * ladder.rungs[0].cv_rms_m
