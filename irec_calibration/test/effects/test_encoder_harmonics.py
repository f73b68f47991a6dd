# SPDX-License-Identifier: Apache-2.0
"""What harmonics of an encoder can't be, and what else they may be."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose.candidates import options
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import encoder_harmonics, find_effect
from irec_calibration.effects.encoder_harmonics import EncoderHarmonics
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Term

EFFECT = EncoderHarmonics()


def called(monkeypatch: pytest.MonkeyPatch, first: float, second: float, gravity: tuple[float, float]) -> str:
    """What harmonics of so many rad of two axes may be called too, of which the weight turns each by so many N m at most."""
    monkeypatch.setattr(encoder_harmonics, "rated_torque", lambda _: np.array([1000.0, 1000.0]))
    scene = arm(200.0)
    scene.tau_gravity, scene.robot = np.array([gravity, (0.0, 0.0)]), None
    theta = np.array([first, 0.0, 0.0, 0.0, second, 0.0, 0.0, 0.0])
    return EFFECT.also_called(scene, theta, np.full(8, 1e-5))


@pytest.mark.parametrize(
    ("first", "second", "gravity", "expected"),
    [
        (1e-4, 1e-5, (0.0, 300.0), "joint_backlash"),  # that of the second are within their errors
        (1e-4, 1e-4, (0.0, 300.0), ""),
        (1e-4, 0.0, (300.0, 300.0), ""),
        (1e-5, 1e-5, (0.0, 0.0), ""),
    ],
)
def test_harmonics_of_an_axis_that_no_weight_turns_may_be_play(monkeypatch, first, second, gravity, expected) -> None:
    assert called(monkeypatch, first, second, gravity) == expected


@pytest.mark.parametrize(
    ("second_harmonic", "expected"),
    [
        (0.0, "joint_backlash"),  # that of an axis that crosses its play slowly
        (5e-5, "joint_backlash"),  # flattened, as an axis that crosses it faster
        (-8e-5, ""),  # steepest where play is crossed the other way
    ],
)
def test_harmonics_of_a_shape_that_play_does_not_have_are_those_of_an_encoder(monkeypatch, second_harmonic, expected) -> None:
    monkeypatch.setattr(encoder_harmonics, "rated_torque", lambda _: np.array([1000.0, 1000.0]))
    scene = arm(200.0)
    scene.tau_gravity, scene.robot = np.zeros((1, 2)), None
    assert EFFECT.also_called(scene, np.array([1e-4, 0.0, second_harmonic, 0.0, *[0.0] * 4]), np.full(8, 1e-6)) == expected


@pytest.mark.parametrize("travel", [80.0, 200.0, 320.0])
@pytest.mark.parametrize("width", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("side", [-0.4, 0.0, 0.3])
def test_harmonics_that_were_fitted_to_play_may_be_play(monkeypatch, travel, width, side) -> None:
    monkeypatch.setattr(encoder_harmonics, "rated_torque", lambda _: np.array([1000.0, 1000.0]))
    scene = arm(travel)
    scene.tau_gravity, scene.robot = np.zeros((1, 2)), None
    angle = scene.q[:, 0]
    play = 1e-4 * np.tanh(np.sin(angle - side) / width)
    waves = np.stack([np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle), np.ones_like(angle)], axis=1)
    fitted = np.linalg.solve(waves.T @ waves + 1e-6 * np.eye(5), waves.T @ play)[:4]
    assert EFFECT.also_called(scene, np.array([*fitted, *[0.0] * 4]), np.full(8, 1e-7)) == "joint_backlash"


def arm(travel: float) -> Any:
    """A scene of two axes, each of which is used over a travel in degrees."""
    q = np.radians(travel) * np.linspace(-0.5, 0.5, 40)[:, None] * np.ones(2)
    kin = SimpleNamespace(is_prismatic=np.zeros(2, bool))
    return SimpleNamespace(kind="absolute", q=q, driven=np.array([True, True]), kin=kin)


def why(travel: float, *, a1: float = 0.0, b1: float = 0.0, b2: float = 0.0, se: float = 1e-5, axis: int = 1) -> str:
    return EFFECT.why_impossible({f"{n}_{axis}": (v, se) for n, v in (("a1", a1), ("b1", b1), ("b2", b2))}, {}, arm(travel))


def test_a_curve_that_millirads_leave_of_each_other_is_no_encoder() -> None:
    said = why(60.0, b1=2e-3, b2=-0.45e-3, axis=2)
    assert "axis 2" in said and "0.0021 rad" in said and "smooth curve" in said


@pytest.mark.parametrize("travel", [60.0, 120.0, 320.0])
def test_an_eccentric_encoder_is_one_over_any_travel(travel: float) -> None:
    assert not why(travel, a1=1e-4, b1=1e-4)


def test_harmonics_that_may_as_well_be_small_are_not_held_against_it() -> None:
    assert not why(60.0, b1=2e-3, b2=-0.45e-3, se=1e-3)


def test_what_small_harmonics_of_another_axis_do_is_not_asked() -> None:
    values = {"a1_1": (1e-4, 1e-5), "b1_2": (2e-4, 1e-5), "b2_2": (-0.45e-4, 1e-5)}
    assert not EFFECT.why_impossible(values, {}, arm(60.0))


def test_a_loaded_session_tells_of_no_encoder() -> None:
    """Whatever their size: a joint that stands elsewhere, a hose or a warm link goes with the same angles."""
    scene = arm(120.0)
    assert EFFECT.why_impossible({"a1_1": (1e-4, 1e-5)}, {}, scene) == ""
    scene.kind = "loaded"
    assert "absolute session" in EFFECT.why_impossible({"a1_1": (1e-4, 1e-5)}, {}, scene)


def test_a_diagnosis_of_a_loaded_session_does_not_weigh_it_and_says_why() -> None:
    found, skipped = options(prepare(synthetic.session(poses=6), (Term(find_effect("joint_torsion")),)))
    assert "encoder_harmonics" not in [o.effect.id for o in found]
    assert "absolute session" in skipped["encoder_harmonics"]


def test_no_encoder_is_worse_in_a_loaded_session_than_in_an_absolute_one() -> None:
    loaded, absolute = (EFFECT.parameters(scene_of(s)) for s in (synthetic.session(2), absolute_sessions.session(poses=4)))
    limits = {p.plausible for p in (*loaded, *absolute)}
    assert limits == {(-encoder_harmonics.LARGEST, encoder_harmonics.LARGEST)}
