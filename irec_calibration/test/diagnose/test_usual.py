# SPDX-License-Identifier: Apache-2.0
"""An effect that is there as in every robot is part of the model, and no cause that anybody has to look for."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.commands.improve import in_words
from irec_calibration.diagnose import Ladder, assessment, diagnose, explanation, improve, start_terms
from irec_calibration.diagnose.assessment import as_in_every_robot
from irec_calibration.diagnose.explanation import Explanation, cause_though_usual, usual
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.improve import with_term
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.study import Study, prepare, study_of
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import rms
from irec_calibration.identification.noise import InferredNoise
from irec_calibration.model import Estimate, Term, total_displacement
from numpy.typing import NDArray

GEOMETRY = find_effect("geometry_error")
LOADED = scene_of(synthetic.session(poses=2))
BY_WEIGHT = scene_of(absolute_sessions.session(poses=2, stated=True))


def marker_elsewhere(scene: Scene) -> NDArray[np.float64]:
    return scene.kin.R_tool @ np.array([0.01, 0.0, 0.015])


@pytest.mark.parametrize(
    ("values", "usual"),
    [
        ({"x_1": 4e-4, "y_2": -3e-4, "zero_2": 3e-4, "tilt_3a": 2e-4}, True),  # what is left after a geometric calibration
        ({"x_1": 2e-3, "y_2": -1e-3, "zero_2": 3e-4, "tilt_3a": 2e-4}, False),
        ({"x_1": 4e-4, "y_2": -3e-4, "zero_2": 3e-3, "tilt_3a": 2e-4}, False),
        ({"zero_2": 3e-3}, False),
    ],
)
def test_a_geometry_that_is_off_by_tenths_of_a_millimetre_is_usual_and_by_millimetres_it_is_not(values, usual) -> None:
    assert GEOMETRY.is_usual(values, 0.5, LOADED) == usual


@pytest.mark.parametrize("effect_id", ["tool_compliance", "base_compliance"])
def test_tools_and_floors_give_way_a_little_in_every_cell(effect_id) -> None:
    effect = find_effect(effect_id)
    assert effect.is_usual({}, 0.02, LOADED) and not effect.is_usual({}, 0.05, LOADED)


@pytest.mark.parametrize(
    ("play", "usual"),
    [
        ((4e-5, 4e-5, 0.0, 8e-5, 3e-5), True),  # a little in every gear
        ((0.0, 5e-5, 0.0, 0.0, 0.0), True),  # a sixth of an arc minute, as the best of gears have
        ((0.0, 8e-5, 0.0, 0.0, 0.0), False),  # one gear is unlike the others
        ((2e-5, 3e-5, 2e-5, 1.2e-4, 1e-5), False),
        ((2e-4, 2e-4, 2e-4, 2e-4, 2e-4), False),
    ],
)
def test_lost_motion_of_a_third_of_an_arc_minute_in_several_gears_is_usual(play, usual) -> None:
    values = {f"b_{k + 1}": b for k, b in enumerate(play)} | {"w": 0.03}
    assert find_effect("joint_backlash").is_usual(values, 0.03, LOADED) == usual


@pytest.mark.parametrize(("share", "axes", "usual"), [(0.02, 4, True), (0.035, 4, False), (0.02, 2, False)])
def test_friction_of_a_hundredth_of_the_deflection_in_several_gears_is_usual(share, axes, usual) -> None:
    values = {f"h_{k + 1}": 2e-9 for k in range(axes)} | {"late_6": 0.0, "r": 0.03, "freed": 100.0}
    assert find_effect("joint_hysteresis").is_usual(values, share, LOADED) == usual


@pytest.mark.parametrize(("lag", "usual"), [(3e-5, True), (-1e-4, False)])
def test_friction_of_a_sixth_of_an_arc_minute_is_usual_in_an_absolute_session_in_whatever_axis(lag, usual) -> None:
    assert find_effect("joint_hysteresis").is_usual({"lag_2": lag, "over": 0.01}, 0.02, BY_WEIGHT) == usual


@pytest.mark.parametrize(
    ("force", "usual"),
    [((1.0, -2.0, -30.0), True), ((20.0, 0.0, -30.0), False), ((0.0, 0.0, -300.0), False)],  # N; the arm weighs some 1800 N
)
def test_a_constant_pull_along_gravity_is_masses_that_are_known_to_a_tenth(force, usual) -> None:
    values = {f"f_{a}": f for a, f in zip("xyz", force, strict=True)}
    assert find_effect("external_force").is_usual(values, 0.1, BY_WEIGHT) == usual


def test_what_no_sound_robot_has_is_not_usual_whatever_its_size() -> None:
    assert not find_effect("sensor_gain").is_usual({"e_xx": 1e-9}, 1e-9, LOADED)


def test_the_share_of_an_effect_is_that_of_the_deflection_in_the_rows_that_were_observed() -> None:
    stiff, soft = (study(lambda scene, c=c: c * scene.force) for c in (3e-8, 3e-7))
    shares = []
    for one in (stiff, soft):
        with_it = study_of(one.observation, (*one.terms, Term(find_effect("tool_compliance"))))
        added = Explanation(with_it.terms[-1:], with_it, 0.0, grow(with_it.bench, family_of(with_it), with_it.base))
        shares.append(usual(added, "tool_compliance"))
    assert shares == [True, False]


def test_what_is_hardly_seen_is_usual_unless_it_is_surely_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    """A share is known by one in as many as its displacement has standard deviations of noise."""
    tool, shares = find_effect("tool_compliance"), []
    monkeypatch.setattr(type(tool), "is_usual", lambda self, values, share, scene: shares.append(share))
    plain = study(lambda scene: 5e-8 * scene.force)
    with_it = study_of(plain.observation, (*plain.terms, Term(tool)))
    for louder in (1.0, 100.0):
        whiten = with_it.observation.whiten.scaled(louder)
        fit = replace(with_it.fit, observation=replace(with_it.observation, whiten=whiten))
        loud = replace(with_it, fit=fit)
        usual(Explanation(loud.terms[-1:], loud, 0.0, grow(loud.bench, family_of(loud), loud.base)), "tool_compliance")
    assert shares[0] > 0.0 and shares[1] < 0.7 * shares[0]


@pytest.mark.parametrize(
    ("left", "of_noise", "usual"),
    [(0.006, 0.25, True), (0.02, 0.25, False), (0.006, 0.5, False)],  # of the deflection, of the noise
)
def test_structure_of_half_a_hundredth_of_the_deflection_is_usual_where_noise_hides_it(left, of_noise, usual) -> None:
    plain = study(lambda scene: np.zeros((len(scene), 3)))
    observation = plain.observation
    size = left * rms(observation.of(total_displacement(plain.terms, observation.scene)))
    level = size / of_noise
    noise = InferredNoise(level, level, level, level, "residual", 100.0)
    assert as_in_every_robot(plain, size, noise, SETTINGS) == (size if usual else 0.0)


@pytest.mark.long
def test_small_structure_of_sound_gears_is_told_and_is_no_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may still help to predict: the improved model has what stands in for it."""
    monkeypatch.setattr(assessment, "as_in_every_robot", lambda study, left, noise, settings: left)
    found = diagnose(synthetic.session(poses=30, seed=2, extra=goes_with_another_angle))
    assert found.verdict.status == "adequate" and not found.verdict.evidence and found.verdict.remaining_m == 0.0
    assert "of structure is left, no more than gears of every robot leave" in found.verdict.text
    monkeypatch.undo()
    assert diagnose(synthetic.session(poses=30, seed=2, extra=goes_with_another_angle)).verdict.status == "unexplained"


