# SPDX-License-Identifier: Apache-2.0
"""The page's side of the cell: recertify, pause, resume, stop, put in force. rclpy in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

from ..errors import IrecError
from ..recertification.preconditions import told_lines

ANSWER = 5.0  # s
PUT_ANSWER = 90.0  # s: calibration_node itself waits for correction_node, 10 s until it is there and 60 s for its answer
POLL = 0.1  # s


class RosLink:
    """Talks to the nodes of the cell. Raises IrecError on construction where ROS is not there."""

    def __init__(self) -> None:
        try:
            import rclpy
            from irec_ros.guard import GuardedNode
            from irec_ros.results import GoalResult, is_unknown
            from rclpy.action import ActionClient
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.qos import DurabilityPolicy, QoSProfile
            from rclpy.signals import SignalHandlerOptions
            from std_srvs.srv import Trigger

            from irec_msgs.action import Recertify
            from irec_msgs.msg import ProcedureStatus
            from irec_msgs.srv import PutInForce
        except ImportError as error:
            raise IrecError(f"ROS 2 or the messages of irec are not here ({error.name})") from error
        self._goal_type, self._put_type, self._trigger_type = Recertify.Goal, PutInForce.Request, Trigger.Request
        self.progress: dict[str, Any] | None = None
        self.preconditions: list[str] = []  # of the run under way or of the last one, as far as told, one line each
        self._goal: Any = None
        self._result: Any = None
        self._result_of, self._is_unknown = GoalResult, is_unknown
        self._asked = False  # from before the answer of calibration_node on: feedback may come earlier than it
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = GuardedNode("irec_cell_page", context=self._context)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(ProcedureStatus, "irec/procedure/status", self._on_status, latched)
        self._recertify = ActionClient(self._node, Recertify, "irec/recertify")
        client = self._node.create_client
        self._clients = {
            "irec/put_in_force": client(PutInForce, "irec/put_in_force"),
            "irec/procedure/pause": client(Trigger, "irec/procedure/pause"),
            "irec/procedure/resume": client(Trigger, "irec/procedure/resume"),
        }
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="irec cell page", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether a run that this page began is under way."""
        return self._asked

    async def recertify(
        self, who: str, confirmed: list[str], *, check_only: bool = False, full: bool = False, resume: bool = False
    ) -> dict[str, Any]:
        """Run a recertification to its end. Raises IrecError: calibration_node does not answer, or refuses."""
        if self.running:
            raise IrecError("A run is under way already.")
        self._asked, self.preconditions = True, []
        goal = self._goal_type(operator_name=who, confirmed=confirmed, check_only=check_only, full=full, resume=resume)
        try:
            result = await self._run(goal)
        finally:
            self._goal, self._result, self.progress, self._asked = None, None, None, False
        names = ("success", "verdict", "text", "activated", "calibration", "model_path", "session_path", "certificate_path")
        return {n: getattr(result, n) for n in names}

    async def _run(self, goal: Any) -> Any:
        begun = time.monotonic()
        while not self._recertify.server_is_ready():
            if time.monotonic() - begun > ANSWER:
                raise IrecError("calibration_node does not answer on irec/recertify; start it")
            await asyncio.sleep(POLL)
        handle = await _done(self._recertify.send_goal_async(goal, feedback_callback=self._on_feedback), ANSWER, "irec/recertify")
        if not handle.accepted:
            raise IrecError("calibration_node refused to start")
        self._goal, self._result = handle, self._result_of(handle)
        there = time.monotonic()
        while (answer := self._result.poll()) is None:
            there = time.monotonic() if self._recertify.server_is_ready() else there
            if time.monotonic() - there > ANSWER:
                raise IrecError("calibration_node has gone in the middle of the run; what was measured is kept")
            await asyncio.sleep(POLL)
        if self._is_unknown(answer):
            raise IrecError("calibration_node was started anew in the middle of the run; what was measured is kept")
        return answer.result

    async def stop(self) -> str:
        """End the run in order: the robot leaves the contact by itself, and the run can be resumed."""
        if self._goal is None:
            raise IrecError("No run of this page is under way.")
        await _done(self._goal.cancel_goal_async(), ANSWER, "irec/recertify")
        return "Stopping: the robot leaves the contact. The run can be gone on with."

    async def pause(self) -> str:
        return await self._trigger("irec/procedure/pause")

    async def resume(self) -> str:
        return await self._trigger("irec/procedure/resume")

    async def put_in_force(self, who: str, calibration: str) -> str:
        """Put a stored calibration in force (empty: the one before). Raises IrecError with the reason where it is refused."""
        request = self._put_type(operator_name=who, calibration=calibration)
        answer = await self._ask("irec/put_in_force", request, "calibration_node", PUT_ANSWER)
        if not answer.success:
            raise IrecError(str(answer.message))
        return str(answer.message)

    async def _trigger(self, name: str) -> str:
        answer = await self._ask(name, self._trigger_type(), "procedure_node")
        if not answer.success:
            raise IrecError(str(answer.message))
        return str(answer.message)

    async def _ask(self, name: str, request: Any, node: str, patience: float = ANSWER) -> Any:
        client = self._clients[name]
        begun = time.monotonic()
        while not client.service_is_ready():
            if time.monotonic() - begun > ANSWER:
                raise IrecError(f"{node} does not answer on {name}; start it")
            await asyncio.sleep(POLL)
        return await _done(client.call_async(request), patience, name)

    def _on_feedback(self, message: Any) -> None:
        f = message.feedback
        if self._result is not None:
            self._result.heard()
        told = told_lines(f.message)
        if told:
            self.preconditions = [*self.preconditions, *told]
            return
        self.progress = {
            "message": f.message, "pose": f.pose, "poses": f.poses, "remaining_s": f.remaining.sec + 1e-9 * f.remaining.nanosec,
            "paused": bool(self.progress and self.progress.get("paused")),
        }  # fmt: skip

    def _on_status(self, m: Any) -> None:
        if self.progress is not None:
            self.progress = {**self.progress, "paused": bool(m.paused)}

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except Exception as error:  # at the end the context is taken away
            if self._context.ok():
                self._node.get_logger().error(str(error))

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(2.0)
        self._node.destroy_node()
        self._context.try_shutdown()


async def _done(future: Any, timeout: float, name: str) -> Any:
    begun = time.monotonic()
    while not future.done():
        if time.monotonic() - begun > timeout:
            raise IrecError(f"no answer on {name} within {timeout:.0f} s")
        await asyncio.sleep(POLL)
    return future.result()
