# SPDX-License-Identifier: Apache-2.0
"""Which axis has it: on sessions whose cause is written out here, an axis is named only where the data prove it."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import Diagnosis, Ladder, add_effect, diagnose, improve, start_terms
from irec_calibration.diagnose.parts import prune
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.scene import Scene
from irec_calibration.effects.user import effect_from_text
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model.file import load_model, save_model
from irec_calibration.session import Session
from numpy.typing import NDArray

Array = NDArray[np.float64]
POSES = 20
# arm stretched: axis 2, axis 3 and TCP lie in one line, so that axes 2 and 3 move the TCP alike and carry torques in proportion
STRETCHED = ((-0.7, 0.1, -1.55, -1.5, -0.02, -1.5), (0.7, 0.9, -1.53, 1.5, 0.02, 1.5))


def turned(scene: Scene, axis: int, angle: Array) -> Array:
    """Displacement of the marker when one axis (from 1) turns by (n,) rad."""
    return scene.kin.jacobian(scene.p_observed)[:, :, axis - 1] * angle[:, None]


def gear(scene: Scene, axis: int, soft_until: float, compliance: float) -> Array:
    """A gear with further compliance (rad/(N m)) up to a torque (N m)."""

    def wound(torque: Array) -> Array:
        return compliance * np.clip(torque, -soft_until, soft_until)

    gravity = scene.tau_gravity[:, axis - 1]
    return turned(scene, axis, wound(scene.tau[:, axis - 1] + gravity) - wound(gravity))


def play(scene: Scene, axis: int, half: float) -> Array:
    """Lost motion, half of it to each side, rad."""
    return turned(scene, axis, half * np.clip((scene.tau + scene.tau_gravity)[:, axis - 1] / 5.0, -1.0, 1.0))


def axis_3_stiffens(scene: Scene) -> Array:
    return gear(scene, 3, 900.0, 4e-7)


def axes_1_and_5_stiffen(scene: Scene) -> Array:
    return gear(scene, 1, 900.0, 4e-7) + gear(scene, 5, 200.0, 1.2e-6)


def play_in_axes_1_and_4(scene: Scene) -> Array:
    return play(scene, 1, 2e-4) + play(scene, 4, 2e-4)


def axis_1_is_soft_near_zero(scene: Scene) -> Array:
    return gear(scene, 1, 600.0, 5e-7)


def axis_4_softer_in_four_steps(scene: Scene) -> Array:
    # steps end at 2, 5, 8 and 12 % of the rated torque: most of it where a gear would have play
    steps = ((50.0, 5e-6), (120.0, 1.8e-6), (200.0, 0.8e-6), (300.0, 0.4e-6))
    return sum((gear(scene, 4, until, more) for until, more in steps), np.zeros((len(scene), 3)))


def axis_4_softer_in_two_steps(scene: Scene) -> Array:
    # steps end at 2 and 4 % of the rated torque: play ends between them
    steps = ((50.0, 5e-6), (100.0, 2e-6))
    return sum((gear(scene, 4, until, more) for until, more in steps), np.zeros((len(scene), 3)))


def axis_3_stiffens_a_little(scene: Scene) -> Array:
    torque, gravity = scene.tau[:, 2], scene.tau_gravity[:, 2]
    return turned(scene, 3, -1.6e-14 * ((torque + gravity) ** 3 - gravity**3))


def axis_1_lags_and_axis_5_a_little(scene: Scene) -> Array:
    return turned(scene, 1, 0.2 * scene.step[:, 0]) + turned(scene, 5, 0.02 * scene.step[:, 4])


@cache
def session(hidden: Callable[[Scene], Array], seed: int = 6) -> Session:
    if hidden is axis_3_stiffens_a_little:
        return synthetic.session(poses=POSES, seed=seed, extra=hidden, joints=STRETCHED)
    return synthetic.session(poses=POSES, seed=seed, extra=hidden)


@cache
def diagnosis(hidden: Callable[[Scene], Array], seed: int = 6) -> Diagnosis:
    return diagnose(session(hidden, seed))


@cache
def ladder() -> Ladder:
    return improve(session(axis_3_stiffens))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "effect", "axes"),
    [
        (axis_3_stiffens, "joint_stiffening", ("axis 3",)),
        pytest.param(axes_1_and_5_stiffen, "joint_stiffening", ("axis 1", "axis 5"), marks=pytest.mark.long),
        pytest.param(play_in_axes_1_and_4, "joint_backlash", ("axis 1", "axis 4"), marks=pytest.mark.long),
    ],
)
def test_the_axes_that_have_it_are_named_and_no_others(
    hidden: Callable[[Scene], Array], effect: str, axes: tuple[str, ...]
) -> None:
    found = diagnosis(hidden)
    said = found.verdict.parts[effect]
    assert (said.proven, said.one_of, said.perhaps) == (axes, (), ())
    assert f"({', '.join(axes)})" in found.verdict.text
    assert found.candidates[0].groups == axes


def test_each_named_axis_has_its_evidence_value_and_error() -> None:
    found = diagnosis(axes_1_and_5_stiffen)
    assert min(found.verdict.parts["joint_stiffening"].log_evidence.values()) > 6.5
    for name in ("a_1", "a_5"):
        value = found.candidates[0].parameters[name]
        assert value["value"] < -3.0 * value["se"]


@pytest.mark.slow
def test_axes_that_these_poses_do_not_tell_apart_are_not_named_but_said_to_be_so() -> None:
    found = diagnosis(axis_3_stiffens_a_little, 4)
    said = found.verdict.parts["joint_stiffening"]
    assert said.proven == ()
    assert set(said.one_of) == {("axis 2",), ("axis 3",)}
    assert "these data do not tell them apart" in found.verdict.text
    assert "Missing: joint stiffening. " in found.verdict.text


def test_a_measurement_that_would_tell_the_axes_apart_is_proposed() -> None:
    found = diagnosis(axis_3_stiffens_a_little, 4)
    first = found.next_measurements[0]
    assert set(first.separates) == {"joint_stiffening:axis 2", "joint_stiffening:axis 3"}
    assert first.gain > 0.0
    assert "separates these axes" in found.verdict.text


def test_the_result_file_tells_what_is_proven_from_what_is_not() -> None:
    sure = json.loads(json.dumps(diagnosis(axis_3_stiffens).to_json()))["verdict"]["parts"]["joint_stiffening"]
    assert (sure["proven"], sure["one_of"]) == (["axis 3"], [])
    unsure = json.loads(json.dumps(diagnosis(axis_3_stiffens_a_little, 4).to_json()))["verdict"]["parts"]["joint_stiffening"]
    assert (unsure["proven"], sorted(unsure["one_of"])) == ([], [["axis 2"], ["axis 3"]])


@pytest.mark.slow
@pytest.mark.long
def test_the_improved_model_has_parameters_of_the_proven_axis_only(tmp_path) -> None:
    model = load_model(save_model(ladder().model, tmp_path / "m.yaml"))
    term = next(t for t in model.terms if t.effect.id == "joint_stiffening")
    assert set(term.estimates) == {"a_3", "w_3", "u_3", "x_0", "slow"}
    assert term.estimates["a_3"].se > 0.0
    parts = next(h["parts"] for h in model.history if "joint_stiffening" in h.get("parts", {}))
    assert parts["joint_stiffening"]["proven"] == ["axis 3"]


def test_the_model_without_the_idle_axes_predicts_held_out_poses_as_well() -> None:
    plain, improved = ladder().rungs[0], ladder().rungs[-1]
    assert improved.cv_rms_m < 0.5 * plain.cv_rms_m


def test_adding_an_effect_by_hand_adds_the_axes_that_need_it() -> None:
    model = model_of(identify(session(play_in_axes_1_and_4), blank_model(EIGHTEEN_DOF)))
    new, _, _ = add_effect(model, find_effect("joint_backlash"), session(play_in_axes_1_and_4))
    assert set(new.terms[-1].estimates) == {"b_1", "b_4", "w", "uneven", "held"}


def test_settling_what_is_settled_changes_nothing() -> None:
    model = ladder().model
    study = prepare(session(axis_3_stiffens), model.terms)
    again = prune(study, ["joint_stiffening"])
    assert again.study is study
    assert again.parts["joint_stiffening"].proven == ("axis 3",)


@pytest.mark.slow
def test_an_axis_with_a_hundredth_of_the_effect_is_in_the_model_but_not_named() -> None:
    # as much could come from an effect whose form is not quite right
    lagging = session(axis_1_lags_and_axis_5_a_little)
    last = improve(lagging).rungs[-1]
    said = last.parts["joint_settling"]
    assert (said.proven, said.perhaps) == (("axis 1",), ("axis 5",))
    assert set(last.model.terms[-1].estimates) == {"a_1", "a_5", "travel", "over"}
    assert "Perhaps also axis 5" in diagnosis(axis_1_lags_and_axis_5_a_little).verdict.text


def test_an_effect_without_axes_has_no_parts() -> None:
    terms = (*start_terms(session(axis_3_stiffens)), *blank_model(["marker_offset"]))
    assert prune(prepare(session(axis_3_stiffens), terms), ["marker_offset"]).parts == {}


@pytest.mark.slow
def test_an_effect_that_another_one_makes_needless_is_not_named_beside_it() -> None:
    # play fits a gear that is soft near zero torque before the gear's own effect is tried at the right softness
    assert diagnosis(axis_1_is_soft_near_zero, 5).verdict.effects == ("joint_stiffening",)


@pytest.mark.slow
@pytest.mark.long
def test_a_formula_that_somebody_registered_does_not_take_a_cause_its_name() -> None:
    # it mends the form of stiffening a little, and then neither of both is stronger than structure of unknown form
    effect_from_text("axis 1: slope * tau**3")
    assert diagnose(session(axis_1_is_soft_near_zero, 5)).verdict.effects == ("joint_stiffening",)


@pytest.mark.slow
def test_a_gear_that_is_soft_over_a_small_range_is_not_said_to_have_play() -> None:
    said = diagnosis(axis_4_softer_in_four_steps).verdict
    assert "joint_backlash" not in said.effects
    assert said.effects == ("joint_stiffening",) or ("joint_backlash", "joint_stiffening") in said.one_of, said.text