@pytest.mark.parametrize(("together", "usual_"), [(0.0, True), (np.inf, False)])
def test_effects_that_take_one_cause_up_from_each_other_are_looked_at_together(monkeypatch, together, usual_) -> None:
    plain = study(lambda scene: np.zeros((len(scene), 3)))
    play = Term(find_effect("joint_backlash"), {"b_2": Estimate(1e-3, unit="rad")})
    soft = Term(find_effect("joint_stiffening"), {"a_2": Estimate(-1e-7, unit="rad/(N m)")})
    both = study_of(plain.observation, (*plain.terms, play, soft))
    one = Explanation(both.terms[-2:], both, 0.0, grow(both.bench, family_of(both), both.base))
    monkeypatch.setattr(explanation, "_visible", lambda one, ids, moved: together if len(ids) > 1 else 0.0)
    assert usual(one, "joint_stiffening") == usual_


@pytest.mark.parametrize("effect_id", ["tool_compliance", "base_compliance", "geometry_error"])
@pytest.mark.parametrize(("of_limit", "usual_"), [(0.9, True), (1.1, False)])
def test_what_springs_of_links_take_up_is_usual_however_much_of_it_there_is(monkeypatch, effect_id, of_limit, usual_) -> None:
    """Bearings and links that bend leave as much as such a tool, floor or zero does beside the springs of a model."""
    effect = find_effect(effect_id)
    plain = study(lambda scene: 3e-7 * scene.force)
    with_it = study_of(plain.observation, (*plain.terms, Term(effect)))
    one = Explanation(with_it.terms[-1:], with_it, 0.0, grow(with_it.bench, family_of(with_it), with_it.base))
    monkeypatch.setattr(type(effect), "is_usual", lambda self, values, share, scene: False)
    shown = np.sqrt((with_it.observation.of(total_displacement(with_it.terms, with_it.observation.scene)) ** 2).sum())
    monkeypatch.setattr(explanation, "_visible", lambda one, ids, moved: of_limit * effect.usual_visible * shown)
    assert usual(one, effect_id) == usual_


