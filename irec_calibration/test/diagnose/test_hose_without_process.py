# SPDX-License-Identifier: Apache-2.0
"""A hose between forearm and flange in an absolute session: it bends the wrist by its angles, whatever else does."""

from __future__ import annotations

import numpy as np
import pytest
from absolute_sessions import session, torsion
from irec_calibration.diagnose import diagnose
from irec_calibration.effects import find_effect
from irec_calibration.effects.hoses import TAUT, taut
from irec_calibration.effects.of_session import scene_of
from irec_calibration.session import Noise, Session
from irec_calibration.typing import Array

COMPLIANCE = np.array([1e-6, 1e-6, 1.5e-6, 5e-6, 8e-6, 1e-5])
STIFFNESS, LENGTH = 1500.0, 0.3  # N/m, m
ON_FOREARM, ON_TOOL = np.array([0.05, 0.1, 0.2]), np.array([0.02, -0.03, -0.08])  # in the frames of joint 3 and of tool0, m
POSES = 100
NOISE = Noise(tracker_m=1.5e-5)


def hose(s: Session, p: Array) -> Array:
    """Displacement of the marker by the gears of the wrist under the pull of the hose, (n, 3), m."""
    kin = s.robot.kinematics(s.q)
    end = kin.p_tcp + kin.R_tool @ ON_TOOL
    way = kin.origin[:, 2] + kin.R_joint[:, 2] @ ON_FOREARM - end
    length = np.linalg.norm(way, axis=1, keepdims=True)
    pull = STIFFNESS * np.maximum(length - LENGTH, 0.0) * way / length
    twist = np.einsum("nik,ni->nk", kin.jacobian(end), pull) * COMPLIANCE * (np.arange(6) >= 3)
    return np.einsum("nik,nk->ni", kin.jacobian(p), twist)


def with_hose(seed: int = 3) -> Session:
    sag = torsion(COMPLIANCE)
    return session(poses=POSES, seed=seed, noise=NOISE, moved=lambda s, p: sag(s, p) + hose(s, p))


@pytest.mark.slow
def test_it_is_named_and_no_encoder_is() -> None:
    verdict = diagnose(with_hose()).verdict
    assert set(verdict.effects) == {"joint_torsion", "external_force"}, verdict.text
    assert "a hose between forearm and flange comes tight" in verdict.text


@pytest.mark.slow
def test_without_it_none_is_named() -> None:
    verdict = diagnose(session(poses=POSES, seed=3, noise=NOISE, moved=torsion(COMPLIANCE))).verdict
    assert verdict.effects == ("joint_torsion",), verdict.text


def test_all_of_its_pull_shows_where_there_is_no_reference() -> None:
    scene = scene_of(with_hose())
    values = np.array([STIFFNESS, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = np.linalg.norm(scene.kin.origin[:, 2] - scene.p_tcp, axis=1)
    force = np.linalg.norm(taut(scene, values)[:, :3, 0] * STIFFNESS, axis=1)
    np.testing.assert_allclose(force, STIFFNESS * way, rtol=1e-2)


def test_a_constant_pull_of_a_dress_pack_is_not_looked_for_beside_the_weight() -> None:
    groups = {p.group for p in find_effect("external_force").parameters(scene_of(with_hose()))}
    assert TAUT in groups
    assert not {g for g in groups if "pack" in g or "under load" in g or g == "between forearm and flange"}
