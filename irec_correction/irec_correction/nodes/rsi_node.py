# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the RSI bridge: parameters and models in, measurements and diagnostics out. Nothing waits for it.

A lifecycle node: configured, it answers the controller with zero; active, with offsets; cleaned up, the port is free.
"""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_ros.diagnostics import Diagnostics
from irec_ros.parameters import Parameters
from irec_ros.senders import other_senders
from irec_ros.startup import refuse_unknown_parameters
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import QoSProfile, ReliabilityPolicy

from irec_msgs.srv import ActivateModel

from ..errors import SettingsError
from ..rsi.bridge import SHUTDOWN_MARGIN
from ..rsi.report import KEPT, REPORT_SIZE
from ..shared import SharedValues
from ..state import State
from ..watchdog import Fault, Finding
from . import parameters
from .chain_clock import ChainClock
from .fade_out import not_at_zero
from .input_senders import InputSenders, two_senders
from .loop_pipe import ANSWER_WAIT, LoopPipe
from .managed import Managed, run_managed
from .model_checks import Mounted, calibration_in_force, read_checked
from .offset_topics import OFFSET, refusal, wait_for_discovery
from .rsi_inputs import RsiInputs
from .rsi_monitor import MONITOR_RATE, RsiMonitor
from .rsi_setup import bridge_setup

IN_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
AT_REST = (State.INACTIVE, State.FAULT)
RSI_ENDED = 1.5  # s without a packet, after which the controller has stopped by its time-out and holds no offset


class RsiNode(Managed):
    """Creates the blocks, tells the loop its setup, publishes what it reports."""

    _monitor: RsiMonitor
    _inputs: RsiInputs

    def __init__(self, pipe: Connection, asked_to_stop: threading.Event) -> None:
        super().__init__("rsi_bridge")
        self._made = time.monotonic()
        own = {q.name for q in parameters.RSI}
        fixed = [replace(q, settable=False) for q in parameters.CORRECTION if q.name not in own]  # the loop gets them once
        self._p = p = Parameters(self, (*fixed, *parameters.RSI))
        refuse_unknown_parameters(self)
        self._loop = LoopPipe(pipe, lambda kind, content: self._monitor.take(kind, content))
        self._asked_to_stop = asked_to_stop
        self._status = self._diagnostics = Diagnostics(self)
        self._clock_of_chain = ChainClock(self)
        self._blocks: list[SharedValues] = []
        self._begun = False  # the loop has its setup
        if p["autostart"]:
            self._configure_and_activate()

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Let the loop follow. Raises SettingsError."""
        if self._p["source"] == "chain":
            wait_for_discovery(self._made)
            if others := self._monitor.others:
                raise SettingsError(refusal(others))
            if others := self._senders.found_at_start():
                raise SettingsError(two_senders(others))
        if why := self._ask("start"):
            raise SettingsError(why)
        self.errors.pop("activation", None)
        self._monitor.state = State.INACTIVE  # a fault that was is over; the loop tells what follows

    def stop(self) -> None:
        """Fade the offset out; a fault stays one until somebody activates again."""
        if self._monitor.state is not State.FAULT:
            self._ask("stop")

    def configure(self) -> None:
        """Answer the controller with zero. Raises IrecError."""
        p = self._p
        if not p["cell"]:
            raise SettingsError("parameter 'cell' is empty; name a cell file")
        self._cell = read_cell(p["cell"])
        self._serial = str(p["robot_serial"]) or self._cell.serial
        self._report, self._latency = SharedValues.create(REPORT_SIZE), SharedValues.create(KEPT)
        self._blocks += [self._report, self._latency]
        wrench_frame = str(p["sensor_frame"]) if p["raw_wrench"] else "tool0"
        self._inputs = RsiInputs(
            self._clock_of_chain, wrench_frame, p["watch.clock_tolerance"], max(p["watch.force_range"], p["watch.torque_range"]),
            self._pass_on_refusal, lambda: self._others(OFFSET, 1),
        )  # fmt: skip
        self._mounted = Mounted(
            self._cell.robot, self._serial, str(p["tool"]) or self._cell.tool_name, p.three("gravity"), self._cell.payload,
            1e-3 * p["cycle_ms"], p["predicted_limit"], p["need_envelope"], str(p["rail_joint"]).removeprefix("ext_"),
        )  # fmt: skip
        self._blocks += [self._inputs.wrench, self._inputs.offset]
        names = list(self._cell.robot.joint_names)
        computes = p["source"] == "chain"
        self._monitor = RsiMonitor(self, self._report, self._latency, names, self._serial, computes, self._status)
        self._two_senders = False  # the loop was told of two senders of an input
        self._senders = InputSenders(self._others, self._topics_taken(), joints="")
        self.entities += self._monitor.entities
        self._begin()
        self._begun = True
        self._create()
        if p["model_path"]:
            why = self._put_in_force(str(p["model_path"]))
            if why:
                raise SettingsError(why)
        elif p["calibrations"]:
            self._take_calibration(str(p["cell"]), str(p["calibrations"]))

    def _others(self, topic: str, own: int) -> str:
        """Who publishes a topic beside `own` publishers, for people."""
        return other_senders(self, self.resolve_topic_name(topic), own)

    def _topics_taken(self) -> tuple[str, ...]:
        """Topics of inputs that one node may publish; the joint angles come from the controller."""
        if self._p["source"] != "chain" or self._p["wrench_block"]:
            return ()
        return ("wrench_raw" if self._p["raw_wrench"] else "wrench",)

    def _take_calibration(self, cell: str, folder: str) -> None:
        """As correction_node: the calibration in force is followed once somebody activates this node."""
        try:
            path = calibration_in_force(cell, folder, self._mounted.serial)
            why = "" if path is None else self._put_in_force(str(path))
        except IrecError as error:
            why = str(error)
        if why:
            self.errors["calibrations"] = why
            self.get_logger().error(f"no model is in force: {why}")

    def at_work(self) -> str:
        """The controller still acts on an offset: without answers it would keep that."""
        if not self._begun or self._state_of_loop() in AT_REST or self._monitor.silence > RSI_ENDED:
            return ""
        return not_at_zero(self._monitor.state)

    def _state_of_loop(self) -> State:
        self._loop.listen(0.0)
        return self._monitor.state

    def release(self) -> None:
        """Free the port and the blocks; a loop that still sends an offset fades it out first."""
        if self._begun:
            self._inputs.closed = True
            if why := self._ask("release", wait=ANSWER_WAIT + self._p["time.fade"] + SHUTDOWN_MARGIN):
                self.get_logger().error(f"the port may still be open: {why}")
        self._begun = False
        self._close_blocks()

    def _configure_and_activate(self) -> None:
        """Raises SettingsError where the node can't be configured; one that must not begin answers with zero."""
        self.go_through(self.trigger_configure)
        if not (self._p["model_path"] or self._p["source"] == "offset_topic"):
            return
        if self.trigger_activate() is not TransitionCallbackReturn.SUCCESS:
            self.errors["activation"] = f"{self.refused}; activate it once that is over"

    def _begin(self) -> None:
        """Send the setup. Raises SettingsError where the loop can't begin."""
        setup = bridge_setup(
            self._p, self._cell, self._report.name, self._latency.name, self._inputs, self.get_logger().info
        )  # fmt: skip
        port, refused = self._loop.begin(setup)
        for text in refused:
            self.get_logger().warning(text)
        self.get_logger().info(f"answering {setup.link.peer} on {setup.link.address}:{port}, offset from {self._p['source']}")

    def _create(self) -> None:
        p = self._p
        made = self.entities
        subscribe, serve = self.create_subscription, self.create_service
        if p["source"] == "chain":
            made.append((self.destroy_service, serve(ActivateModel, "irec/correction/activate_model", self._on_activate_model)))
            for topic in self._topics_taken():
                made.append((self.destroy_subscription, subscribe(WrenchStamped, topic, self._inputs.take_wrench, IN_QOS)))
        else:
            take = self._inputs.take_offset
            made.append((self.destroy_subscription, subscribe(TransformStamped, OFFSET, take, IN_QOS)))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for period, callback in ((1.0 / MONITOR_RATE, self._on_timer), (1.0, self._on_second)):
            made.append((self.destroy_timer, self.create_timer(period, callback, clock=steady)))

    # -- commands to the loop ------------------------------------------------------------------------------------------

    def _ask(self, command: str, argument: Any = None, wait: float = ANSWER_WAIT) -> str:
        """Empty, or why the loop did not do it within so many s."""
        if not self._begun:
            return "rsi_bridge is not configured; configure it first"
        return self._loop.ask(command, argument, wait)

    def _put_in_force(self, path: str) -> str:
        try:
            checked = read_checked(path, self._mounted)
        except IrecError as error:
            return str(error)
        why = self._ask("model", checked.model)
        if not why:
            self._monitor.digest = checked.sha256
            if checked.caution:
                self.get_logger().warning(f"model {path}: {checked.caution}")
            self.errors.pop("calibrations", None)
        return why

    def _put_in_force_and_start(self, path: str) -> str:
        why = self._put_in_force(path)
        if not why and self.active:
            why = self._ask("start")
        elif not why and (self._p["autostart"] or self._monitor.state is State.FAULT):
            why = "" if self.trigger_activate() is TransitionCallbackReturn.SUCCESS else self.refused
        return why

    def _on_activate_model(self, request: ActivateModel.Request, response: ActivateModel.Response) -> ActivateModel.Response:
        response.message = self._put_in_force_and_start(request.model_path) if request.model_path else self._ask("stop")
        response.success = not response.message
        response.sha256 = self._monitor.digest if response.success and request.model_path else ""
        return response

    # -- out of the loop -----------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        if not self._begun:  # it was due already when the node was cleaned up
            return
        self._loop.listen(0.0)
        if (why := self._loop.ended) is not None:
            self._end(why)
            return
        self._look_for_senders()
        self._monitor.publish()
        if self._monitor.state is State.FAULT and self.active and self._p["source"] == "chain":
            self.trigger_deactivate()  # stays in FAULT; so "activate" is what the operator can ask for

    def _end(self, why: str) -> None:
        """The loop has ended before the node, as where a signal reaches its process alone: nothing is left to watch."""
        if why:
            self.get_logger().error(why)
        self._asked_to_stop.set()

    def _look_for_senders(self) -> None:
        """Of two senders of an input nobody knows whom to believe."""
        found = self._senders.found()
        if bool(found) != self._two_senders:
            self._two_senders = bool(found)
            self._pass_on_refusal("sender of an input", Finding(Fault.OTHER_SENDER, found) if found else None)

    def _on_second(self) -> None:
        if not self._begun:
            return
        refused = [*(f.text for f in self._inputs.refused.values()), *([self._monitor.others] if self._monitor.others else [])]
        errors = [f"{where}: {text}" for where, text in self.errors.items()]
        self._monitor.publish_diagnostics("; ".join(refused + errors))

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        """Fade the offset out, unless it was a service that failed and its caller knows."""
        if self._begun and not answered:
            self._pass_on_refusal(where, Finding(Fault.INTERNAL, f"unexpected error in {where}: {type(error).__name__}: {error}"))

    def _pass_on_refusal(self, source: str, finding: Finding | None) -> None:
        """Tell the loop that an input is refused (None: no longer); the loop does not answer that."""
        if finding is not None:
            self.get_logger().warning(f"{source} is not used: {finding.text}", throttle_duration_sec=5.0)
        if self._begun:
            self._loop.tell("refused", (source, finding))

    def ended(self) -> None:
        """Remove the blocks; the loop keeps its own hold on them."""
        self._close_blocks()

    def _close_blocks(self) -> None:
        for block in self._blocks:
            block.close()
        self._blocks.clear()


def main(pipe: Connection, arguments: list[str]) -> int:
    """Run the node; exit code."""

    def if_refused() -> None:
        with contextlib.suppress(OSError):  # the loop's process has ended already where it was the one that refused
            pipe.send(None)

    return run_managed("rsi_bridge", lambda asked: RsiNode(pipe, asked), arguments, if_refused=if_refused)