@pytest.mark.parametrize(("share", "known", "usual_"), [(0.05, 0.8, False), (0.05, 0.6, True), (0.02, 1.0, True)])
def test_creep_of_more_than_a_few_per_cent_for_certain_is_not_usual_however_little_of_it_is_seen(
    monkeypatch, share: float, known: float, usual_: bool
) -> None:
    """Most of it looks like softer gears: creep of 5 % of the deflection, of which 0.7 % were seen, had been usual."""
    plain = study(lambda scene: np.zeros((len(scene), 3)))
    creep = Term(find_effect("creep"), {"share": Estimate(share), "T": Estimate(1e-3)})  # all of it at once
    with_it = study_of(plain.observation, (*plain.terms, creep))
    of_that_size = replace(with_it, fit=replace(with_it.fit, terms=(*plain.terms, creep)))
    one = Explanation((creep,), of_that_size, 0.0, grow(with_it.bench, family_of(with_it), with_it.base))
    monkeypatch.setattr(explanation, "_visible", lambda one, ids, moved: 0.0)
    monkeypatch.setattr(explanation, "_known", lambda one, effect_id, own: known)
    assert usual(one, "creep") == usual_


def test_how_much_an_effect_moves_is_known_as_well_as_it_is_told_from_the_rest() -> None:
    plain = study(lambda scene: np.zeros((len(scene), 3)))
    with_it = study_of(plain.observation, (*plain.terms, Term(find_effect("creep"))))
    one = Explanation(with_it.terms[-1:], with_it, 0.0, grow(with_it.bench, family_of(with_it), with_it.base))
    in_place_of_a_spring = total_displacement(with_it.terms[:1], with_it.observation.scene)
    of_no_spring = np.random.default_rng(3).normal(0.0, 1e-3, in_place_of_a_spring.shape)
    taken_up, told = (explanation._known(one, "creep", with_it.observation.of(m)) for m in (in_place_of_a_spring, of_no_spring))
    assert taken_up == 0.0 and told > 0.95


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize(
    ("of_deflection", "of_noise", "expected"),
    [
        (1.1, 1.1, True),
        (0.9, 1.1, False),  # a good robot leaves as much
        (1.1, 0.9, False),  # noise hides it
    ],
)
def test_usual_links_are_a_cause_where_more_than_noise_is_seen_of_them(
    monkeypatch, of_deflection, of_noise, expected, beside
) -> None:
    """Beside other causes, whose form they may mend, more of them than by themselves."""
    plain = study(lambda scene: np.zeros((len(scene), 3)))
    links = Term(GEOMETRY, {"zero_2": Estimate(1e-4, unit="rad")})
    with_it = study_of(plain.observation, (*plain.terms, links))
    one = Explanation(with_it.terms[-1:], with_it, 0.0, grow(with_it.bench, family_of(with_it), with_it.base))
    springs = with_it.observation.of(total_displacement(with_it.terms, with_it.observation.scene))
    seen = of_deflection * (GEOMETRY.usual_beside if beside else GEOMETRY.usual_alone) * rms(springs)
    monkeypatch.setattr(explanation, "_visible", lambda one, ids, moved: seen * np.sqrt(len(springs)))
    noise = seen / (of_noise * SETTINGS.usual_beside_noise)
    assert cause_though_usual(one, "geometry_error", noise, beside=beside) == expected


