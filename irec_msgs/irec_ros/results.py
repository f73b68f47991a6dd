# SPDX-License-Identifier: Apache-2.0
"""The result of an action's goal, asked for again where the answer may have been lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus

AGAIN = 20.0  # s without any news of the goal after which its result is asked for again: DDS forgets a silent process after 20 s


class GoalResult:
    """Waits for the end of a goal.

    A process that stood still (a debugger, a machine that slept) is forgotten by the others, and forgets them. Once it runs, they
    find each other again, but a result that it sends before is lost, and who asked once would wait for ever. A server keeps
    results (rclpy: 900 s) and answers again, and one that was started anew says that it knows nothing of the goal.
    """

    def __init__(self, handle: Any, clock: Callable[[], float] = time.monotonic) -> None:
        """handle: of an accepted goal (rclpy.action.client.ClientGoalHandle). clock: s."""
        self._handle, self._clock = handle, clock
        self._asked = [handle.get_result_async()]
        self._heard = clock()

    def heard(self) -> None:
        """The server has said something of this goal, e.g. feedback."""
        self._heard = self._clock()

    def poll(self) -> Any:
        """The answer (`status`, `result`), or None while the goal is under way; asks again if need be, never waits."""
        for future in self._asked:
            if future.done():
                return future.result()
        if self._clock() - self._heard > AGAIN:
            self.heard()
            self._asked.append(self._handle.get_result_async())
        return None


def is_unknown(answer: Any) -> bool:
    """Whether the server knows nothing of the goal: it was started anew since, or has forgotten it."""
    return bool(answer.status == GoalStatus.STATUS_UNKNOWN)
