# SPDX-License-Identifier: Apache-2.0
"""What was said before a run was asked for, and comes late, does not judge it: it may be of a driver that has ended since."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

from irec_calibration.cell import read_cell
from irec_calibration.nodes import procedure_node, procedure_start
from irec_calibration.nodes.sources import PATIENCE, SourceWatch, of_cell
from irec_calibration.procedure.axes import read_axes
from irec_calibration.procedure.inputs import Inputs
from irec_calibration.procedure.standstill import Streams
from std_msgs.msg import Header

from irec_msgs.msg import RobotState

pytestmark = pytest.mark.ros
CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
AXES = read_axes(CELL)
Q = (*CELL.home.tolist(), 0.1)
NO = (0.0, 0.0, 0.0)
NOW = 100.0  # cell's clock


class Asked:
    """A run that was asked for; the machine's clock is that of the test, the cell's runs with it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.machine = 0.0
        monkeypatch.setattr(procedure_start.time, "monotonic", lambda: self.machine)
        self.inputs = Inputs(Streams(5.0), AXES, ["A"])
        link: Any = SimpleNamespace(missing="", rivals="")
        correction: Any = SimpleNamespace(problem=lambda _: "")
        self.senders: dict[str, list[str]] = {}  # topic -> nodes that publish there
        sources = SourceWatch(self, of_cell(False, 1))
        self.check = procedure_start.StartCheck(link, self.inputs, correction, sources)
        self.check.run_asked_for()

    def resolve_topic_name(self, topic: str) -> str:
        return f"/{topic}"

    def count_publishers(self, topic: str) -> int:
        return len(self.senders.get(topic, ["driver"]))

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(node_namespace="/", node_name=name) for name in self.senders[topic]]

    @property
    def now(self) -> float:
        return NOW + self.machine

    def look(self, machine: float) -> procedure_start.Start:
        self.machine = machine
        return self.check.look(self.now)

    def feed(self, taken: float, frame: str = "tool0") -> None:
        self.inputs.wrench(self.now, taken, frame, NO, NO)
        self.inputs.joints(self.now, taken, AXES.driver, Q)
        self.inputs.tcp(self.now, taken, "base_link", (1.9, 0.0, 1.1), (0.0, 0.0, 0.0, 1.0))

    def state(self, stamp: float, mode: int = RobotState.MODE_POSITION) -> RobotState:
        header = Header()
        header.stamp.sec, header.stamp.nanosec = int(stamp), int(1e9 * (stamp % 1.0))
        return RobotState(header=header, mode=mode)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    return Asked(monkeypatch)


def test_a_late_wrench_in_the_frame_of_the_driver_before_does_not_end_the_run(asked: Asked) -> None:
    asked.feed(NOW - 0.05, frame="base_link")
    assert asked.look(0.1).waits and not asked.look(0.1).stop
    asked.feed(asked.now, frame="base_link")  # stamped by a clock that is ahead of this node's
    assert not asked.look(0.2).stop
    assert not asked.look(0.31).stop
    asked.feed(NOW + 0.2, frame="base_link")  # later still, but of before
    assert not asked.look(0.4).stop
    asked.check.robot_said(asked.state(asked.now))
    asked.feed(asked.now)
    assert asked.look(0.6).begin


def test_the_wrong_frame_of_this_driver_ends_it(asked: Asked) -> None:
    asked.look(0.31)
    asked.machine = 0.35
    asked.feed(asked.now, frame="base_link")
    assert "header.frame_id is 'base_link'" in asked.look(0.4).stop


def test_readings_of_before_do_not_let_it_begin(asked: Asked) -> None:
    asked.check.robot_said(asked.state(NOW - 0.05))
    asked.feed(NOW - 0.05)
    asked.look(0.31)
    asked.feed(NOW + 0.29)
    waits = asked.look(0.6).waits
    assert all(topic in waits for topic in ("robot/state", "wrench", "joint_states", "tcp_pose")), waits


