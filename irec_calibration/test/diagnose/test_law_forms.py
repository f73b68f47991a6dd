# SPDX-License-Identifier: Apache-2.0
"""Laws in proportion to the process force: what is written, what it moves, and that the likeliest one is found."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import law_forms
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.held_out import validated
from irec_calibration.diagnose.improve import improve
from irec_calibration.diagnose.law_forms import NAMES, _family, _told_apart, forms, likeliest, targets
from irec_calibration.diagnose.run import start_terms
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.study import Study
from irec_calibration.effects.formula import FormulaEffect, in_words
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from numpy.typing import NDArray

Array = NDArray[np.float64]
EVERY = 11  # of some thousand laws


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(synthetic.session(poses=5, seed=8))


def axis_1_gives_way_to_the_product_of_two_torques(scene: Scene) -> Array:
    angle = np.zeros_like(scene.tau)
    angle[:, 0] = 2e-10 * scene.tau[:, 0] * scene.tau[:, 4]
    return np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), angle)


def a_bearing_of_axis_4_tilts_by_a_force(scene: Scene) -> Array:
    tilt = 3e-7 * np.abs(scene.force_in_tool[:, 0])
    return np.asarray(scene.kin.virtual_jacobian(scene.p_observed)[:, :, 6] * tilt[:, None])


@pytest.fixture(scope="module")
def study() -> Study:
    session = synthetic.session(poses=30, seed=8, extra=axis_1_gives_way_to_the_product_of_two_torques)
    return validated(session, start_terms(session)).study


def test_what_a_law_moves_is_what_its_formula_says(scene: Scene) -> None:
    for target in targets(scene):
        for form in islice(forms(scene, target), 0, None, EVERY):
            law = FormulaEffect("law", form.text(target.name))
            names = [p.name for p in law.parameters(scene)]
            assert names == list(NAMES[: len(form.terms)])
            values = np.arange(1.0, len(names) + 1.0)
            expected = target.along * (np.stack(form.values, axis=1) @ values)[:, None]
            np.testing.assert_allclose(law.displacement(scene, values), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("share", [0.5, 3.0])
def test_every_law_is_in_proportion_to_the_force(scene: Scene, share: float) -> None:
    other = scene.with_wrench(share * scene.force_in_tool, share * scene.torque_in_tool)
    for target in targets(scene):
        for form in islice(forms(scene, target), 0, None, EVERY):
            law = FormulaEffect("law", form.text(target.name))
            ones = np.ones(len(form.terms))
            expected = share * law.displacement(scene, ones)
            np.testing.assert_allclose(law.displacement(other, ones), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_no_law_is_written_twice(scene: Scene) -> None:
    texts = [form.text(target.name) for target in targets(scene) for form in forms(scene, target)]
    assert len(texts) == len(set(texts))


def test_no_law_follows_a_force_that_is_not_there(scene: Scene) -> None:
    without = scene.with_wrench(scene.force_in_tool * [1.0, 0.0, 1.0], scene.torque_in_tool)
    texts = [form.text(target.name) for target in targets(without) for form in forms(without, target)]
    assert any("f_x" in text for text in texts) and not any("f_y" in text for text in texts)


def test_the_likeliest_law_is_the_cause(study: Study) -> None:
    law, block, nats = likeliest(study)[0]
    assert law.formula == "axis 1: a * tau * tau_5 / load"
    assert block.A.shape == (len(study.bench.b), 1) and nats > 50.0


def test_there_are_some_laws_of_each_number_of_terms(study: Study) -> None:
    terms = [len(law.parameters(study.ready)) for law, _, _ in likeliest(study)]
    assert len(set(terms)) > 2 and max(terms.count(n) for n in terms) == SETTINGS.laws.of_a_length


def test_how_many_laws_are_held_in_memory_at_once_changes_nothing(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = likeliest(study)
    monkeypatch.setattr(law_forms, "AT_ONCE", 40 * len(study.ready))
    parts = likeliest(study)
    assert [law.formula for law, _, _ in parts] == [law.formula for law, _, _ in whole]
    np.testing.assert_allclose([nats for _, _, nats in parts], [nats for _, _, nats in whole], rtol=1e-9)


@pytest.mark.parametrize(
    ("cause", "law"),
    [
        (axis_1_gives_way_to_the_product_of_two_torques, "axis 1: a * tau * tau_5 / load"),
        (a_bearing_of_axis_4_tilts_by_a_force, "link 4a: a * abs(f_x)"),
    ],
)
@pytest.mark.long
def test_an_improved_model_predicts_a_cause_that_has_no_name(cause, law) -> None:
    ladder = improve(synthetic.session(poses=30, seed=8, extra=cause))
    assert ladder.before.verdict.effects == ()
    assert law in [r.formula for r in ladder.rungs]
    assert ladder.rungs[-1].cv_rms_m < 1.2 * ladder.noise_floor_m < 0.7 * ladder.rungs[0].cv_rms_m


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("axis 1: a * tau * tau_5 / load", "axis 1: a * tau * tau_5 / load"),
        ("link 3a: f_x * (a + b * cos(q_4) + c * sin(q_4)) + abs(f_x) * (d + e * cos(q_4))", "link 3a: by f_x, q_4"),
    ],
)
def test_a_law_that_no_line_holds_is_said_in_short(formula, said) -> None:
    law = FormulaEffect("law", formula)
    assert law.in_short == said and in_words(law) == f"the law '{said}'"


@pytest.mark.parametrize(
    ("words", "apart"), [("axis 1: a * tau * tau_5 / load", True), ("f_z * f_z * f_z / load / load", False)]
)
def test_terms_that_cancel_where_it_was_measured_are_no_law(study: Study, words: str, apart: bool) -> None:
    """The normal force has one sign and nearly one size: the terms of a curve of it make up for each other."""
    target = next(targets(study.ready))
    some = [form for form in forms(study.ready, target) if words in form.text(target.name)][:1]
    family = _family(study, target, some, np.inf)
    assert _told_apart(family, Ground(study.bench, study.base), SETTINGS.laws.least_apart).tolist() == [apart]
