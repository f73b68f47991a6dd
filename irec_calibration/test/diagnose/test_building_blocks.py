# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis is built of, each piece by itself: steps that last, shapes found again, remainders grown from products."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import start_terms, tries
from irec_calibration.diagnose.candidates import options, try_option
from irec_calibration.diagnose.evidence import Block
from irec_calibration.diagnose.explanation import Explanation, explain, implausible, own_forms, without
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.forms import forms_of, has_form_of
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.held_out import held_out, held_out_beside, only_good_poses
from irec_calibration.diagnose.lasting import lasts
from irec_calibration.diagnose.parts import without_columns
from irec_calibration.diagnose.remainder import Part, grow
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.shape import reshaped
from irec_calibration.diagnose.study import Study, prepare, study_of
from irec_calibration.diagnose.tries import laws_by_themselves
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.validation import gain
from irec_calibration.model import Estimate, Term, whole_sag_of
from irec_calibration.session import Session
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = np.array([2e-4, -1e-4, 1e-4])
HIT = 8  # pose at which something happens, between its reference and its load cases
MOMENT = 4.0 * 6 * (HIT - 1) + 2.0  # s; rows are 4 s apart


def station_is_bumped(scene: Scene) -> Array:
    return (scene.stamp > MOMENT)[:, None] * STEP


def station_is_bumped_and_tilts(scene: Scene) -> Array:
    lever = scene.p_observed - scene.p_observed[scene.pose == HIT][0]
    return (scene.stamp > MOMENT)[:, None] * (STEP + np.cross([1.5e-3, -1e-3, 1e-3], lever))


def reference_is_knocked(scene: Scene) -> Array:
    return ((scene.pose == HIT) & (scene.load_case == 0))[:, None] * -STEP


def reflector_is_knocked(scene: Scene) -> Array:
    """Between two load cases: half of the pose moves."""
    return ((scene.pose == HIT) & (scene.load_case > 2))[:, None] * STEP


def reflector_is_seated_anew(scene: Scene) -> Array:
    return (scene.stamp > MOMENT)[:, None] * (scene.kin.R_tool @ STEP)


def play_of_axis_4(scene: Scene) -> Array:
    angle = np.zeros_like(scene.tau)
    angle[:, 3] = 2e-4 * np.tanh((scene.tau[:, 3] + scene.tau_gravity[:, 3]) / 4.0)
    return np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), angle)


@cache
def study(hidden: Callable[[Scene], Array] | None = None) -> Study:
    measured = synthetic.session(poses=20, seed=5, extra=hidden)
    return prepare(measured, start_terms(measured)).to_weigh


ROUGHLY_PLACED = (station_is_bumped, reference_is_knocked)


def prepared_from(measured: Session, beside: Array) -> Study:
    """A session whose marker is read elsewhere, (3,) or (n, 3), m in the station's frame."""
    read = replace(measured, p_marker_in_station=measured.p_marker_in_station + beside)
    return prepare(read, start_terms(read)).to_weigh


def shift(size: Array) -> Term:
    values = dict(zip(("d_x", "d_y", "d_z"), size, strict=True)) | {"t_shift": MOMENT}
    return Term(find_effect("station_shift"), {n: Estimate(float(v)) for n, v in values.items()})


def test_a_bumped_station_shows_in_all_later_readings() -> None:
    assert lasts(study(station_is_bumped), shift(STEP)) > 6.5


def test_a_bumped_station_is_recognised_though_it_tilts() -> None:
    assert lasts(study(station_is_bumped_and_tilts), shift(STEP)) > 20.0


def test_wherever_the_station_stands_a_bump_shows_in_later_readings_and_a_knocked_reference_in_none() -> None:
    elsewhere = np.array([0.03, -0.02, 0.01])
    bumped, knocked = (prepared_from(synthetic.session(poses=20, seed=5, extra=e), elsewhere) for e in ROUGHLY_PLACED)
    assert lasts(bumped, shift(STEP)) > 6.5
    assert lasts(knocked, shift(STEP)) < 0.0


def test_wherever_the_marker_sits_on_the_tool_a_bump_shows_in_later_readings() -> None:
    """A marker 4 cm beside where the session states it had hidden a step of 2.7 mm of another simulator."""
    drawn = synthetic.session(poses=20, seed=5, extra=station_is_bumped)
    beside = scene_of(drawn).kin.R_tool @ np.array([0.025, -0.02, 0.015]) @ drawn.stations[0].R_in_base
    assert lasts(prepared_from(drawn, beside), shift(STEP)) > 6.5


