# SPDX-License-Identifier: Apache-2.0
"""What a correction may begin with: no contact, and no input that is old when it comes in."""

from __future__ import annotations

import numpy as np
import pytest
from chain import WRENCH, Q, Rig
from irec_correction.correction import CorrectionSettings
from irec_correction.errors import ActivationError, SettingsError
from irec_correction.state import State


def begun(load: float, **changes: object) -> Rig:
    """A correction that was asked to begin before the first wrench came, as after a start by itself."""
    rig = Rig(**{"start_load": 0.15, **changes})
    rig.wrench = load * WRENCH
    rig.correction.start(rig.now, 0.2)
    return rig


def test_in_contact_the_correction_does_not_begin_whoever_asks_first():
    rig = begun(1.0)
    out = rig.run(2.5)
    assert out.state is State.FAULT and rig.largest_step == 0.0
    assert "the force is 916 N where the correction is to begin, limit 180 N (0.15 of the 1200 N" in out.reason
    with pytest.raises(ActivationError, match="take the tool off first"):
        rig.correction.start(rig.now, 0.2)
    rig.wrench = 0.1 * WRENCH
    rig.run(0.5)
    rig.correction.start(rig.now, 0.2)
    assert rig.run(1.0).state is State.ACTIVE
    rig.wrench = WRENCH.copy()
    assert rig.run(1.0).state is State.ACTIVE, "what comes later is the process"
    rig.run(0.1, wrench=False)
    assert rig.run(1.0).state is State.ACTIVE, "and a wrench that was lost for a moment is no beginning"


def test_without_contact_it_begins_and_with_leave_it_begins_in_contact():
    assert begun(0.1).run(1.5).state is State.ACTIVE
    assert begun(1.0, start_load=10.0).run(1.5).state is State.ACTIVE


def test_a_new_session_of_the_robot_in_contact_is_a_beginning_too():
    rig = begun(0.1)
    rig.run(1.5)
    rig.wrench = WRENCH.copy()
    assert rig.run(1.0).state is State.ACTIVE
    rig.correction.start_session(rig.now)
    out = rig.run(2.5)
    assert out.state is State.FAULT and "where the correction is to begin" in out.reason


def test_a_share_that_is_no_number_is_refused():
    for share in (-0.1, float("nan")):
        with pytest.raises(SettingsError, match="start_load"):
            CorrectionSettings(start_load=share)


@pytest.mark.parametrize(
    ("age", "fault", "text"),
    [
        (0.1, None, ""),
        (0.45, "stale", "is 0.450 s old when it comes in, limit 0.15 s"),
        (-0.4, None, ""),  # a clock that goes ahead by less than its tolerance is none of that
        (0.6, "clock", "is stamped -0.600 s from now, limit 0.5 s"),
        (-0.6, "clock", "is stamped +0.600 s from now, limit 0.5 s"),
    ],
)  # fmt: skip
def test_an_input_that_is_old_when_it_comes_in_is_stale_long_before_the_clocks_are_doubted(age, fault, text):
    for what, key in (("wrench", "wrench"), ("joint state", "joints")):
        rig = Rig()
        watchdog = rig.correction.watchdog
        taken = {
            "wrench": watchdog.accept_wrench(rig.now - age * (what == "wrench"), rig.now, "tool0", WRENCH),
            "joints": watchdog.accept_joints(rig.now - age * (what != "wrench"), rig.now, Q, 0.0),
        }
        assert taken == {"wrench": True, "joints": True} | {key: fault is None}
        finding = watchdog.finding(rig.now, np.zeros(6))
        told = None if finding is None else (finding.fault.value, f"{what} {text}" in finding.text)
        assert told == (None if fault is None else (f"{key}_{fault}", True))
