# SPDX-License-Identifier: Apache-2.0
"""The person at the cell, as a ROS node: asks for runs and services and watches their progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from irec_ros.seen import SeenBy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from irec_msgs.action import Move, RunProcedure

CELL_PARAMETERS = "cell/set_parameters"
SERVER_WAIT = 120.0  # s; a process that has ended is told at once


def speed_request(speed: float) -> SetParameters.Request:
    """For CELL_PARAMETERS: so many simulated seconds per second."""
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=speed)
    return SetParameters.Request(parameters=[Parameter(name="speed_factor", value=value)])


class RequestRefused(RuntimeError):
    """A node does not answer, or refuses; the message says which and why."""


class Operator:
    """Blocking calls with a look at the processes while waiting."""

    def __init__(self, watch: Callable[[], None]) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # an interrupt first lets the robot retract
        self.node = rclpy.create_node("demo_operator")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._watch = watch
        self._of_cell = self.node.create_client(SetParameters, CELL_PARAMETERS)

    def close(self) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Let messages in for a while."""
        self._watch()
        self._executor.spin_once(timeout_sec=seconds)

    def wait_for_action(self, kind: Any, name: str) -> None:
        """Return when a node offers the action."""
        client = ActionClient(self.node, kind, name)
        self._until(client.server_is_ready, SERVER_WAIT, f"action {name} is not there")
        client.destroy()

    def call(self, kind: Any, name: str, request: Any, timeout: float, tell: Callable[[float], None] | None = None) -> Any:
        """Response of a service; tell(seconds waited) is called now and then."""
        client = self.node.create_client(kind, name)
        self._until(client.service_is_ready, SERVER_WAIT, f"service {name} is not there")
        self._until(SeenBy(self.node, name), SERVER_WAIT, f"the node of service {name} does not answer")
        future = client.call_async(request)
        self._until(future.done, timeout, f"service {name} did not answer", tell)
        self.node.destroy_client(client)
        return future.result()

    def set_speed(self, speed: float) -> None:
        """Ask the simulated cell for so many simulated seconds per second, without waiting for its answer."""
        if self._of_cell.service_is_ready():
            self._of_cell.call_async(speed_request(speed))

    def move_joints(self, q: Sequence[float], speed: float, timeout: float) -> None:
        """Move the robot to joint angles, rad; speed is a share of the limits."""
        client = ActionClient(self.node, Move, "robot/move")
        self._until(client.server_is_ready, SERVER_WAIT, "action robot/move is not there")
        self._until(SeenBy.of_action(self.node, "robot/move"), SERVER_WAIT, "the node of action robot/move does not answer")
        names = [f"joint_{i + 1}" for i in range(len(q))]
        goal = Move.Goal(kind=Move.Goal.JOINT, joint_names=names, joint_position=[float(v) for v in q], speed=float(speed))
        accepted = client.send_goal_async(goal)
        self._until(accepted.done, SERVER_WAIT, "robot/move did not accept the move")
        result = accepted.result().get_result_async()
        self._until(result.done, timeout, "robot/move did not come to an end")
        if not result.result().result.success:
            raise RequestRefused(f"robot/move: {result.result().result.message}")

    def run_procedure(self, goal: RunProcedure.Goal, timeout: float, tell: Callable[[RunProcedure.Feedback], None]) -> Any:
        """Result of irec/run_procedure."""
        return self.run_action(RunProcedure, "irec/run_procedure", goal, timeout, tell)

    def run_action(self, kind: Any, name: str, goal: Any, timeout: float, tell: Callable[[Any], None]) -> Any:
        """Result of an action. An interrupt cancels the run and waits until the robot has retracted."""
        client = ActionClient(self.node, kind, name)
        self._until(client.server_is_ready, SERVER_WAIT, f"action {name} is not there")
        self._until(SeenBy.of_action(self.node, name), SERVER_WAIT, f"the node of action {name} does not answer")
        accepted = client.send_goal_async(goal, feedback_callback=lambda m: tell(m.feedback))
        self._until(accepted.done, SERVER_WAIT, f"{name} did not accept the run")
        handle = accepted.result()
        if not handle.accepted:
            raise RequestRefused(f"{name} refused the run")
        result = handle.get_result_async()
        try:
            self._until(result.done, timeout, f"{name} did not come to an end")
        except KeyboardInterrupt:
            handle.cancel_goal_async()
            self._until(result.done, SERVER_WAIT, f"{name} did not end after it was cancelled")
            raise
        return result.result().result

    def _until(
        self, done: Callable[[], bool], timeout: float, otherwise: str, tell: Callable[[float], None] | None = None
    ) -> None:
        begun = time.monotonic()
        while not done():
            self.spin(0.1)
            waited = time.monotonic() - begun
            if tell is not None:
                tell(waited)
            if waited > timeout:
                raise RequestRefused(f"{otherwise} within {timeout:g} s")
