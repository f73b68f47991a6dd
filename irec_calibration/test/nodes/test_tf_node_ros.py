# SPDX-License-Identifier: Apache-2.0
"""tf_node as a process: the chain of frames that it publishes puts the TCP where forward kinematics puts it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("tf2_msgs", reason="tf2_msgs is not built: run `make test`")

import rclpy
from irec_calibration.cell import read_cell
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

pytestmark = pytest.mark.ros
CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
PATIENCE = 90.0  # s
RAIL = 0.4


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    rclpy.init()
    made = rclpy.create_node("driver")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def frames_of(
    node: Node, start_process: Callable[..., subprocess.Popen[bytes]], message: JointState, **parameters: object
) -> dict[str, tuple[str, np.ndarray]]:
    """Child -> parent and transform (4, 4) of everything on /tf and /tf_static after one message of joint states."""
    found: dict[str, tuple[str, np.ndarray]] = {}

    def take(transforms: TFMessage) -> None:
        for t in transforms.transforms:
            p, r = t.transform.translation, t.transform.rotation
            at = np.eye(4)
            at[:3, :3] = Rotation.from_quat([r.x, r.y, r.z, r.w]).as_matrix()
            at[:3, 3] = p.x, p.y, p.z
            found[t.child_frame_id] = (t.header.frame_id, at)

    node.create_subscription(TFMessage, "/tf", take, 10)
    node.create_subscription(TFMessage, "/tf_static", take, QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    states = node.create_publisher(JointState, "joint_states", 5)
    settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    start_process([sys.executable, "-m", "irec_calibration.nodes.tf_node", "--ros-args", *settings], name="tf_node")
    until = time.monotonic() + PATIENCE
    while not all(any(child.endswith(end) for child in found) for end in ("tool0", "link_6")):
        assert time.monotonic() < until, f"tf_node said no more than {sorted(found)} within {PATIENCE} s"
        states.publish(message)
        rclpy.spin_once(node, timeout_sec=0.05)
    return found


def in_frame(frames: dict[str, tuple[str, np.ndarray]], child: str, root: str) -> np.ndarray:
    at = np.eye(4)
    while child != root:
        child, step = frames[child]
        at = step @ at
    return at


def test_the_tcp_is_where_forward_kinematics_puts_it_on_the_rail_of_the_cell(node, start_process):
    cell = read_cell(CELL)
    q = cell.home + 0.1
    message = JointState(name=[*cell.robot.joint_names, "ext_rail"], position=[*map(float, q), RAIL])
    frames = frames_of(node, start_process, message, cell=CELL)
    kin = cell.robot.kinematics(q[None])
    tcp = in_frame(frames, "tool0", "cell")
    assert np.allclose(tcp[:3, 3], kin.p_tcp[0] + RAIL * cell.rail.axis, atol=1e-9)
    assert np.allclose(tcp[:3, :3], kin.R_tool[0], atol=1e-9)
    assert np.allclose(in_frame(frames, f"station_{cell.stations[0].name}", "cell")[:3, 3], cell.stations[0].p_in_cell)


def test_two_cells_on_one_graph_keep_their_frames_apart_by_a_prefix(node, start_process):
    cell = read_cell(CELL)
    message = JointState(name=list(cell.robot.joint_names), position=[float(v) for v in cell.home])
    frames = frames_of(node, start_process, message, robot_description_file=cell.robot.source, frame_prefix="left/")
    assert frames and all(child.startswith("left/") and parent.startswith("left/") for child, (parent, _) in frames.items())
