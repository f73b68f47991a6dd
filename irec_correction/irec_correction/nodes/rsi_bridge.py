# SPDX-License-Identifier: Apache-2.0
"""`rsi_bridge`: this process answers the controller and never imports ROS; the node is its child and watches.

The child dies alone: the loop fades out and goes on answering. The loop dies: the robot stops by its own time-out.
"""

from __future__ import annotations

import multiprocessing
import sys
from multiprocessing.connection import Connection

from ..rsi.bridge import run_bridge


def _ros_side(pipe: Connection, arguments: list[str]) -> None:
    from .rsi_node import main as run_node  # rclpy is imported in the child only

    sys.exit(run_node(pipe, arguments))


def main() -> int:
    """Start the node, then answer packets in this process."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    node = context.Process(target=_ros_side, args=(theirs, sys.argv), name="rsi_node", daemon=True)
    node.start()
    theirs.close()
    return run_bridge(ours)


if __name__ == "__main__":
    sys.exit(main())
