# SPDX-License-Identifier: Apache-2.0
"""Records topics as they come, serialized, into a rosbag2 folder: no message is decoded on the way to the file."""

from __future__ import annotations

import sys
import threading
import time
from datetime import datetime
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from irec_ros.guard import GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process, spin_until
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_topic_name import validate_topic_name
from std_srvs.srv import Trigger

from .. import __version__
from ..errors import RecordingError
from ..recording import BagWriter, Qos

DISCOVERY_PERIOD = 0.2  # s of the machine's clock, between looks for topics that are not there yet
STOP_TIME = 2.0  # s that a stop may wait for messages that have arrived already
QUIET_SPINS = 5  # turns of the executor without a message, after which none is left
QUEUE_DEPTH = 5000  # messages; a recorder that is held up for seconds loses nothing
PARAMETERS = (
    P("output", "", "folder to write; empty: recording_<date>_<time> in the current folder"),
    P("topics", [""], "names of the topics to record"),
    P("attachments", [""], "files to store inside the recording"),
    P("autostart", True, "record from the start"),
)


class RecorderNode(GuardedNode):
    """Parameters: see PARAMETERS. Services: ~/start, ~/stop."""

    def __init__(self) -> None:
        super().__init__("recorder")
        p = Parameters(self, PARAMETERS)
        refuse_unknown_parameters(self)
        self._output: str = p["output"]
        self._topics = [t for t in p["topics"] if t]
        self._attachments = [Path(f) for f in p["attachments"] if f]
        if not self._topics:
            raise RecordingError("parameter 'topics' is empty; name at least one topic to record")
        for topic in self._topics:
            try:
                validate_topic_name(topic)
            except NameValidationException as error:
                raise RecordingError(f"parameter 'topics' names '{topic}': {' '.join(str(error).split())}") from error
        for path in self._attachments:
            if not path.is_file():
                raise RecordingError(f"parameter 'attachments' names {path}, which is not a file")
        self._writer: BagWriter | None = None
        self._subscriptions_by_topic: dict[str, Any] = {}
        self._runs = 0
        self.received = 0
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_timer(DISCOVERY_PERIOD, self._look_for_topics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if p["autostart"]:
            self.start()

    def start(self) -> Path:
        """Open a new recording; returns its folder. RecordingError where one is open or the folder exists."""
        if self._writer is not None:
            raise RecordingError(f"{self._writer.path.parent} is being recorded; stop it first")
        name = self._output or datetime.now().astimezone().strftime("recording_%Y%m%d_%H%M%S")
        folder = Path(name if self._runs == 0 else f"{name}_{self._runs + 1}")
        if folder.exists():
            raise RecordingError(f"{folder} exists; recordings are never overwritten: set parameter 'output' to another name")
        writer = BagWriter(folder / f"{folder.name}_0.mcap")
        self._runs += 1
        writer.add_metadata("irec", {"version": __version__, "ros_distro": "jazzy", "topics": "\n".join(self._topics)})
        for path in self._attachments:
            writer.attach(path.name, path.read_bytes())
        self._writer = writer
        self._look_for_topics()
        self.get_logger().info(f"recording {len(self._topics)} topics to {folder}")
        return folder

    def stop(self) -> str:
        """Close the recording; returns one sentence. RecordingError where none is open or writing failed."""
        if self._writer is None:
            raise RecordingError("nothing is being recorded; call start first")
        writer, self._writer = self._writer, None
        for subscription in self._subscriptions_by_topic.values():
            self.destroy_subscription(subscription)
        self._subscriptions_by_topic.clear()
        writer.close()
        writer.write_bag_metadata()
        return f"{writer.message_count} messages in {writer.path.parent}"

    @property
    def recording(self) -> bool:
        return self._writer is not None

    def _look_for_topics(self) -> None:
        if self._writer is None or len(self._subscriptions_by_topic) == len(self._topics):
            return
        known = dict(self.get_topic_names_and_types())
        for topic in self._topics:
            name = self.resolve_topic_name(topic)
            if topic in self._subscriptions_by_topic or not known.get(name):
                continue
            offers = [info.qos_profile for info in self.get_publishers_info_by_topic(name)]
            if not offers:
                continue
            self._subscribe(topic, name, known[name][0], offers)

    def _subscribe(self, topic: str, name: str, type_name: str, offers: list[QoSProfile]) -> None:
        writer = self._writer
        if writer is None:
            return
        reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
        latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
        qos = QoSProfile(
            depth=QUEUE_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        offered = Qos(
            "reliable" if reliable else "best_effort", "transient_local" if latched else "volatile", offers[0].depth or 1
        )
        channel = writer.add_topic(name, type_name, offered)
        package, _, kind = type_name.split("/")
        message_class = getattr(import_module(f"{package}.msg"), kind)
        callback = partial(self._on_message, writer, channel)
        self._subscriptions_by_topic[topic] = self.create_subscription(message_class, name, callback, qos, raw=True)

    def _on_message(self, writer: BagWriter, channel: int, data: bytes) -> None:
        self.received += 1
        if writer is self._writer:  # what was under way when the recording was stopped is left out
            writer.write(channel, data, self.get_clock().now().nanoseconds)

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, lambda: f"recording to {self.start()}")

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self.stop)

    def _answer(self, response: Trigger.Response, action: Any) -> Trigger.Response:
        try:
            response.message, response.success = str(action()), True
        except RecordingError as error:
            response.message, response.success = str(error), False
        return response


def main() -> int:
    """Record until SIGINT, SIGTERM or SIGHUP, then write what has arrived by then and finish the file."""
    return run_process("recorder", _work, RecordingError)


def _work(asked_to_stop: threading.Event) -> None:
    node = RecorderNode()
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        spin_until(asked_to_stop, executor.spin_once)
        _empty_queues(node, executor)
    finally:
        if node.recording:
            print(f"recorder: {node.stop()}", file=sys.stderr)


def _empty_queues(node: RecorderNode, executor: EventsExecutor) -> None:
    """Take what the middleware has received already."""
    end = time.monotonic() + STOP_TIME
    quiet = 0
    while quiet < QUIET_SPINS and time.monotonic() < end:
        before = node.received
        executor.spin_once(timeout_sec=0.01)
        quiet = 0 if node.received > before else quiet + 1


if __name__ == "__main__":
    sys.exit(main())
