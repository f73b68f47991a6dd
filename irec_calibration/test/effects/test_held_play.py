# SPDX-License-Identifier: Apache-2.0
"""Play that a seal holds where it is: a gear without weight on it stays on the side on which its last load left it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.effects import find_effect
from irec_calibration.effects.joint_backlash import HELD_UP_TO
from irec_calibration.effects.live import Tick
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.robot.ratings import rated_torque
from synthetic import session

BACKLASH, PLAY, W = find_effect("joint_backlash"), 4e-4, 0.005


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(session(8, seed=4))


def theta(scene: Scene, axis: int, held: float) -> np.ndarray:
    values = {f"b_{axis + 1}": PLAY, "w": W, "held": held}
    return np.array([values.get(p.name, p.start) for p in BACKLASH.parameters(scene)])


def test_an_axis_without_weight_stays_at_the_next_reference_where_the_last_load_left_it(scene: Scene) -> None:
    assert not scene.tau_gravity[:, 0].any(), "axis 1 stands upright"
    r = HELD_UP_TO * W * rated_torque(scene.robot)[0]
    side = 2.0 * (np.einsum("nik,ni->nk", scene.J, BACKLASH.displacement(scene, theta(scene, 0, 1.0)))[:, 0]) / PLAY
    side /= (scene.J[:, :, 0] ** 2).sum(axis=1)
    order = np.lexsort((scene.load_case, scene.stamp))
    strong, compared = [i for i in order if abs(scene.tau[i, 0]) > 3.0 * r], 0
    for row in (i for i in order if scene.load_case[i] == 0):
        before = [i for i in strong if scene.stamp[i] < scene.stamp[row]]
        later = [i for i in order if before and scene.stamp[before[-1]] < scene.stamp[i] < scene.stamp[row]]
        if before and not any(abs(scene.tau[i, 0]) > r for i in later):
            held = np.sign(scene.tau[before[-1], 0]) * np.tanh(HELD_UP_TO)
            assert side[row] == pytest.approx(held, abs=0.03), "the sensor reads a little at rest"
            compared += 1
    assert compared > 3


def test_a_weight_that_holds_the_gear_to_one_side_leaves_nothing_of_the_memory(scene: Scene) -> None:
    """Axis 2 carries the arm; what is the same in all rows cancels against the reference."""
    heavy = replace(scene, gravity=replace(scene.gravity, tau=scene.gravity.tau + 50.0 * rated_torque(scene.robot)))
    held, free = (BACKLASH.displacement(heavy, theta(heavy, 1, kind)) for kind in (1.0, 0.0))
    np.testing.assert_allclose(held, free, atol=1e-12)


@pytest.mark.parametrize("held", [0.0, 1.0])
def test_the_live_form_crosses_the_play_where_the_session_does(scene: Scene, held: float) -> None:
    live = BACKLASH.live(scene, theta(scene, 0, held))
    soft = W * rated_torque(scene.robot)[0]
    tick, turned = Tick(scene.n_joints), []
    for torque in (6.0, 0.0, -1.0, -6.0, 0.0):
        tau = np.zeros(scene.n_joints)
        tau[0] = torque * soft
        turned.append(float(live.displacement(tick, tau)[0]) / (0.5 * PLAY))  # type: ignore[union-attr]
    r = HELD_UP_TO * held
    followed = [6.0 - r, r, r - 1.0 if held else -1.0, r - 6.0, -r]
    np.testing.assert_allclose(turned, np.tanh(followed))
