# SPDX-License-Identifier: Apache-2.0
"""A correction node that is busy, or was started just now, is asked for its answer again; why a run did not begin is told."""

from __future__ import annotations

import re
import threading
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.nodes import cell_side
from irec_calibration.poses.store import read_poses
from irec_ros.guard import GuardedNode
from rclpy.action import ActionClient, ActionServer

from irec_msgs.action import RunProcedure
from irec_msgs.srv import ActivateModel

pytestmark = pytest.mark.ros
CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"


class Correction:
    """A client whose answers are lost up to one of them, or all."""

    def __init__(self, answered: int) -> None:
        self.answered, self.asked = answered, 0

    def wait_for_service(self, timeout_sec: float) -> bool:
        return True

    def call_async(self, _: object) -> Future[Any]:
        self.asked += 1
        future: Future[Any] = Future()
        if self.asked == self.answered:
            future.set_result(SimpleNamespace(success=True, message=""))
        return future


@pytest.fixture
def side(monkeypatch: pytest.MonkeyPatch) -> cell_side.RosCell:
    monkeypatch.setattr(cell_side, "ANSWER_WAIT", 0.3)
    monkeypatch.setattr(cell_side, "ACTIVATE_WAIT", 0.9)
    monkeypatch.setattr(cell_side, "check_before_force", lambda *_: None)
    made = cell_side.RosCell.__new__(cell_side.RosCell)
    made._cell, made._limits = None, cell_side.Limits(0.02, 1.3)  # type: ignore[assignment]
    return made


def test_a_procedure_node_that_is_not_there_is_told_before_anything_moves(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With the clients of rclpy on an empty domain; the instruments are not looked at here."""
    monkeypatch.setattr(cell_side, "ANSWER_WAIT", 0.3)
    monkeypatch.setattr(cell_side, "look", lambda *_: None)
    monkeypatch.setattr(cell_side, "judged_readings", lambda *_: ())
    rclpy.init()
    try:
        node = GuardedNode("alone")
        procedure = ActionClient(node, RunProcedure, "irec/run_procedure")
        activate = node.create_client(ActivateModel, "irec/correction/activate_model")
        here = cell_side.RosCell(node, read_cell(CELL), procedure, activate, tmp_path, None, cell_side.Limits(0.02, 1.3))
        told = {p.name: (p.holds, p.text) for p in here.for_run(lambda *_: None, lambda: "", (), None, True).preconditions()}
        assert told == {
            "procedure_node": (False, "does not answer; start it"),
            "correction_node": (False, "does not answer; start and configure it"),
        }
        server = ActionServer(node, RunProcedure, "irec/run_procedure", lambda _: RunProcedure.Result())
        told = {p.name: p.holds for p in here.for_run(lambda *_: None, lambda: "", (), None, False).preconditions()}
        assert told == {"procedure_node": True}, "a check that puts nothing in force needs no correction_node"
        server.destroy()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize(("wanted", "factor"), [(1.3, 1.25), (1.1, 1.1), (1.0, 1.0)])
def test_the_quick_check_presses_no_harder_than_the_parameter_says(side: cell_side.RosCell, wanted: float, factor: float) -> None:
    cell = read_cell(CELL)
    side._cell, side._limits = cell, cell_side.Limits(0.02, wanted)
    assert side.lateral_factor(read_poses(cell.poses_path), 1.3) == factor


@pytest.mark.parametrize("answered", [1, 2, 3])
def test_a_lost_answer_is_asked_for_again(side: cell_side.RosCell, answered: int, tmp_path: Any) -> None:
    side._activate = Correction(answered)
    assert side.activate(tmp_path / "model.yaml") == ""
    assert side._activate.asked == answered


def test_a_node_that_never_answers_is_told_with_what_to_do(side: cell_side.RosCell, tmp_path: Any) -> None:
    side._activate = Correction(0)
    assert "no answer within 1 s; end it and start it again" in side.activate(tmp_path / "model.yaml")
    assert side._activate.asked == 3


@pytest.mark.parametrize(
    ("accepted", "recording", "why"),
    [
        (None, "", "gave no answer within 1 s; end it and start it again"),
        (False, "/data/s.mcap", "another run is under way (it records to /data/s.mcap); end that one first"),
        (False, "", "it is not active, or another run is under way"),
    ],
)
def test_why_procedure_node_begins_no_run_is_told(side, monkeypatch, accepted, recording, why) -> None:
    monkeypatch.setattr(cell_side, "START_WAIT", 1.0)
    sent: Future[Any] = Future()
    if accepted is not None:
        sent.set_result(SimpleNamespace(accepted=accepted))
    side._recording, side._cancelled = recording, lambda: ""
    with pytest.raises(IrecError, match=re.escape(why)):
        side._accepted(sent)


def test_an_answer_of_procedure_node_that_comes_late_is_waited_for(side, monkeypatch) -> None:
    monkeypatch.setattr(cell_side, "START_WAIT", 20.0)
    side._cancelled = lambda: ""
    sent: Future[Any] = Future()
    threading.Timer(1.3, lambda: sent.set_result(SimpleNamespace(accepted=True))).start()
    assert side._accepted(sent).accepted


def test_who_waits_for_procedure_node_can_be_cancelled(side) -> None:
    side._cancelled = lambda: "the operator asked for it"
    with pytest.raises(cell_side.Cancelled, match="the operator asked for it before anything was measured"):
        side._accepted(Future())