@pytest.mark.parametrize(("cause", "status"), [(True, "missing_effect"), (False, "adequate")])
def test_such_a_session_is_not_adequate(monkeypatch, cause, status) -> None:
    monkeypatch.setattr(type(find_effect("marker_offset")), "is_usual", lambda self, values, share, scene: True)
    monkeypatch.setattr(assessment, "cause_though_usual", lambda one, effect_id, noise, beside=False: cause and not beside)
    verdict = diagnose(synthetic.session(poses=20, seed=5, extra=marker_elsewhere)).verdict
    named, usual_ = (("marker_offset",), ()) if cause else ((), ("marker_offset",))
    assert (verdict.status, verdict.effects, verdict.usual) == (status, named, usual_)


def goes_with_another_angle(scene: Scene) -> NDArray[np.float64]:
    u = np.einsum("nik,nk->ni", scene.J, synthetic.COMPLIANCE * scene.tau)
    return 0.08 * np.sin(4.0 * scene.q[:, [1]] + scene.q[:, [4]]) * u


def test_a_station_that_is_turned_makes_no_soft_tool_usual() -> None:
    """It moves what is read at each reference by centimetres, of which differences keep nothing."""
    turned = find_effect("station_registration")

    def hidden(scene: Scene) -> NDArray[np.float64]:
        return 3e-7 * scene.force + turned.displacement(scene, np.full(len(turned.parameters(scene)), 0.01))

    plain = study(hidden)
    with_both = study_of(plain.observation, (*plain.terms, Term(turned), Term(find_effect("tool_compliance"))))
    added = Explanation(with_both.terms[-2:], with_both, 0.0, grow(with_both.bench, family_of(with_both), with_both.base))
    assert not usual(added, "tool_compliance")


@pytest.mark.parametrize(("se", "usual_then"), [(1e-5, False), (3e-3, True)])
def test_a_turn_of_a_station_that_another_effect_makes_up_for_does_not_count(se, usual_then) -> None:
    plain = study(lambda scene: 1e-8 * scene.force)
    turned = find_effect("station_registration")
    found = study_of(plain.observation, (*plain.terms, Term(turned)))
    values = dict.fromkeys((p.name for p in turned.parameters(found.ready)), Estimate(2e-4, 1e-6, "rad", identified=True))
    about_z = next(n for n in values if n.startswith("w_z"))
    values[about_z] = Estimate(2e-3, se, "rad", identified=True)
    terms = (*found.terms[:-1], Term(turned, values))
    known = replace(found, fit=replace(found.fit, terms=terms))
    added = Explanation(terms[-1:], known, 0.0, grow(found.bench, family_of(found), found.base))
    assert usual(added, "station_registration") == usual_then


def study(hidden) -> Study:
    measured = synthetic.session(poses=20, seed=5, extra=hidden)
    return prepare(measured, start_terms(measured)).to_weigh


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(find_effect("marker_offset")), "is_usual", lambda self, values, share, scene: True)
        return improve(synthetic.session(poses=20, seed=5, extra=marker_elsewhere))


def test_what_every_robot_has_lowers_the_error_without_a_name(ladder) -> None:
    verdict, last = ladder.before.verdict, ladder.rungs[-1]
    assert (verdict.status, verdict.effects, verdict.one_of) == ("adequate", (), ())
    assert "marker offset as every robot has it: no cause to look for" in verdict.text
    assert "marker_offset" in ladder.model.effects and last.cv_rms_m < 0.9 * ladder.rungs[0].cv_rms_m
    rung = next(r for r in ladder.rungs if r.added == "marker_offset")
    assert (rung.named, rung.usual, rung.title) == (False, True, "+ marker_offset (usual)")
    said = in_words(ladder)
    assert "+ marker_offset (usual)" in said and "no cause to look for" in said and "(no name)" not in said
    assert [s["usual"] for s in ladder.to_json()["steps"] if s["added"] == "marker_offset"] == [True]


def test_a_tool_weight_that_is_added_last_is_named_whatever_came_before_it(ladder) -> None:
    weight = Term(find_effect("tool_weight"), {"dm": Estimate(1.5, 0.1, "kg")})
    for last in (ladder.rungs[-1], replace(ladder.rungs[-1], usual=False, one_of=("joint_backlash", "joint_stiffening"))):
        rung = with_term(last, weight, 40.0)
        assert (rung.title, rung.named, rung.usual, rung.one_of) == ("+ tool_weight", True, False, ())
        assert rung.model.effects == (*last.model.effects, "tool_weight") and rung.cv_rms_m == last.cv_rms_m


