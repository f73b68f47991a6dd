# SPDX-License-Identifier: Apache-2.0
"""A quick check through the nodes presses across the tool as hard as the cell bears it, and no row is lost by that."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

from irec_calibration.recording import BagReader
from irec_calibration.session import read_session, record_message
from test_recertification_refusals_ros import Site, site

__all__ = ["site"]  # a fixture
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.long, pytest.mark.timeout(900)]


def test_a_robot_that_has_not_changed_is_pressed_harder_and_found_as_it_was(site: Callable[..., Site]) -> None:
    here = site()
    calibrations = here.store()
    here.calibration_node(calibrations)
    result = here.person.answer(here.person.ask(poses_path=str(here.poses), check_only=True))
    assert result.verdict in ("pass", "failed: not decided"), result.text  # of a calibration of 14 poses
    (recording,) = calibrations.rglob("quick.mcap")
    session = read_session(recording)
    assert session.load_cases[2] == (350.0, 0.0, -1100.0) and session.load_cases[1] == (0.0, 0.0, -1100.0)
    np.testing.assert_allclose(session.force_in_tool[session.load_case == 2, 0], 350.0, atol=15.0)
    bag = BagReader(recording)
    events = [json.loads(bag.decode(m).data) for m in bag.messages() if m.topic.name == record_message.EVENT_TOPIC]
    assert {e["kind"] for e in events} <= {"complete", "stopped", "finished"}, "nothing slips"