@pytest.mark.parametrize("drift", [0.0, -6e-4, 6e-4])
def test_a_bump_shows_in_later_readings_while_the_station_drifts(drift: float) -> None:
    """By 0.6 mm over the session, which has no name yet: later readings had been against the step."""
    drawn = synthetic.session(poses=20, seed=5, extra=station_is_bumped)
    course = drawn.stamp / drawn.stamp.max()
    along = STEP / np.linalg.norm(STEP) @ drawn.stations[0].R_in_base
    assert lasts(prepared_from(drawn, drift * course[:, None] * along), shift(STEP)) > 6.5


@pytest.mark.parametrize("sags", [0.0, 1.0])
def test_a_bump_shows_in_later_readings_of_a_soft_arm_whether_or_not_its_controller_commands_the_sag_away(sags: float) -> None:
    """The weight of another simulator's arm turned joints by a milliradian, and a bump of half a millimetre was none."""
    soft = 5.0 * synthetic.COMPLIANCE
    drawn = synthetic.session(poses=20, seed=5, extra=station_is_bumped, compliance=soft)
    plain = prepared_from(drawn, np.zeros(3))
    at_references = whole_sag_of(plain.terms, plain.ready)[plain.ready.reference]
    sag = at_references @ drawn.stations[0].R_in_base
    assert np.ptp(sag, axis=0).max() > 5e-4
    assert lasts(prepared_from(drawn, sags * sag), shift(STEP)) > 6.5


