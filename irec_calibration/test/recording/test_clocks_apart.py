# SPDX-License-Identifier: Apache-2.0
"""Stamps of another clock show in a recording by the times at which its messages were received."""

from __future__ import annotations

from dataclasses import replace

from irec_calibration.commands.inspect_bag import _text
from irec_calibration.recording.survey import NEEDED_RATES, Skew, Survey, TopicSurvey, clocks_apart

TOPICS = ("/joint_states", "/wrench", "/tracker/point", "/tcp_pose")


def topic(name: str, kind: str, least: float, middle: float | None = None) -> TopicSurvey:
    """Lags in s: the least, and the median."""
    skew = Skew(least, least + 0.004 if middle is None else middle, least + 1.5, 0.1)
    return TopicSurvey(name, kind, 1000, True, 100.0, 0.01, (), 0, False, 0, 0, skew, 0)


def topics(**least: float) -> tuple[TopicSurvey, ...]:
    known = zip(TOPICS, NEEDED_RATES, strict=True)
    return tuple(topic(name, kind, least.get(name.split("/")[1], 0.001)) for name, kind in known)


def inspected(found: tuple[TopicSurvey, ...]) -> str:
    return _text(Survey("a.mcap", ("a.mcap",), 10.0, found, (), {}, (), (), ()))


def test_a_topic_whose_stamps_are_of_another_clock_is_irregular_and_named() -> None:
    ahead = topics(tracker=-1.998)
    assert "/tracker/point: stamps 1994 ms ahead of the times at which they were received, limit 300 ms" in inspected(ahead)
    (said,) = clocks_apart(ahead)
    assert "the stamps of /tracker/point are 1999 ms ahead of those of the other topics" in said
    (said,) = clocks_apart(topics(wrench=0.501))
    assert "the stamps of /wrench are 500 ms behind those of the other topics" in said
    assert "/wrench: stamps at least 501 ms behind" in inspected(topics(wrench=0.501))


def test_topics_of_one_clock_are_neither() -> None:
    assert not clocks_apart(topics(tracker=0.2)) and "Irregular" not in inspected(topics(tracker=0.2))


def test_a_recorder_whose_clock_differs_from_that_of_all_topics_tells_none_from_another() -> None:
    alike = topics(joint_states=-2.0, wrench=-2.001, tracker=-1.999, tcp_pose=-2.0)
    assert not clocks_apart(alike) and "Irregular" in inspected(alike)


def test_messages_of_which_some_are_held_up_are_of_the_same_clock() -> None:
    late = [replace(t, skew=Skew(0.001, 0.9, 1.8, 0.5)) if t.name == "/wrench" else t for t in topics()]
    assert not clocks_apart(late) and "Irregular" not in inspected(tuple(late))


def test_rows_are_recorded_half_a_window_after_their_stamps() -> None:
    assert "Irregular" not in inspected((topic("/irec/procedure/load_case", "irec_msgs/msg/LoadCaseRecord", 0.6),))


def test_of_two_topics_nobody_knows_which_is_wrong() -> None:
    assert not clocks_apart(topics(tracker=-2.0)[1:3])
