# SPDX-License-Identifier: Apache-2.0
"""A gear that is soft over just the range of torque at which play ends: what it is goes with how much softer it is there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.effects.scene import Scene
from irec_calibration.robot.ratings import rated_torque
from irec_calibration.typing import Array
from test_diagnose import session, turned

AXIS = 3


def softer_about_zero(times: float) -> Callable[[Scene], Array]:
    """A gear that is so many times softer about zero torque than far from it, over 2.5 % of the rated torque."""

    def moved(scene: Scene) -> Array:
        over, angle = 0.025 * rated_torque(scene.robot)[AXIS], 0.0 * scene.tau
        before, after = scene.tau_gravity[:, AXIS], scene.tau_gravity[:, AXIS] + scene.tau[:, AXIS]
        more = (times - 1.0) * synthetic.COMPLIANCE[AXIS] * over
        angle[:, AXIS] = more * (np.tanh(after / over) - np.tanh(before / over))
        return turned(scene, angle)

    return moved


def test_a_gear_that_is_four_times_softer_about_zero_is_a_soft_gear() -> None:
    verdict = diagnose(session(softer_about_zero(4.0))).verdict
    assert (verdict.effects, verdict.one_of) == (("joint_stiffening",), ())


def test_one_that_is_sixteen_times_softer_may_be_play() -> None:
    verdict = diagnose(session(softer_about_zero(16.0))).verdict
    assert verdict.effects == () and [set(either) for either in verdict.one_of] == [{"joint_stiffening", "joint_backlash"}]
