# SPDX-License-Identifier: Apache-2.0
"""How much friction in a gear may hold back."""

from __future__ import annotations

import pytest
import synthetic
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of


@pytest.mark.parametrize(("h", "possible"), [(1e-6, True), (1e-5, False)])
def test_friction_holds_a_gear_back_by_milliradians_at_most(h, possible):
    """However soft what it holds back is: by less than it, over a small range of torque."""
    scene, friction = scene_of(synthetic.session(poses=4, seed=3)), find_effect("joint_hysteresis")
    why = friction.why_impossible({"h_3": (h, 0.0), "r": (0.1, 0.0)}, {}, scene)
    assert (why == "") == possible and ("axis 3" in why) != possible
