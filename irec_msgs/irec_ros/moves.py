# SPDX-License-Identifier: Apache-2.0
"""The answer of a driver to a move that has ended."""

from __future__ import annotations

from rclpy.action.server import ServerGoalHandle

from irec_msgs.action import Move

# s of the driver's clock for which it remembers a move that has ended. Each change of a move publishes all that are remembered:
# with the 900 s of rclpy these messages, and what both sides keep room for, grow with every move of a quarter of an hour
RESULT_KEPT = 10


def answer_move(handle: ServerGoalHandle, fraction: float, problem: str) -> Move.Result:
    """Close the goal and say how it ended.

    Args:
        fraction: share of the way that was driven.
        problem: why it could not be driven to its end; empty where it was driven or cancelled.
    """
    if problem:
        handle.abort()
        return Move.Result(success=False, message=problem)
    if handle.is_cancel_requested:
        handle.canceled()
        return Move.Result(success=False, message=f"cancelled after {100 * fraction:.0f} % of the way")
    handle.succeed()
    return Move.Result(success=True)
