# SPDX-License-Identifier: Apache-2.0
"""How far apart two effects in each other's place have to be before one is named."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import rivals, start_terms
from irec_calibration.diagnose.candidates import options, try_option
from irec_calibration.diagnose.explanation import Explanation, explain
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.rivals import as_they_count, has_a_cause_of_its_own, rivals_of
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term
from irec_calibration.typing import Array
from test_diagnose import play_of_axis_4


@pytest.mark.parametrize("own", [10.0, 100.0])
def test_two_laws_of_torque_need_more_to_be_told_apart_the_stronger_they_show(own: float) -> None:
    least = SETTINGS.nats_over_rival + SETTINGS.share_between_laws * own
    short, enough = (as_they_count(least + more, own, SETTINGS.share_between_laws) for more in (-0.1, 0.1))
    assert short < SETTINGS.nats_over_rival < enough


def test_odds_over_an_effect_of_another_kind_count_as_they_are() -> None:
    assert as_they_count(2.4, 100.0, 0.0) == 2.4


@pytest.mark.parametrize("odds", [-1.0, 0.005, 3.0])
def test_the_likelier_of_two_laws_is_named_first(odds: float) -> None:
    assert (as_they_count(odds, 100.0, SETTINGS.share_between_laws) > 0.0) == (odds > 0.0)


def marker_elsewhere(scene: Scene) -> Array:
    """As a wrong nest does, and a last link of another length."""
    return scene.kin.R_tool @ np.array([0.01, 0.0, 0.015])


def joint_3_elsewhere(scene: Scene) -> Array:
    """As no marker does."""
    return 0.02 * scene.J[:, :, 2]


@pytest.mark.parametrize(("hidden", "instead"), [(marker_elsewhere, ["marker_offset"]), (joint_3_elsewhere, [])])
def test_wrong_links_give_way_to_a_wrong_marker_unless_they_explain_more(hidden, instead) -> None:
    measured = synthetic.session(poses=20, seed=5, extra=hidden)
    study = prepare(measured, start_terms(measured)).to_weigh
    family, found = family_of(study), options(study)[0]
    start = Explanation((), study, 0.0, grow(study.bench, family, study.base))
    links = next(o for o in found if o.effect.id == "geometry_error")
    one = explain(start, start, try_option(Ground(study.bench, study.base), links, study.ready), family)
    assert one is not None
    rivals = rivals_of(start, one, {}, [], found, family, lambda: None, SETTINGS)
    assert [better.ids[-1] for better, _ in rivals.likelier] == instead


def marker_elsewhere_beside_play(scene: Scene) -> Array:
    return marker_elsewhere(scene) + play_of_axis_4(scene)


@pytest.mark.parametrize(
    ("hidden", "rival", "its_own"),
    [(marker_elsewhere_beside_play, "joint_backlash", True), (marker_elsewhere, "geometry_error", False)],
)
def test_an_effect_that_explains_as_much_beside_a_name_has_a_cause_of_its_own(hidden, rival, its_own) -> None:
    measured = synthetic.session(poses=20, seed=5, extra=hidden)
    study = prepare(measured, start_terms(measured)).to_weigh
    family, found = family_of(study), {o.effect.id: o for o in options(study)[0]}
    start = Explanation((), study, 0.0, grow(study.bench, family, study.base))

    def with_(effect_id: str) -> Explanation:
        one = explain(start, start, try_option(Ground(study.bench, study.base), found[effect_id], study.ready), family)
        assert one is not None
        return one

    models = (with_("marker_offset"), with_(rival), start)
    assert has_a_cause_of_its_own(start, models, found[rival], family, SETTINGS) == its_own


@pytest.mark.parametrize(("of_name", "of_rival", "odds"), [(0.0, -8.0, 8.0), (-3.0, 0.0, -3.0), (40.0, -8.0, 8.0)])
def test_readings_that_are_against_a_rival_speak_for_the_name(
    monkeypatch: pytest.MonkeyPatch, of_name: float, of_rival: float, odds: float
) -> None:
    read = {"sensor_gain": of_name, "geometry_error": of_rival}
    monkeypatch.setattr(rivals, "carried", lambda study, term: read[term.effect.id])
    one: Any = SimpleNamespace(study=None, term=lambda i: Term(find_effect(i)))
    assert rivals._unread(one, "sensor_gain", one, "geometry_error") == odds


@pytest.mark.parametrize(("errors", "odds"), [(("zero_1", "tilt_1a"), 0.0), (("zero_1", "zero_2"), -40.0)])
def test_readings_do_not_tell_turned_stations_from_a_first_axis_that_stands_otherwise(
    monkeypatch: pytest.MonkeyPatch, errors: tuple[str, ...], odds: float
) -> None:
    read = {"station_registration": -40.0, "geometry_error": 0.0}
    monkeypatch.setattr(rivals, "carried", lambda study, term: read[term.effect.id])
    scene = scene_of(synthetic.session(4, 1))
    estimates = {"station_registration": {}, "geometry_error": {n: Estimate(0.01) for n in errors}}
    one: Any = SimpleNamespace(study=SimpleNamespace(ready=scene), term=lambda i: Term(find_effect(i), estimates[i]))
    assert rivals._unread(one, "station_registration", one, "geometry_error") == odds


PLAY, SOFT = "joint_backlash", "joint_stiffening"


def at_bounds(monkeypatch: pytest.MonkeyPatch, **bounds: str) -> Any:
    """A model of which fitted effects end where others begin."""
    monkeypatch.setattr(rivals, "ends_at", lambda one, i: bounds.get(i, ""))
    monkeypatch.setattr(rivals, "rather", lambda one, i: bounds.get(i, "") if i == PLAY else "")
    values = {PLAY: "bw", SOFT: "awux"}  # to fit
    return SimpleNamespace(term=lambda i: SimpleNamespace(effect=SimpleNamespace(special_of=""), estimates=values[i]))


@pytest.mark.parametrize(
    ("bounds", "odds", "is_play"),
    [
        ({SOFT: PLAY}, 2.5, True),
        ({SOFT: PLAY}, 1.0, False),
        ({SOFT: PLAY, PLAY: SOFT}, 9.0, False),
        ({}, 9.0, False),
    ],
    ids=["preferred", "no likelier", "both at the bound", "inside"],
)
def test_a_soft_gear_that_came_to_the_range_of_play_is_no_rival_of_play_that_is_preferred(
    monkeypatch: pytest.MonkeyPatch, bounds: dict[str, str], odds: float, is_play: bool
) -> None:
    """Eight of eight such plays of two outside simulators and the own one were `one_of` both, by 1.8 to 10 nats."""
    one = at_bounds(monkeypatch, **bounds)
    assert rivals._is_the_name(one, PLAY, one, SOFT, odds, SETTINGS) == is_play


@pytest.mark.parametrize(("odds", "is_soft"), [(4.0, False), (6.0, True)])
def test_play_that_came_to_where_a_soft_gear_begins_is_no_rival_of_one_that_is_preferred_by_more(
    monkeypatch: pytest.MonkeyPatch, odds: float, is_soft: bool
) -> None:
    """It has more values to fit: of twelve of three outside simulators three had play, by 3.7 to 6.5."""
    one = at_bounds(monkeypatch, **{PLAY: SOFT})
    assert rivals._is_the_name(one, SOFT, one, PLAY, odds, SETTINGS) == is_soft


@pytest.mark.parametrize(("odds", "instead"), [(-3.0, True), (-1.0, False), (0.5, False)])
def test_play_that_came_to_its_bound_gives_way_to_a_soft_gear_that_is_preferred(
    monkeypatch: pytest.MonkeyPatch, odds: float, instead: bool
) -> None:
    """Play over 7 % of a drive's limit, by another simulator's measure, was called a soft gear at even odds."""
    one = at_bounds(monkeypatch, **{PLAY: SOFT})
    assert rivals._takes_its_place(one, PLAY, one, SOFT, odds, SETTINGS) == instead


@pytest.mark.parametrize(("simpler", "instead"), [(True, True), (False, False)])
def test_a_special_form_takes_the_place_of_the_general_one_only_where_its_values_are_the_likelier(
    monkeypatch: pytest.MonkeyPatch, simpler: bool, instead: bool
) -> None:
    one = at_bounds(monkeypatch)
    one.term = lambda i: SimpleNamespace(effect=SimpleNamespace(special_of="sensor_gain"))
    monkeypatch.setattr(rivals, "is_simpler", lambda term: simpler)
    assert rivals._takes_its_place(one, "sensor_gain", one, "sensor_alignment", 0.4, SETTINGS) == instead
