# SPDX-License-Identifier: Apache-2.0
"""Where springs sit off the joints' origins: how far goes with how soft they are, and every model has it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import improve
from irec_calibration.diagnose.priors import FACTORS, FORM_LEVELS, choices, level_of_form, log_odds_of_form
from irec_calibration.diagnose.study import Study, completed_study, prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scales import typical_compliance
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import default_terms
from irec_calibration.model import Model
from irec_calibration.robot import Robot

OFF = np.random.default_rng(3).normal(0.0, 0.03, (6, 3))  # m, in base_link axes of the joint's frame


def off_centre(scene: Scene) -> np.ndarray:
    """What springs across the joints do at their places more than at the origins, written out, (n, 3), m."""
    out = np.zeros((len(scene), 3))
    for k in range(6):
        d = np.einsum("nij,j->ni", _frame(scene, k), OFF[k])
        for v in range(2):
            a, c = scene.kin.virtual_axis[:, k, v], synthetic.TRANSVERSE[2 * k + v]
            for place, sign in ((scene.kin.origin[:, k] + d, 1.0), (scene.kin.origin[:, k], -1.0)):
                torque = np.einsum("ni,ni->n", a, np.cross(scene.p_tcp - place, scene.force))
                out += sign * c * torque[:, None] * np.cross(a, scene.p_observed - place)
    return out


def _frame(scene: Scene, k: int) -> np.ndarray:
    return np.stack([scene.kin.virtual_axis[:, k, 0], scene.kin.virtual_axis[:, k, 1], scene.kin.axis[:, k]], axis=2)


@pytest.fixture(scope="module")
def fits() -> tuple[Study, Study]:
    """The 18-DOF model of a robot whose springs sit 3 cm off, and the one with the place of bending."""
    fine = synthetic.Noise(tracker_m=2e-6, force_n=0.1)
    bent = synthetic.session(seed=2, extra=off_centre, noise=fine)
    plain = prepare(bent, default_terms(bent))
    return plain, completed_study(plain)


def half_way(scene: Scene) -> np.ndarray:
    """A link that bends in the plane of the arm, at half its length between two parallel axes, (n, 3), m."""
    kin = scene.kin
    middle, axis = 0.5 * (kin.origin[:, 1] + kin.origin[:, 2]), kin.axis[:, 1]
    torque = np.einsum("ni,ni->n", axis, np.cross(scene.p_tcp - middle, scene.force))
    return 1e-7 * torque[:, None] * np.cross(axis, scene.p_observed - middle)


def missed(study: Study, extra: Callable[[Scene], np.ndarray] = off_centre) -> float:
    """RMS over rows of what a model's prediction of the marker misses, without the session's noise, m."""
    quiet = synthetic.session(seed=7, extra=extra)
    scene = scene_of(quiet)
    moved = scene.change(Model(study.terms).predict(scene))
    exact = synthetic.Noise(tracker_m=1e-12, tracker_m_per_m=0.0, force_n=0.0, settling_m=0.0)
    seen = prepare(synthetic.session(seed=7, extra=extra, noise=exact), study.terms).observation
    return float(np.sqrt(((seen.y - moved[seen.rows]) ** 2).sum(axis=1).mean()))


def test_the_prior_of_a_springs_place_goes_with_how_soft_the_spring_is(fits):
    study = fits[1]
    at = {p.name: i for i, p in enumerate(study.parameters)}
    A, x = study.base.A, study.bench.posterior(study.base).x
    variance = np.linalg.inv(A.T @ A + np.diag(study.base.width**-2.0)).diagonal()
    for group, count in (("across", 24), ("in the plane", 12)):  # two for each of three springs of a joint
        places = [(i, at[p.goes_with]) for i, p in enumerate(study.parameters) if p.level == group]
        assert len(places) == count
        level = np.array([study.base.width[i] / np.hypot(x[j], np.sqrt(variance[j])) for i, j in places])
        assert level == pytest.approx(np.full(count, np.median(level)), rel=0.05)
        assert np.median(level) == pytest.approx(study.form[f"bending_place/{group}"], rel=0.1)


def test_links_that_bend_only_across_the_plane_of_the_arm_leave_the_places_of_the_drives_where_they_are(fits):
    form = fits[1].form
    assert form["bending_place/across"] >= 1.0
    assert form["bending_place/in the plane"] <= 0.125


def test_a_model_with_the_place_of_bending_predicts_a_robot_whose_springs_sit_beside_the_joints(fits):
    plain, whole = fits
    assert missed(whole) < 0.6 * missed(plain)


def test_a_link_that_bends_in_the_plane_of_the_arm_is_not_taken_for_a_cause() -> None:
    fine = synthetic.Noise(tracker_m=2e-6, force_n=0.1)
    bent = synthetic.session(seed=2, extra=half_way, noise=fine)
    plain = prepare(bent, default_terms(bent))
    assert missed(completed_study(plain), half_way) < 0.4 * missed(plain, half_way)
    assert improve(bent).before.verdict.status == "adequate"


def test_an_improved_model_has_the_place_of_bending_where_the_session_does_not_tell():
    ladder = improve(synthetic.session(poses=20, seed=1))
    assert [r.added for r in ladder.rungs] == ["", "bending_place"]
    assert ladder.before.verdict.status == "adequate"
    assert "as every robot has" in ladder.before.verdict.text


def test_how_far_off_springs_may_sit_goes_with_the_size_of_the_robot():
    def share(robot: Robot) -> float:
        scene = scene_of(replace(synthetic.session(4), robot=robot))
        return float(find_effect("bending_place").parameters(scene)[0].scale / typical_compliance(robot)[0])

    def smaller(of: re.Match[str]) -> str:
        return 'origin xyz="' + " ".join(str(0.4 * float(v)) for v in of[1].split()) + '"'

    small = re.sub(r'origin xyz="([^"]+)"', smaller, synthetic.urdf())
    assert share(Robot(small)) == pytest.approx(0.4 * share(Robot(synthetic.urdf())), rel=0.02)


def test_a_tool_and_the_place_of_bending_are_given_their_sizes_together_before_each_by_itself():
    def asked(*ids: str) -> list[tuple[str, ...]]:
        owners = [find_effect(i) for i in ids]
        return [tuple(i for i, chosen in zip(ids, c.of, strict=True) if chosen) for c in choices(owners, [""] * len(ids))]

    assert asked("joint_torsion", "bending_place", "tool_compliance") == [
        ("joint_torsion",), ("bending_place", "tool_compliance"), ("bending_place",), ("tool_compliance",),
    ]  # fmt: skip
    assert asked("joint_torsion", "bending_place", "sensor_gain") == [("joint_torsion",), ("bending_place",), ("sensor_gain",)]


@pytest.mark.parametrize(
    ("likely", "level"), [((1.0,), 1.0), ((0.125, 8.0), 1.0), ((0.25, 0.5, 1.0, 2.0), np.sqrt(0.5)), ((0.0625,), 0.0625)]
)
def test_the_level_is_the_mean_of_the_logarithms_of_those_that_are_likely(likely: tuple[float, ...], level: float) -> None:
    log_evidence = np.where(np.isin(FORM_LEVELS, likely), -1000.0, -1100.0)
    assert level_of_form(log_evidence) == pytest.approx(level)


def test_together_every_pair_of_sizes_is_tried_a_usual_place_likelier_than_others():
    owners = [find_effect(i) for i in ("joint_torsion", "bending_place", "tool_compliance")]
    both = next(c for c in choices(owners, [""] * 3) if c.of.sum() == 2)
    assert {(place, tool) for _, place, tool in both.times.tolist()} == {(p, t) for p in FORM_LEVELS for t in FACTORS.tolist()}
    np.testing.assert_allclose(both.log_odds, log_odds_of_form(both.times[:, 1]))
