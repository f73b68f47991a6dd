# SPDX-License-Identifier: Apache-2.0
"""A hose that is fixed to a link of the wrist pulls whenever the process is on, in a direction that turns with the wrist."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.typing import Array

PULL = np.array([60.0, -45.0, 30.0])  # N, along the frame of link 5


def of_link_5(scene: Scene) -> Array:
    """The pull in base_link, (n, 3), N."""
    return scene.kin.R_joint[:, 4] @ PULL * (scene.load_case > 0)[:, None]


def moves_the_tool(scene: Scene) -> Array:
    tau = np.einsum("nik,ni->nk", scene.kin.jacobian(scene.p_tcp), of_link_5(scene))
    return np.asarray(np.einsum("nik,nk->ni", scene.J, tau * synthetic.COMPLIANCE))


def test_along_axes_of_the_tool_it_is_what_turns_with_the_last_axis() -> None:
    scene, effect = scene_of(synthetic.session(poses=6)), find_effect("external_force")
    names = [p.name for p in effect.parameters(scene)]
    shape = [f"f_{a}_tool{t}" for t in ("", "_sin6", "_cos6") for a in "xyz"]
    columns = np.stack([effect.pull(scene, np.eye(len(names))[names.index(n)])[0] for n in shape], axis=2)
    in_tool = np.einsum("nji,nj->ni", scene.kin.R_tool, of_link_5(scene))
    values = np.linalg.lstsq(columns.reshape(-1, len(shape)), in_tool.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns @ values, in_tool, atol=1e-9)


@pytest.mark.slow
def test_it_is_named_and_no_other_place_of_it_is_proven() -> None:
    verdict = diagnose(synthetic.session(seed=3, extra=moves_the_tool)).verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert set(verdict.parts["external_force"].proven) <= {"with the tool", "with the tool and axis 6"}, verdict.text
