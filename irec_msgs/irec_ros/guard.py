# SPDX-License-Identifier: Apache-2.0
"""One guard round every callback of a node: an error answers the caller, is told in diagnostics, and never ends the node."""

from __future__ import annotations

import copy
import functools
import traceback
from collections.abc import Callable
from typing import Any, TypeAlias

from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from .diagnostics import ERROR, Diagnostics, status

Callback: TypeAlias = Callable[..., Any]
OVERRIDABLE = QoSOverridingOptions(
    [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY]
)
PARAMETERS_OF_RCLPY = frozenset(("use_sim_time", "start_type_description_service"))  # declared in every node
OF_RCLPY = ("/clock", "/parameter_events", "/rosout", "~/transition_event")  # entities that it makes itself


class Guarded:
    """Mixin, named before Node or LifecycleNode: what subscriptions, timers and services call can't end the node.

    Callbacks of actions and futures are wrapped by hand, with `guarded`. A node that moves a robot overrides `on_error`.
    """

    errors: dict[str, str]  # what went wrong in which callback, the newest of each
    given_parameters: frozenset[str]  # on the command line, in a parameter file or by who made the node
    _diagnostics: Diagnostics | None = None
    _is_made = False  # rclpy has made what every node has

    def __init__(self, *args: Any, **named: Any) -> None:
        self.errors = {}
        named["automatically_declare_parameters_from_overrides"] = True
        super().__init__(*args, **named)
        self._is_made = True
        self.given_parameters = self._taken_back()

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        """Called after an unexpected error in a callback: leave the contact, fade the offset, ... Nothing by default.

        Args:
            where: for people, e.g. `topic joint_states`. answered: whoever asked for it is told (a service, a goal).
        """

    def guarded(self, where: str, callback: Callback, otherwise: Callback | None = None) -> Callback:
        """The callback, which raises nothing any more.

        Args:
            where: for people, e.g. `topic joint_states`.
            otherwise: called with the error and then the callback's arguments; its result is the answer. None: answer None.
        """

        @functools.wraps(callback)
        def call(*arguments: Any, **named: Any) -> Any:
            try:
                return callback(*arguments, **named)
            except Exception as error:
                self._report_error(where, error, otherwise is not None)
                return otherwise(error, *arguments) if otherwise is not None else None

        return call

    def _report_error(self, where: str, error: Exception, answered: bool) -> None:
        node: Any = self
        if not node.context.ok():  # the process is ending and has nobody to tell
            return
        text = f"{type(error).__name__}: {error}"
        known = self.errors.get(where)
        self.errors[where] = text
        if known != text:  # the trace once, not 250 times a second
            trace = "".join(traceback.format_exception(error))
            node.get_logger().error(f"unexpected error in {where}: {text}; the node goes on\n{trace}")
        try:
            self.on_error(where, error, answered)
            if known != text:
                if self._diagnostics is None:
                    self._diagnostics = Diagnostics(node)
                self._diagnostics.publish(status(node, where, ERROR, f"unexpected error: {text}"))
        except Exception as second:  # what protects must not be what ends the node
            node.get_logger().error(f"unexpected error while reacting to {where}: {type(second).__name__}: {second}")

    def _taken_back(self) -> frozenset[str]:
        """Names of the parameters that were given; declaring them stays with the node itself."""
        node: Any = self
        given = frozenset(node.get_parameters_by_prefix("")) - PARAMETERS_OF_RCLPY
        for name in given:
            node.undeclare_parameter(name)
        return given

    # rclpy's own signatures, passed on as they are

    def create_subscription(self, msg_type: Any, topic: str, callback: Callback, *args: Any, **named: Any) -> Any:
        """As in rclpy, guarded."""
        callback = self.guarded(f"topic {topic}", callback)
        args, named = self._overridable(topic, args, named)
        return super().create_subscription(msg_type, topic, callback, *args, **named)  # type: ignore[misc]

    def create_publisher(self, msg_type: Any, topic: str, *args: Any, **named: Any) -> Any:
        """As in rclpy, with a quality of service that parameters can override."""
        args, named = self._overridable(topic, args, named)
        return super().create_publisher(msg_type, topic, *args, **named)  # type: ignore[misc]

    def _overridable(self, topic: str, args: tuple[Any, ...], named: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """`qos_overrides.<topic>.subscription.reliability` and the like are parameters of the node, as in C++ nodes."""
        if not self._is_made or topic in OF_RCLPY or not args or "qos_overriding_options" in named:
            return args, named
        # a copy, as rclpy writes into the profile; several entities may share one
        qos = QoSProfile(depth=args[0]) if isinstance(args[0], int) else copy.copy(args[0])
        return (qos, *args[1:]), {**named, "qos_overriding_options": OVERRIDABLE}

    def create_timer(self, timer_period_sec: float, callback: Callback, *args: Any, **named: Any) -> Any:
        """As in rclpy, guarded."""
        name = getattr(callback, "__name__", "timer").lstrip("_")
        return super().create_timer(timer_period_sec, self.guarded(f"timer {name}", callback), *args, **named)  # type: ignore[misc]

    def create_service(self, srv_type: Any, srv_name: str, callback: Callback, *args: Any, **named: Any) -> Any:
        """As in rclpy, guarded: the caller of a failed one is told `success: false` and the reason."""
        callback = self.guarded(f"service {srv_name}", callback, _refusal)
        return super().create_service(srv_type, srv_name, callback, *args, **named)  # type: ignore[misc]


class GuardedNode(Guarded, Node):
    """A node whose callbacks are guarded."""


class GuardedLifecycleNode(Guarded, LifecycleNode):
    """A lifecycle node whose callbacks are guarded, and which answers who asks for a transition that is not possible now.

    rclpy raises out of its service then, and the caller waits for ever.
    """

    def __init__(self, *args: Any, **named: Any) -> None:
        super().__init__(*args, **named)
        service: Any = self._service_change_state
        service.callback = self.guarded("service change_state", self._answered(service.callback), _refusal)

    def _answered(self, change: Callback) -> Callback:
        def answer(request: Any, response: Any) -> Any:
            state = self._state_machine.current_state[1]
            try:
                return change(request, response)
            except RCLError:
                asked = request.transition.label or request.transition.id
                self.get_logger().error(f"transition {asked} is not possible in state '{state}'")
                response.success = False
                return response

        return answer


def _refusal(error: Exception, _: Any, response: Any) -> Any:
    if hasattr(response, "success"):
        response.success = False
    for field in ("message", "verdict"):
        if hasattr(response, field):
            setattr(response, field, f"unexpected error, please report it: {type(error).__name__}: {error}")
            break
    return response
