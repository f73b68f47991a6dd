# SPDX-License-Identifier: Apache-2.0
"""Secondary encoders in the correction: what the gears have wound up is taken as it is read, and doubted where it can't be."""

from __future__ import annotations

import numpy as np
from chain import PERIOD, ROBOT, WRENCH, Q, Rig, model
from irec_calibration.model import Model
from irec_correction.deflection import Deflection
from irec_correction.links import LATE, Links
from irec_correction.state import State
from irec_correction.watchdog import Fault

WINDUP = np.array([1.0e-4, -2.5e-4, 3.0e-4, 2.0e-4, -4.0e-4, 5.0e-4])


class LinkRig(Rig):
    """With a model of the structure alone, and encoders behind the gears."""

    windup: np.ndarray | None = WINDUP

    def __init__(self) -> None:
        super().__init__()
        whole = model()
        self.structure = Model(whole.terms[1:], serial="S-1", urdf_sha256=ROBOT.sha256, envelope=whole.envelope)
        self.correction.put_in_force(self.structure, 0.0)
        self.correction.links = Links(ROBOT, [])

    def tick(self) -> None:
        if self.windup is not None:
            self.correction.take_links(self.now, self.windup)
        super().tick()


def test_windup_moves_the_tcp_as_the_joints_would() -> None:
    links = Links(ROBOT, [])
    assert links.take(0.0, WINDUP) == ""
    moved = ROBOT.kinematics((Q + WINDUP)[None]).p_tcp[0] - ROBOT.kinematics(Q[None]).p_tcp[0]
    np.testing.assert_allclose(links.displacement(Q), moved, atol=2e-6)
    assert np.linalg.norm(moved) > 2e-4


def test_the_offset_is_against_the_measured_windup_and_the_predicted_structure() -> None:
    rig = LinkRig().active()
    structure, _ = Deflection(rig.structure, ROBOT)(rig.q, WRENCH[:3], WRENCH[3:], PERIOD)
    links = Links(ROBOT, [])
    links.take(0.0, WINDUP)
    assert rig.outputs[-1].state is State.ACTIVE
    assert np.linalg.norm(rig.outputs[-1].translation + structure + links.displacement(rig.q)) < 5e-6


def test_windup_that_no_gear_has_holds_the_offset_until_it_is_right_again() -> None:
    for wrong in (np.full(6, np.nan), np.full(6, 0.5), np.zeros(5)):
        rig = LinkRig().active()
        before = rig.outputs[-1].translation
        rig.windup = wrong
        held = rig.run(0.1)
        assert held.state is State.HOLD
        assert rig.correction.watchdog.counters[Fault.JOINTS_NOT_FINITE] >= 1
        np.testing.assert_allclose(held.translation, before, atol=1e-5)
        rig.windup = WINDUP
        assert rig.run(1.0).state is State.ACTIVE


def test_encoders_that_fall_silent_hold_the_offset() -> None:
    rig = LinkRig().active()
    rig.windup = None
    assert rig.run(LATE + 0.1).state is State.HOLD
    assert rig.correction.watchdog.counters[Fault.JOINTS_STALE] >= 1


def test_a_chain_without_encoders_does_not_look_at_windups() -> None:
    rig = Rig().active()
    before = rig.outputs[-1].translation
    rig.correction.take_links(rig.now, np.full(6, np.nan))
    assert rig.run(0.2).state is State.ACTIVE
    np.testing.assert_allclose(rig.outputs[-1].translation, before, atol=5e-6)


def test_without_a_dry_drive_what_the_gears_have_wound_up_at_the_start_is_taken_off() -> None:
    rig = LinkRig()
    rig.correction.links = Links(ROBOT, [], zeroed=True)
    gravity = np.array([2e-4, 1.2e-3, -9e-4, 1e-4, -2e-4, 0.0])
    rig.windup = gravity
    rig.active()
    rig.windup = gravity + WINDUP
    rig.run(0.5)
    expected = Links(ROBOT, [])
    expected.take(0.0, WINDUP)
    assert rig.correction.links is not None
    np.testing.assert_allclose(rig.correction.links.displacement(Q), expected.displacement(Q), atol=1e-9)
    rig.correction.stop(rig.now)
    rig.run(2.0)
    rig.active()  # started anew: from what is there now
    np.testing.assert_allclose(rig.correction.links.displacement(Q), np.zeros(3), atol=1e-9)