def test_a_fault_that_the_robot_told_before_is_not_believed(asked: Asked) -> None:
    assert not asked.check.believes(asked.now, asked.state(NOW - 0.05, RobotState.MODE_FAULT))
    asked.look(0.31)
    assert not asked.check.believes(asked.now, asked.state(NOW + 0.2, RobotState.MODE_FAULT))
    asked.machine = 0.4
    assert asked.check.believes(asked.now, asked.state(asked.now, RobotState.MODE_FAULT))


def test_readings_that_queued_up_while_a_long_recording_was_opened_do_not_end_the_run(
    asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*_: Any) -> Any:
        asked.machine = 3.0
        return SimpleNamespace(recorder=SimpleNamespace(losses=[]), begun="")

    monkeypatch.setattr(procedure_node, "ProcedureRun", opened)
    node: Any = MagicMock(_starting=asked.check)
    procedure_node.ProcedureNode._begin(node, SimpleNamespace(request=None))
    assert asked.look(3.01).waits
    asked.feed(NOW + 0.5)  # from the queue
    assert not asked.look(3.1).stop
    asked.look(3.35)
    asked.machine = 3.4
    asked.feed(asked.now)
    asked.check.robot_said(asked.state(asked.now))
    assert asked.look(3.6).begin


# --- who sends ----------------------------------------------------------------------------------------------------------------


def begun(asked: Asked) -> Asked:
    asked.look(0.31)
    asked.machine = 0.5
    asked.feed(asked.now)
    asked.check.robot_said(asked.state(asked.now))
    return asked


@pytest.mark.parametrize("topic", ["wrench", "joint_states", "tcp_pose", "robot/state", "wrench_raw", "tracker/point"])
def test_no_run_begins_while_two_nodes_send_what_it_reads(asked: Asked, topic: str) -> None:
    asked.senders[f"/{topic}"] = ["cell", "rqt"]
    begun(asked)
    now = asked.look(3.0)
    assert not now.begin and not now.stop and f"2 publishers of /{topic} (/cell, /rqt), 1 alone" in now.waits
    assert "end all but the one that measures" in asked.look(procedure_start.RIVAL_WAIT + 1.0).stop


def test_a_run_begins_once_the_second_sender_is_forgotten(asked: Asked) -> None:
    asked.senders["/wrench"] = ["killed", "driver"]
    begun(asked)
    assert asked.look(3.0).waits
    del asked.senders["/wrench"]
    assert asked.look(20.0).begin


def test_what_two_senders_say_together_is_told_as_two_senders(asked: Asked) -> None:
    asked.senders["/wrench"] = ["cell", "other"]
    asked.look(0.31)
    asked.machine = 0.5
    asked.feed(asked.now, frame="base_link")
    now = asked.look(1.6)
    assert not now.stop
    assert "2 publishers of /wrench" in asked.look(procedure_start.RIVAL_WAIT + 1.0).stop


@pytest.mark.parametrize("topic", ["wrench", "joint_states", "tcp_pose"])
def test_a_second_sender_of_what_leads_the_robot_ends_a_run_at_the_next_look(asked: Asked, topic: str) -> None:
    assert not asked.check.disturbed
    asked.senders[f"/{topic}"] = ["cell", "rqt"]
    asked.machine += 0.5
    assert not asked.check.disturbed, "the graph is asked once a second"
    asked.machine += 0.6
    assert f"2 publishers of /{topic} (/cell, /rqt)" in asked.check.disturbed


@pytest.mark.parametrize("topic", ["tracker/point", "wrench_raw"])
def test_a_driver_that_was_restarted_in_a_run_ends_it_only_where_the_old_one_does_not_disappear(asked: Asked, topic: str) -> None:
    asked.senders[f"/{topic}"] = ["killed", "tracker"]
    for asked.machine in (1.1, 10.0, PATIENCE):
        assert not asked.check.disturbed
    asked.machine = PATIENCE + 2.0
    assert f"2 publishers of /{topic}" in asked.check.disturbed


def test_each_tracker_station_may_have_a_driver_and_a_cell_without_tracker_none_that_counts() -> None:
    assert of_cell(False, 2)["tracker/point"] == 2 and "tracker/point" not in of_cell(True, 2)
