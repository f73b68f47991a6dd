# SPDX-License-Identifier: Apache-2.0
"""A correction node that is busy, or was started just now, is asked for its answer again."""

from __future__ import annotations

from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

from irec_calibration.nodes import cell_side

pytestmark = pytest.mark.ros


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
    made._cell, made._predicted_limit = None, 0.02  # type: ignore[assignment]
    return made


@pytest.mark.parametrize("answered", [1, 2, 3])
def test_a_lost_answer_is_asked_for_again(side: cell_side.RosCell, answered: int, tmp_path: Any) -> None:
    side._activate = Correction(answered)
    assert side.activate(tmp_path / "model.yaml") == ""
    assert side._activate.asked == answered


def test_a_node_that_never_answers_is_told_with_what_to_do(side: cell_side.RosCell, tmp_path: Any) -> None:
    side._activate = Correction(0)
    assert "no answer within 1 s; end it and start it again" in side.activate(tmp_path / "model.yaml")
    assert side._activate.asked == 3
