# SPDX-License-Identifier: Apache-2.0
"""The tracker driver against fakes of what trackers and their loggers send: packets over TCP, lines over UDP, late topics."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from irec_calibration.nodes.tracker_driver import TrackerDriver

pytestmark = pytest.mark.ros
PATIENCE = 30.0  # s


def packet(seconds: int, microseconds: int, x: float, y: float, z: float) -> bytes:
    """One continuous measurement as an emScon server sends it, m."""
    one = struct.pack("<iiiddd", 0, seconds, microseconds, x, y, z)
    body = struct.pack("<i", 0) + struct.pack("<iiiddd", 1, 2, 0, 20.0, 1013.0, 50.0) + one
    return struct.pack("<ii", 8 + len(body), 3) + body


class Listener:
    """A driver in this process, who listens to it, and a publisher that stands for another driver."""

    def __init__(self, *parameters: str) -> None:
        arguments = [word for parameter in parameters for word in ("-p", parameter)]
        rclpy.init(args=["--ros-args", *arguments])
        self.driver = TrackerDriver()
        self.node = rclpy.create_node("listener", use_global_arguments=False)
        self.points: list[PointStamped] = []
        self.said: list[Any] = []
        self.node.create_subscription(PointStamped, "tracker/point", self.points.append, 100)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: self.said.extend(m.status), 100)
        self.other = self.node.create_publisher(PointStamped, "leica/point", 100)

    def until(self, condition: Callable[[], Any], what: str, each: Callable[[], None] = lambda: None) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"no {what} within {PATIENCE:g} s; points: {len(self.points)}, said: {self.said[-1:]}"
            each()
            for _ in range(8):  # messages, so that nothing is left in a queue
                for node in (self.driver, self.node):
                    rclpy.spin_once(node, timeout_sec=0.002)

    def close(self) -> None:
        self.driver.close()
        for node in (self.driver, self.node):
            node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def listening(ros_domain: int) -> Iterator[Callable[..., Listener]]:
    made: list[Listener] = []

    def listen(*parameters: str) -> Listener:
        made.append(Listener(*parameters))
        return made[0]

    yield listen
    for one in made:
        one.close()


def stamp(m: PointStamped) -> float:
    return m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec


def test_packets_of_a_tracker_become_points_and_a_lost_connection_is_made_again(listening: Callable[..., Listener]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE)
        cell = listening(f"source:=tcp://127.0.0.1:{server.getsockname()[1]}", "format:=emscon", "unit:=m", "station:=A")
        for connection in (0, 1):
            tracker, _ = server.accept()
            heard = len(cell.points)
            sent = [0]

            def send(tracker: socket.socket = tracker, sent: list[int] = sent, x: float = 3.0 + connection) -> None:
                tracker.sendall(packet(1000 + sent[0] // 100, 10_000 * (sent[0] % 100), x, -0.5, 0.1))
                sent[0] += 1

            cell.until(lambda heard=heard: len(cell.points) > heard + 20, "points", send)
            tracker.close()
            if connection == 0:
                cell.until(lambda: any(s.level == DiagnosticStatus.ERROR for s in cell.said), "word of the lost connection")
    point = cell.points[-1]
    assert point.header.frame_id == "A"
    assert (point.point.x, point.point.y, point.point.z) == (4.0, -0.5, 0.1)
    assert "closed the connection" in next(s.message for s in cell.said if s.level == DiagnosticStatus.ERROR)


def test_lines_of_a_logger_over_udp_are_in_metres_and_of_the_station_that_they_name(listening: Callable[..., Listener]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    cell = listening(f"source:=udp://127.0.0.1:{port}", "columns:=station,time,x,y,z", "time_unit:=ms")
    sent = [0]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as logger:

        def send() -> None:
            sent[0] += 1
            line = "nonsense" if sent[0] == 7 else f"B;{10.0 * sent[0]:.1f};3000.5;-500.25;100.0"
            logger.sendto(line.encode(), ("127.0.0.1", port))

        cell.until(lambda: len(cell.points) > 30, "points", send)
        cell.until(lambda: any("could not be read" in s.message for s in cell.said), "word of the line that is none", send)
    first = cell.points[0]
    assert first.header.frame_id == "B"
    assert (first.point.x, first.point.y, first.point.z) == pytest.approx((3.0005, -0.50025, 0.1))
    assert abs(stamp(cell.points[-1]) - time.time()) < PATIENCE


def test_a_topic_that_is_stamped_late_and_in_bursts_gets_even_stamps(listening: Callable[..., Listener]) -> None:
    cell = listening("source:=topic:leica/point", "period:=0.02", "station:=A")
    cell.until(lambda: cell.other.get_subscription_count() > 0, "driver that listens")

    def burst() -> None:
        for _ in range(5):
            late = PointStamped()
            late.header.frame_id, late.header.stamp = "tracker", cell.node.get_clock().now().to_msg()
            late.point.x = 3.0
            cell.other.publish(late)
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            rclpy.spin_once(cell.driver, timeout_sec=0.005)

    cell.until(lambda: len(cell.points) > 50, "points", burst)
    steps = sorted(stamp(b) - stamp(a) for a, b in zip(cell.points[:-1], cell.points[1:], strict=True))
    assert steps[0] > 0.0, "two points of one time"
    assert steps[len(steps) // 2] == pytest.approx(0.02, abs=2e-3)
    assert {m.header.frame_id for m in cell.points} == {"A"}
