# SPDX-License-Identifier: Apache-2.0
"""What readings at the references rule out, what is taken off them before they are asked, and what they prove by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import readings, start_terms
from irec_calibration.diagnose.candidates import try_effect
from irec_calibration.diagnose.explanation import Explanation, implausible
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.readings import against, carried, proved, readings_of
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.shape import refit
from irec_calibration.diagnose.standing import proven
from irec_calibration.diagnose.study import Study, prepare, study_of
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term
from irec_calibration.session import Session
from numpy.typing import NDArray

Array = NDArray[np.float64]
STATION = np.array([4.0, -2.0, 1.0])
MASS = 3.0  # kg


def plain(measured: Session) -> Study:
    return prepare(measured, start_terms(measured)).to_weigh


def scale_of(value: float, se: float) -> Term:
    return Term(find_effect("tracker_scale"), {"s": Estimate(value, se)})


def weight_of(value: float, se: float) -> Term:
    return Term(find_effect("tool_weight"), {"dm": Estimate(value, se)})


def long_lengths(scene: Scene) -> Array:
    return 0.05 * (scene.p_observed - STATION)


def warming_up(scene: Scene) -> Array:
    """1.5 mm over the session."""
    return scene.stamp[:, None] / np.ptp(scene.stamp) * [1.2e-3, -0.9e-3, 0.0]


def with_too_much_weight() -> Session:
    measured = synthetic.session(poses=20, seed=5)
    weight = np.einsum("nji,j->ni", scene_of(measured).kin.R_tool, [0.0, 0.0, -9.81 * MASS])
    return replace(measured, force_in_tool=measured.force_in_tool + weight)


@pytest.mark.parametrize("odds, refused", [(-2.0, False), (-2.6, True), (3.0, False)])
def test_readings_refuse_an_instrument_by_what_one_effect_is_preferred(
    odds: float, refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readings, "carried", lambda study, term: odds)
    study, term = plain(synthetic.session(poses=20, seed=5)), scale_of(-0.012, 0.008)
    assert bool(against(study, term)) == refused
    one = Explanation((term,), study, 20.0, grow(study.bench, family_of(study), study.base))
    assert ("readings at the references" in implausible(one, "tracker_scale")) == refused


def test_a_tool_weight_that_the_sensor_does_not_read_is_refused() -> None:
    study = plain(synthetic.session(poses=20, seed=5))
    assert "readings at the references" in against(study, weight_of(-17.0, 2.7))


def test_a_tool_weight_that_the_sensor_reads_may_stand_and_no_other() -> None:
    study = plain(with_too_much_weight())
    assert not against(study, weight_of(MASS, 0.5))
    assert "readings at the references" in against(study, weight_of(-17.0, 2.7))


def test_a_drift_that_is_in_the_model_is_taken_off_the_readings() -> None:
    measured = synthetic.session(poses=20, seed=5, extra=warming_up)
    study = plain(measured)
    trial = try_effect(study, find_effect("thermal_drift"))
    drifts = refit(study, trial) if trial else None
    assert drifts is not None
    wrong = scale_of(1e-3, 3e-4)
    before, after = readings_of(study, wrong.effect), readings_of(drifts, wrong.effect)
    assert before is not None
    assert after is not None
    assert np.ptp(after.values, axis=0).max() < 0.5 * np.ptp(before.values, axis=0).max()
    assert after.log_evidence > before.log_evidence
    assert carried(drifts, wrong) < carried(study, wrong)


def test_what_a_drift_may_be_besides_leaves_a_true_scale_its_odds() -> None:
    measured = synthetic.session(poses=20, seed=5, extra=lambda s: warming_up(s) + long_lengths(s))
    study = plain(measured)
    drift = Term(find_effect("thermal_drift"))
    both = study_of(study.observation, (*study.terms, drift, scale_of(0.05, 0.002)))
    assert carried(both, both.terms[-1]) > SETTINGS.nats_to_name


@pytest.mark.parametrize("hidden, there", [(long_lengths, True), (None, False)])
def test_readings_prove_a_scale_whatever_value_a_fit_gives_it(hidden: object, there: bool) -> None:
    study = plain(synthetic.session(poses=20, seed=5, extra=hidden))
    assert proved(study, find_effect("tracker_scale")) == there


def links_a_centimetre_off(scene: Scene) -> Array:
    effect = find_effect("geometry_error")
    lengths = [p.scale * (20.0 if p.name[0] in "xyz" else 5.0) for p in effect.parameters(scene)]
    return effect.displacement(scene, np.array(lengths) * np.random.default_rng(2).normal(size=len(lengths)))


def test_beside_a_geometry_error_of_centimetres_readings_prove_no_scale_but_may_be_against_it() -> None:
    found = plain(synthetic.session(poses=20, seed=5, extra=links_a_centimetre_off))
    wrong, huge = scale_of(-0.015, 0.007), scale_of(0.3, 0.01)
    known = readings_of(found, wrong.effect)
    assert known is not None and known.prove
    with_geometry = study_of(found.observation, (*found.terms, Term(find_effect("geometry_error"))))
    known = readings_of(with_geometry, wrong.effect)
    assert known is not None and not known.prove
    assert not proved(with_geometry, wrong.effect)
    assert carried(with_geometry, wrong) <= 0.0
    assert "readings at the references" in against(with_geometry, huge)


def test_a_name_that_readings_contradict_does_not_stand_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    start_study = plain(synthetic.session(poses=20, seed=5, extra=long_lengths))
    family = family_of(start_study)
    study = study_of(start_study.observation, (*start_study.terms, Term(find_effect("tracker_scale"))))
    start = Explanation((), start_study, 0.0, grow(start_study.bench, family, start_study.base))
    gained = study.bench.posterior(study.base).log_evidence - start_study.bench.posterior(start_study.base).log_evidence
    one = Explanation((study.terms[-1],), study, gained, grow(study.bench, family, study.base))
    assert proven(start, (start, one), family, SETTINGS)[0].ids == ("tracker_scale",)
    monkeypatch.setattr("irec_calibration.diagnose.explanation.against", lambda study, term: "not read")
    assert proven(start, (start, one), family, SETTINGS)[0].ids == ()
