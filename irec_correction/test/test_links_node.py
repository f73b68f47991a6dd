# SPDX-License-Identifier: Apache-2.0
"""Secondary encoders by DDS: the node corrects what they read, and holds and fades where it can't believe them."""

from __future__ import annotations

import sys
from array import array

import numpy as np
import pytest
from cell_side import CELL, CellSide, afp_model
from chain import WRENCH, Q, model
from irec_calibration.cell import read_cell
from irec_calibration.commands.links import write_table
from irec_calibration.sensors.dry_drive import DryDriveTable
from irec_correction.deflection import Deflection
from irec_correction.links import Links

pytestmark = [pytest.mark.ros, pytest.mark.paced]
WINDUP = np.array([1.0e-4, -2.5e-4, 3.0e-4, 2.0e-4, -4.0e-4, 5.0e-4])
DRY = np.array([1e-5, 1.2e-3, -8e-4, 1e-4, 2e-4, 0.0])  # by gravity
NAMES = [f"joint_{k}" for k in range(6, 0, -1)]  # another order than that of the robot


class EncoderSide(CellSide):
    """A cell with encoders behind the gears too."""

    def __init__(self) -> None:
        super().__init__()
        self.encoders = self.node.create_publisher(self.types[0], "link_states", 50)
        self.names, self.link, self.silent = NAMES, Q + DRY + WINDUP, False

    def _publish(self) -> None:
        super()._publish()
        if self.silent:
            return
        message = self.types[0](name=self.names, position=array("d", self.link[::-1][: len(self.names)].tolist()))
        message.header.stamp = self.node.get_clock().now().to_msg()
        self.encoders.publish(message)

    def until_state(self, state: int, reason: str = "") -> None:
        self.until(lambda: self.states and self.states[-1].state == state and reason in self.states[-1].reason, what=reason)


@pytest.fixture
def side(ros_domain, start_process, tmp_path):
    robot = read_cell(CELL).robot
    write_table(tmp_path / "links.csv", DryDriveTable(robot.joint_names, Q[None], (Q + DRY)[None], 1))
    start_process([
        sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}",
        "-p", "autostart:=true", "-p", "start_load:=10.0", "-p", "watch.wrench_timeout:=2.0",
        "-p", "watch.joints_timeout:=2.0", "-p", "watch.age_limit:=2.0", "-p", "time.hold:=1.0",
        "-p", "links.topic:=link_states", "-p", f"links.file:={tmp_path / 'links.csv'}", "-p", "links.timeout:=2.0",
    ], name="correction")  # fmt: skip
    side = EncoderSide()
    yield side
    side.close()


def test_the_offset_is_against_the_windup_that_is_read_and_fades_where_it_is_not(side, tmp_path):
    answer = side.activate(afp_model(tmp_path))
    assert answer.success, answer.message
    side.until_state(2)
    robot = read_cell(CELL).robot
    expected, _ = Deflection(model(), robot)(Q, WRENCH[:3], WRENCH[3:], 0.004)
    links = Links(robot, [])
    links.take(0.0, WINDUP)
    expected = expected + links.displacement(Q)
    assert np.linalg.norm(links.displacement(Q)) > 2e-4
    side.until(lambda: np.linalg.norm(side.offsets[-1] + expected) < 5e-6, what="offset against model and windup")
    side.link = Q + DRY + np.full(6, np.nan)
    side.until_state(3, "NaN")
    side.link = Q + DRY + WINDUP
    side.until_state(2)
    side.names = NAMES[:-1]  # a joint is missing
    side.until_state(3, "5 joints came, the robot has 6")
    side.names = NAMES
    side.until_state(2)
    side.silent = True
    side.until_state(3, "no windup from the secondary encoders")
    side.until_state(5, "no windup from the secondary encoders")
    side.until(lambda: np.linalg.norm(side.offsets[-1]) < 1e-8, what="no offset")
    steps = np.linalg.norm(np.diff(np.array([np.zeros(3), *side.offsets]), axis=0), axis=1)
    assert steps.max() <= 0.02 * 0.004 * 3  # messages may be lost on the way here: three ticks at most between two
