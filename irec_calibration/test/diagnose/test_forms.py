# SPDX-License-Identifier: Apache-2.0
"""Which structures an effect is a special form of."""

from __future__ import annotations

import pytest
import synthetic
from irec_calibration.diagnose import start_terms
from irec_calibration.diagnose.family import Structure, family_of
from irec_calibration.diagnose.forms import Forms, forms_of
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Estimate, Term


@pytest.mark.parametrize(
    ("structure", "is_form"),
    [
        (Structure(("joint_1",), "turning axis 1", slice(0, 3), 1, axis=0), True),
        (Structure(("joint_2",), "turning axis 1", slice(0, 3), 1, axis=0), False),
        (Structure(("joint_2",), "turning axis 2", slice(0, 3), 1, axis=1), False),
        (Structure(("joint_1",), "turning axis 1, 2.67 times per turn", slice(0, 2), 1, ripple=(0, 2.67)), True),
        (Structure(("joint_1",), "turning axis 1, 10.5 times per turn", slice(0, 2), 1, ripple=(0, 10.5)), False),
        (Structure(("joint_2",), "turning axis 2, 2.67 times per turn", slice(0, 2), 1, ripple=(1, 2.67)), False),
    ],
)
def test_what_turns_an_axis_smoothly_by_its_own_angle_is_a_form_of_its_encoders_harmonics(structure, is_form):
    assert Forms(angles=frozenset({0})).has(structure) == is_form


@pytest.mark.parametrize(
    ("effect_id", "name", "its_own"),
    [
        ("joint_hysteresis", "h_3", True),
        ("joint_hysteresis", "h_2", False),
        ("joint_stiffening", "a_3", False),
        ("creep", "c", False),
    ],
)
def test_what_turns_an_axis_by_the_torque_before_is_a_form_of_friction_in_its_gear_and_of_nothing_else(effect_id, name, its_own):
    measured = synthetic.session(poses=8, seed=3)
    history = [s for s in family_of(prepare(measured, start_terms(measured)).to_weigh).structures if s.history_of == 2]
    assert [s.words for s in history] == ["turning axis 3 by its torque before"]
    term = Term(find_effect(effect_id), {name: Estimate(1e-8)})
    assert forms_of(term, scene_of(measured)).has(history[0]) == its_own
