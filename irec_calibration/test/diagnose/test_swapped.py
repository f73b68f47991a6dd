# SPDX-License-Identifier: Apache-2.0
"""An effect whose fitted values are rather those of another one gives way to that, and takes nothing beside it along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose.candidates import options, try_option
from irec_calibration.diagnose.explanation import Explanation, explain
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.diagnose.study import prepare
from irec_calibration.diagnose.swapped import as_rather, told_apart
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Term

TURNED = np.array([[0.0, -0.09, 0.0], [0.09, 0.0, 0.0], [0.0, 0.0, 0.0]])
ONE_SIDED = np.array([[0.0, -0.09, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
BOTH = np.array([[0.0, -0.09, 0.05], [0.09, 0.0, 0.0], [0.0, -0.06, 0.0]])


def _with_gain(wrong_by: np.ndarray) -> tuple:
    """Start, the model with sensor_gain on it, what else could come in, and the family, where the force is read wrongly."""
    clean = synthetic.session(poses=20, seed=4)
    read = replace(clean, force_in_tool=clean.force_in_tool @ np.linalg.inv(np.eye(3) + wrong_by).T)
    study = prepare(read, (Term(find_effect("joint_torsion")),))
    found, _ = options(study, [find_effect("sensor_gain"), find_effect("sensor_alignment")])
    family = family_of(study)
    start = Explanation((), study, 0.0, grow(study.bench, family, study.base))
    trial = try_option(Ground(study.bench, study.base), next(o for o in found if o.effect.id == "sensor_gain"), study.ready)
    one = explain(start, start, trial, family)
    assert one is not None
    return start, one, found, family


@pytest.mark.parametrize(
    ("wrong_by", "named"), [(TURNED, "sensor_alignment"), (ONE_SIDED, "sensor_gain")], ids=["turned", "one axis reads another"]
)
def test_crosstalk_that_turns_the_force_is_a_turned_sensor_in_a_model_on_the_way(wrong_by: np.ndarray, named: str) -> None:
    start, with_gain, found, family = _with_gain(wrong_by)
    one, evidence = as_rather(start, with_gain, {"sensor_gain": 40.0}, found, family, SETTINGS)
    assert one.ids == (named,) and evidence == {named: 40.0}
    assert one.log_evidence > with_gain.log_evidence - SETTINGS.nats_to_separate


@pytest.mark.parametrize(
    ("wrong_by", "named"),
    [(BOTH, ("sensor_gain", "sensor_alignment")), (ONE_SIDED, ("sensor_gain",))],
    ids=["turned besides", "one axis reads another"],
)
def test_a_turned_sensor_that_crosstalk_holds_besides_is_an_effect_of_its_own(wrong_by: np.ndarray, named: tuple) -> None:
    start, with_gain, found, family = _with_gain(wrong_by)
    one, evidence = told_apart(start, with_gain, {"sensor_gain": 40.0}, found, family, SETTINGS)
    assert one.ids == named and set(evidence) == set(named)
    assert one.log_evidence > with_gain.log_evidence - SETTINGS.nats_to_prefer
    if "sensor_alignment" in named:
        assert one.term("sensor_alignment").estimates["w_z"].value == pytest.approx(0.09, abs=0.01)
        assert not {"e_xy", "e_yx"} & set(one.term("sensor_gain").estimates)


@pytest.mark.parametrize(
    ("values", "turned_by"),
    [
        ({"e_xy": -0.066, "e_yx": 0.070, "e_xz": 0.04}, 0.068),
        ({"e_xy": -0.066, "e_yx": 0.040}, None),
        ({"e_xy": 0.056, "e_yx": -0.055, "e_xx": 0.056, "e_yz": -0.13, "e_zy": -0.13}, None),  # alike by chance
        ({"e_xy": -0.012, "e_yx": 0.013}, None),  # no mounting is better
        ({"e_xy": -0.066}, None),
    ],
)
def test_two_axes_that_read_each_other_alike_are_a_turned_sensor(values: dict, turned_by: float | None) -> None:
    held = find_effect("sensor_gain").holds(values)
    assert (held is None) == (turned_by is None)
    if held is not None:
        assert held == ("sensor_alignment", {"w_z": pytest.approx(turned_by)}, {"e_xy", "e_yx"})


@pytest.mark.parametrize(
    ("values", "other"),
    [
        ({"e_xy": -0.09, "e_yx": 0.08, "e_zy": 0.01}, "sensor_alignment"),
        ({"e_xz": -0.05, "e_zx": 0.05, "e_xy": -0.06, "e_yx": 0.06}, ""),
        ({"e_xy": -0.09}, ""),
        ({"e_xx": 0.05, "e_yy": -0.05}, ""),
        ({}, ""),
    ],
)
def test_what_crosstalk_is_rather(values: dict[str, float], other: str) -> None:
    assert find_effect("sensor_gain").rather(values, {}, scene_of(synthetic.session(poses=2))) == other


@pytest.mark.parametrize(("turn", "simpler"), [({"w_z": 0.1}, True), ({"w_y": 0.02, "w_z": -0.03}, False), ({"w_x": 0.1}, False)])
def test_a_turned_sensor_is_simpler_than_crosstalk_if_turned_about_the_flange(turn: dict[str, float], simpler: bool) -> None:
    assert find_effect("sensor_alignment").simpler(turn) == simpler
