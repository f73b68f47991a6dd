# SPDX-License-Identifier: Apache-2.0
"""What readings at the references say about effects that move each reading by itself, and by which springs pass for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import start_terms
from irec_calibration.diagnose.candidates import try_effect
from irec_calibration.diagnose.explanation import Explanation, implausible, shown_by_readings
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.improve import improve
from irec_calibration.diagnose.naming import odds_of
from irec_calibration.diagnose.readings import along_readings, by_readings, carried
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.shape import refit
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term
from numpy.typing import NDArray

Array = NDArray[np.float64]
STATION = np.array([4.0, -2.0, 1.0])


def long_lengths(scene: Scene) -> Array:
    return 0.05 * (scene.p_observed - STATION)


def turned_station(scene: Scene) -> Array:
    return np.cross([0.02, 0.0, 0.03], scene.p_observed - STATION)


def marker_elsewhere(scene: Scene) -> Array:
    return scene.kin.R_tool @ np.array([0.03, 0.0, 0.05])


def soft_tool(scene: Scene) -> Array:
    """Moves the marker under load only, and along the tool as a wrong scale would."""
    return 6e-8 * np.einsum("nij,nj->ni", scene.kin.R_tool, scene.force_in_tool)


TRUE = {
    "tracker_scale": {"s": 0.05}, "station_registration": {"w_x_A": -0.02, "w_y_A": 0.0, "w_z_A": -0.03},
    "marker_offset": {"d_x": 0.03, "d_y": 0.0, "d_z": 0.05},
}  # fmt: skip
CAUSES = {"tracker_scale": long_lengths, "station_registration": turned_station, "marker_offset": marker_elsewhere}


@cache
def found(hidden: Callable[[Scene], Array], effect: str) -> tuple[Study, Term]:
    """A session with something hidden, and an effect fitted to it."""
    measured = synthetic.session(poses=20, seed=5, extra=hidden)
    study = prepare(measured, start_terms(measured)).to_weigh
    trial = try_effect(study, find_effect(effect))
    fitted = refit(study, trial) if trial else None
    assert fitted is not None
    return fitted, fitted.terms[-1]


def explanation(study: Study, term: Term) -> Explanation:
    return Explanation((term,), study, 20.0, grow(study.bench, family_of(study), study.base))


@pytest.mark.parametrize("effect", CAUSES)
def test_readings_carry_what_an_instrument_does_to_them(effect: str) -> None:
    study, _ = found(CAUSES[effect], effect)
    right, wrong = ({n: Estimate(sign * v, 0.002) for n, v in TRUE[effect].items()} for sign in (1.0, -1.0))
    assert carried(study, Term(find_effect(effect), right)) > SETTINGS.nats_to_name
    assert carried(study, Term(find_effect(effect), wrong)) <= 0.0


@pytest.mark.parametrize("effect", CAUSES)
def test_what_is_found_in_differences_alone_is_no_error_of_the_instrument(effect: str) -> None:
    study, fitted = found(soft_tool, effect)
    large = {n: Estimate(0.05, 0.005) for n in fitted.estimates}
    term = Term(fitted.effect, large)
    assert carried(study, term) < -SETTINGS.nats_to_name
    said = implausible(explanation(study, term), effect)
    assert "readings at the references do not have it" in said
    assert "with those of the differences" in said
    assert shown_by_readings(explanation(study, term), effect) == 0.0


def test_readings_say_nothing_about_springs_and_about_what_is_small() -> None:
    study, _ = found(soft_tool, "tracker_scale")
    spring = Term(find_effect("tool_compliance"), {"t_x": Estimate(6e-8, 1e-9)})
    assert carried(study, spring) == 0.0
    small = Term(find_effect("tracker_scale"), {"s": Estimate(1e-5, 1e-5)})
    assert abs(carried(study, small)) < SETTINGS.nats_to_prefer


@pytest.mark.parametrize("seed", [6, 7])  # of those whose errors are most like a scale
def test_links_that_are_off_by_tenths_of_a_millimetre_are_no_scale_of_the_tracker(seed: int) -> None:
    off = np.random.default_rng(seed).normal(0.0, 4e-4, (6, 3))
    measured = synthetic.session(poses=30, seed=5, extra=lambda scene: np.einsum("nkij,kj->ni", scene.kin.R_joint, off))
    study = prepare(measured, start_terms(measured)).to_weigh
    assert by_readings(study, find_effect("tracker_scale"))[0] < 0.0


def test_two_stations_that_are_turned_by_a_tenth_of_a_milliradian_are_registered() -> None:
    """As well as anybody registers one; where nothing else scatters, their difference is plain to see."""
    one = synthetic.session(poses=40, seed=5)
    turned = np.array([[1.0, -1e-4, 2e-4], [1e-4, 1.0, -1e-4], [-2e-4, 1e-4, 1.0]])
    second = one.pose > 20
    p = np.where(second[:, None], one.p_marker_in_station @ turned.T, one.p_marker_in_station)
    stations = (*one.stations, replace(one.stations[0], name="B"))
    measured = replace(one, p_marker_in_station=p, station=second.astype(np.int64), stations=stations)
    study = prepare(measured, start_terms(measured)).to_weigh
    assert by_readings(study, find_effect("station_registration"))[0] < 0.0


def slightly_turned_station(scene: Scene) -> Array:
    return np.cross([0.004, 0.0, 0.006], scene.p_observed - STATION)


def test_readings_alone_give_the_values_and_differences_bear_them_out_along_these() -> None:
    measured = synthetic.session(poses=20, seed=5, extra=slightly_turned_station)
    study, effect = prepare(measured, start_terms(measured)).to_weigh, find_effect("station_registration")
    odds, values = by_readings(study, effect)
    assert odds > SETTINGS.nats_to_name
    np.testing.assert_allclose(values, [-0.004, 0.0, -0.006], atol=4e-4)
    trial = try_effect(study, effect)
    assert trial is not None
    assert along_readings(study, effect) > max(trial.log_evidence, SETTINGS.nats_to_prefer) + 1.0
    assert by_readings(study, find_effect("geometry_error"))[0] == 0.0  # of its values readings tell together only


def wrong_links(scene: Scene) -> Array:
    """Zeros of two axes off by 10 and 5 mrad and a link 8 mm too long, to first order."""
    J = scene.kin.jacobian(scene.p_observed)
    return J[:, :, 1] * 0.01 + J[:, :, 3] * 0.005 + 0.008 * np.swapaxes(scene.kin.R_joint[:, 2], 1, 2)[:, 2]


def test_of_wrong_links_readings_tell_the_order_only_and_never_speak_for_them() -> None:
    study, term = found(wrong_links, "geometry_error")
    assert carried(study, term) == 0.0  # differences give other values: readings have some of that order all the same
    elsewhere, large = found(soft_tool, "geometry_error")
    large = Term(large.effect, {n: Estimate(0.05) for n in large.estimates})
    assert carried(elsewhere, large) < -SETTINGS.nats_to_name


@pytest.mark.parametrize("effect", CAUSES)
def test_readings_without_an_error_of_an_instrument_give_it_no_odds(effect: str) -> None:
    measured = synthetic.session(poses=20, seed=5, extra=soft_tool)
    assert by_readings(prepare(measured, start_terms(measured)).to_weigh, find_effect(effect))[0] < 0.0


def test_no_structure_is_a_rival_of_what_readings_carry() -> None:
    study, fitted = found(long_lengths, "tracker_scale")
    one = explanation(study, fitted)
    shown = shown_by_readings(one, "tracker_scale")
    assert shown > SETTINGS.nats_to_name
    family = family_of(study)
    bare = Explanation((), prepare(study.session, start_terms(study.session)).to_weigh, 3.0, one.remainder)
    along = along_readings(bare.study, fitted.effect)
    assert odds_of(bare, one, bare, "tracker_scale", family, SETTINGS) == pytest.approx(max(17.0, along) + shown)


def test_a_wrong_tool_weight_is_in_the_improved_model_where_no_joint_moves_between_reference_and_load() -> None:
    measured = synthetic.session(poses=12, seed=3, approach=0.0)
    scene = scene_of(measured)
    too_much = 5.0 * np.einsum("nji,j->ni", scene.kin.R_tool, scene.gravity_in_base)
    ladder = improve(replace(measured, force_in_tool=measured.force_in_tool + too_much))
    weight = ladder.model.terms[-1]
    assert weight.effect.id == "tool_weight" and weight.estimates["dm"].value == pytest.approx(5.0, abs=0.1)
    assert "tool_weight" in ladder.before.verdict.effects
    assert "tool_weight" not in ladder.before.skipped
