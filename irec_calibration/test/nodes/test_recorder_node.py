# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process: what it heard is in the bag, whichever way it ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")

import rclpy
from geometry_msgs.msg import PointStamped
from irec_calibration.recording import BagReader
from irec_calibration.session import record_message
from irec_ros.cdr import exact_cdr
from irec_ros.seen import SeenBy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros
PATIENCE = 90.0  # s
COUNT = 2000


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    rclpy.init()
    made = rclpy.create_node("source")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def command(folder: Path, **parameters: object) -> list[str]:
    values = {"output": folder, "topics": "[/point,/robot_description]"} | parameters
    settings = [text for name, value in values.items() for text in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", "irec_calibration.nodes.recorder_node", "--ros-args", *settings]


def wait(condition: Callable[[], Any], what: str) -> None:
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, f"no {what} within {PATIENCE} s"
        time.sleep(0.02)


def publish(node: Node) -> None:
    """A latched description and COUNT points, once the recorder listens."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    description = node.create_publisher(String, "/robot_description", latched)
    description.publish(String(data="<robot/>"))
    points = node.create_publisher(PointStamped, "/point", COUNT)
    wait(lambda: points.get_subscription_count() and description.get_subscription_count(), "recorder")
    message = PointStamped()
    for k in range(COUNT):
        message.point.x = float(k)
        points.publish(message)
    points.wait_for_all_acked()
    description.wait_for_all_acked()


def recorded(folder: Path) -> tuple[BagReader, list[float], int]:
    bag = BagReader(folder)
    values: list[float] = []
    descriptions = 0
    for message in bag.messages():
        if message.topic.name == "/point":
            values.append(bag.decode(message).point.x)
        else:
            descriptions += 1
    return bag, values, descriptions


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_recording_with_every_message_in_it(
    node: Node, start_process: Callable[..., subprocess.Popen[bytes]], tmp_path: Path, number: signal.Signals
) -> None:
    process = start_process(command(tmp_path / "bag"), name="recorder")
    publish(node)
    process.send_signal(number)
    assert process.wait(PATIENCE) == 0
    bag, values, descriptions = recorded(tmp_path / "bag")
    assert bag.losses == []
    assert values == [float(k) for k in range(COUNT)]
    assert descriptions == 1
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


def test_a_killed_recorder_leaves_all_but_the_open_chunk(
    node: Node, start_process: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    process = start_process(command(tmp_path / "bag"), name="recorder")
    publish(node)
    file = tmp_path / "bag" / "bag_0.mcap"
    wait(lambda: sum(1 for _ in BagReader(file).messages()) > COUNT // 2, "chunk on the disk")
    process.kill()
    process.wait(PATIENCE)
    bag, values, _ = recorded(tmp_path / "bag")
    assert values == [float(k) for k in range(len(values))]
    assert bag.losses


def test_start_and_stop_by_service(node: Node, start_process: Callable[..., subprocess.Popen[bytes]], tmp_path: Path) -> None:
    start_process(command(tmp_path / "bag", autostart=False), name="recorder")
    answers = []
    for name in ("start", "stop", "stop"):
        client = node.create_client(Trigger, f"/recorder/{name}")
        assert client.wait_for_service(PATIENCE)
        seen = SeenBy(node, f"/recorder/{name}")

        def found(seen: SeenBy = seen) -> bool:
            rclpy.spin_once(node, timeout_sec=0.0)
            return seen()

        wait(found, "recorder that knows the client")
        future = client.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
        answers.append(future.result())
    assert [answer.success for answer in answers] == [True, True, False]
    assert "start" in answers[2].message
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


@pytest.mark.parametrize(("topics", "named"), [("['']", "topics"), ("['joint_states','no topic']", "no topic")])
def test_a_recorder_without_topics_or_with_a_wrong_one_refuses_to_start(
    ros_domain: int, tmp_path: Path, topics: str, named: str
) -> None:
    done = subprocess.run(command(tmp_path / "bag", topics=topics), capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 2
    assert named in done.stderr
    assert "Traceback" not in done.stderr


def test_nothing_follows_a_serialized_row_with_empty_sequences() -> None:
    from irec_msgs.msg import LoadCaseRecord

    three, row = [0.0] * 3, LoadCaseRecord()
    row.header.frame_id = "base_link"
    other_encoder = record_message.encode(
        stamp_ns=0, time=0.0, pose=0, load_case=0, repeat=0, joint_names=[], joint_position=[],
        joint_target=[], p_tcp_in_base=three, p_marker_in_station=three, marker="", station="", wrench_in_tool=[0.0] * 6,
        temperature_names=[], temperature=[],
    )  # fmt: skip
    assert len(exact_cdr(row)) == len(other_encoder) < len(serialize_message(row))
