# SPDX-License-Identifier: Apache-2.0
"""A force sensor of another unit is no robot that has changed: one factor for all of the deflection gives it away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.identification.identify import identify
from irec_calibration.model import EIGHTEEN_DOF, Model, blank_model
from irec_calibration.procedure.settings import Acceptance
from irec_calibration.recertification.force_scale import scale_doubt
from irec_calibration.recertification.judgement import Judgement, judge
from irec_calibration.session import Session

ACCEPTANCE = Acceptance(min_poses=5, held_out_share=0.3, held_out_rms_m=1e-4, max_ratio_to_old=1.05, max_noise_floors=6.0)


def judged(gain: float, **robot: object) -> Judgement:
    """A session of a robot whose sensor reads `gain` of the force, against the calibration of before."""
    before = synthetic.session(25, 5)
    in_force = Model(identify(before, blank_model(EIGHTEEN_DOF)).terms)
    return judge(scaled(synthetic.session(15, 6, **robot), gain), in_force, before, ACCEPTANCE, 3e-4)  # type: ignore[arg-type]


def scaled(session: Session, gain: float) -> Session:
    torque = session.torque_in_tool
    return replace(session, force_in_tool=gain * session.force_in_tool, torque_in_tool=gain * torque)


@pytest.mark.parametrize(
    ("gain", "likely"), [(1.0 / 4.448, "pounds (lbf)"), (4.448, "taken for pounds"), (0.5, "gain seems to be 0.5")]
)
def test_a_sensor_of_another_scale_is_to_be_looked_at_and_its_calibration_not_put_in_force(gain: float, likely: str) -> None:
    found = judged(gain)
    assert found.verdict == "investigate: force sensor" and likely in found.text and "hang a known weight" in found.text


def test_a_robot_that_has_not_changed_raises_no_doubt_of_the_sensor() -> None:
    assert judged(1.0).verdict == "pass"


def test_a_robot_one_axis_of_which_is_twice_as_soft_is_no_sensor() -> None:
    softer = synthetic.COMPLIANCE * np.where(np.arange(6) == 1, 2.0, 1.0)
    assert "force sensor" not in judged(1.0, compliance=softer).verdict


def test_what_one_factor_does_not_explain_is_no_scale() -> None:
    rng = np.random.default_rng(1)
    predicted = rng.normal(0.0, 1e-3, (200, 3))
    assert "4 times as far" in scale_doubt(4.0 * predicted, predicted)
    assert not scale_doubt(4.0 * predicted + rng.normal(0.0, 2e-3, (200, 3)), predicted)
    assert not scale_doubt(-4.0 * predicted, predicted) and not scale_doubt(predicted, 0.0 * predicted)
