# SPDX-License-Identifier: Apache-2.0
"""`can_ft_node`: this process reads the force sensor on CAN and never imports ROS; the node is its child and publishes."""

from __future__ import annotations

import multiprocessing
import socket
import sys
from multiprocessing.connection import Connection

from ..can_ft.process import run_sensor


def _ros_side(pipe: Connection, records: socket.socket, arguments: list[str]) -> None:
    from .can_ft_publisher import main as run_node  # rclpy is imported in the child only

    sys.exit(run_node(pipe, records, arguments))


def main() -> int:
    """Start the node, then read the sensor in this process."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    send, receive = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    node = context.Process(target=_ros_side, args=(theirs, receive, sys.argv), name="can_ft_publisher", daemon=True)
    node.start()
    theirs.close()
    receive.close()
    return run_sensor(ours, send)


if __name__ == "__main__":
    sys.exit(main())