@pytest.mark.long
def test_poses_that_were_measured_twice_tell_of_a_step_where_robots_are_less_accurate_than_it_is_large() -> None:
    """Every pose is a millimetre beside where the controller believes it, the same each time."""
    q = np.random.default_rng(11).uniform(*synthetic.JOINTS, (12, 6))
    drawn = synthetic.session(poses=24, seed=5, extra=station_is_bumped, q_of_poses=np.concatenate([q, q]))
    beside = np.random.default_rng(3).normal(0.0, 1e-3, (12, 3))[(drawn.pose - 1) % 12]
    twice = replace(drawn, pose=(drawn.pose - 1) % 12 + 1, repeat=(drawn.pose - 1) // 12)
    assert lasts(prepared_from(twice, beside), shift(STEP)) > 6.5
    assert lasts(prepared_from(drawn, beside), shift(STEP)) < 6.5


@pytest.mark.parametrize("accident", [reference_is_knocked, reflector_is_seated_anew])
def test_a_knocked_reference_or_reflector_is_no_bumped_station(accident: Callable[[Scene], Array]) -> None:
    found = study(accident)
    moved = STEP
    if accident is reflector_is_seated_anew:
        moved = found.ready.kin.R_tool[np.flatnonzero(found.ready.pose == HIT)[0]] @ STEP
    assert lasts(found, shift(moved)) < 0.0


def test_a_step_in_the_last_pose_is_not_known_to_last() -> None:
    late = Term(find_effect("station_shift"), shift(STEP).estimates | {"t_shift": Estimate(4.0 * 6 * 19 + 2.0)})
    assert lasts(study(), late) == 0.0


def test_a_shape_is_found_again_where_it_was_wrong() -> None:
    plain = study(play_of_axis_4)
    wrong = Term(find_effect("joint_backlash"), {"b_4": Estimate(1e-4, lower=0.0), "w": Estimate(0.03, lower=1e-4, upper=0.03)})
    before = study_of(plain.observation, (*plain.terms, wrong))
    after = reshaped(before, ("joint_backlash",))
    width = after.terms[-1].estimates["w"].value
    assert width < 0.02
    assert after.bench.posterior(after.base).log_evidence > before.bench.posterior(before.base).log_evidence


@pytest.mark.parametrize(("se", "alone", "can_be"), [(0.004, True, True), (0.002, True, False), (0.004, False, False)])
def test_a_value_that_may_lie_within_what_is_likely_is_not_beyond_it(se: float, alone: bool, can_be: bool) -> None:
    found = study()
    high = find_effect("creep").parameters(found.ready)[0].plausible_range[1]
    term = Term(find_effect("creep"), {"share": Estimate(high + 0.006, se, identified=alone)})
    one = Explanation((term,), found, 0.0, grow(found.bench, family_of(found), found.base))
    assert (implausible(one, "creep") == "") == can_be


def law(effect: str, axes: tuple[int, ...], **values: float) -> Term:
    name = {"joint_backlash": "b", "joint_stiffening": "a", "joint_hysteresis": "h"}[effect]
    known = {f"{name}_{k}": Estimate(0.0) for k in axes} | {n: Estimate(v) for n, v in values.items()}
    return Term(find_effect(effect), known)


def test_two_laws_bend_one_curve_where_they_share_an_axis_and_friction_bends_none() -> None:
    found = study()
    added = (
        law("joint_backlash", (2, 4), w=1e-3), law("joint_stiffening", (4, 5), x_0=0.1, slow=0.0),
        law("joint_hysteresis", (1, 2, 3, 4, 5, 6), r=0.03),
    )  # fmt: skip
    one = Explanation(added, found, 0.0, grow(found.bench, family_of(found), found.base))
    # the general law of axis 4 is a rival of both, since either may only mend the other's form
    assert own_forms(one, "joint_backlash").axes == {1}
    assert own_forms(one, "joint_stiffening").axes == {4}
    assert own_forms(one, "joint_hysteresis").axes == {0, 1, 2, 3, 4, 5}


def test_a_compliance_that_goes_with_its_own_angle_is_a_form_of_a_balancer_and_of_no_gear() -> None:
    found = study()
    structures = [s for s in family_of(found).structures if s.softer_by_angle is not None]
    assert {s.softer_by_angle for s in structures} == set(range(6))
    assert any("over its turn" in s.words for s in structures) and any("over its turn" not in s.words for s in structures)
    balancer = Term(find_effect("counterbalance"), {"a": Estimate(1e-8), "b": Estimate(0.0)})
    by_balancer, by_gear = (forms_of(t, found.ready) for t in (balancer, law("joint_stiffening", (2,), x_0=0.1, slow=0.0)))
    for s in structures:
        assert by_balancer.has(s) == (s.softer_by_angle == 1)
        assert not by_gear.has(s)


def test_what_turns_all_axes_by_what_is_one_axis_own_has_that_axis_law_in_it() -> None:
    """Each axis by itself is a structure of its own, so nothing that has none of that law in it goes unasked."""
    found = study()
    of_all = [s for s in family_of(found).structures if s.words in ("turning the axes", "as compliance of the axes")]
    by_torque, by_angle = ([s for s in of_all if s.variables[0].startswith(v)] for v in ("tau_", "joint_"))
    assert len(by_torque) == 12 and len(by_angle) == 12
    assert all(s.law_of == int(s.variables[0][-1]) - 1 and s.softer_by_angle is None for s in by_torque)
    compliance = [s for s in by_angle if "compliance" in s.words]
    assert all(s.softer_by_angle == int(s.variables[0][-1]) - 1 for s in compliance)
    assert all(s.softer_by_angle is None and s.law_of is None for s in by_angle if s not in compliance)


def test_a_curve_of_the_step_of_an_axis_has_the_form_of_what_settles_there_in_loaded_sessions_too() -> None:
    found = study()
    by_step = [s for s in family_of(found).structures if s.by_step]
    assert {s.axis for s in by_step} > {2}
    settling = Term(find_effect("joint_settling"), {"a_3": Estimate(1e-4)})
    for s in by_step:
        assert has_form_of(s, settling, found.ready) == (s.axis == 2)
        assert not has_form_of(s, law("joint_backlash", (3,)), found.ready)


@pytest.mark.parametrize(("first", "kept"), [("station_shift", ("station_shift", "joint_backlash")), ("creep", ("creep",))])
def test_a_step_in_one_pose_keeps_no_weaker_effect_from_being_tried(monkeypatch, first: str, kept: tuple[str, ...]) -> None:
    """Readings may refuse it. Play is worse by 40 here."""
    worth = {first: 100.0, "joint_backlash": 60.0}

    def trial(effect: str) -> Any:
        block = SimpleNamespace(of=effect)
        return SimpleNamespace(effect=find_effect(effect), best=SimpleNamespace(block=block, log_prior=0.0))

    found = study()
    start = Explanation((), found, 0.0, grow(found.bench, family_of(found), found.base))
    monkeypatch.setattr(Block, "__add__", lambda _, other: other)
    monkeypatch.setattr(tries, "grow", lambda bench, family, block, parts: SimpleNamespace(log_evidence=worth[block.of]))
    monkeypatch.setattr(type(found.bench), "posterior", lambda *_: SimpleNamespace(log_evidence=0.0))
    family: Any = None
    chosen = tries._screened(start, [trial(first), trial("joint_backlash")], family, SETTINGS)
    assert tuple(t.effect.id for t in chosen) == kept


def test_two_models_are_compared_at_the_noise_of_the_first_whatever_each_takes_for_noise() -> None:
    found = study(play_of_axis_4)
    whiten = found.observation.whiten
    doubtful = np.where(found.observation.pose == HIT, 5.0, 1.0)  # what the model leaves there passes for noise
    noisy = replace(whiten, sigma=whiten.sigma * doubtful, sigma_reference=whiten.sigma_reference * doubtful)
    same = study_of(replace(found.observation, whiten=noisy), found.terms)
    before = held_out(found)
    assert gain(before, held_out(same))[0] > 0.01, "no example: the noise makes no difference"
    assert gain(before, held_out_beside(found, same))[0] == pytest.approx(0.0, abs=1e-3)
    assert held_out_beside(found, same).rms_m == held_out(same).rms_m


def test_of_two_laws_of_one_axis_that_which_explains_more_by_itself_is_asked_first() -> None:
    found = study(play_of_axis_4)
    family = family_of(found)
    none = replace(grow(found.bench, family, found.base), parts=())
    general = next(s for s in family.structures if s.law_of == 3)
    mended = Explanation((law("joint_stiffening", (4,)),), found, 20.0, replace(none, parts=(Part(general, 1.0, 100.0),)))
    better = Explanation((law("joint_backlash", (4,)),), found, 90.0, none)
    other_axis = Explanation((law("joint_stiffening", (5,)),), found, 20.0, mended.remainder)
    friction = Explanation((law("joint_hysteresis", (4,)),), found, 20.0, mended.remainder)
    assert laws_by_themselves([mended, friction, better]) == [better, friction, mended]
    assert laws_by_themselves([other_axis, better]) == [other_axis, better]


def test_what_is_left_of_two_laws_of_one_axis_finds_its_shape_again() -> None:
    found = study(play_of_axis_4)
    family = family_of(found)
    rest = grow(found.bench, family, found.base)
    second = law("joint_stiffening", (4,), x_0=0.1, slow=0.0)
    both = study_of(found.observation, (*found.terms, law("joint_backlash", (4,), w=0.03), second))
    one = Explanation(both.terms[-2:], both, 0.0, rest)
    bare = without(Explanation((), found, 0.0, rest), one, "joint_stiffening", family)
    assert bare.ids == ("joint_backlash",)
    assert bare.added[0].estimates["w"].value < 0.02, "beside the second law it was wide"


def test_a_compliance_from_which_stiffening_takes_something_away_has_room_for_it() -> None:
    found = study()
    both = study_of(found.observation, (*found.terms, law("joint_stiffening", (4,), x_0=0.1, slow=0.0)))
    named = [(o, p.name) for o, p in zip(both.owners, both.parameters, strict=True)]
    width = dict(zip(named, both.base.width * both.scale, strict=True))
    scale = dict(zip(named, both.scale, strict=True))
    level = width["joint_torsion", "c_3"] / scale["joint_torsion", "c_3"]  # that of all axes
    loaded = level * scale["joint_torsion", "c_4"]
    assert width["joint_torsion", "c_4"] == pytest.approx(np.hypot(loaded, width["joint_stiffening", "a_4"]))
    assert width["joint_torsion", "c_4"] > loaded


def axis_4_is_soft_at_small_torque(scene: Scene) -> Array:
    def wound(torque: Array) -> Array:
        return 6e-4 * np.tanh(torque / 120.0)

    angle = np.zeros_like(scene.tau)
    angle[:, 3] = wound(scene.tau[:, 3] + scene.tau_gravity[:, 3]) - wound(scene.tau_gravity[:, 3])
    return np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), angle)


