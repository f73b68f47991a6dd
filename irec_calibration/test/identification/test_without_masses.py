# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions of other people often have no masses; a session with one is identified and diagnosed all the same."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.diagnose import diagnose
from irec_calibration.effects.of_session import scene_of
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.model import Model
from irec_calibration.robot import Robot
from irec_calibration.session import Session
from synthetic import session, urdf

WEIGHTLESS = Robot(re.sub("<inertial>.*?</inertial>", "", urdf()))


def predicted(data: Session) -> np.ndarray:
    return Model(tuple(identify(data, default_terms(data)).terms)).predict(scene_of(data))


def test_where_no_arm_sags_its_masses_change_no_prediction() -> None:
    data = session(seed=3, weight=False)
    there, without = predicted(data), predicted(replace(data, robot=WEIGHTLESS))
    assert np.sqrt(((there - without) ** 2).sum(axis=1).mean()) < 3e-6


@pytest.mark.slow
def test_a_loaded_session_is_diagnosed() -> None:
    assert diagnose(replace(session(seed=3, weight=False), robot=WEIGHTLESS)).verdict.status == "adequate"
