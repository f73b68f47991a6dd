# SPDX-License-Identifier: Apache-2.0
"""Stations and markers of an absolute session are placed whatever the order in which they were read."""

from __future__ import annotations

import absolute_sessions
import numpy as np
import pytest
from irec_calibration.session import Marker
from irec_calibration.session.registration import ROWS_ENOUGH, registered


@pytest.mark.parametrize("poses", [200, 620, pytest.param(1250, marks=pytest.mark.long)])
def test_markers_that_take_turns_are_all_placed_however_many_rows_there_are(poses: int) -> None:
    """Beyond `ROWS_ENOUGH` every second, or third, row would be of some of six markers only."""
    sites = tuple((0.03 * i - 0.1, (-1) ** i * 0.05, 0.05 + 0.02 * i) for i in range(5))
    markers = (*(Marker(f"M{i}", "tool0", at, known=False) for i, at in enumerate(sites)),
               Marker("B", "base_link", (0.5, 0.4, 0.1), known=False))  # fmt: skip
    measured = absolute_sessions.session(poses=poses, markers=markers)
    assert (len(measured) > ROWS_ENOUGH) == (poses > 500), "no example"
    placed = registered(measured, measured.robot.kinematics(measured.q))
    for true, found in zip(markers, placed.markers, strict=True):
        np.testing.assert_allclose(found.xyz, true.xyz, atol=5e-3, err_msg=true.name)
