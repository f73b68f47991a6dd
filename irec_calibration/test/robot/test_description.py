# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions as people write them: what is not stated is unknown, and what can't be is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from irec_calibration.errors import RobotError
from irec_calibration.robot import Robot
from irec_calibration.robot.ratings import rating_known
from synthetic import EFFORT, urdf

Q = np.array([0.2, 0.5, 0.1, 0.3, 0.8, 0.0])


def without(pattern: str) -> str:
    text = re.sub(pattern, "", urdf())
    assert text != urdf()
    return text


@pytest.mark.parametrize("text", [without(r' effort="[^"]*"'), re.sub(r'effort="[^"]*"', 'effort="inf"', urdf())])
def test_an_effort_that_is_not_stated_is_unknown(text: str) -> None:
    assert not rating_known(Robot(text)).any()
    assert rating_known(Robot(urdf())).all() and len(EFFORT) == 6


def test_a_velocity_that_is_not_stated_is_unknown() -> None:
    assert not np.any(Robot(without(r' velocity="[^"]*"')).velocity)


def test_a_mass_without_moments_of_inertia_weighs_what_it_says() -> None:
    """The parser drops such a mass without a word."""
    np.testing.assert_allclose(Robot(without(r"<inertia [^>]*/>")).gravity_torque(Q), Robot(urdf()).gravity_torque(Q))


@pytest.mark.parametrize("mass", ["-5", "nan", "heavy", "inf"])
def test_a_mass_that_cannot_be_is_refused_with_link_and_value(mass: str) -> None:
    text = re.sub(r'mass value="[^"]*"', f'mass value="{mass}"', urdf(), count=1)
    with pytest.raises(RobotError, match=rf"cell\.urdf: link 'link_\w+' has the mass '{mass}'; kg, 0 or more, is expected"):
        Robot(text, "cell.urdf")


def test_the_description_is_kept_as_it_was_given() -> None:
    text = without(r' effort="[^"]*"')
    assert Robot(text).urdf_text == text
    assert Robot(urdf()).completed_urdf == urdf()
