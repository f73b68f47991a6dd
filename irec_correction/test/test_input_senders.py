# SPDX-License-Identifier: Apache-2.0
"""Two publishers of an input are told, one that is started anew is not."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
from irec_correction.nodes.input_senders import FORGET, GRACE, LOOK, InputSenders

TOPICS = ("wrench", "joint_states")


class Graph:
    """Publishers per topic, and a clock."""

    def __init__(self) -> None:
        self.now, self.count = 50.0, dict.fromkeys(TOPICS, 1)
        self.senders = InputSenders(self.others, ("wrench",), "joint_states", lambda: self.now)

    def others(self, topic: str, own: int) -> str:
        return f"{self.count[topic]} publishers of {topic} (/a, /b)" if self.count[topic] > own else ""

    def after(self, seconds: float) -> str:
        for _ in range(round(seconds / LOOK)):
            self.now += 1.01 * LOOK
            found = self.senders.found()
        return found

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.mark.parametrize("topic", TOPICS)
def test_two_publishers_of_an_input_are_told_after_a_second_and_no_more_when_one_has_gone(topic):
    graph = Graph()
    assert graph.after(5.0) == ""
    graph.count[topic] = 2
    assert graph.after(0.8 * GRACE) == ""
    assert graph.after(0.4 * GRACE) == f"2 publishers of {topic} (/a, /b)"
    graph.count[topic] = 1
    assert graph.after(0.2) == ""


def test_one_that_has_just_gone_keeps_nobody_from_starting():
    graph = Graph()
    graph.count["wrench"] = 2
    assert graph.after(2.0 * GRACE) != ""
    graph.count["wrench"] = 1
    assert graph.senders.found_at_start(graph.sleep) == ""


def test_a_publisher_that_is_started_anew_is_not_told():
    graph = Graph()
    for count in (1, 2, 1, 0, 1, 2, 1):
        graph.count["wrench"] = count
        assert graph.after(0.6) == ""


def test_who_sends_joints_of_another_device_is_no_other_sender_until_nothing_comes_from_it():
    graph = Graph()
    graph.count["joint_states"] = 2
    for _ in range(20):
        graph.senders.saw_strangers(["gripper"])
        assert graph.after(0.5) == ""
    assert "2 publishers of joint_states" in graph.after(FORGET + 2.0 * GRACE)
    graph.senders.saw_strangers(["gripper"])
    graph.count["joint_states"] = 3
    assert "3 publishers of joint_states" in graph.after(2.0 * GRACE)


def test_at_the_start_a_second_is_waited_for_one_of_two_to_go():
    graph = Graph()
    assert graph.senders.found_at_start(graph.sleep) == "" and graph.now == 50.0
    graph.count["wrench"] = 2
    assert "2 publishers of wrench" in graph.senders.found_at_start(graph.sleep)
    assert GRACE <= graph.now - 50.0 <= GRACE + 2 * LOOK

    def one_goes(seconds: float) -> None:
        graph.sleep(seconds)
        graph.count["wrench"] = 1

    assert graph.senders.found_at_start(one_goes) == ""
