# SPDX-License-Identifier: Apache-2.0
"""A payload that a loaded session does not state, found by the torque at which play is crossed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import Ladder, compare, improve, payload
from irec_calibration.diagnose.payload import with_payload_as_shown
from irec_calibration.diagnose.study import completed_study, prepare
from irec_calibration.effects.of_session import carrying, scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import default_terms
from irec_calibration.model import Model
from irec_calibration.model.file import load_model, save_model
from irec_calibration.robot import Payload
from irec_calibration.session import Session
from irec_calibration.typing import Array

TOOL = Payload(120.0, (-0.02, 0.01, -0.15))
PLAY = 8e-4  # rad, in axes 4 and 5


def play(carried: Payload | None, width: float = PLAY, over: float = 15.0) -> Callable[[Scene], Array]:
    """Play of two axes of the wrist, crossed at zero torque of process, links and a payload, written out; rad, and N m in which
    it is crossed."""

    def moved(scene: Scene) -> Array:
        robot, q = scene.robot, scene.q
        tau = scene.tau_acting + robot.gravity_torque(q, (0.0, 0.0, -9.81), carried)
        return sum(0.5 * width * np.tanh(tau[:, k] / over)[:, None] * scene.J[:, :, k] for k in (3, 4))

    return moved


@cache
def measured(mass: bool) -> Session:
    """Without a word on the payload."""
    return synthetic.session(40, 3, extra=play(TOOL if mass else None))


def as_shown(session: Session) -> Session:
    return with_payload_as_shown(session, completed_study(prepare(session, default_terms(session))))


@cache
def shown() -> Session:
    return as_shown(measured(True))


@cache
def improved() -> Ladder:
    return improve(measured(True))


@pytest.mark.long
def test_the_mass_of_a_tool_that_nobody_stated_is_found() -> None:
    found = shown().payload
    about = np.linalg.norm(TOOL.com) / np.linalg.norm(found.com)  # its moment is what shows
    assert found.mass == pytest.approx(about * TOOL.mass, rel=0.5)
    assert any("no payload is stated" in note and "which is taken: state it" in note for note in shown().notes)


@pytest.mark.long
def test_where_it_sits_is_found_too_since_narrow_play_asks_for_it() -> None:
    """Ten centimetres of a head of 120 kg are 120 N m about the wrist, and this play is crossed within 10."""
    head = Payload(120.0, (0.1, -0.08, -0.1))
    ladder = improve(synthetic.session(30, 3, extra=play(head, width=5e-4, over=5.0)))
    assert ladder.before.verdict.parts["joint_backlash"].proven == ("axis 4", "axis 5")
    assert ladder.model.figures["cv_rms_m"] < 1.3 * ladder.before.noise.claimed_m  # 2.9 with the mass alone


@pytest.mark.parametrize(("mass", "sought"), [(60.0, False), (0.01, True)])  # a simulator asks for some mass of every link
def test_none_is_sought_where_the_robot_description_has_the_tool(monkeypatch, mass, sought) -> None:
    session = measured(False)
    asked: list[object] = []
    monkeypatch.setattr(payload, "_evidence", lambda *one: asked.append(one) or {})
    monkeypatch.setattr(type(session.robot), "tool_mass", mass)
    assert as_shown(session) is session
    assert bool(asked) == sought


def test_where_there_is_none_none_is_found() -> None:
    for session in (measured(False), synthetic.session(20, 1)):
        assert as_shown(session) is session


def test_a_payload_that_is_stated_is_believed() -> None:
    stated = replace(measured(True), payload=Payload(10.0))
    assert as_shown(stated) is stated


def test_play_is_found_by_a_session_that_does_not_state_the_tool() -> None:
    verdict = improved().before.verdict
    assert "joint_backlash" in (*verdict.effects, *(i for s in verdict.one_of for i in s))


def test_a_model_counts_on_the_payload_wherever_none_is_stated(tmp_path) -> None:
    model = load_model(save_model(improved().model, tmp_path / "model.yaml"))
    assert model.carried == shown().payload
    other = synthetic.session(20, 9, extra=play(TOOL))
    scene, heavier = scene_of(other, observe="tcp"), scene_of(replace(other, payload=model.carried), observe="tcp")
    np.testing.assert_allclose(model.predict(scene), model.predict(heavier), atol=1e-12)
    bare = Model(model.terms)
    left = [compare(s, m.terms).rms_m for s, m in ((carrying(other, model.carried), model), (other, bare))]
    assert left[0] < 0.8 * left[1]
