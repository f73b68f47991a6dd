# SPDX-License-Identifier: Apache-2.0
"""A station that is turned about the first axis and an error of that axis' zero do the same to all that is seen."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from irec_calibration.diagnose import Diagnosis, diagnose
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from synthetic import COMPLIANCE, session

STATION = find_effect("station_registration")


@pytest.mark.parametrize(
    ("turn", "se", "also"),
    [
        ((0.0, 0.0, 5e-3), 0.0, "geometry_error"),
        ((2e-4, -7e-4, -5e-3), 0.0, "geometry_error"),  # within what every base frame is off
        ((3e-3, 0.0, 5e-3), 0.0, ""),
        ((3e-3, 0.0, 5e-3), 1.5e-3, "geometry_error"),  # the turn about x may be none
        ((0.0, 5e-3, 0.0), 0.0, ""),
        ((0.0, 0.0, 3e-4), 0.0, "geometry_error"),
        ((3e-4, 0.0, 1e-4), 0.0, ""),
        ((4.5e-4, 2.7e-4, 4.9e-4), 5e-5, ""),  # about no axis more than about others
        ((8.8e-4, 4.3e-4, -6.9e-4), 6e-5, ""),
    ],
)
def test_a_turn_about_the_first_axis_may_be_that_axis_zero(turn: tuple[float, float, float], se: float, also: str) -> None:
    assert STATION.also_called(scene_of(session(3)), np.array(turn), np.full(3, se)) == also


@cache
def found(turn: tuple[float, float, float]) -> Diagnosis:
    def turned(scene: Scene) -> np.ndarray:
        u = np.einsum("nik,nk->ni", scene.J, COMPLIANCE * scene.tau)
        return -np.cross(np.array(turn), u + scene.p_observed)

    return diagnose(session(seed=6, extra=turned))


@pytest.mark.slow
@pytest.mark.long
def test_which_of_the_two_it_is_no_verdict_says() -> None:
    verdict = found((0.0, 0.0, 0.02)).verdict
    assert verdict.one_of == (("station_registration", "geometry_error"),)
    assert "an error of that axis' zero do the same to all that is seen" in verdict.text


@pytest.mark.slow
def test_a_station_that_is_turned_about_another_direction_is_named() -> None:
    assert found((0.014, 0.0, 0.014)).verdict.effects == ("station_registration",)
