# SPDX-License-Identifier: Apache-2.0
"""Which structures an effect is a special form of."""

from __future__ import annotations

import pytest
from irec_calibration.diagnose.family import Structure
from irec_calibration.diagnose.forms import Forms


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
