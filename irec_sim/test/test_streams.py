# SPDX-License-Identifier: Apache-2.0
"""Streams keep their rates on the grid of the steps, and quick serialization says the same as the slow one."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")

from geometry_msgs.msg import Point, PointStamped
from irec_sim.nodes.streams import Stream, Template, ros_time
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("rate", [250.0, 100.0, 30.0, 1.0, 0.0])
def test_a_stream_is_published_as_often_as_its_rate_says(rate: float) -> None:
    stream = Stream(rate, lambda: None)
    assert sum(stream.due(step, 0.004) for step in range(1, 2501)) == round(10 * rate)


def test_a_stream_below_the_rate_of_the_steps_is_spread_evenly() -> None:
    stream = Stream(100.0, lambda: None)
    steps = [step for step in range(1, 1001) if stream.due(step, 0.004)]
    assert {after - before for before, after in zip(steps, steps[1:], strict=False)} == {2, 3}


def test_a_template_gives_the_message_with_new_stamp_and_numbers() -> None:
    template = Template(PointStamped(header=Header(frame_id="A"), point=Point(x=1.0, y=2.0, z=3.0)), [1.0, 2.0, 3.0])
    message = deserialize_message(template.serialized(ros_time(12.5), [0.1, -0.2, 0.3]), PointStamped)
    expected = PointStamped(header=Header(stamp=ros_time(12.5), frame_id="A"), point=Point(x=0.1, y=-0.2, z=0.3))
    assert message == expected


def test_a_template_finds_the_positions_of_a_joint_state() -> None:
    names = ["joint_1", "joint_22", "ext_rail"]
    template = Template(JointState(name=names, position=[1.0, 2.0, 3.0]), [1.0, 2.0, 3.0])
    message = deserialize_message(template.serialized(ros_time(1.0), [7.0, 8.0, 9.0]), JointState)
    assert (list(message.name), list(message.position)) == (names, [7.0, 8.0, 9.0])


def test_nothing_follows_a_message_with_empty_sequences() -> None:
    """Strict readers of a recording refuse what the middleware estimates too much for empty velocity and effort."""
    names = [*(f"joint_{k}" for k in range(1, 7)), "ext_rail"]
    data = Template(JointState(name=names, position=[float(k) for k in range(7)]), [float(k) for k in range(7)])
    stamp_and_empty_frame, six_names, rail, count_and_positions, two_empty = 4 + 8 + 4 + 4, 4 + 6 * 12, 16, 4 + 7 * 8, 8
    expected = stamp_and_empty_frame + six_names + rail + count_and_positions + two_empty
    assert len(data.serialized(ros_time(0.0), [0.0] * 7)) == expected == 180


def test_a_template_refuses_numbers_that_it_does_not_find() -> None:
    with pytest.raises(TypeError, match="PointStamped"):
        Template(PointStamped(point=Point(x=1.0, y=2.0, z=3.0)), [3.0, 2.0, 1.0])


def test_a_stamp_never_has_more_than_a_second_of_nanoseconds() -> None:
    stamp = ros_time(3.9999999999)
    assert (stamp.sec, stamp.nanosec) == (4, 0)
