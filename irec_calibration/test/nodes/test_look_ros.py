# SPDX-License-Identifier: Apache-2.0
"""What a look at the standing cell hears of topics that come after it has begun."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from irec_calibration.nodes import look as module
from sensor_msgs.msg import Temperature

pytestmark = [pytest.mark.ros]


def test_thermometers_that_are_found_after_the_look_has_begun_are_heard(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cell that was just switched on is found bit by bit; a cold machine would pass for one without thermometers."""
    monkeypatch.setattr(module, "LOOK_SECONDS", 4.0)
    monkeypatch.setattr(module, "LOOK_LONGEST", 10.0)  # there is nothing else to see: it looks for so long
    rclpy.init()
    node, cell = rclpy.create_node("looks"), rclpy.create_node("cell")
    publishers: list = []
    begun = time.monotonic()

    def go_on() -> None:
        if not publishers and time.monotonic() > begun + 1.0:
            publishers.append(cell.create_publisher(Temperature, "temperature/gear_2", 1))
        for publisher in publishers:
            publisher.publish(Temperature(temperature=21.5))

    try:
        readings = module.look(node, {"tracker_m": 1e-5}, go_on)
    finally:
        cell.destroy_node()
        node.destroy_node()
        rclpy.shutdown()
    assert readings.temperature == {"gear_2": 21.5}
