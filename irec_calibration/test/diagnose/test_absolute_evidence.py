# SPDX-License-Identifier: Apache-2.0
"""What evidence rests on in absolute sessions, which start without springs: small signals beside far larger ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from absolute_sessions import session, torsion
from irec_calibration.diagnose import diagnose, start_terms
from irec_calibration.diagnose.evidence import Ground
from irec_calibration.diagnose.explanation import Explanation, own_forms
from irec_calibration.diagnose.level import family_in_view
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
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
    theta = np.array([0.0, 0.0, 0.0, 8e-6, 8e-6, 0.0, 0.0])  # 2 mrad under its own weight
    return np.asarray(SOFT(s, p) + effect.regressor(scene_of(s), theta) @ theta)


def seen_at_wrong_angles(s: Session, p: Array) -> Array:
    """An encoder of the tracker that sits beside its axis: 40 urad, three times per turn."""
    v = p - np.asarray(s.stations[0].xyz)
    return np.asarray(SOFT(s, p) + 4e-5 * np.sin(3.0 * np.arctan2(v[:, 1], v[:, 0]))[:, None] * np.cross([0.0, 0.0, 1.0], v))


def settles_slowly(s: Session, p: Array) -> Array:
    step = np.diff(s.q[:, 2], prepend=s.q[0, 2])
    return np.asarray(SOFT(s, p) + 1.5e-4 * step[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 2])


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


def test_a_reflector_that_is_seated_anew_stands_out_of_what_the_springs_leave() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=seated_anew)).verdict
    assert "joint_torsion" in verdict.effects
    assert "the reflector seated anew at pose 71," in verdict.text


def test_the_pedestal_of_a_light_robot_may_be_as_soft_as_that_robot_is_light() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=on_a_soft_pedestal)).verdict
    assert set(verdict.effects) == {"base_compliance", "joint_torsion"}, verdict.text


def test_what_the_instrument_reads_wrongly_is_told_by_where_it_looks_and_passes_for_no_error_of_joint_angles() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=seen_at_wrong_angles)).verdict
    assert "encoder_harmonics" not in verdict.effects
    assert verdict.remaining_m > 1e-5 and "marker_x" in verdict.depends_on, verdict.text


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


def test_the_general_law_of_an_axis_own_angle_is_no_rival_of_the_harmonics_of_its_encoder() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=read_by_an_eccentric_encoder)).verdict
    assert set(verdict.effects) == {"encoder_harmonics", "joint_torsion"}, verdict.text


def test_what_harmonics_do_not_explain_of_an_encoder_is_said() -> None:
    verdict = diagnose(session(poses=80, noise=NOISE, moved=read_by_a_chipped_encoder)).verdict
    assert verdict.remaining_m > 1e-5 and "joint_1" in verdict.depends_on, verdict.text
