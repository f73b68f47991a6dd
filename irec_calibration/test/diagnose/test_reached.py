# SPDX-License-Identifier: Apache-2.0
"""A law of torque is not read off its tail: there a value would move the tool by far more where it bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import start_terms
from irec_calibration.diagnose.columns import block_columns
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.effects import find_effect
from irec_calibration.robot.ratings import rated_torque


@pytest.fixture(scope="module")
def study() -> Study:
    measured = synthetic.session(poses=15, seed=2)
    return prepare(measured, start_terms(measured))


def with_torque(study: Study, share: tuple[float, float]) -> Study:
    """The torque of axis 2 between two shares of what it is rated for, in all rows."""
    scene = study.ready
    low, high = np.array(share) * rated_torque(scene.robot)[1]
    tau = scene.tau_gravity.copy()
    tau[:, 1] = np.linspace(low, high, len(tau)) - scene.tau[:, 1]
    return replace(study, ready=replace(scene, gravity=replace(scene.gravity, tau=tau)))


SHAPES = [("joint_backlash", "b_2", {"w": 0.01}), ("joint_stiffening", "a_2", {"x_0": 0.1, "slow": 0.0})]


@pytest.mark.parametrize("shape", SHAPES)
def test_an_axis_that_never_comes_near_no_torque_has_no_column(study: Study, shape: tuple[str, str, dict[str, float]]) -> None:
    effect_id, name, values = shape
    bends = next(v for v in values.values())

    def size(share: tuple[float, float]) -> float:
        block, parameters = block_columns(with_torque(study, share), find_effect(effect_id), values)
        at = [p.name for p in parameters].index(name)
        return float(np.linalg.norm(block.A[:, at]))

    assert size((2.0 * bends, 5.0 * bends)) == 0.0
    assert size((bends, 5.0 * bends)) > 0.0
    assert size((-5.0 * bends, 5.0 * bends)) > 0.0
