# SPDX-License-Identifier: Apache-2.0
"""What the lifecycle nodes of this package share: transitions that say why they failed, and the node's process."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import rclpy
from irec_calibration.errors import IrecError
from irec_ros.guard import GuardedLifecycleNode
from irec_ros.startup import begin, spin_until, stop_on_signals
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from ..errors import SettingsError


class Managed(GuardedLifecycleNode):
    """A lifecycle node by what it does in each transition.

    A node gives `configure` and `start`, which raise IrecError where they can't, `stop`, and `release`, which takes back what
    `configure` did, however far it came. What is in `entities` is destroyed before that, so that nobody calls what is closed.
    `at_work` and `come_to_rest` keep what the node sends from ending in a step.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.entities: list[tuple[Callable[[Any], Any], Any]] = []  # how each is destroyed, what it is
        self.active = False
        self.refused = ""  # why the last transition failed

    def configure(self) -> None:
        """Open and create what the node needs. Raises IrecError: nothing is left open then, `release` has been called."""
        raise NotImplementedError

    def start(self) -> None:
        """Begin to act. Raises IrecError."""
        raise NotImplementedError

    def stop(self) -> None:
        """Act no more."""
        raise NotImplementedError

    def release(self) -> None:
        """Close what `configure` has opened, as far as it came."""
        raise NotImplementedError

    def at_work(self) -> str:
        """Why the node can't be cleaned up now; empty where it can."""
        return ""

    def come_to_rest(self) -> None:
        """Bring what is sent to its end, for at most some seconds: the node is shut down, or its process ends."""

    def ended(self) -> None:
        """Called once, when the process has done its work."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.configure()
        except Exception as error:  # unexpected ones too: rclpy would end the life of the node and tell nobody why
            self._free()
            return self._failed("configured", error)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.start()
        except Exception as error:
            return self._failed("activated", error)
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.guarded("deactivation", self.stop)()
        self.active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        if why := self.at_work():
            return self._failed("cleaned up", SettingsError(why))
        self._free()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.come_to_rest()  # a shutdown can't be refused
        self._free()
        return TransitionCallbackReturn.SUCCESS

    def go_through(self, *transitions: Callable[[], TransitionCallbackReturn]) -> None:
        """Trigger transitions one after the other. Raises SettingsError with the reason of the first that fails."""
        for transition in transitions:
            if transition() is not TransitionCallbackReturn.SUCCESS:
                raise SettingsError(self.refused)

    def _free(self) -> None:
        self.active = False
        for destroy, entity in self.entities:
            destroy(entity)
        self.entities.clear()
        self.release()

    def _failed(self, what: str, error: Exception) -> TransitionCallbackReturn:
        self.refused = str(error) if isinstance(error, IrecError) else f"unexpected error: {type(error).__name__}: {error}"
        self.get_logger().error(f"not {what}: {self.refused}")
        return TransitionCallbackReturn.FAILURE


AnyManaged = TypeVar("AnyManaged", bound=Managed)


def run_managed(
    name: str,
    make: Callable[[threading.Event], AnyManaged],
    arguments: list[str] | None,
    *,
    executor_type: Callable[[], Executor] = EventsExecutor,
    if_refused: Callable[[], None] = lambda: None,
) -> int:
    """Run the node of a process until SIGINT, SIGTERM or SIGHUP; its exit code, 2 where what the user gave can't be used.

    Args:
        name: for messages on stderr. arguments: of the process; those of the command line where None.
        make: the node; the event is set when the process has been asked to stop.
        if_refused: called where the node could not be made.
    """
    if not begin(name, args=arguments, signal_handler_options=SignalHandlerOptions.NO):
        return 2
    asked_to_stop = stop_on_signals()
    try:
        node = make(asked_to_stop)
    except Exception as error:  # IrecError, and whatever rclpy raises for parameters out of range
        print(f"{name}: error: {error}", file=sys.stderr)
        if_refused()
        rclpy.try_shutdown()
        return 2
    executor = executor_type()
    executor.add_node(node)
    try:
        spin_until(asked_to_stop, node.guarded("executor", executor.spin_once))
    finally:
        node.guarded("the end of the process", node.come_to_rest)()
        node.ended()
        rclpy.try_shutdown()
    return 0