def test_a_trial_of_stiffening_leaves_the_compliance_of_the_loaded_axis_as_likely_as_it_was() -> None:
    found = study(axis_4_is_soft_at_small_torque)
    family = family_of(found)
    start = Explanation((), found, 0.0, grow(found.bench, family, found.base))
    stiffening = next(o for o in options(found)[0] if o.effect.id == "joint_stiffening")
    trial = try_option(Ground(found.bench, found.base), stiffening, found.ready)
    assert trial.best.groups == ("axis 4",)
    one = explain(start, start, trial, family)
    assert one is not None
    assert trial.log_evidence > 0.9 * one.named, "the exact fit is no surprise"


def test_a_remainder_from_known_products_is_the_same_as_one_from_all_equations() -> None:
    found = study(play_of_axis_4)
    family = family_of(found)
    rest = grow(found.bench, family, found.base)
    assert rest.structures
    ground = Ground(found.bench, rest.block)
    gains, _ = family.gains(ground)
    odds = gains - np.log([s.tried for s in family.structures])
    odds[[s in [p.structure for p in rest.parts] for s in family.structures]] = -np.inf
    assert odds.max() < 3.0
    assert ground.chi2 == pytest.approx(found.bench.posterior(rest.block).chi2, rel=1e-9)


def test_a_promise_of_the_linear_problem_that_the_exact_fit_does_not_keep_is_no_evidence() -> None:
    found = study()
    family = family_of(found)
    start = Explanation((), found, 0.0, grow(found.bench, family, found.base))
    creep = next(o for o in options(found)[0] if o.effect.id == "creep")
    promised = replace(try_option(Ground(found.bench, found.base), creep, found.ready), log_evidence=50.0)
    one = explain(start, start, promised, family)
    assert one is not None
    assert one.named < 5.0, "nothing creeps there: the residual hardly falls"


