# SPDX-License-Identifier: Apache-2.0
"""An absolute session whose robot description has no masses: what the arm's own weight does is given no name."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from absolute_sessions import SIX, session, torsion, urdf
from irec_calibration.diagnose import Diagnosis, diagnose
from irec_calibration.effects import find_effect
from irec_calibration.effects.base import absent
from irec_calibration.effects.of_session import scene_of
from irec_calibration.robot import Robot
from irec_calibration.session import Noise

WITHOUT = Robot(re.sub("<inertial>.*?</inertial>", "", urdf(SIX)))
WOULD_PASS = ("base_compliance", "counterbalance", "encoder_harmonics", "external_force", "joint_stiffening", "tool_compliance")


@cache
def found() -> Diagnosis:
    data = session(noise=Noise(tracker_m=1e-5), moved=torsion(np.full(6, 1e-5)))
    return diagnose(replace(data, robot=WITHOUT))


@pytest.mark.parametrize("effect_id", WOULD_PASS)
def test_what_the_arms_own_weight_would_pass_for_is_not_tried_beside_a_payload(effect_id: str) -> None:
    needs = find_effect(effect_id).needs
    there = session(poses=5)
    assert "gives no masses" in absent(scene_of(replace(there, robot=WITHOUT)), needs)
    assert absent(scene_of(there), needs) == ""


@pytest.mark.slow
def test_the_verdict_says_what_is_not_known_and_what_to_do() -> None:
    verdict = found().verdict
    assert "gives no masses" in verdict.text and "State the masses (<inertial>)." in verdict.text
    assert set(verdict.effects) <= {"joint_torsion", "link_bending"}
