# SPDX-License-Identifier: Apache-2.0
"""Versions of a model: effects that are added, with their parts, and taken out again."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import add_effect, improve, remove_effect
from irec_calibration.diagnose.attempt import attempt
from irec_calibration.diagnose.held_out import held_out, on_the_way, validated
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.scene import Scene
from irec_calibration.errors import EffectError, ModelError
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, Model, blank_model
from irec_calibration.model.file import load_model, save_model
from test_diagnose import Array, play_of_axis_4, session, turned


@cache
def model() -> Model:
    return model_of(identify(session(play_of_axis_4), blank_model(EIGHTEEN_DOF)))


def test_improve_adds_what_is_missing_and_stops() -> None:
    ladder = improve(session(play_of_axis_4))
    assert [r.added for r in ladder.rungs if r.added != "bending_place"] == ["", "joint_backlash"]
    assert ladder.rungs[-1].cv_rms_m < 0.7 * ladder.rungs[0].cv_rms_m
    assert [h["change"] for h in ladder.model.history] == ["start", *(f"added {r.added}" for r in ladder.rungs[1:])]


@pytest.mark.slow
def test_the_place_of_bending_that_a_missing_effect_hid_is_found_beside_it() -> None:
    place = find_effect("bending_place")

    def hidden(scene: Scene) -> Array:
        off = [1.2 * p.scale * (-1) ** (i + 1) for i, p in enumerate(place.parameters(scene))]
        angle = np.zeros_like(scene.tau)
        angle[:, 3] = 1e-3 * np.tanh((scene.tau[:, 3] + scene.tau_gravity[:, 3]) / 4.0)
        return turned(scene, angle) + place.displacement(scene, np.array(off))

    found = improve(synthetic.session(poses=20, seed=5, extra=hidden))
    assert [r.added for r in found.rungs] == ["", "joint_backlash", "bending_place"]
    assert found.rungs[2].cv_rms_m < found.rungs[1].cv_rms_m
    assert found.rungs[2].parts == found.rungs[1].parts
    assert found.before.cv_rms_after_m == found.rungs[2].cv_rms_m
    assert "Beside that the springs' place of bending matters" in found.before.verdict.text


def test_a_version_on_the_way_counts_the_readings_that_the_last_one_counts() -> None:
    whole = validated(session(play_of_axis_4), blank_model((*EIGHTEEN_DOF, "joint_backlash")))
    plain = on_the_way(whole, blank_model(EIGHTEEN_DOF))
    assert plain.study.observation is whole.study.observation
    assert plain.held_out.rms_m > 1.5 * whole.held_out.rms_m


def test_the_place_of_bending_is_added_and_tried_like_any_effect() -> None:
    place = find_effect("bending_place")

    def hidden(scene: Scene) -> Array:
        return place.displacement(scene, np.array([6.0 * p.scale * (-1) ** i for i, p in enumerate(place.parameters(scene))]))

    bent = synthetic.session(poses=20, seed=5, extra=hidden)
    new, before, after = add_effect(model(), place, bent)
    assert new.effects == (*EIGHTEEN_DOF, "bending_place")
    assert held_out(after).rms_m < 0.8 * held_out(before).rms_m
    tried = attempt(before, place)
    assert tried.after.rms_m < 0.8 * tried.before.rms_m


def test_a_model_with_a_part_of_an_effect_survives_its_file_and_a_refit(tmp_path) -> None:
    new, _, _ = add_effect(model(), find_effect("joint_backlash"), session(play_of_axis_4))
    again = load_model(save_model(new, tmp_path / "m.yaml"))
    assert tuple(again.terms[-1].estimates) == ("b_4", "w", "uneven", "held")
    assert held_out(prepare(session(play_of_axis_4), again.terms)).rms_m == pytest.approx(new.figures["cv_rms_m"], rel=1e-3)


def test_removing_an_effect_brings_the_error_back() -> None:
    new, _, after = add_effect(model(), find_effect("joint_backlash"), session(play_of_axis_4))
    plain, without = remove_effect(new, "joint_backlash", session(play_of_axis_4))
    assert plain.effects == EIGHTEEN_DOF
    assert held_out(without).rms_m > 1.5 * held_out(after).rms_m


def test_effects_that_the_model_has_or_the_session_cannot_show_are_refused() -> None:
    with pytest.raises(ModelError, match="already"):
        add_effect(model(), find_effect("link_bending"), session(play_of_axis_4))
    with pytest.raises(EffectError, match="no external axis"):
        add_effect(model(), find_effect("rail_compliance"), session(play_of_axis_4))
