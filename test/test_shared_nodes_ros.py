# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: a callback that fails, parameters out of their range, names of diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from irec_ros.guard import Guarded, GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros
PATIENCE = 90.0  # s
TABLE = (
    P("cell", "", "cell file"),
    P("speed", 1.0, "simulated per real seconds", 0.1, 100.0, settable=True),
    P("limit", 0.003, "largest offset", 0.0, 0.02, "m"),
    P("depth", 3, "messages", 1, 10),
    P("gravity", [0.0, 0.0, -9.81], "free fall"),
)


class Fragile(Guarded, Node):
    """Fails in each kind of callback."""

    def __init__(self) -> None:
        super().__init__("fragile", namespace="/cell_a")
        self.heard: list[str] = []
        self.reactions: dict[str, bool] = {}
        self.create_subscription(String, "word", self._on_word, 10)
        self.create_service(Trigger, "ask", self._on_ask)
        self.create_timer(0.01, self._on_time)

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        self.reactions[where] = answered

    def _on_word(self, message: String) -> None:
        self.heard.append(message.data)
        if message.data == "bad":
            raise ValueError("three positions, six joints")

    def _on_ask(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        raise KeyError("mass")

    def _on_time(self) -> None:
        raise ZeroDivisionError("no time")


@pytest.fixture
def context(ros_domain: int) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


def until(nodes: list[Node], condition: Callable[[], Any]) -> None:
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.05)
    executor.shutdown()


def test_an_error_in_a_callback_answers_the_caller_is_told_in_diagnostics_and_the_node_goes_on(context: None) -> None:
    node, other = Fragile(), Node("other", namespace="/cell_a")
    told: dict[str, str] = {}
    other.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: told.update({s.name: s.message for s in m.status}), 100
    )
    words, ask = other.create_publisher(String, "word", 10), other.create_client(Trigger, "ask")
    found = (ask.service_is_ready, words.get_subscription_count, lambda: node.count_subscribers("/diagnostics"))
    until([node, other], lambda: all(condition() for condition in found))
    answer = ask.call_async(Trigger.Request())
    words.publish(String(data="bad"))
    words.publish(String(data="good"))
    until([node, other], lambda: answer.done() and "good" in node.heard and "cell_a/fragile: topic word" in told)
    assert not answer.result().success and "KeyError: 'mass'" in answer.result().message
    assert "ValueError: three positions, six joints" in told["cell_a/fragile: topic word"]
    assert node.reactions == {"topic word": False, "service ask": True, "timer on_time": False}


def make(**given: Any) -> tuple[GuardedNode, Parameters]:
    node = GuardedNode("node", parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    parameters = Parameters(node, TABLE)
    refuse_unknown_parameters(node)
    return node, parameters


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"speed": 0.0}, "speed"),
        ({"limit": float("nan")}, "limit"),
        ({"gravity": [0.0, float("inf"), 0.0]}, "finite"),
        ({"depth": 11}, "depth"),
        ({"lmit": 0.001}, "but limit"),
        ({"cell": 5}, "cell"),
    ],
)
def test_a_parameter_that_can_not_be_is_refused_by_name(context: None, given: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterException, match=message):
        make(**given)


def test_what_can_not_be_set_while_running_is_read_only_and_the_rest_is_told_to_the_node(context: None) -> None:
    node, parameters = make(limit=0, speed=2)
    assert parameters["limit"] == 0.0 and isinstance(parameters["speed"], float)
    speeds: list[float] = []
    parameters.when_set("speed", speeds.append)
    answers = node.set_parameters([Parameter("cell", value="x"), Parameter("speed", value=4), Parameter("speed", value=1e9)])
    assert [a.successful for a in answers] == [False, True, False]
    assert "read-only" in answers[0].reason
    assert speeds == [4.0]
    assert "[m]" in node.describe_parameter("limit").description


def test_the_quality_of_service_of_each_topic_can_be_overridden_and_no_other_entity_changes(ros_domain: int) -> None:
    override = "qos_overrides./cell_a/word.subscription.reliability:=best_effort"
    rclpy.init(args=["--ros-args", "-p", override])
    try:
        node = Fragile()
        shared = QoSProfile(depth=7)
        other = node.create_subscription(String, "other", lambda _: None, shared)
        words = next(s for s in node.subscriptions if s.topic_name == "/cell_a/word")
        assert words.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        assert other.qos_profile.reliability == ReliabilityPolicy.RELIABLE and shared.depth == 7
        refuse_unknown_parameters(node)
        node.destroy_subscription(other)
        node.create_subscription(String, "other", lambda _: None, shared)  # as a lifecycle node does when configured again
    finally:
        rclpy.try_shutdown()
