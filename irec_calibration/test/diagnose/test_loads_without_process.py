# SPDX-License-Identifier: Apache-2.0
"""What an absolute session shows of a soft tool, of hoses and of gears that ripple: no process acts there, but weights do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from absolute_sessions import session, torsion
from irec_calibration.diagnose import diagnose, improve
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.robot import Payload
from irec_calibration.session import Noise, Session
from irec_calibration.typing import Array

NOISE = Noise(tracker_m=1e-5)
C = np.array([4e-6, 8e-6, 1.2e-5, 1e-5, 1e-5, 1e-5])
SOFT = torsion(C)
PULL = np.array([25.0, -18.0, 6.0])  # N, in base_link
FULL = Payload(12.0, (0.02, -0.03, 0.12))  # kg, m in tool0


def loaded_by(payload: Payload, moved, **more) -> Session:  # type: ignore[no-untyped-def]
    """A session of an arm that really carries a payload."""
    return session(poses=90, noise=NOISE, moved=lambda s, p: moved(replace(s, payload=payload), p), **more)


def bends_its_tool(s: Session, p: Array) -> Array:
    kin = s.robot.kinematics(s.q)
    weight = s.payload.mass * np.einsum("nji,j->ni", kin.R_tool, s.gravity_in_base)
    turn = np.array([3e-5, 2e-5, 0.0]) * np.cross(s.payload.com, weight)
    beyond = np.einsum("nji,nj->ni", kin.R_tool, p - kin.p_tcp)
    bent = np.array([4e-7, 2e-7, 1e-7]) * weight + np.cross(turn, beyond)
    return np.asarray(SOFT(s, p) + np.einsum("nij,nj->ni", kin.R_tool, bent))


def bends_at_its_flange(s: Session, p: Array) -> Array:
    """A tool changer that gives way, 0.7 of the way from tool0 to the last joint."""
    kin = s.robot.kinematics(s.q)
    weight = s.payload.mass * np.asarray(s.gravity_in_base)
    changer = kin.p_tcp + 0.7 * (kin.origin[:, -1] - kin.p_tcp)
    moment = np.cross(kin.p_tcp + kin.R_tool @ np.array(s.payload.com) - changer, weight)
    turn = np.einsum("nij,nj->ni", kin.R_tool, np.array([4e-5, 2e-5, 1e-5]) * np.einsum("nji,nj->ni", kin.R_tool, moment))
    return np.asarray(SOFT(s, p) + np.cross(turn, p - changer))


def pulled_at_the_tool(s: Session, p: Array) -> Array:
    kin = s.robot.kinematics(s.q)
    J = kin.jacobian(kin.p_tcp)
    return np.asarray(SOFT(s, p) + np.einsum("nik,nk->ni", kin.jacobian(p), np.einsum("njk,j->nk", J, PULL) * C))


def ripples_eleven_times(s: Session, p: Array) -> Array:
    turned = 8e-5 * np.sin(11.0 * s.q[:, 2] + 0.4)
    return np.asarray(SOFT(s, p) + turned[:, None] * s.robot.kinematics(s.q).jacobian(p)[:, :, 2])


def test_the_weight_of_the_payload_bends_a_soft_tool() -> None:
    made = replace(session(poses=4, noise=NOISE), payload=FULL)
    scene, effect = scene_of(made), find_effect("tool_compliance")
    values = {"c_x": 4e-7, "c_y": 2e-7, "c_z": 1e-7, "r_x": 3e-5, "r_y": 2e-5}
    theta = np.array([values.get(p.name, 0.0) for p in effect.parameters(scene)])
    np.testing.assert_allclose(
        effect.displacement(scene, theta), bends_its_tool(made, scene.p_observed) - SOFT(made, scene.p_observed), atol=1e-12
    )


def test_a_tool_may_be_soft_at_its_flange() -> None:
    made = replace(session(poses=4, noise=NOISE), payload=FULL)
    scene, effect = scene_of(made), find_effect("tool_compliance")
    values = {"r_x": 4e-5, "r_y": 2e-5, "r_z": 1e-5, "back": 0.7}
    theta = np.array([values.get(p.name, 0.0) for p in effect.parameters(scene)])
    np.testing.assert_allclose(
        effect.displacement(scene, theta), bends_at_its_flange(made, scene.p_observed) - SOFT(made, scene.p_observed), atol=1e-12
    )


def test_a_tool_that_is_soft_at_its_flange_is_no_link_that_bends() -> None:
    """Both turn what is mounted about places that are some centimetres apart: the link may be named beside the tool only."""
    verdict = diagnose(replace(loaded_by(FULL, bends_at_its_flange), payload=FULL)).verdict
    assert "tool_compliance" in (*verdict.effects, *(i for s in verdict.one_of for i in s)), verdict.text
    assert "link_bending" not in verdict.effects, verdict.text


def test_a_soft_tool_under_its_payload_is_named() -> None:
    verdict = diagnose(replace(loaded_by(FULL, bends_its_tool), payload=FULL)).verdict
    assert set(verdict.effects) == {"joint_torsion", "tool_compliance"}, verdict.text


def test_a_hose_that_pulls_is_named_and_shows_springs_that_the_weight_does_not() -> None:
    told = improve(session(poses=90, noise=NOISE, moved=pulled_at_the_tool))
    assert set(told.before.verdict.effects) == {"joint_torsion", "external_force"}, told.before.verdict.text
    # the table of candidates begins with what is named, a hose too, which moves nothing without springs
    assert [c.effect for c in told.before.candidates[:2]] == list(told.before.verdict.effects)
    found = {n: e for t in told.rungs[-1].model.terms for n, e in t.estimates.items()}
    # the first axis is vertical: no weight turns it
    assert found["c_1"].value == pytest.approx(C[0], rel=0.15)
    assert [found[f"f_{a}"].value for a in "xyz"] == pytest.approx(PULL, abs=4.0)


def test_a_payload_of_another_mass_is_no_hose() -> None:
    verdict = diagnose(loaded_by(Payload(9.0), SOFT)).verdict  # the session states 5 kg
    assert "external_force" not in verdict.effects, verdict.text


def test_a_constant_force_along_gravity_is_refused_with_the_mass_that_it_stands_for() -> None:
    scene, effect = scene_of(session(poses=3)), find_effect("external_force")
    down = {"f_x": (0.1, 1.0), "f_y": (-0.2, 1.0), "f_z": (-19.62, 1.0)}
    assert "payload that is +2 kg from" in effect.why_impossible(down, {}, scene)
    assert not effect.why_impossible(down | {"f_x": (9.0, 1.0)}, {}, scene)
    on_forearm = {f"{n}_wrist": v for n, v in down.items()}
    assert "a forearm that is +2 kg" in effect.why_impossible(on_forearm, {}, scene)
    assert not effect.why_impossible(on_forearm | {"k_wrist": (20.0, 1.0)}, {}, scene)
    beside = {"m_x_tool": (0.0, 0.1), "m_y_tool": (1.5, 0.1), "m_z_tool": (0.0, 0.1)}
    assert "payload that is +2 kg from" in effect.why_impossible(down | beside, {}, scene)
    assert not effect.why_impossible(down | beside | {"m_x_tool": (6.0, 0.1)}, {}, scene)
    both = effect.why_impossible(down | on_forearm, {}, scene)
    assert "payload that is +2 kg from" in both and "a forearm that is +2 kg" in both


@pytest.fixture(scope="module")
def rippled():
    return improve(session(poses=120, noise=NOISE, moved=ripples_eleven_times))


def test_what_repeats_many_times_per_turn_is_no_noise_and_has_no_name(rippled) -> None:
    verdict = rippled.before.verdict
    assert verdict.effects == ("joint_torsion",) and verdict.depends_on[0] == "joint_3", verdict.text
    assert verdict.remaining_m > 2e-5
    assert "11 times per turn of axis 3" in verdict.text
    assert rippled.before.noise.inferred_m < 1.3 * rippled.before.noise.claimed_m


def test_it_stands_in_for_itself_and_the_error_on_held_out_poses_falls(rippled) -> None:
    ripple = next(r for r in rippled.rungs if r.added == "joint_ripple")
    before = rippled.rungs[rippled.rungs.index(ripple) - 1]
    assert not ripple.named
    assert ripple.cv_rms_m < 0.6 * before.cv_rms_m


def test_a_formula_for_it_is_proposed(rippled) -> None:
    assert rippled.before.proposals[0].formula == "axis 3: a * cos(11 * q_3) + b * sin(11 * q_3)"


def test_a_ripple_that_turns_a_joint_further_than_gears_and_encoders_do_can_not_be() -> None:
    scene, effect = scene_of(session(poses=20)), find_effect("joint_ripple")
    names = [p.name for p in effect.parameters(scene)]

    def too_far(**values: float) -> set[int]:
        return effect.too_far(scene, np.array([values.get(n, 0.0) for n in names]))

    assert too_far(a11_3=3e-4, b12_3=3e-4) == set()
    assert too_far(a11_3=3e-3, b12_4=3e-4) == {2}


def test_where_nothing_ripples_nothing_is_said_of_it() -> None:
    found = improve(session(poses=120, noise=NOISE, moved=SOFT))
    assert "per turn" not in found.before.verdict.text
    assert "joint_ripple" not in found.rungs[-1].effects


def test_what_a_balancer_carries_of_the_weight_shows_in_absolute_sessions_as_an_encoder_would() -> None:
    scene = scene_of(session(poses=6))
    balancer, encoder = find_effect("counterbalance"), find_effect("encoder_harmonics")
    own, other = balancer.parameters(scene), encoder.parameters(scene)
    carried = np.array([{"p_a": 2e-4, "p_b_twice": 1e-4}.get(p.name, 0.0) for p in own])
    wrong = np.array([{"a1_2": 2e-4, "b2_2": 1e-4}.get(p.name, 0.0) for p in other])
    np.testing.assert_allclose(balancer.displacement(scene, carried), encoder.displacement(scene, wrong), atol=1e-15)
    # a light arm has none
    assert balancer.log_odds(scene) < -4.0 and balancer.rather({}, {}, scene) == "encoder_harmonics"


@pytest.mark.parametrize(("stiffness", "also"), [(0.0, "encoder_harmonics"), (1e-7, "")])
def test_a_balancer_that_changes_no_compliance_may_be_an_encoder(stiffness: float, also: str) -> None:
    scene, balancer = scene_of(session(poses=6)), find_effect("counterbalance")
    values = {"a": stiffness, "p_a": 2e-4}
    theta = np.array([values.get(p.name, 0.0) for p in balancer.parameters(scene)])
    errors = np.full(len(theta), 1e-8)
    assert balancer.also_called(scene, theta, errors) == also
    in_differences = scene_of(synthetic.session(poses=2))
    assert balancer.also_called(in_differences, theta, errors) == "" and balancer.rather({}, {}, in_differences) == ""
