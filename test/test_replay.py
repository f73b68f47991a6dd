# SPDX-License-Identifier: Apache-2.0
"""A foreign recording of a real robot and tracker passes through the subscribing side of the nodes whole and in order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from irec_calibration.cell import read_cell
from irec_calibration.nodes.instruments import Instruments
from irec_calibration.procedure.axes import read_axes
from irec_calibration.procedure.inputs import Inputs
from irec_calibration.procedure.standstill import Streams
from irec_calibration.recording import BagReader
from rclpy.experimental import EventsExecutor

pytestmark = [pytest.mark.ros, pytest.mark.alone]
ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("IREC_REAL_DATA", ROOT.parent / "shared" / "data"))
BAG = DATA / "akig_ur5_tracker_bag" / "rotateBaseBFspeed1Pts10hzLAN_ros2_mcap"
TOPICS = {"/joint_states": "/joint_states", "/wrench": "/wrench", "/tracker_points": "/tracker/point"}
SPEED = 10.0
PATIENCE = 120.0  # s


def assert_whole_and_in_order(heard: list[bytes], messages: list[bytes], topic: str) -> None:
    """Every message once, in the order in which it was sent."""
    known = set(heard)
    missing = [i for i, message in enumerate(messages) if message not in known]
    assert not missing, f"{topic}: {len(missing)} of {len(messages)} are missing, from number {missing[0]} to {missing[-1]}"
    assert heard == messages, f"{topic}: doubled or out of order"


@pytest.fixture
def sent() -> dict[str, list[bytes]]:
    """Serialized messages of the recording by the topic that they are replayed on."""
    if not BAG.is_dir():
        pytest.skip(f"no real data at {BAG}; set IREC_REAL_DATA")
    messages: dict[str, list[bytes]] = defaultdict(list)
    for message in sorted(BagReader(BAG).messages(TOPICS), key=lambda m: m.log_time):
        messages[TOPICS[message.topic.name]].append(message.data)
    return messages


def replay(start_process: Callable[..., subprocess.Popen[bytes]], listener: str) -> subprocess.Popen[bytes]:
    program = str(Path(__file__).with_name("replay.py"))
    names = [f"{old}:{new}" for old, new in TOPICS.items()]
    return start_process([sys.executable, program, str(BAG), str(SPEED), listener, *names], name="replay")


class Catcher:
    """Stands in the place of the session recorder: keeps what the subscriptions hand over."""

    def __init__(self) -> None:
        self.topics: list[str] = []
        self.messages: dict[str, list[bytes]] = defaultdict(list)

    def add_topic(self, topic: str, _: str) -> int:
        self.topics.append(topic)
        return len(self.topics) - 1

    def write_raw(self, channel: int, data: bytes, _: int) -> None:
        self.messages[self.topics[channel]].append(data)


def test_the_procedure_hears_every_message_once_and_in_order(
    ros_domain: int, start_process: Callable[..., Any], sent: dict[str, list[bytes]]
) -> None:
    rclpy.init()
    node = rclpy.create_node("listener")
    try:
        streams, catcher = Streams(horizon_s=60.0), Catcher()
        inputs = Inputs(streams, read_axes(read_cell(ROOT / "config" / "cells" / "afp.yaml")), ["A"])
        instruments = Instruments(node, inputs, lambda _: None, lambda: None)
        instruments.record_to(catcher)  # type: ignore[arg-type]
        executor = EventsExecutor()
        executor.add_node(node)
        process = replay(start_process, "listener")
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until and any(catcher.messages[t][-1:] != m[-1:] for t, m in sent.items()):
            executor.spin_once(timeout_sec=0.1)
        assert process.wait(PATIENCE) == 0
        for topic, messages in sent.items():
            assert_whole_and_in_order(catcher.messages[topic], messages, topic)
        assert streams.counts["force"] == 0, "forces in a frame that is not tool0 are recorded but not believed"
        assert "wrench" in str(inputs.faults)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_the_recorder_writes_every_message_once_and_in_order(
    ros_domain: int, start_process: Callable[..., Any], sent: dict[str, list[bytes]], tmp_path: Path
) -> None:
    topics = f"[{','.join(TOPICS.values())}]"
    node = [sys.executable, "-m", "irec_calibration.nodes.recorder_node", "--ros-args"]
    recorder = start_process([*node, "-p", f"output:={tmp_path / 'bag'}", "-p", f"topics:={topics}"], name="recorder")
    assert replay(start_process, "recorder").wait(PATIENCE) == 0
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(PATIENCE) == 0
    bag = BagReader(tmp_path / "bag")
    recorded: dict[str, list[bytes]] = defaultdict(list)
    for message in bag.messages():
        recorded[message.topic.name].append(message.data)
    assert bag.losses == []
    for topic, messages in sent.items():
        assert_whole_and_in_order(recorded[topic], messages, topic)
