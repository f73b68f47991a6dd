# SPDX-License-Identifier: Apache-2.0
"""A model on the way asks to see the session otherwise; two effects that are tried together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.diagnose import again
from irec_calibration.diagnose import build as building
from irec_calibration.diagnose.build import Built, build
from irec_calibration.diagnose.explanation import Explanation
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.standing import all_stand, standing
from irec_calibration.diagnose.study import Study
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.noise import Wander
from irec_calibration.identification.observe import Observation
from numpy.typing import NDArray
from test_building_blocks import play_of_axis_4, study

Array = NDArray[np.float64]


def play_and_a_drift(scene: Scene) -> Array:
    return play_of_axis_4(scene) + 2e-6 * (scene.stamp - scene.stamp[0])[:, None] * np.array([1.0, -0.5, 0.7])


@cache
def built() -> Built:
    return build(study(play_and_a_drift))


@pytest.mark.slow
def test_a_session_that_is_to_be_seen_otherwise_is_not_searched_for_two_effects_together(monkeypatch) -> None:
    monkeypatch.setattr(building, "two_together", lambda *_: pytest.fail("two effects were tried together"))
    asked = study(play_of_axis_4)
    found = build(asked, look=lambda one, family: one.study.observation)
    assert found.seen is found.final.study.observation and found.rivals == {}


@pytest.mark.slow
def test_a_model_that_is_content_is_asked_once_for_each_model_that_it_may_be(monkeypatch) -> None:
    seen: list[Explanation] = []

    def look(one: Explanation, family: object) -> None:
        seen.append(one)

    found = build(study(play_of_axis_4), look=look)
    assert found.seen is None
    assert seen[-1] is found.final and len(seen) == len({id(one) for one in seen}) <= 2


@pytest.mark.slow
def test_names_that_all_stand_have_the_evidence_that_each_has_by_itself() -> None:
    found = built()
    assert len(found.final.ids) == 2
    kept, evidence = standing(found.start, found.final, found.family, SETTINGS)
    assert kept is found.final
    assert all_stand(found.start, found.final, found.family, SETTINGS) == evidence


@pytest.mark.slow
def test_where_one_name_is_too_weak_not_all_stand(monkeypatch) -> None:
    from irec_calibration.diagnose import standing as module

    found = built()
    weakest = found.final.ids[0]
    monkeypatch.setattr(module, "odds_of", lambda start, one, bare, effect_id, *_: 1.0 if effect_id == weakest else 100.0)
    assert all_stand(found.start, found.final, found.family, SETTINGS) == {}


@pytest.mark.parametrize(
    ("kind", "share", "named", "built_with"),
    [
        ("absolute", 0.45, ("play",), [True]),
        ("absolute", 0.55, ("play",), [True, False]),
        ("loaded", 0.55, (), [True, False]),
        ("loaded", 0.55, ("play",), [True]),
    ],
)
def test_a_model_is_built_without_noise_that_wanders_where_most_of_the_noise_does(
    monkeypatch, kind, share, named, built_with
) -> None:
    """In a loaded session only where nothing was found beside it."""
    asked = study(play_of_axis_4)
    seen = asked.observation
    wander = Wander(share, 40.0, asked.ready.stamp[seen.rows], np.zeros(len(seen.rows), dtype=np.int64), seen.whiten.sigma)
    wandering = replace(seen, session=replace(seen.session, kind=kind), whiten=replace(seen.whiten, wander=wander))
    with_wander = []

    def on(observation: Observation) -> Study:
        return replace(asked, fit=replace(asked.fit, observation=observation))

    def built_once(asked: Study, study: Study, *_: object) -> tuple[Study, Study, SimpleNamespace]:
        with_wander.append(study.observation.whiten.wander is not None)
        return asked, study, SimpleNamespace(final=SimpleNamespace(added=named))

    monkeypatch.setattr(again, "built_again", built_once)
    monkeypatch.setattr(again, "at_level_beside", lambda observation, terms: observation)
    monkeypatch.setattr(again, "study_of", lambda observation, terms: on(observation))
    monkeypatch.setattr(again, "_log_odds", lambda one: 0.0)
    again.built_either_way(on(wandering), on(wandering), lambda: None, lambda words: None)
    assert with_wander == built_with
