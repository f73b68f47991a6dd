# SPDX-License-Identifier: Apache-2.0
"""What evidence rests on in absolute sessions, which start without springs: small signals beside far larger ones."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from absolute_sessions import THREE_MARKERS, session, torsion
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.diagnose import diagnose, start_terms
from irec_calibration.diagnose.candidates import options
from irec_calibration.diagnose.evidence import Bench, Block
from irec_calibration.diagnose.explanation import Explanation, own_forms
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.level import family_in_view
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import Effect, find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Estimate, Term
from irec_calibration.session import Noise, Session
from numpy.typing import NDArray

Array = NDArray[np.float64]
NOISE = Noise(tracker_m=1.5e-5)
SOFT = torsion(np.array([2e-6, 8e-6, 1.2e-5, 1e-5, 1e-5, 1e-5]))


def seated_anew(s: Session, p: Array) -> Array:
    return np.asarray(SOFT(s, p) + s.robot.kinematics(s.q).R_tool @ [6e-5, -5e-5, 4e-5] * (np.arange(len(p)) >= 70)[:, None])


def on_a_soft_pedestal(s: Session, p: Array) -> Array:
    effect = find_effect("base_compliance")
    scene = scene_of(s)
    theta = np.array([8e-6 * (q.name in ("r_x", "r_y")) for q in effect.parameters(scene)])  # 2 mrad under its own weight
    return np.asarray(SOFT(s, p) + effect.regressor(scene, theta) @ theta)


def on_a_pedestal_that_tips_about_an_edge(s: Session, p: Array) -> Array:
    """Half a metre beside base_link: a moment about y lifts it, too."""
    effect = find_effect("base_compliance")
    scene = scene_of(s)
    values = {"r_x": 2e-6, "r_y": 8e-6, "tr_zy": 4e-6, "t_z": 2e-6}
    theta = np.array([values.get(q.name, 0.0) for q in effect.parameters(scene)])
    return np.asarray(SOFT(s, p) + effect.regressor(scene, theta) @ theta)


def seen_at_wrong_angles(s: Session, p: Array) -> Array:
    """An encoder of the tracker that sits beside its axis: 40 urad, three times per turn."""
    v = p - np.asarray(s.stations[0].xyz)
    return np.asarray(SOFT(s, p) + 4e-5 * np.sin(3.0 * np.arctan2(v[:, 1], v[:, 0]))[:, None] * np.cross([0.0, 0.0, 1.0], v))


def settles_slowly(s: Session, p: Array) -> Array:
    step = np.diff(s.q[:, 2], prepend=s.q[0, 2])
    return np.asarray(SOFT(s, p) + 1.5e-4 * step[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 2])


def settles_and_has_friction(s: Session, p: Array) -> Array:
    """Axis 3 stays behind its step, and to the side from which it came."""
    step = np.diff(s.q[:, 2], prepend=s.q[0, 2])
    behind = 1.5e-4 * step + 1.5e-4 * np.sign(step)
    return np.asarray(SOFT(s, p) + behind[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 2])


def stays_behind_by_a_law_of_its_own(s: Session, p: Array) -> Array:
    step = np.diff(s.q[:, 2], prepend=s.q[0, 2])
    behind = 3e-4 * np.cos(2.0 * step)
    return np.asarray(SOFT(s, p) + behind[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 2])


def read_by_an_eccentric_encoder(s: Session, p: Array) -> Array:
    turned = 1.5e-4 * np.sin(s.q[:, 0]) + 1e-4 * np.cos(2.0 * s.q[:, 0])
    return np.asarray(SOFT(s, p) + turned[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 0])


def read_by_a_chipped_encoder(s: Session, p: Array) -> Array:
    """Wrong within a quarter of a turn only."""
    turned = 4e-4 * np.exp(-(((s.q[:, 0] - 0.4) / 0.4) ** 2))
    return np.asarray(SOFT(s, p) + turned[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 0])


def test_what_a_structure_is_said_to_bring_it_brings() -> None:
    made = session(poses=80, noise=NOISE, moved=SOFT)
    study = prepare(made, start_terms(made)).to_weigh
    family = family_in_view(study)
    block = study.base
    for part in grow(study.bench, family, study.base).parts:
        before = Ground(study.bench, block)
        block = block + family.block(part.structure, part.amplitude)
        brought = Ground(study.bench, block).log_evidence - before.log_evidence - np.log(part.structure.tried)
        # at the best of nine amplitudes, equally likely beforehand
        assert part.log_evidence - 0.01 < brought < part.log_evidence + np.log(9.0) + 0.01


@pytest.mark.long
def test_a_reflector_that_is_seated_anew_stands_out_of_what_the_springs_leave() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=seated_anew)).verdict
    assert "joint_torsion" in verdict.effects
    assert "the reflector seated anew at pose 71," in verdict.text


@pytest.mark.long
def test_the_pedestal_of_a_light_robot_may_be_as_soft_as_that_robot_is_light() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=on_a_soft_pedestal)).verdict
    assert set(verdict.effects) == {"base_compliance", "joint_torsion"}, verdict.text


def test_a_place_of_tilting_is_no_evidence_of_a_base_under_the_weight_alone() -> None:
    base = find_effect("base_compliance")
    sessions = {"absolute": session(poses=60, moved=SOFT), "loaded": synthetic.session(12)}
    groups = {kind: _groups_tried(base, s) for kind, s in sessions.items()}
    assert groups == {"absolute": {"translation", "rotation"}, "loaded": {"translation", "rotation", "place of tilting"}}


def _groups_tried(effect: Effect, s: Session) -> set[str]:
    (option,), _ = options(prepare(s, start_terms(s)), [effect])
    return {n for table in option.tables for n in table.groups}


@pytest.mark.long
def test_a_base_that_is_named_has_the_place_where_it_tilts() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=on_a_pedestal_that_tips_about_an_edge)).verdict
    assert "base_compliance" in verdict.effects, verdict.text
    assert {"rotation", "place of tilting"} <= set(verdict.parts["base_compliance"].proven), verdict.text
    told = re.search(r"it tilts most about y, about a line near x = (-?[\d.]+) m, z = (-?[\d.]+) m in base_link", verdict.text)
    assert told is not None, verdict.text
    np.testing.assert_allclose([float(v) for v in told.groups()], [0.5, 0.0], atol=0.1)


@pytest.mark.long
def test_what_the_instrument_reads_wrongly_is_told_by_where_it_looks_and_passes_for_no_error_of_joint_angles() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=seen_at_wrong_angles)).verdict
    assert "encoder_harmonics" not in verdict.effects
    assert verdict.remaining_m > 1e-5 and "marker_x" in verdict.depends_on, verdict.text


@pytest.mark.long
def test_the_general_law_of_the_step_before_is_no_rival_of_what_is_a_form_of_it() -> None:
    made = session(poses=80, noise=NOISE, moved=settles_slowly)
    assert set(diagnose(made).verdict.effects) == {"joint_settling", "joint_torsion"}
    study = prepare(made, start_terms(made)).to_weigh
    by_step = [s for s in family_in_view(study).structures if s.by_step and s.axis == 2]
    settling, friction = (
        Term(find_effect(i), {n: Estimate(1e-5, unit="1", lower=-1.0, upper=1.0)})
        for i, n in (("joint_settling", "a_3"), ("joint_hysteresis", "lag_3"))
    )
    alone = Explanation((settling,), study, 0.0, grow(study.bench, family_in_view(study), study.base))
    assert all(own_forms(alone, "joint_settling").has(s) for s in by_step) and by_step
    # beside friction it may only mend that one's form
    assert not any(own_forms(replace(alone, added=(settling, friction)), "joint_settling").has(s) for s in by_step)


@pytest.mark.long
def test_the_general_law_of_an_axis_own_angle_is_no_rival_of_the_harmonics_of_its_encoder() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=read_by_an_eccentric_encoder)).verdict
    assert set(verdict.effects) == {"encoder_harmonics", "joint_torsion"}, verdict.text


@pytest.mark.long
def test_what_harmonics_do_not_explain_of_an_encoder_is_said() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=read_by_a_chipped_encoder)).verdict
    assert verdict.remaining_m > 1e-5 and "joint_1" in verdict.depends_on, verdict.text


@pytest.mark.long
def test_settling_and_friction_of_one_axis_are_named_where_both_together_are_better_than_any_curve_of_its_step() -> None:
    verdict = diagnose(session(poses=120, noise=NOISE, moved=settles_and_has_friction)).verdict
    assert set(verdict.effects) == {"joint_settling", "joint_hysteresis", "joint_torsion"}, verdict.text
    other = diagnose(session(poses=120, noise=NOISE, moved=stays_behind_by_a_law_of_its_own)).verdict
    assert set(other.effects) <= {"joint_torsion"}, other.text


@pytest.mark.parametrize(
    ("axis", "law", "name"),
    [
        pytest.param(1, np.sign, "joint_hysteresis", marks=pytest.mark.long),
        (2, lambda step: 3.0 * np.tanh(step / 0.06), "joint_hysteresis"),
        (3, lambda step: 2.0 * step, "joint_settling"),
    ],
    ids=("friction", "friction that turns over some travel", "settling"),
)
def test_friction_or_settling_is_named_where_a_curve_of_the_step_explains_as_much(axis, law, name) -> None:
    springs = torsion(np.array([2e-6, 3e-6, 4e-6, 1e-5, 1e-5, 2e-5]))

    def behind(s: Session, p: Array) -> Array:
        q = s.q[:: len(s.markers)]
        turned = np.repeat(1e-4 * law(np.diff(q[:, axis], prepend=q[0, axis])), len(s.markers))
        return np.asarray(springs(s, p) + turned[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, axis])

    verdict = diagnose(session(poses=60, seed=3, noise=NOISE, markers=THREE_MARKERS, moved=behind)).verdict
    assert set(verdict.effects) == {"joint_torsion", name}, verdict.text


def test_where_an_arm_gives_way_by_its_gears_no_links_are_named_in_their_place() -> None:
    q = np.zeros((80, 6))
    q[:, :2] = np.random.default_rng(3).uniform(-1.3, 1.3, (80, 2))
    q += np.random.default_rng(4).uniform(-0.1, 0.1, q.shape)
    verdict = diagnose(session(q=q, noise=NOISE, moved=SOFT)).verdict
    assert verdict.effects == ("joint_torsion",) or verdict.one_of[0][0] == "joint_torsion", verdict.text
    assert "link_bending" not in verdict.effects


@given(exponent=st.floats(-6.0, 6.0), seed=st.integers(0, 100))
def test_evidence_does_not_change_with_the_unit_of_a_column(exponent: float, seed: int) -> None:
    rng, scale = np.random.default_rng(seed), 10.0**exponent
    A, b = rng.normal(size=(60, 5)), rng.normal(size=60)
    free = np.full(5, np.inf)
    width = np.array([np.inf, np.inf, np.inf, 2.0, 3.0])
    bench = Bench(b, np.repeat(np.arange(20), 3))
    unit = np.array([1.0, 1.0, 1.0, 1.0, scale])
    same, other = (bench.posterior(Block(A * u, -free, free, width / u)).log_evidence for u in (np.ones(5), unit))
    assert same == pytest.approx(other, abs=1e-5)
