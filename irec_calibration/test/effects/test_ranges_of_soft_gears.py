# SPDX-License-Identifier: Apache-2.0
"""The gear of each axis may be soft over a range of torque of its own; where that is a spring's and where it is play."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.diagnose.study import study_of
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import observe
from irec_calibration.model import EIGHTEEN_DOF, Estimate, Term
from irec_calibration.robot import Robot
from irec_calibration.robot.ratings import rated_torque
from synthetic import session, urdf

STIFFENING, PLAY = find_effect("joint_stiffening"), find_effect("joint_backlash")
NO_LIMIT = re.sub(r'effort="\d+"', 'effort="0"', urdf())
SOFTER = -8e-7


def theta(effect_id: str, scene: Scene, **values: float) -> np.ndarray:
    return np.array([values.get(p.name, p.start) for p in find_effect(effect_id).parameters(scene)])


def gears(scene: Scene, ranges: dict[int, float]) -> np.ndarray:
    """Displacement, (n, 3), m, of gears that are soft over their shares of the rated torque."""
    turned = np.zeros((len(scene), scene.n_joints))
    for axis, share in ranges.items():
        weight, x_0 = scene.tau_gravity[:, axis], share * rated_torque(scene.robot)[axis]

        def bent(tau: np.ndarray, x_0: float = x_0) -> np.ndarray:
            return np.asarray(SOFTER * (tau - x_0 * np.tanh(tau / x_0)))

        turned[:, axis] = bent(scene.tau[:, axis] + weight) - bent(weight)
    return np.asarray((scene.J @ turned[:, :, None])[:, :, 0])


def test_a_fit_finds_the_range_of_each_gear_that_is_soft_over_another_share_of_its_rated_torque() -> None:
    ranges = {1: 0.2, 2: 0.08}
    observation = observe(session(31, seed=5, extra=lambda scene: gears(scene, ranges)))
    given = {"a_2": Estimate(0.0, upper=0.0), "a_3": Estimate(0.0, upper=0.0), "x_0": Estimate(0.15), "slow": Estimate(0.0)}
    fit = study_of(observation, [*(Term(find_effect(i)) for i in EIGHTEEN_DOF), Term(STIFFENING, given)])
    found = fit.terms[-1].estimates
    apart = found["u_2"].value - found["u_3"].value
    assert apart == pytest.approx(np.log(ranges[1] / ranges[2]), abs=4.0 * np.hypot(found["u_2"].se, found["u_3"].se))
    assert np.hypot(found["u_2"].se, found["u_3"].se) < 0.3


@pytest.mark.parametrize(("effort", "least"), [(None, 0.03), ("0", 0.003)])
def test_no_gear_is_soft_over_less_than_play_ends_at_or_a_tenth_of_that_where_no_limit_is_stated(effort, least) -> None:
    measured = session(8)
    scene = scene_of(replace(measured, robot=measured.robot if effort is None else Robot(NO_LIMIT)))
    narrow, at_least = (theta("joint_stiffening", scene, a_1=SOFTER, x_0=0.03, u_1=u) for u in (-6.0, np.log(least / 0.03)))
    np.testing.assert_allclose(STIFFENING.displacement(scene, narrow), STIFFENING.displacement(scene, at_least), atol=1e-12)


@pytest.mark.parametrize(("slow", "called"), [(0.0, "joint_backlash"), (0.5, ""), (1.0, "")])
def test_a_gear_that_goes_on_stiffening_beyond_the_border_of_play_is_not_at_it(slow: float, called: str) -> None:
    scene = scene_of(session(8))
    at_border = theta("joint_stiffening", scene, a_1=SOFTER, x_0=0.03, slow=slow)
    assert STIFFENING.also_called(scene, at_border, np.zeros_like(at_border)) == called


@pytest.mark.parametrize(("effort", "w", "rather"), [(None, 0.03, "joint_stiffening"), (None, 0.02, ""), ("0", 0.03, "")])
def test_play_that_would_be_wider_than_play_is_rather_a_soft_gear_where_the_limit_is_stated(effort, w, rather) -> None:
    measured = session(8)
    robot = measured.robot if effort is None else Robot(NO_LIMIT)
    assert PLAY.rather({"b_1": 1e-4, "w": w}, {}, scene_of(replace(measured, robot=robot))) == rather


@pytest.mark.parametrize(("share_of_largest", "rather"), [(0.02, "joint_backlash"), (0.06, "")])
def test_a_gear_that_is_soft_over_3_percent_of_what_the_session_shows_is_rather_play(share_of_largest, rather) -> None:
    scene = scene_of(replace(session(8), robot=Robot(NO_LIMIT)))
    largest = np.abs(scene.tau_acting + scene.tau_gravity).max(axis=0)[0]
    share = share_of_largest * largest / rated_torque(scene.robot)[0]
    values = {"a_1": SOFTER, "x_0": 0.03, "u_1": np.log(share / 0.03), "slow": 0.0}
    assert STIFFENING.rather(values, {}, scene) == rather


def test_an_axis_whose_limit_is_stated_is_no_play_though_another_one_has_no_limit() -> None:
    only_axis_3 = NO_LIMIT.replace('effort="0"', 'effort="7759"', 3).replace('effort="7759"', 'effort="0"', 2)
    scene = scene_of(replace(session(8), robot=Robot(only_axis_3)))
    assert STIFFENING.rather({"a_3": SOFTER, "x_0": 0.1, "slow": 0.0}, {}, scene) == ""


@pytest.mark.parametrize(
    ("effort", "values", "ends_at"),
    [
        (None, {"a_1": SOFTER, "x_0": 0.03, "slow": 0.0}, "joint_backlash"),
        (None, {"a_1": SOFTER, "x_0": 0.03, "slow": 0.5}, "joint_backlash"),
        (None, {"a_1": SOFTER, "x_0": 0.03, "slow": 1.0}, ""),
        (None, {"a_1": SOFTER, "a_2": SOFTER, "u_2": 0.5, "x_0": 0.03, "slow": 0.0}, ""),
        (None, {"a_1": SOFTER, "a_2": 0.01 * SOFTER, "u_2": 0.5, "x_0": 0.03, "slow": 0.0}, "joint_backlash"),
        (None, {"a_1": SOFTER, "x_0": 0.05, "slow": 0.0}, ""),
        ("0", {"a_1": SOFTER, "x_0": 0.03, "slow": 0.0}, ""),
    ],
)
def test_a_soft_gear_ends_where_play_begins_if_its_axes_came_to_the_narrowest_range_of_a_stated_limit(
    effort: str | None, values: dict[str, float], ends_at: str
) -> None:
    measured = session(8)
    robot = measured.robot if effort is None else Robot(NO_LIMIT)
    assert STIFFENING.ends_at(values, scene_of(replace(measured, robot=robot))) == ends_at


@pytest.mark.parametrize(
    ("effort", "w", "ends_at"),
    [(None, 0.03, "joint_stiffening"), (None, 0.024, "joint_stiffening"), (None, 0.02, ""), ("0", 0.03, "")],
)
def test_play_ends_where_a_soft_gear_begins_if_it_came_near_the_widest_range_of_a_stated_limit(
    effort: str | None, w: float, ends_at: str
) -> None:
    measured = session(8)
    robot = measured.robot if effort is None else Robot(NO_LIMIT)
    assert PLAY.ends_at({"b_1": 1e-4, "w": w}, scene_of(replace(measured, robot=robot))) == ends_at
