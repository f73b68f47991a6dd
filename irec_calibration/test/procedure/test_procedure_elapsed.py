# SPDX-License-Identifier: Apache-2.0
"""Time that has passed in the cell: whoever sets the clock is found out, and time-outs stay."""

from __future__ import annotations

import pytest
from irec_calibration.procedure.elapsed import CellTime


@pytest.mark.parametrize("simulated", [False, True])
def test_a_clock_that_is_set_and_set_back_between_two_looks_is_found_out(simulated: bool) -> None:
    time = CellTime(simulated)
    time.look(100.0, 10.0)
    time.was_set(1100.0, 10.005)
    time.was_set(100.01, 10.006)
    time.look(100.02, 10.02)
    assert abs(time.jump) == pytest.approx(1000.0, rel=1e-3)
    assert time.elapsed < 6.0


def test_a_jump_is_told_once_and_a_clock_that_goes_on_is_none() -> None:
    time = CellTime(simulated=True)
    time.look(100.0, 10.0)
    time.was_set(1100.0, 10.005)
    time.look(1100.02, 10.02)
    assert time.jump > 900.0
    time.look(1100.04, 10.04)
    assert time.jump == 0.0


def test_a_simulation_that_is_held_up_and_catches_up_has_set_nothing() -> None:
    time = CellTime(simulated=True)
    time.look(100.0, 10.0)
    time.was_set(103.0, 10.5)
    time.look(103.02, 10.51)
    assert time.jump == 0.0
