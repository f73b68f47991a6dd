# SPDX-License-Identifier: Apache-2.0
"""A robot on a rail that stands on posts: it gives way most in the middle between any two of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import improve
from irec_calibration.effects.rail_compliance import softness
from irec_calibration.effects.scene import Scene
from numpy.typing import NDArray

POSES, APART = 36, 1.1  # m between posts


def on_posts(scene: Scene) -> NDArray[np.float64]:
    """What a beam between posts does under the moment about its own direction, written out here."""
    moment = np.cross(scene.p_tcp, scene.force)[:, 1]
    soft = 4e-8 * (0.3 + np.sin(np.pi * (positions() - 0.4) / APART) ** 2)
    return np.cross((soft * moment)[:, None] * [0.0, 1.0, 0.0], scene.p_observed)


def positions() -> NDArray[np.float64]:
    return np.repeat(np.random.default_rng(7).uniform(0.0, 3.0, POSES), 6)


@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.long), 2])
def test_a_rail_on_posts_is_named_with_the_distance_of_its_posts(seed: int) -> None:
    session = replace(synthetic.session(POSES, seed=seed, extra=on_posts), ext={"rail": positions()})
    ladder = improve(session)
    assert ladder.before.verdict.effects == ("rail_compliance",)
    found = {n: e.value for t in ladder.rungs[-1].model.terms if t.effect.id == "rail_compliance" for n, e in t.estimates.items()}
    assert found["posts"] == 1.0
    assert found["w"] == pytest.approx(APART, rel=0.05)
    assert found["r_y"] == pytest.approx(0.3 * 4e-8, rel=0.3)
    assert found["r_y_soft"] == pytest.approx(4e-8, rel=0.2)


@pytest.mark.parametrize(("apart", "softest"), [(0.39, 0.0), (0.41, 1.0)])
def test_a_rail_is_not_softer_between_posts_that_stand_close(apart: float, softest: float) -> None:
    assert softness(np.array([1.0]), 1.0, apart, 1.0) == softest


def test_a_carriage_on_a_rail_may_be_soft_at_a_narrow_place() -> None:
    assert softness(np.array([1.0]), 1.0, 0.1, 0.0) == 1.0


def aslant(scene: Scene) -> NDArray[np.float64]:
    """What a carriage does that tilts about a direction between x and y, by far more at one end of its rail."""
    moment = np.cross(scene.p_tcp, scene.force)
    about = np.array([0.8, -0.6, 0.0])
    soft = 1e-7 * (0.4 + np.exp(-((positions() - 3.0) ** 2)))
    return np.cross((soft * (moment @ about))[:, None] * about, scene.p_observed)


@pytest.mark.long
def test_a_carriage_that_tilts_aslant_is_a_rail_and_no_base_beside_it() -> None:
    session = replace(synthetic.session(POSES, seed=4, extra=aslant), ext={"rail": positions()})
    ladder = improve(session)
    assert ladder.before.verdict.effects == ("rail_compliance",)
    found = {n: e.value for t in ladder.rungs[-1].model.terms if t.effect.id == "rail_compliance" for n, e in t.estimates.items()}
    assert found["r_xy"] + found["r_xy_soft"] < -3e-8
