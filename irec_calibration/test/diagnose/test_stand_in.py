# SPDX-License-Identifier: Apache-2.0
"""An effect that can't be named but predicts other poses is part of an improved model, and is said to be no diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import Ladder, improve
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.observe import observe
from irec_calibration.model import Model
from irec_calibration.session import Session
from irec_calibration.typing import Array
from test_diagnose import play_in_the_bearing_of_axis_5, play_of_axis_4, session


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    return improve(session(play_in_the_bearing_of_axis_5))


def missed(model: Model) -> float:
    """RMS over rows of what a model misses of the marker's true displacement at other poses, m."""
    exact = synthetic.Noise(tracker_m=1e-12, force_n=0.0)
    others = synthetic.session(seed=11, extra=play_in_the_bearing_of_axis_5, noise=exact)
    seen, scene = observe(others), scene_of(others)
    return float(np.sqrt(((seen.y - scene.change(model.predict(scene))[seen.rows]) ** 2).sum(axis=1).mean()))


def test_what_cannot_be_named_stands_in_for_what_is_missing_and_is_no_diagnosis(ladder):
    verdict = ladder.before.verdict
    assert (verdict.status, verdict.effects) == ("unexplained", ())
    effect = ladder.rungs[-1]
    assert (effect.added, effect.named) == ("joint_backlash", False)
    assert all(r.named for r in ladder.rungs[:-1])
    assert "which is no diagnosis" in verdict.text
    assert [s["named"] for s in ladder.to_json()["steps"]] == [r.named for r in ladder.rungs]
    assert ladder.before.cv_rms_after_m == effect.cv_rms_m < ladder.rungs[-2].cv_rms_m


def test_neither_terminal_nor_report_passes_off_as_a_diagnosis_what_stands_in(ladder, tmp_path):
    from irec_calibration.commands.improve import in_words
    from irec_calibration.report.ladder import write_ladder_report

    assert "+ joint_backlash (no name)" in in_words(ladder)
    page = write_ladder_report(ladder, session(play_in_the_bearing_of_axis_5), tmp_path)[0].read_text(encoding="utf-8")
    assert "the model has joint backlash" in page and "which is no diagnosis" in page
    assert "Adding joint backlash" not in page


def test_a_model_with_what_stands_in_predicts_other_poses_better(ladder):
    without, with_effect = (missed(r.model) for r in ladder.rungs[-2:])
    assert with_effect < 0.8 * without


def read_with_gain(loss_per_kilonewton: float, hidden: Callable[[Scene], Array] | None = None) -> Session:
    """A session whose force sensor reads each component the lower the larger it is."""
    read = session(hidden)
    force = read.force_in_tool
    return replace(read, force_in_tool=force * (1.0 - loss_per_kilonewton * np.abs(force) / 1000.0))


@pytest.mark.long
def test_each_of_several_that_stand_in_is_a_rung_and_lowers_the_error():
    found = improve(read_with_gain(0.2, play_in_the_bearing_of_axis_5))
    standing_in = [r for r in found.rungs if not r.named]
    assert found.before.verdict.effects == ()
    assert [r.added for r in standing_in if not r.formula] == ["joint_backlash", "sensor_gain"]
    assert standing_in[1].effects == (*standing_in[0].effects, "sensor_gain")
    errors = [r.cv_rms_m for r in found.rungs[-1 - len(standing_in) :]]
    assert errors == sorted(errors, reverse=True)
    assert "has joint backlash and force sensor gain and the law" in found.before.verdict.text


def test_a_force_sensor_whose_gain_falls_with_the_load_is_not_called_one_with_different_gains():
    found = improve(read_with_gain(0.1))
    assert (found.before.verdict.status, found.before.verdict.effects) == ("unexplained", ())
    assert "sensor_gain" not in [r.added for r in found.rungs if r.named]


def test_different_gains_of_a_force_sensor_are_named_all_the_same():
    clean = session(None)
    crosstalk = np.array([[0.02, 0.03, -0.04], [0.01, 0.02, 0.05], [0.03, -0.02, -0.04]])
    read = clean.force_in_tool @ np.linalg.inv(np.eye(3) + crosstalk).T
    assert improve(replace(clean, force_in_tool=read)).before.verdict.effects == ("sensor_gain",)


def on_a_soft_pedestal(scene: Scene) -> Array:
    """The marker's displacement where the base tilts by 25 nrad/(N m) about both of its horizontal axes."""
    moment = np.cross(scene.p_observed, scene.force) * np.array([1.0, 1.0, 0.0])
    return np.cross(2.5e-8 * moment, scene.p_observed)


def test_an_effect_that_is_likelier_there_than_not_predicts_without_being_named():
    found = improve(session(lambda scene: play_of_axis_4(scene) + 1.2 * on_a_soft_pedestal(scene), seed=3))
    assert found.before.verdict.effects == ("joint_backlash",)
    last = found.rungs[-1]
    assert (last.added, last.named) == ("base_compliance", False)
    assert 2.3 <= last.log_evidence < 6.5
    assert last.cv_rms_m < found.rungs[-2].cv_rms_m


def test_nothing_stands_in_where_nothing_is_missing():
    found = improve(synthetic.session(seed=6))
    assert found.before.verdict.status == "adequate"
    assert [r.added for r in found.rungs if r.added not in ("", "bending_place")] == []
