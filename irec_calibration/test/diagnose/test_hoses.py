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
from irec_calibration.model import Estimate, Term, total_displacement
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
    columns = np.stack([effect.torque_of_pull(scene, np.eye(len(names))[names.index(n)]) for n in shape], axis=2)
    tau = np.einsum("nik,ni->nk", scene.kin.jacobian(scene.p_tcp), of_link_5(scene))
    values = np.linalg.lstsq(columns.reshape(-1, len(shape)), tau.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns @ values, tau, atol=1e-9)


def test_a_dress_pack_between_forearm_and_flange_bends_the_wrist_alone() -> None:
    scene = scene_of(synthetic.session(poses=6))
    springs = Term(find_effect("joint_torsion"), {f"c_{k + 1}": Estimate(c) for k, c in enumerate(synthetic.COMPLIANCE)})
    values = dict(zip((f"f_{d}_pack" for d in ("along", "a", "b")), PULL, strict=True))
    pack = Term(find_effect("external_force"), {n: Estimate(v) for n, v in values.items()})
    kin = scene.kin
    force = PULL[0] * kin.axis[:, 2] + PULL[1] * kin.virtual_axis[:, 2, 0] + PULL[2] * kin.virtual_axis[:, 2, 1]
    expected = np.zeros((len(scene), 3))
    for k in (3, 4, 5):  # the forearm carries back what the flange is pulled by, so that no axis before it feels a torque
        torque = np.einsum("ni,ni->n", kin.axis[:, k], np.cross(kin.origin[:, 5] - kin.origin[:, k], force))
        turned = synthetic.COMPLIANCE[k] * torque * (scene.load_case > 0)
        expected += turned[:, None] * np.cross(kin.axis[:, k], scene.p_observed - kin.origin[:, k])
    moved = total_displacement([springs, pack], scene) - total_displacement([springs], scene)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    tau = pack.effect.torque_of_pull(scene, pack.theta(pack.effect.parameters(scene)))
    assert np.abs(tau[:, 3:]).max() > 1.0 and np.all(tau[:, :3] == 0.0)


@pytest.mark.slow
def test_it_is_named_and_no_other_place_of_it_is_proven() -> None:
    verdict = diagnose(synthetic.session(seed=3, extra=moves_the_tool)).verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert set(verdict.parts["external_force"].proven) <= {"with the tool", "with the tool and axis 6"}, verdict.text
