# SPDX-License-Identifier: Apache-2.0
"""A session read without its tracker: what it recovers, what it leaves open, what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.cli import main
from irec_calibration.diagnose.where import views
from irec_calibration.effects import find_effect
from irec_calibration.effects.live import LeftOut
from irec_calibration.effects.of_session import scene_of
from irec_calibration.errors import SessionError, SolveError
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model.file import load_model
from irec_calibration.session import ExternalAxis, Session, read_session, write_table
from irec_calibration.session.without_tracker import without_tracker
from synthetic import COMPLIANCE, TRANSVERSE, session, urdf

from irec_calibration import diagnose

DISC = np.array([6.7e-7, 6.7e-7, 2.5e-7])  # m/N in tool0
CASES = ((0, 0, -1100), (280, 0, -1100), (-280, 0, -1100), (0, -280, -1100), (0, 280, -1100))
TRUTH = {f"joint_torsion.c_{k + 1}": c for k, c in enumerate(COMPLIANCE)}
TRUTH |= {f"link_bending.c_{k // 2 + 1}{'ab'[k % 2]}": c for k, c in enumerate(TRANSVERSE)}
TRUTH |= {"disc_compliance.c_normal": DISC[2], "disc_compliance.c_lateral": DISC[0]}


def bend(kin, force: np.ndarray) -> np.ndarray:
    """Deflection of the TCP of the true arm, (n, 3), m; written out on purpose, without the effects under test."""
    u = np.zeros_like(force)
    for k in range(6):
        arm = kin.p_tcp - kin.origin[:, k]
        for axis, c in [(kin.axis[:, k], COMPLIANCE[k])] + [(kin.virtual_axis[:, k, v], TRANSVERSE[2 * k + v]) for v in (0, 1)]:
            torque = np.einsum("ni,ni->n", axis, np.cross(arm, force))
            u += c * torque[:, None] * np.cross(axis, arm)
    return u


def pressed(
    poses: int = 31, cases=CASES, encoder: float = 0.0, slip: float = 0.0, spread: float = 0.0, seed: int = 0, gap: float = 0.0
) -> Session:
    """Force control holds the disc on a rigid tooling: joint angles follow until arm and disc have given way.

    Args:
        encoder: noise, rad; slip: along the surface, m; spread: by which forces miss the set point, N: one standard deviation.
        gap: play of axis 1, rad, that opens within 20 N m.
    """
    rng = np.random.default_rng([seed, 1])
    made = session(poses, seed)
    j = made.load_case
    force = np.array([(0, 0, 0), *cases], dtype=float)[j] + np.where(j[:, None] > 0, rng.normal(0.0, spread, (len(j), 3)), 0.0)
    first = np.repeat(made.q[j == 0], len(cases) + 1, axis=0)
    kin = made.robot.kinematics(first)
    stands = kin.p_tcp + np.where(j[:, None] > 0, 0.003 * kin.R_tool[:, :, 2], 0.0)  # a reference of 3 mm off
    slipped = rng.normal(0.0, slip, (len(j), 3)) * np.array([1.0, 1.0, 0.0]) * (j[:, None] > 0)
    q = first
    for _ in range(6):
        kin = made.robot.kinematics(q)
        f = np.einsum("nij,nj->ni", kin.R_tool, force)
        goal = stands + np.einsum("nij,nj->ni", kin.R_tool, slipped - DISC * force)
        whole = np.concatenate([kin.jacobian(kin.p_tcp), kin.axis.swapaxes(1, 2)], axis=1)
        turned = 0.5 * gap * np.tanh(np.einsum("ni,ni->n", kin.jacobian(kin.p_tcp)[:, :, 0], f) / 20.0)
        play = kin.jacobian(kin.p_tcp)[:, :, 0] * turned[:, None]
        step = np.concatenate([goal - kin.p_tcp - bend(kin, f) - play, np.zeros_like(f)], axis=1)
        q = q + np.linalg.solve(whole, step[:, :, None])[..., 0]
    q = q + rng.normal(0.0, encoder, q.shape)
    nowhere = np.full((len(q), 3), np.nan)
    return replace(made, q=q, p_tcp_in_base=made.robot.kinematics(q).p_tcp, force_in_tool=force, p_marker_in_station=nowhere)


def apart(model, where: Session) -> tuple[np.ndarray, np.ndarray]:
    """What a model predicts and what is true under load, both (m, 3), m in tool0."""
    scene = scene_of(where, observe="tcp")
    loaded = where.load_case > 0
    both = np.stack([model.predict(scene), bend(scene.kin, scene.force)])[:, loaded]
    return tuple(np.einsum("nji,anj->ani", scene.kin.R_tool[loaded], both))


def test_deflection_under_the_normal_force_is_foretold_without_any_reading_of_a_tracker():
    held = without_tracker(pressed(encoder=2e-6, slip=1e-4, spread=3.0))
    model, _ = diagnose.solved(held, default_terms(held))
    assert "disc_compliance" in model.effects
    other = pressed(20, cases=(CASES[0],) * 5, seed=5)
    predicted, true = apart(model, other)
    size = np.linalg.norm(true, axis=1).mean()
    assert size > 4e-4
    assert np.linalg.norm(predicted - true, axis=1).mean() < 0.1 * size


@pytest.mark.parametrize("last", [(0, 280, -1100), (0, 0, -300)])
def test_what_is_told_to_be_known_holds_the_truth_and_the_disc_is_not_told_from_the_wrist(last):
    held = without_tracker(pressed(cases=(*CASES[:4], last), encoder=2e-6, spread=3.0), slip_m=6e-6)
    fit = identify(held, default_terms(held))
    found = {f"{t.effect.id}.{n}": e for t in fit.terms for n, e in t.estimates.items()}
    assert ("disc_compliance.c_normal" in found) == (last[2] == -300)
    for name, e in found.items():
        assert not np.isfinite(e.se) or abs(e.value - TRUTH[name]) < 4.0 * e.se, name
    for c in fit.combinations:
        assert abs(c.value - sum(w * TRUTH[n] for n, w in c.weights.items())) < 4.0 * c.se, str(c)
    assert not found["disc_compliance.c_lateral"].identified


def test_where_the_normal_force_stays_the_disc_has_a_lateral_compliance_only():
    held = without_tracker(pressed(6, spread=3.0))
    assert [p.name for p in find_effect("disc_compliance").parameters(scene_of(held))] == ["c_lateral"]


def test_a_disc_that_slips_by_a_millimetre_hardly_changes_what_is_foretold_under_the_normal_force():
    other = pressed(10, cases=(CASES[0],) * 5, seed=5)
    found = []
    for slip in (0.0, 1e-3):
        held = without_tracker(pressed(encoder=2e-6, slip=slip), slip_m=max(slip, 1e-4))
        found.append(apart(diagnose.solved(held, default_terms(held))[0], other)[0])
    assert np.linalg.norm(found[1] - found[0], axis=1).mean() < 0.1 * np.linalg.norm(found[0], axis=1).mean()


def test_the_disc_is_no_part_of_predictions_and_of_the_live_correction():
    held = without_tracker(pressed(12, encoder=2e-6))
    model, _ = diagnose.solved(held, default_terms(held))
    scene = scene_of(session(4, seed=3), observe="tcp")
    without = replace(model, terms=model.terms[:-1])
    assert model.terms[-1].estimates["c_lateral"].value > 0.0
    np.testing.assert_array_equal(model.predict(scene), without.predict(scene))
    assert isinstance(find_effect("disc_compliance").no_live_form(), LeftOut)


def test_a_session_with_a_tracker_has_no_disc():
    assert find_effect("disc_compliance").parameters(scene_of(session(4))) == ()
    assert [t.effect.id for t in default_terms(session(4))] == list(EIGHTEEN_DOF)


def test_poses_with_one_load_case_in_contact_are_left_out_and_named():
    made = pressed(6)
    few = made.select((made.pose != 3) | (made.load_case < 2))
    held = without_tracker(few)
    assert 3 not in held.poses and len(held.poses) == 5
    assert any("1 poses left out" in n for n in held.notes)


def commanded(made: Session) -> Session:
    """Joint angles as they were asked for: the same under every load."""
    first = np.flatnonzero(made.load_case == 1)[np.searchsorted(made.poses, made.pose)]
    return replace(made, q=made.q[first], p_tcp_in_base=made.p_tcp_in_base[first])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: replace(s, kind="absolute"), "kind is absolute"),
        (without_tracker, "without its tracker already"),
        (lambda s: replace(s, force_in_tool=-s.force_in_tool), "no loaded row in contact"),
        (commanded, "joint angles seem to be commanded ones"),
        (lambda s: s.select(s.load_case < 2), "0 poses have two load cases in contact"),
        (
            lambda s: replace(s, ext={"rail": 1e-3 * s.load_case}, ext_axes=(ExternalAxis("rail", "prismatic", (0, 1, 0)),)),
            "ext_rail moves by 0.004 within pose 1",
        ),
    ],
)
def test_what_can_not_be_read_without_a_tracker_is_refused_with_the_reason(change, said):
    with pytest.raises(SessionError, match=said):
        without_tracker(change(pressed(4)))


@pytest.mark.parametrize("numbers", [(0.0, 2e-6), (2.0, 2e-6), (1e-4, 0.0), (1e-4, 1.0), (float("nan"), 2e-6)])
def test_slip_and_noise_of_encoders_have_limits(numbers):
    with pytest.raises(SessionError, match="are allowed"):
        without_tracker(pressed(4), *numbers)


def test_the_command_reads_a_session_in_which_no_marker_was_measured_at_all(tmp_path, capsys):
    made = pressed(12, encoder=2e-6, spread=3.0)
    (tmp_path / "robot.urdf").write_text(urdf())
    folder = write_table(made, tmp_path / "table")
    assert not read_session(folder).marker_seen.any()
    assert main(["solve", str(folder), "--without-tracker", "-o", str(tmp_path / "m.yaml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["effects"] == [*EIGHTEEN_DOF, "disc_compliance"]
    model = load_model(tmp_path / "m.yaml")
    predicted, true = apart(model, pressed(10, cases=(CASES[0],) * 5, seed=5))
    assert np.linalg.norm(predicted - true, axis=1).mean() < 0.2 * np.linalg.norm(true, axis=1).mean()
    assert main(["solve", str(folder), "-o", str(tmp_path / "n.yaml")]) == 2
    assert "--without-tracker" in capsys.readouterr().err


def test_what_a_broken_tracker_says_is_not_judged(tmp_path):
    made = pressed(12, encoder=2e-6)
    stuck = replace(made, p_marker_in_station=np.full((len(made), 3), 1000.0))
    folder = write_table(stuck, tmp_path / "table")
    assert main(["solve", str(folder), "-o", str(tmp_path / "m.yaml")]) == 2
    assert main(["solve", str(folder), "--without-tracker", "-o", str(tmp_path / "m.yaml")]) == 0
    assert load_model(tmp_path / "m.yaml").made["without_tracker"] is True


@pytest.mark.parametrize("option", [["--slip", "1e-3"], ["--disc", "4e6", "1.5e6"]])
def test_options_of_the_disc_without_it_are_refused(option, tmp_path, capsys):
    folder = write_table(pressed(4), tmp_path / "table")
    assert main(["solve", str(folder), *option, "-o", str(tmp_path / "m.yaml")]) == 2
    assert "give both or none" in capsys.readouterr().err


def test_the_command_says_why_it_can_not(tmp_path, capsys):
    folder = write_table(commanded(pressed(6)), tmp_path / "table")
    assert main(["solve", str(folder), "--without-tracker", "-o", str(tmp_path / "m.yaml")]) == 2
    assert "joint angles seem to be commanded ones" in capsys.readouterr().err
    assert not (tmp_path / "m.yaml").exists()


def test_a_disc_that_was_measured_before_lets_the_deflection_across_be_foretold_too():
    made, other = pressed(encoder=2e-6, slip=2e-5, spread=3.0), pressed(20, seed=5)
    sideways = np.hypot(*other.force_in_tool[other.load_case > 0, :2].T) > 100.0
    wrong = []
    for disc in (None, (1.0 / DISC[2], 1.0 / DISC[0])):
        held = without_tracker(made, slip_m=2e-5, disc=disc)
        model = diagnose.solved(held, default_terms(held))[0]
        predicted, true = apart(model, other)
        wrong.append(np.linalg.norm((predicted - true)[sideways, :2], axis=1).mean())
    assert model.effects == EIGHTEEN_DOF
    assert wrong[1] < 0.5 * wrong[0] and wrong[1] < 2e-5


@pytest.mark.parametrize("disc", [(4e6, 0.0), (4e-7, 1.5e6), (4e6, float("nan"))])
def test_the_stiffness_of_a_disc_is_one(disc):
    with pytest.raises(SessionError, match="N/m are allowed"):
        without_tracker(pressed(4), disc=disc)


@pytest.mark.parametrize(("effect", "said"), [("tracker_scale", "no tracker measured"), ("creep", "was before is not known")])
def test_effects_that_need_a_tracker_or_a_relaxed_reference_are_refused(effect, said):
    held = without_tracker(pressed(6))
    with pytest.raises(SolveError, match=said):
        identify(held, blank_model([*EIGHTEEN_DOF, effect, "disc_compliance"]))


@pytest.mark.long
def test_improve_finds_the_play_of_a_gear_without_a_tracker(tmp_path, capsys):
    folder = write_table(pressed(encoder=2e-6, slip=1e-4, spread=3.0, gap=2e-4), tmp_path / "table")
    assert main(["improve", str(folder), "--without-tracker", "-o", str(tmp_path / "improved")]) == 0
    model = load_model(tmp_path / "improved" / "model.yaml")
    assert set(model.effects) >= {"disc_compliance", "joint_backlash"}
    play = next(t for t in model.terms if t.effect.id == "joint_backlash").estimates["b_1"]
    assert abs(play.value - 2e-4) < 0.15 * 2e-4
    assert "--without-tracker --model" in capsys.readouterr().out


def test_no_residual_is_said_to_be_along_a_displacement_of_a_point_that_stays():
    held = without_tracker(pressed(12, encoder=2e-6, gap=2e-4))
    fit = identify(held, default_terms(held))
    predicted = fit.observation.y - fit.residual
    names = {v.view for v in views(fit.observation, fit.residual, predicted)}
    assert "base frame" in names and not {n for n in names if n.endswith("displacement")}
