# SPDX-License-Identifier: Apache-2.0
"""Friction that is in no gear: in the force sensor, under base_link. No gear is named for it, and gears keep their name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.diagnose.memories import HELD, held_back
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from numpy.typing import NDArray
from test_diagnose import session

Array = NDArray[np.float64]


def slider(x: Array, pose: Array, load_case: Array, threshold: float) -> Array:
    """What a slider holds of x (n,), row by row in the order of the load cases, nothing at each reference."""
    out, held, last, now = np.zeros_like(x), 0.0, 0.0, -1
    for i in np.lexsort((load_case, pose)):
        if pose[i] != now:
            held, last, now = 0.0, x[i], pose[i]
        held = float(np.clip(held + x[i] - last, -threshold, threshold))
        last, out[i] = x[i], held
    return out


def sensor_with_friction(scene: Scene) -> Array:
    """The force sensor shows less of each change than there is: two sliders, as its own material has them."""
    f = scene.force_in_tool
    held = sum(np.stack([slider(f[:, a], scene.pose, scene.load_case, t) for a in range(3)], axis=1) for t in (60.0, 250.0))
    springs = np.full(6, 3e-7)
    in_base = np.einsum("nij,nj->ni", scene.kin.R_tool, held)
    torque = np.einsum("nik,ni->nk", scene.kin.jacobian(scene.p_tcp), in_base)
    return -np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), springs * torque)


def pedestal_with_friction(scene: Scene) -> Array:
    """base_link turns on its bolts, which slip."""
    in_base = np.einsum("nij,nj->ni", scene.kin.R_tool, scene.force_in_tool)
    moment = np.cross(scene.p_tcp, in_base)
    held = np.stack([slider(moment[:, a], scene.pose, scene.load_case, 900.0) for a in range(3)], axis=1)
    return np.cross(-1e-7 * held, scene.p_observed)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [pytest.param(sensor_with_friction, marks=pytest.mark.long), pedestal_with_friction])
def test_friction_outside_of_the_gears_opens_no_gear(hidden: Callable[[Scene], Array]) -> None:
    verdict = diagnose(session(hidden)).verdict
    assert "joint_hysteresis" not in verdict.effects, verdict.text
    assert verdict.status == "unexplained", verdict.text


def test_a_slider_holds_a_change_up_to_its_threshold_and_follows_beyond() -> None:
    scene = scene_of(synthetic.session(4, seed=1))
    x = (scene.force_in_tool - scene.force_in_tool[scene.reference])[:, :1]
    for share in HELD:
        threshold = share * np.abs(x).max(axis=0)
        expected = -slider(x[:, 0], scene.pose, scene.load_case, float(threshold[0]))
        np.testing.assert_allclose(held_back(scene, x, threshold)[:, 0], expected, atol=1e-9)
