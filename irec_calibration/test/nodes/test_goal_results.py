# SPDX-License-Identifier: Apache-2.0
"""The result of a run is asked for again where the answer was lost."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

from action_msgs.msg import GoalStatus
from irec_calibration.nodes import cell_side
from irec_ros import results

pytestmark = pytest.mark.ros


class Handle:
    """Of an accepted goal whose first answers are lost."""

    accepted = True

    def __init__(self, lost: int, status: int = GoalStatus.STATUS_SUCCEEDED) -> None:
        self.lost, self.asked, self.cancelled = lost, 0, False
        self._answer = SimpleNamespace(status=status, result=SimpleNamespace(success=True, message=""))

    def get_result_async(self) -> Future[Any]:
        self.asked += 1
        future: Future[Any] = Future()
        if self.asked > self.lost:
            future.set_result(self._answer)
        return future

    def cancel_goal_async(self) -> None:
        self.cancelled = True


def test_a_goal_of_which_nothing_is_heard_is_asked_for_again_and_one_that_reports_is_not() -> None:
    handle, now = Handle(lost=1), [0.0]
    waits = results.GoalResult(handle, lambda: now[0])
    for _ in range(10):
        now[0] += 0.9 * results.AGAIN
        waits.heard()
        assert waits.poll() is None
    assert handle.asked == 1, "it has reported all the time"
    now[0] += 1.1 * results.AGAIN
    waits.poll()
    assert waits.poll().result.success
    assert handle.asked == 2


@pytest.fixture
def side(monkeypatch: pytest.MonkeyPatch) -> cell_side.RosCell:
    monkeypatch.setattr(results, "AGAIN", 0.2)
    made = cell_side.RosCell.__new__(cell_side.RosCell)
    made._node = SimpleNamespace(context=SimpleNamespace(ok=lambda: True))  # type: ignore[assignment]
    made._cancelled, made._stage, made._recording = (lambda: ""), "measuring", ""
    made._report = lambda *_: None
    return made


def procedure(handle: Handle) -> Any:
    sent: Future[Any] = Future()
    sent.set_result(handle)
    return SimpleNamespace(
        wait_for_server=lambda timeout_sec: True, server_is_ready=lambda: True, send_goal_async=lambda *_, **__: sent
    )


def test_a_run_whose_answer_was_lost_comes_to_its_end(side: cell_side.RosCell, tmp_path: Path) -> None:
    side._procedure = procedure(handle := Handle(lost=1))
    assert side.run(tmp_path / "poses.yaml", tmp_path / "run.mcap", False, lambda: False) == ""
    assert handle.asked == 2


def test_a_procedure_that_was_started_anew_ends_the_run_with_the_reason(side: cell_side.RosCell, tmp_path: Path) -> None:
    side._procedure = procedure(Handle(lost=1, status=GoalStatus.STATUS_UNKNOWN))
    assert "started anew" in side.run(tmp_path / "poses.yaml", tmp_path / "run.mcap", False, lambda: False)


def test_a_cancelled_run_waits_for_an_answer_that_was_lost(side: cell_side.RosCell, tmp_path: Path) -> None:
    side._procedure = procedure(handle := Handle(lost=1))
    side._cancelled = lambda: "cancelled by the operator"
    with pytest.raises(cell_side.Cancelled, match="the robot has left the contact"):
        side.run(tmp_path / "poses.yaml", tmp_path / "run.mcap", False, lambda: False)
    assert handle.cancelled
    assert handle.asked == 2
