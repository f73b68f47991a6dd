# SPDX-License-Identifier: Apache-2.0
"""A look at the standing cell before a recertification: some seconds of all that it measures."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped, WrenchStamped
from irec_ros.guard import GuardedNode
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, Temperature

from irec_msgs.msg import RobotState

from ..recertification.readings import Readings, enough_readings

LOOK_SECONDS = 6.0  # of the machine's clock, for readings before anything moves
LOOK_LONGEST = 30.0  # where the marker does not plainly stand still by then
MODES = {RobotState.MODE_POSITION: "position", RobotState.MODE_FORCE: "force", RobotState.MODE_FAULT: "fault"}


def look(node: Any, noise: dict[str, float], go_on: Callable[[], None]) -> Readings:
    """Listen for a few seconds, longer where they don't suffice.

    Args:
        noise: of the cell file, by which it is told whether they do.
        go_on: called again and again; what it raises ends the look.
    """
    force: list[list[float]] = []
    marker: list[list[float]] = []
    joints: list[list[float]] = []
    stations: list[str] = []
    t_marker: list[float] = []
    temperature: dict[str, list[float]] = {}
    state: list[RobotState] = []

    def on_wrench(m: WrenchStamped) -> None:
        force.append([m.wrench.force.x, m.wrench.force.y, m.wrench.force.z])

    def on_point(m: PointStamped) -> None:
        marker.append([m.point.x, m.point.y, m.point.z])
        t_marker.append(m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec)
        stations.append(m.header.frame_id)

    def on_joints(m: JointState) -> None:
        if not joints or len(m.position) == len(joints[0]):
            joints.append(list(m.position))

    sensors = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    listening: list[tuple[type, str, Callable[[Any], None]]] = [
        (WrenchStamped, "wrench", on_wrench),
        (PointStamped, "tracker/point", on_point),
        (JointState, "joint_states", on_joints),
        (RobotState, "robot/state", state.append),
    ]

    def readings() -> Readings:
        last = state[-1] if state else None
        return Readings(
            np.array(force).reshape(-1, 3), np.array(marker).reshape(-1, 3), np.array(joints), np.array(t_marker), stations,
            {name: float(np.median(values)) for name, values in temperature.items()},
            "" if last is None else MODES.get(last.mode, "an unknown"), last is not None and last.in_motion,
        )  # fmt: skip

    # a node of its own, turned in this thread: subscriptions must not be destroyed while another executor waits on them
    ear = GuardedNode(
        f"{node.get_name()}_listener",
        context=node.context,
        namespace=node.get_namespace(),
        start_parameter_services=False,
    )
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(ear)
    try:
        for kind, name, take in listening:
            ear.create_subscription(kind, name, take, sensors)
        heard: set[str] = set()
        begun = time.monotonic()
        for end in (LOOK_SECONDS, 0.5 * (LOOK_SECONDS + LOOK_LONGEST), LOOK_LONGEST):
            while time.monotonic() - begun < end and node.context.ok():
                go_on()
                for name in _thermometers(node) - heard:  # again and again: a cell that was just switched on is found bit by bit
                    heard.add(name)
                    ear.create_subscription(Temperature, name, _into(temperature, name.rpartition("/")[2]), sensors)
                executor.spin_once(timeout_sec=0.1)
            if enough_readings(readings(), noise):
                break
    finally:
        executor.shutdown(timeout_sec=1.0)
        ear.destroy_node()
    return readings()


def _thermometers(node: Any) -> set[str]:
    topics = node.get_topic_names_and_types()
    return {name for name, types in topics if "sensor_msgs/msg/Temperature" in types and "temperature/" in name}


def _into(values: dict[str, list[float]], name: str) -> Callable[[Temperature], None]:
    def take(message: Temperature) -> None:
        values.setdefault(name, []).append(message.temperature)

    return take
