# SPDX-License-Identifier: Apache-2.0
"""Rows that stand out bend no model, and stay where alternatives are weighed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import start_terms, validated
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Model
from irec_calibration.session import Session
from numpy.typing import NDArray

BUMPED = {3: (3e-4, 0.0, -2e-4), 9: (-1e-4, 3e-4, 0.0), 14: (0.0, -4e-4, 1e-4), 22: (2e-4, 2e-4, 2e-4)}  # pose index -> m


@pytest.fixture(scope="module")
def clean() -> Session:
    return synthetic.session(seed=1)


@pytest.fixture(scope="module")
def bumped(clean: Session) -> Session:
    """The reflector is knocked between the second and the third load case of four poses."""
    marker = clean.p_marker_in_station.copy()
    for pose, by in BUMPED.items():
        marker[(clean.pose == np.unique(clean.pose)[pose]) & (clean.load_case > 2)] += by
    return replace(clean, p_marker_in_station=marker)


def deflection(study: Study, session: Session) -> NDArray[np.float64]:
    return Model(study.terms).predict(scene_of(session, observe="tcp"))


def off(study: Study, session: Session, truth: Study) -> float:
    """RMS over rows between what two models predict, m."""
    return float(np.sqrt(((deflection(study, session) - deflection(truth, session)) ** 2).sum(axis=1).mean()))


def test_a_model_is_hardly_bent_by_poses_in_which_the_reflector_was_knocked(clean, bumped):
    without, spoilt = (prepare(s, start_terms(s)) for s in (clean, bumped))
    assert len(spoilt.observation.rows) == len(without.observation.rows), "nothing was left out as plainly wrong"
    assert off(spoilt, clean, without) < 0.4 * off(spoilt.to_weigh, clean, without)


def test_the_poses_that_were_knocked_are_those_that_stand_out(bumped):
    made = validated(bumped, start_terms(bumped))
    poses = np.unique(bumped.pose)[list(BUMPED)]
    assert set(poses) <= set(bumped.pose[[r for p in made.study.apart for r in p.structure.rows]])


def test_alternatives_are_weighed_on_rows_at_their_own_noise(bumped):
    study = prepare(bumped, start_terms(bumped))
    assert (study.observation.whiten.sigma >= study.to_weigh.observation.whiten.sigma * 0.999).all()
    assert (study.observation.whiten.sigma > 3.0 * study.to_weigh.observation.whiten.sigma).sum() >= 8


def test_nothing_is_set_apart_where_nothing_stands_out(clean):
    study = prepare(clean, start_terms(clean))
    assert study.apart == () and study.to_weigh is study