def test_a_drift_is_a_form_of_thermal_drift_and_of_nothing_else() -> None:
    found = study()
    drifts = [s for s in family_of(found).structures if s.is_drift]
    assert drifts
    assert all(forms_of(Term(find_effect("thermal_drift")), found.ready).has(s) for s in drifts)
    assert not any(forms_of(Term(find_effect("creep")), found.ready).has(s) for s in drifts)
    pulled = [s for s in family_of(found).structures if s.words == "stamp: as a force at the tool"]
    assert len(pulled) == 1 and not pulled[0].is_drift  # a force that grows with time is no warmth


def test_a_bad_pose_has_no_say_in_whether_a_model_helps_on_held_out_poses() -> None:
    found = study(reflector_is_knocked)
    before = held_out(found)
    after = replace(before, loss=np.where(before.poses == HIT, 40.0, 0.5) * before.loss)
    assert gain(before, after)[0] < 0.0
    rest = grow(found.bench, family_of(found), found.base)
    assert rest.bad_rows
    assert gain(*(only_good_poses(h, found, rest) for h in (before, after)))[0] > 0.0


def test_a_pose_that_alone_shows_a_step_has_no_say_in_whether_another_effect_helps_on_held_out_poses() -> None:
    bumped = study(station_is_bumped)
    found = study_of(bumped.observation, (*bumped.terms, shift(STEP)))
    rest = grow(found.bench, family_of(found), found.base)
    kept = only_good_poses(held_out(found), found, rest)
    assert HIT in held_out(found).poses and HIT not in kept.poses


def test_parts_of_an_effect_are_weighed_about_the_model_that_has_it() -> None:
    bare = study(play_of_axis_4)
    whole = study_of(bare.observation, (*bare.terms, Term(find_effect("joint_backlash"))))
    rest = without_columns(whole, "joint_backlash")
    others = [i for i, owner in enumerate(whole.owners) if owner != "joint_backlash"]
    assert 0 < len(others) < len(whole.owners) == whole.base.A.shape[1]
    np.testing.assert_array_equal(rest.base.A, whole.base.A[:, others])
    np.testing.assert_array_equal(rest.bench.b, whole.bench.b)
    # what the effect explains is still on the right side
    assert rest.bench.posterior(rest.base).chi2 > 2.0 * whole.bench.posterior(whole.base).chi2


def test_a_structure_explains_nothing_by_an_amplitude_that_cannot_be() -> None:
    read = synthetic.session(poses=12, seed=2)
    read = replace(read, force_in_tool=read.force_in_tool / (1.0 + np.abs(read.force_in_tool) / 300.0))
    found = prepare(read, start_terms(read))
    family, ground = family_of(found), Ground(found.bench, found.base)
    at = next(i for i, s in enumerate(family.structures) if "gain of the force sensor" in s.words)
    gains, amplitude = family.gains(ground)
    assert 0.1 < amplitude[at] <= family.structures[at].largest < np.inf
    least = replace(family, structures=tuple(replace(s, largest=0.1) for s in family.structures))
    bounded, smaller = least.gains(ground)
    assert smaller[at] == pytest.approx(0.1)
    assert bounded[at] < gains[at] - 10.0


def pushed_away(scene: Scene) -> Array:
    return 1.5e-7 * scene.force


def test_a_base_that_slides_without_tilting_is_less_likely_than_a_tool_that_gives_way() -> None:
    # as soft in every direction neither frame tells
    ground = Ground(study(pushed_away).bench, study(pushed_away).base)
    found, _ = options(study(pushed_away), [find_effect(i) for i in ("tool_compliance", "base_compliance")])
    tool, base = (try_option(ground, o, study(pushed_away).ready) for o in found)
    assert base.best.groups == ("translation",)
    assert base.log_evidence > 10.0 and tool.log_evidence > base.log_evidence + 2.0
