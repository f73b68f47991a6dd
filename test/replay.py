# SPDX-License-Identifier: Apache-2.0
"""Publishes the messages of a recording, serialized as they are: replay.py BAG SPEED LISTENER TOPIC:NEW_TOPIC ..."""

from __future__ import annotations

import sys
import time
from importlib import import_module
from typing import Any

import rclpy
from irec_calibration.recording import BagReader
from rclpy.qos import QoSProfile, ReliabilityPolicy

PATIENCE = 90.0  # s


def wait_for(node: Any, listener: str, publishers: dict[str, Any]) -> None:
    """Until the node of that name, and nobody else, has matched every publisher; anybody else would start the stream early."""
    until = time.monotonic() + PATIENCE
    while True:
        heard_by = {topic: [i.node_name for i in node.get_subscriptions_info_by_topic(topic)] for topic in publishers}
        matched = all(publisher.get_subscription_count() == 1 for publisher in publishers.values())
        if matched and all(names == [listener] for names in heard_by.values()):
            return
        if time.monotonic() > until:
            sys.exit(f"expected {listener} alone to listen, found {heard_by}")
        time.sleep(0.02)


def main(bag: str, speed: float, listener: str, renamed: dict[str, str]) -> None:
    """Wait for the listener to every topic, then send the messages at `speed` times the pace of the recording."""
    rclpy.init()
    node = rclpy.create_node("replay")
    messages = sorted(BagReader(bag).messages(renamed), key=lambda message: message.log_time)
    publishers = {}
    for message in messages:
        topic = message.topic
        if topic.name not in publishers:
            package, _, kind = topic.type_name.split("/")
            qos = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
            message_class = getattr(import_module(f"{package}.msg"), kind)
            publishers[topic.name] = node.create_publisher(message_class, renamed[topic.name], qos)
    wait_for(node, listener, {renamed[topic]: publisher for topic, publisher in publishers.items()})
    begin, first = time.monotonic(), messages[0].log_time
    for message in messages:
        ahead = begin + (message.log_time - first) * 1e-9 / speed - time.monotonic()
        if ahead > 0:
            time.sleep(ahead)
        publishers[message.topic.name].publish(message.data)
    for publisher in publishers.values():
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=PATIENCE))
    print("replayed", flush=True)
    rclpy.try_shutdown()


if __name__ == "__main__":
    bag, speed, listener, *names = sys.argv[1:]
    main(bag, float(speed), listener, dict(name.split(":") for name in names))