def test_a_report_says_so_too(ladder, tmp_path) -> None:
    from irec_calibration.report.ladder import write_ladder_report

    page = write_ladder_report(ladder, synthetic.session(poses=20, seed=5, extra=marker_elsewhere), tmp_path)[0]
    text = page.read_text(encoding="utf-8")
    assert "what every robot has (marker offset) lowers the error" in text
    assert "Marker offset of that size is no cause to look for." in text
    assert "which is no diagnosis" not in text


@pytest.mark.parametrize(("remaining_m", "colour"), [(0.0, "adequate"), (1e-5, "missing_effect")])
def test_a_ladder_is_finished_where_all_is_named_or_usual_and_nothing_is_left(ladder, tmp_path, remaining_m, colour) -> None:
    from irec_calibration.report import ladder as report

    shown: list[str] = []
    verdict = replace(ladder.before.verdict, status="missing_effect", effects=("joint_backlash",), remaining_m=remaining_m)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "write_page", lambda page, path: (shown.append(page.status), path)[1])
        report.write_ladder_report(
            replace(ladder, before=replace(ladder.before, verdict=verdict)),
            synthetic.session(poses=20, seed=5, extra=marker_elsewhere),
            tmp_path,
        )
    assert shown == [colour]


def test_a_diagnosis_says_what_to_do_with_it_and_does_not_say_that_nothing_is_to_be_added(ladder, tmp_path) -> None:
    from irec_calibration.report.diagnosis import write_diagnosis_report
    from irec_calibration.report.next_steps import after_diagnosis

    found = ladder.before
    assert found.verdict.usual == ("marker_offset",) and found.to_json()["verdict"]["usual"] == ["marker_offset"]
    ((_, command),) = after_diagnosis(found, "S")
    assert command == "irec improve S -o improved"
    page = write_diagnosis_report(found, synthetic.session(poses=20, seed=5, extra=marker_elsewhere), tmp_path)[0]
    text = page.read_text(encoding="utf-8")
    assert "Marker offset is there as in every robot" in text and "no effect is needed" not in text


@pytest.mark.parametrize(("turned", "usual"), [((1e-4, 4e-4, -2e-4), True), ((3e-3, 0.0, 1e-3), False)])
def test_a_known_station_turned_by_no_more_than_a_first_axis_is_off_is_usual(turned, usual) -> None:
    station = find_effect("station_registration")
    assert station.is_usual({f"w_{a}_A": w for a, w in zip("xyz", turned, strict=True)}, 0.0, LOADED) == usual
    unturned = {f"w_{a}_B": 0.0 for a in "xyz"}
    assert station.is_usual({f"w_{a}_A": w for a, w in zip("xyz", turned, strict=True)} | unturned, 0.0, LOADED) == usual


@pytest.mark.parametrize(("scene", "usual"), [(LOADED, False), (BY_WEIGHT, True)], ids=["loaded", "absolute"])
def test_a_known_station_may_be_turned_by_more_where_positions_are_read_than_where_displacements_are(scene, usual) -> None:
    turned = {"w_x_A": 1.5e-3, "w_y_A": 0.0, "w_z_A": 0.0}  # 0.87 mrad RMS
    assert find_effect("station_registration").is_usual(turned, 0.0, scene) == usual


@pytest.mark.parametrize(("scale", "usual"), [(1e-4, True), (-1e-4, True), (3e-4, False)])
def test_lengths_that_are_off_by_a_tenth_of_a_millimetre_in_a_metre_are_usual_among_positions(scale, usual) -> None:
    tracker = find_effect("tracker_scale")
    assert tracker.is_usual({"s": scale}, 0.0, BY_WEIGHT) == usual


@pytest.mark.parametrize(("scale", "is_usual"), [(1e-4, True), (3e-4, False)])
def test_what_is_usual_among_positions_is_no_cause_of_an_absolute_session(scale, is_usual) -> None:
    made = absolute_sessions.session(poses=30, stated=True)
    study = prepare(made, start_terms(made))
    term = Term(find_effect("tracker_scale"), {"s": Estimate(scale, unit="1")})
    rest = grow(study.bench, family_of(study), study.base)
    one = Explanation((term,), study_of(study.observation, (*study.terms, term)), 0.0, rest)
    assert usual(one, "tracker_scale") == is_usual

