# SPDX-License-Identifier: Apache-2.0
"""The correction as a lifecycle node: wrench and joint states in, offset of the TCP out, one tick per wrench."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace

from geometry_msgs.msg import WrenchStamped
from irec_calibration.cell import Cell, read_cell
from irec_calibration.errors import IrecError
from irec_calibration.procedure.axes import read_axes
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoad
from irec_ros.diagnostics import Diagnostics
from irec_ros.parameters import Parameters
from irec_ros.startup import refuse_unknown_parameters
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from irec_msgs.srv import ActivateModel

from ..conditioning import Conditioner, make_filters, sensor_in_tool
from ..correction import Correction
from ..errors import ActivationError, SettingsError
from ..filters import delay_cost
from ..input_quality import InputQuality
from ..orientations import Orientations
from ..realtime import settle_memory
from ..state import State
from ..watchdog import Fault
from . import parameters
from .chain_clock import ChainClock
from .correction_inputs import CorrectionInputs
from .correction_outputs import CorrectionOutputs
from .correction_watch import CorrectionWatch
from .fade_out import fade_out_now, not_at_zero
from .managed import Managed, run_managed
from .model_checks import CheckedModel, Mounted, calibration_in_force, read_checked
from .offset_topics import LINGER, wait_for_discovery
from .tool_load_service import create_services

SENSOR_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RAIL = "ext_rail"  # default of parameter rail_joint
EARLY = 0.75  # of a period: a wrench that comes sooner after the last tick makes none
MISSING = 1.5  # periods without a tick: the timer makes one


class CorrectionNode(Managed):
    """Parameters: see parameters.py. Activation fails with a reason; a model is put in force by
    `irec/correction/activate_model`."""

    def __init__(self) -> None:
        super().__init__("correction_node")
        self._made = time.monotonic()
        self._told = State.INACTIVE  # in diagnostics, at once
        self._p = Parameters(self, (*parameters.CORRECTION, *parameters.LINKS))
        refuse_unknown_parameters(self)
        for name in [p.name for p in parameters.CORRECTION if p.settable]:
            self._p.when_set(name, self._take_limits)
        self._status = self._diagnostics = Diagnostics(self)
        self._correction: Correction | None = None
        self._robot: Robot | None = None
        self._described: str | None = None
        self._in_force: CheckedModel | None = None
        self.create_subscription(String, "robot_description", self._on_description, LATCHED_QOS)
        if self._p["autostart"] and self._p["cell"]:
            self._configure_and_activate()

    def _offer(self, raw: bool) -> None:
        """Everything that this node takes and gives while it is configured."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        subscribe, serve = self.create_subscription, self.create_service
        made = [
            (self.destroy_subscription, subscribe(WrenchStamped, _wrench_topic(raw), self._on_wrench, SENSOR_QOS)),
            (self.destroy_subscription, subscribe(JointState, "joint_states", self._on_joints, SENSOR_QOS)),
            (self.destroy_service, serve(ActivateModel, "irec/correction/activate_model", self._on_activate_model)),
            (self.destroy_timer, self.create_timer(self._period, self._on_missing_tick, clock=steady)),
            (self.destroy_timer, self.create_timer(1.0, self._on_second, clock=steady)),
        ]
        if self._p["links.topic"]:
            link_states = subscribe(JointState, self._p["links.topic"], self._on_links, SENSOR_QOS)
            made.append((self.destroy_subscription, link_states))
        if self._orientations is not None:
            made += create_services(self, self._orientations, self._take_load)
        self.entities += made

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Follow the model. Raises IrecError."""
        self._begin()
        self.errors = {}

    def _begin(self) -> None:
        """Ramp in, unless somebody else sends an offset or an input. Raises IrecError."""
        correction = self._chain()
        wait_for_discovery(self._made)
        try:
            self._watch.check_start()
            correction.start(self._chain_clock.now(), LINGER)
        except ActivationError as error:
            correction.supervisor.reason = self.errors["activation"] = str(error)
            raise
        self._outputs.offsets.open()

    def stop(self) -> None:
        """Fade the offset out; a fault stays one until somebody activates again."""
        if self._correction is not None and self._correction.supervisor.state is not State.FAULT:
            self._correction.stop(self._chain_clock.now(), "deactivated")

    def _configure_and_activate(self) -> None:
        if self.trigger_configure() is TransitionCallbackReturn.SUCCESS and self._in_force is not None and self._p["model_path"]:
            self.trigger_activate()

    def at_work(self) -> str:
        """An offset that is still being faded out has to come to its end first."""
        correction = self._correction
        return "" if correction is None or correction.at_rest else not_at_zero(correction.supervisor.state)

    def come_to_rest(self) -> None:
        """Fade the offset out here and now, without inputs: nobody calls this node any more."""
        correction = self._correction
        if correction is None or correction.at_rest:
            return
        fade_out_now(correction, self._chain_clock.now(), self._outputs.publish)

    def release(self) -> None:
        """Forget chain and model."""
        if self._correction is not None:
            self._outputs.offsets.close()
        self._correction, self._in_force = None, None

    def configure(self) -> None:
        """Build the chain and put the stated model in force. Raises IrecError."""
        p = self._p
        cell, robot, serial, tool = self._mounted_robot()
        payload, axes = (None, None) if cell is None else (cell.payload, read_axes(cell))
        raw = bool(p["raw_wrench"])
        frame = str(p["sensor_frame"]) if raw else "tool0"
        gravity = p.three("gravity")
        filters = make_filters(parameters.filter_settings(p, robot.joint_names))
        where = sensor_in_tool(robot, frame) if raw else None
        conditioner = Conditioner(filters, where, parameters.tool_load(p), parameters.cable(p), gravity)
        self._chain_clock = ChainClock(self)
        settings = parameters.correction_settings(p, frame)
        if self._chain_clock.simulated:  # it may run faster than this machine passes messages on
            settings = replace(settings, watchdog=replace(settings.watchdog, age_limit=math.inf))
        self._quality = None if self._chain_clock.simulated else InputQuality({"wrench": p["wrench_rate"], "joint_states": 0.0})
        rail = recorded_rail = str(p["rail_joint"])
        names = robot.joint_names
        if axes is not None:  # the cell file knows how the driver names them
            names = axes.driver[: robot.n_joints]
            if rail == RAIL and len(axes.driver) > robot.n_joints:
                rail = axes.driver[robot.n_joints]
        self._robot, self._period = robot, settings.period
        self._mounted = Mounted(robot, serial, tool, gravity, payload, settings.period, p["predicted_limit"],
                                settings.need_envelope, recorded_rail.removeprefix("ext_"))  # fmt: skip
        self._correction = Correction(settings, robot, conditioner, parameters.rail_range(cell))
        self._correction.preview = parameters.preview(p, robot)
        encoders = parameters.links(p, robot)
        self._correction.links = encoders[0] if encoders else None
        self._orientations = Orientations(robot, where[0], gravity) if where is not None else None
        self._outputs = CorrectionOutputs(
            self, self._correction, self._chain_clock, serial, parameters.offset_frame(p), self._status,
            parameters.outputs(p), names,
        )  # fmt: skip
        alone = [_wrench_topic(raw), *([str(p["links.topic"])] if encoders else [])]
        self._watch = CorrectionWatch(
            self, self._correction, self._chain_clock, self._outputs.offsets, alone, parameters.outputs(p)[0]
        )
        self._inputs = CorrectionInputs(
            self._correction, names, self._chain_clock, rail, self._orientations, encoders[1] if encoders else None,
            rail_needed=cell is not None and cell.rail is not None, strangers=self._watch.senders.saw_strangers,
            quality=self._quality,
        )  # fmt: skip
        self.entities += [*self._outputs.entities, *self._watch.entities]
        self._last_tick = -1.0
        self.get_logger().info(str(delay_cost(filters, p["process_feed"], p["deflection_slope"])))
        if p["model_path"]:
            self._put_in_force(str(p["model_path"]))
        elif p["calibrations"]:
            self._take_calibration(str(p["cell"]), str(p["calibrations"]), serial)
        if self._described is not None:
            self._compare_robot(self._described)
        self._offer(raw)

    def _mounted_robot(self) -> tuple[Cell | None, Robot, str, str]:
        """Cell where there is a file of it, robot, its serial, name of the tool."""
        p = self._p
        if p["cell"]:
            cell = read_cell(p["cell"])
            serial, tool = str(p["robot_serial"]) or cell.serial, str(p["tool"]) or cell.tool_name
            return cell, cell.robot, serial, tool
        if self._described is None:
            raise SettingsError("neither parameter 'cell' nor a message on robot_description says which robot this is")
        return None, Robot(self._described, "robot_description"), str(p["robot_serial"]), str(p["tool"])

    def _chain(self) -> Correction:
        if self._correction is None:
            raise SettingsError("correction_node is not configured; configure it first")
        return self._correction

    # -- model, load, limits -------------------------------------------------------------------------------------------

    def _put_in_force(self, path: str) -> str:
        """Read, check and follow a model; its SHA-256. Raises IrecError; then nothing has changed."""
        checked = read_checked(path, self._mounted)
        self._chain().put_in_force(checked.model, self._chain_clock.now(), checked.deflection)
        self._in_force = self._outputs.in_force = checked
        self.errors.pop("calibrations", None)
        for effect, why in checked.deflection.left_out.items():
            self.get_logger().info(f"effect '{effect}' has no part in the correction: it {why}")
        self.get_logger().info(
            f"model {path} is in force ({', '.join(checked.model.effects)}; {checked.spent * 1e6:.0f} us; predicts up to "
            f"{checked.largest_offset * 1e3:.2f} mm in its envelope)"
        )
        if checked.caution:
            self.get_logger().warning(f"model {path}: {checked.caution}")
        return checked.sha256

    def _take_calibration(self, cell: str, folder: str, serial: str) -> None:
        """Follow the calibration in force, once somebody activates this node: after a restart nobody may know that it is back.

        Where that can't be, this node waits for `activate_model`, by which it is mended, and its diagnostics say why.
        """
        try:
            path = calibration_in_force(cell, folder, serial)
            if path is not None:
                self._put_in_force(str(path))
        except IrecError as error:
            self.errors["calibrations"] = str(error)
            self.get_logger().error(f"no model is in force: {error}")
            return
        if path is None:
            self.get_logger().info(f"no calibration is in force yet in {folder}")

    def _on_activate_model(self, request: ActivateModel.Request, response: ActivateModel.Response) -> ActivateModel.Response:
        correction = self._chain()
        if not request.model_path:
            correction.stop(self._chain_clock.now(), "deactivated by activate_model")
            response.success = True
            return response
        try:
            response.sha256 = self._put_in_force(request.model_path)
            if self.active and correction.supervisor.state is State.INACTIVE:
                self._begin()
            elif not self.active and (self._p["autostart"] or correction.supervisor.state is State.FAULT):
                self.go_through(self.trigger_activate)
        except IrecError as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    def _take_load(self, load: ToolLoad) -> str:
        """Remove another tool load from now on; why not, while an offset is being sent."""
        correction = self._chain()
        if correction.supervisor.state not in (State.INACTIVE, State.FAULT):
            return "not in force: the correction is running; deactivate it first"
        correction.conditioner.load = load
        correction.conditioner.reset()
        return ""

    def _take_limits(self, _: object) -> None:
        if self._correction is not None:
            self._correction.set_limits(parameters.offset_limits(self._p))

    # -- inputs --------------------------------------------------------------------------------------------------------

    def _on_description(self, message: String) -> None:
        self._described = message.data
        if self._correction is not None:
            self._compare_robot(message.data)
        elif self._p["autostart"] and not self._p["cell"]:
            self._configure_and_activate()

    def _compare_robot(self, description: str) -> None:
        watchdog, source = self._chain().watchdog, "robot_description"
        if self._robot is not None and description == self._robot.urdf_text:
            watchdog.clear(source)
        else:  # readable or not
            watchdog.refuse(source, Fault.ROBOT_CHANGED, "robot_description is not that of the model in force")

    # a message or a timer may have been due already when the node was cleaned up

    def _on_joints(self, message: JointState) -> None:
        if self._correction is not None:
            self._inputs.take_joints(message)

    def _on_links(self, message: JointState) -> None:
        if self._correction is not None:
            self._inputs.take_links(message)

    def _on_wrench(self, message: WrenchStamped) -> None:
        if self._correction is None:
            return
        now = self._inputs.take_wrench(message)
        if not 0.0 <= now - self._last_tick < EARLY * self._period:
            self._tick(now)

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        """What no check has foreseen fades the offset out; a service that failed has changed nothing."""
        if self._correction is not None and not answered:
            self._correction.fail(where, f"unexpected error in {where}: {type(error).__name__}: {error}")

    # -- output --------------------------------------------------------------------------------------------------------

    def _on_missing_tick(self) -> None:
        if self._correction is None:
            return
        now = self._chain_clock.now()
        if not 0.0 <= now - self._last_tick < MISSING * self._period:
            self._tick(now)

    def _tick(self, now: float) -> None:
        self._last_tick = now
        correction = self._chain()
        self._watch.look(now)
        out = correction.tick(now)
        self._outputs.publish(now, out)
        self._watch.sent(now, out)
        if out.state is not self._told:
            self._told = out.state
            self._on_second()
        if out.state is State.FAULT and self.active:
            self.trigger_deactivate()  # stays in FAULT; so "activate" is what the operator can ask for

    def _on_second(self) -> None:
        if self._correction is None:
            return
        notes = [f"{where}: {text}" for where, text in self.errors.items()]
        if self._quality is not None:
            notes += self._quality.cautions(self._chain_clock.now())
        self._outputs.publish_diagnostics("; ".join(notes))


def _wrench_topic(raw: bool) -> str:
    return "wrench_raw" if raw else "wrench"


def run(args: list[str] | None, priority: int, refused: str) -> int:
    """Run the node; exit code.

    Args:
        priority: SCHED_FIFO priority of the process, 0: none. refused: why the system did not permit it, or empty.
    """

    def make(_: threading.Event) -> CorrectionNode:
        node = CorrectionNode()
        for text in [refused, *settle_memory()] if priority else []:
            if text:
                node.get_logger().warning(text)
        return node

    return run_managed("correction_node", make, args)
