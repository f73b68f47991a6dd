# SPDX-License-Identifier: Apache-2.0
"""The node as a process: two senders of an input, a driver that does not do what it is sent, a rail that nobody reports."""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest
from cell_side import CELL, CellSide, afp_model

pytestmark = [pytest.mark.ros, pytest.mark.paced]
INACTIVE, ACTIVE, FAULT = 0, 2, 5
REPORT = 0.05  # s
STEP = 0.02 * 0.004 * 3  # messages may be lost on the way here: three ticks at most between two


class Driver:
    """Publishes robot/state beside a cell: what it does with the offset, from the last one that came and that of 50 ms ago."""

    def __init__(self, side: CellSide) -> None:
        from irec_msgs.msg import RobotState

        self.side, self.kind = side, RobotState
        self.does, self.mode, self.message = None, RobotState.MODE_POSITION, ""
        self.out = side.node.create_publisher(RobotState, "robot/state", 10)
        self._late: list[tuple[float, np.ndarray]] = []
        side.node.create_timer(REPORT, self._report)

    def _report(self) -> None:
        now = time.monotonic()
        self._late.append((now, self.side.offsets[-1] if self.side.offsets else np.zeros(3)))
        sent = next(v for t, v in reversed([self._late[0], *self._late]) if t <= now - 0.05 or t == self._late[0][0])
        applied = sent if self.does is None else self.does(sent)
        m = self.kind(mode=self.mode, message=self.message)
        m.header.stamp, m.header.frame_id = self.side.node.get_clock().now().to_msg(), "base_link"
        m.offset.x, m.offset.y, m.offset.z = applied.tolist()
        self.out.publish(m)


@pytest.fixture
def side(ros_domain, start_process, request):
    more = getattr(request, "param", ["-p", "start_load:=10.0"])
    start_process([
        sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}",
        "-p", "autostart:=true", "-p", "watch.wrench_timeout:=2.0", "-p", "watch.joints_timeout:=2.0",
        "-p", "watch.frozen_after:=2.0", "-p", "watch.clock_tolerance:=5.0", "-p", "watch.age_limit:=5.0", *more,
    ], name="correction")  # fmt: skip
    side = CellSide()
    yield side
    side.close()


def activate(side: CellSide, folder) -> None:
    answer = side.activate(afp_model(folder))
    assert answer.success, answer.message
    state_of(side, ACTIVE)


def state_of(side: CellSide, state: int) -> None:
    side.until(lambda: side.states and side.states[-1].state == state, what=f"state {state}")


def stays(side: CellSide, state: int, seconds: float) -> None:
    """Whatever the machine does in between, it is in that state and not in FAULT after some seconds."""
    end = time.monotonic() + seconds
    side.until(lambda: time.monotonic() > end, what="some seconds")
    state_of(side, state)


def faded(side: CellSide) -> str:
    """The reason of a FAULT that has come without a step."""
    state_of(side, FAULT)
    side.until(lambda: np.linalg.norm(side.offsets[-1]) < 1e-8, what="no offset")
    steps = np.linalg.norm(np.diff(np.array([np.zeros(3), *side.offsets]), axis=0), axis=1)
    assert steps.max() <= STEP
    return side.states[-1].reason


def test_a_second_sender_of_the_wrench_fades_the_offset_out_and_keeps_the_node_from_being_activated(side, tmp_path):
    activate(side, tmp_path)
    second = side.node.create_publisher(side.types[1], "wrench", 50)
    reason = faded(side)
    assert "2 publishers of /wrench (/cell_side)" in reason
    refused = side.activate(afp_model(tmp_path))
    assert "an input has more than one sender: 2 publishers of /wrench" in refused.message
    stays(side, FAULT, 1.0)
    side.node.destroy_publisher(second)
    side.until(lambda: side.node.count_publishers("wrench") == 1, what="one sender")
    activate(side, tmp_path)


def test_a_second_sender_of_the_joint_states_fades_the_offset_out_but_not_one_of_other_joints(side, tmp_path):
    activate(side, tmp_path)
    joint_state, _ = side.types
    gripper = side.node.create_publisher(joint_state, "joint_states", 50)
    side.node.create_timer(0.1, lambda: gripper.publish(joint_state(name=["finger"], position=[0.01])))
    stays(side, ACTIVE, 2.5)
    side.node.create_publisher(joint_state, "joint_states", 50)
    assert "3 publishers of /joint_states (/cell_side)" in faded(side)


def test_a_driver_that_reports_what_it_is_sent_50_ms_late_and_one_that_reports_nothing_keep_their_offset(side, tmp_path):
    activate(side, tmp_path)
    stays(side, ACTIVE, 2.0)  # nothing is reported
    Driver(side)
    stays(side, ACTIVE, 3.0)
    assert not any("not_obeyed" in str(d) for d in side.diagnostics)


@pytest.mark.parametrize(
    ("does", "words"), [(lambda s: 0.0 * s, "ignores"), (lambda s: 2.0 * s, "doubles"), (lambda s: -s, "the other way round")]
)  # fmt: skip
def test_a_driver_that_does_something_else_with_the_offset_is_told_and_the_offset_fades_out(side, tmp_path, does, words):
    driver = Driver(side)
    activate(side, tmp_path)
    driver.does = does
    reason = faded(side)
    assert "the driver reports offset (" in reason and words in reason
    driver.does = None
    activate(side, tmp_path)


def test_a_driver_in_fault_gets_no_offset_until_it_is_activated_again(side, tmp_path):
    driver = Driver(side)
    activate(side, tmp_path)
    driver.mode, driver.message = driver.kind.MODE_FAULT, "collision of joint 3"
    assert "the driver reports a fault: collision of joint 3" in faded(side)
    driver.mode = driver.kind.MODE_POSITION
    stays(side, FAULT, 1.0)
    activate(side, tmp_path)


def test_joint_states_without_the_rail_are_held_and_named_in_a_cell_with_a_rail(side, tmp_path):
    activate(side, tmp_path)
    side.rail = None
    assert "there is no 'ext_rail' among 'joint_1', 'joint_2'" in faded(side)
    side.rail = 0.0
    activate(side, tmp_path)


@pytest.mark.parametrize("side", [[]], indirect=True)
def test_a_robot_that_presses_on_something_is_not_corrected_until_it_is_free(side, tmp_path):
    answer = side.activate(afp_model(tmp_path))
    if not answer.success:  # the node had a wrench already
        assert "limit 180 N (0.15 of the 1200 N" in answer.message
    side.until(lambda: any("take the tool off first" in str(d) for d in side.diagnostics), what="the reason")
    side.until(lambda: side.states[-1].state in (INACTIVE, FAULT), what="at rest")
    assert not side.offsets or max(np.linalg.norm(o) for o in side.offsets) < 1e-8
    side.load = 0.1
    side.until(lambda: abs(side.states[-1].wrench_process.force.z) < 150.0, what="the filtered force")
    activate(side, tmp_path)
    side.load = 1.0  # what comes later is the process
    stays(side, ACTIVE, 2.0)
