# SPDX-License-Identifier: Apache-2.0
"""The correction as a lifecycle node: wrench and joint states in, offset of the TCP out, one tick per wrench."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.model_file import file_sha256, load_model
from irec_calibration.nodes.startup import begin, refuse_unknown_parameters
from irec_calibration.robot import Payload, Robot
from irec_calibration.tool_load import ToolLoad
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from irec_msgs.msg import CorrectionState
from irec_msgs.srv import ActivateModel

from ..conditioning import Conditioner, make_filters, sensor_in_tool
from ..correction import Correction, Output
from ..errors import SettingsError
from ..filters import delay_cost
from ..orientations import Orientations
from ..realtime import settle_memory
from ..state import State
from ..watchdog import Fault
from . import parameters
from .messages import diagnostics, fill_offset, fill_state, fill_wrench, seconds
from .model_checks import affordable, check_mounted
from .tool_load_service import create_services

SENSOR_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
OUT_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATE_PERIOD = 0.1  # s
EARLY = 0.75  # of a period: a wrench that comes sooner after the last tick makes none
MISSING = 1.5  # periods without a tick: the timer makes one
FOLLOW_PERIOD = 0.015  # s of the cell's clock between two words to a simulated cell; by time, as a wrench may get lost


class CorrectionNode(LifecycleNode):
    """Parameters: see parameters.py. Activation fails with a reason; a model is put in force by
    `irec/correction/activate_model`."""

    def __init__(self) -> None:
        super().__init__("correction_node")
        parameters.declare(self)
        refuse_unknown_parameters(self)
        self._p = parameters.Values(self)
        self._correction: Correction | None = None
        self._robot: Robot | None = None
        self._described: str | None = None
        self._active = False
        self._model_file: tuple[Path, str, float] | None = None
        self._entities: list[Any] = []
        self._latest = 0.0
        self._autostart = bool(self._p["autostart"])
        self._warm_up()
        self.create_subscription(String, "robot_description", self._on_description, LATCHED_QOS)
        if self._autostart and self._p["cell"]:
            self._configure_and_activate()

    def _configure_and_activate(self) -> None:
        if self.trigger_configure() is TransitionCallbackReturn.SUCCESS and self._model_file is not None:
            self.trigger_activate()

    def _warm_up(self) -> None:
        self._offset, self._state, self._process = TransformStamped(), CorrectionState(), WrenchStamped()
        self._follower = Header(frame_id=self.get_name())
        self._followed = -1.0
        self._state_sent: tuple[float, State | None, str] = (-1.0, None, "")

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self._configure()
        except IrecError as error:
            self.get_logger().error(f"not configured: {error}")
            self._cleanup()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        assert self._correction is not None
        try:
            self._correction.start(self._now())
        except IrecError as error:
            self.get_logger().error(f"not activated: {error}")
            return TransitionCallbackReturn.FAILURE
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self._correction is not None:
            self._correction.stop(self._now(), "deactivated")
        self._active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._cleanup()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._cleanup()
        return TransitionCallbackReturn.SUCCESS

    def _cleanup(self) -> None:
        for destroy, entity in self._entities:
            destroy(entity)
        self._entities.clear()
        self._correction, self._active = None, False

    def _configure(self) -> None:
        p = self._p
        robot, serial, payload = self._robot_and_serial()
        self._robot, self._serial, self._payload = robot, serial, payload
        raw = bool(p["raw_wrench"])
        frame = str(p["sensor_frame"]) if raw else "tool0"
        self._offset_frame = str(p["offset_frame"])
        if self._offset_frame not in ("base_link", "tool0"):
            raise SettingsError(f"parameter 'offset_frame' is '{self._offset_frame}'; base_link or tool0 is possible")
        filters = make_filters(parameters.filter_settings(p))
        where = sensor_in_tool(robot, frame) if raw else None
        conditioner = Conditioner(filters, where, parameters.tool_load(p), parameters.cable(p), p.three("gravity"))
        settings = parameters.correction_settings(p, frame)
        self._correction = Correction(settings, robot, conditioner)
        self._orientations = Orientations(robot, where[0], p.three("gravity")) if where is not None else None
        self._period = settings.period
        self.get_logger().info(str(delay_cost(filters, p["process_feed"], p["deflection_slope"])))
        self._index: tuple[list[str], list[int], int | None] = ([], [], None)
        self._last_tick = -1.0
        if p["model_path"]:
            self._put_in_force(str(p["model_path"]))
        self._create(raw)

    def _create(self, raw: bool) -> None:
        def publisher(kind: Any, topic: str) -> Any:
            made = self.create_publisher(kind, topic, OUT_QOS)
            self._entities.append((self.destroy_publisher, made))
            return made

        self._offset_out = publisher(TransformStamped, "irec/offset")
        self._state_out = publisher(CorrectionState, "irec/correction/state")
        self._process_out = publisher(WrenchStamped, "irec/wrench_process")
        self._diagnostics_out = publisher(DiagnosticArray, "/diagnostics")
        simulated = self.get_parameter("use_sim_time").value
        self._follower_out = publisher(Header, "sim/follower") if simulated else None
        topic = "wrench_raw" if raw else "wrench"
        for kind, name, callback in ((WrenchStamped, topic, self._on_wrench), (JointState, "joint_states", self._on_joints)):
            made = self.create_subscription(kind, name, callback, SENSOR_QOS)
            self._entities.append((self.destroy_subscription, made))
        for period, call in ((self._period, self._on_timer), (1.0, self._on_second)):
            self._entities.append((self.destroy_timer, self.create_timer(period, call)))
        service = self.create_service(ActivateModel, "irec/correction/activate_model", self._on_activate_model)
        self._entities.append((self.destroy_service, service))
        if self._orientations is not None:
            self._entities += create_services(self, self._orientations, self._take_load)

    def _take_load(self, load: ToolLoad) -> str:
        """Remove another tool load from now on; why not, while an offset is being sent."""
        assert self._correction is not None
        if self._correction.supervisor.state not in (State.INACTIVE, State.FAULT):
            return "not in force: the correction is running; deactivate it first"
        self._correction.conditioner.load = load
        self._correction.conditioner.reset()
        return ""

    def _robot_and_serial(self) -> tuple[Robot, str, Payload | None]:
        p = self._p
        if p["cell"]:
            cell = read_cell(p["cell"])
            return cell.robot, str(p["robot_serial"]) or cell.serial, cell.payload
        if self._described is None:
            raise SettingsError("neither parameter 'cell' nor a message on robot_description says which robot this is")
        return Robot(self._described, "robot_description"), str(p["robot_serial"]), None

    # -- model ---------------------------------------------------------------------------------------------------------

    def _put_in_force(self, path: str) -> str:
        """Read, check and follow a model; its SHA-256. Raises IrecError; then nothing has changed."""
        assert self._correction is not None and self._robot is not None
        model = load_model(path)
        digest, changed = file_sha256(path), Path(path).stat().st_mtime
        check_mounted(model, self._robot, self._serial, str(self._p["tool"]))
        deflection, spent = affordable(model, self._robot, self._p.three("gravity"), self._payload, self._period)
        self._correction.put_in_force(model, self._now(), deflection)
        self._model_file, self._model = (Path(path), digest, changed), model
        for effect, why in deflection.left_out.items():
            self.get_logger().info(f"effect '{effect}' has no part in the correction: it {why}")
        self.get_logger().info(f"model {path} is in force ({', '.join(model.effects)}; {spent * 1e6:.0f} us)")
        return digest

    def _on_activate_model(self, request: ActivateModel.Request, response: ActivateModel.Response) -> ActivateModel.Response:
        assert self._correction is not None
        if not request.model_path:
            self._correction.stop(self._now(), "deactivated by activate_model")
            response.success = True
            return response
        try:
            response.sha256 = self._put_in_force(request.model_path)
            if self._active:
                self._resume()
            elif self._autostart:
                self.trigger_activate()
        except (IrecError, OSError) as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    def _resume(self) -> None:
        assert self._correction is not None
        if self._correction.supervisor.state in (State.INACTIVE, State.FAULT):
            self._correction.start(self._now())

    def _on_description(self, message: String) -> None:
        self._described = message.data
        if self._correction is None:
            if self._autostart and not self._p["cell"]:
                self._configure_and_activate()
        elif self._robot is not None and Robot(message.data, "robot_description").sha256 != self._robot.sha256:
            self._correction.watchdog.refuse(Fault.ROBOT_CHANGED, "robot_description is not that of the model in force")

    # -- samples -------------------------------------------------------------------------------------------------------

    def _now(self, stamp: float = 0.0) -> float:
        """The node's clock, or the newest stamp where that is a little ahead (a simulated clock comes in steps)."""
        clock = self.get_clock().now().nanoseconds * 1e-9
        tolerance = 0.1
        if clock < stamp <= clock + tolerance:
            clock = stamp
        if clock < self._latest <= clock + tolerance:
            clock = self._latest
        self._latest = clock
        return clock

    def _on_joints(self, message: JointState) -> None:
        if self._correction is None:
            return
        if message.name != self._index[0]:
            self._index = self._columns(list(message.name))
        _, columns, rail = self._index
        if not columns:  # somebody else's joints on the same topic
            return
        given = len(message.position)
        q = np.array([message.position[i] if i < given else np.nan for i in columns])
        stamp = seconds(message.header.stamp)
        now = self._now(stamp)
        self._correction.take_joints(stamp, now, q, message.position[rail] if rail is not None and rail < given else 0.0)
        if self._orientations is not None:
            self._orientations.take_joints(stamp, q)

    def _columns(self, names: list[str]) -> tuple[list[str], list[int], int | None]:
        assert self._robot is not None
        wanted = self._robot.joint_names
        columns = [names.index(j) for j in wanted if j in names]
        rail = str(self._p["rail_joint"])
        return names, columns, names.index(rail) if rail in names else None

    def _on_wrench(self, message: WrenchStamped) -> None:
        if self._correction is None:
            return
        f, t = message.wrench.force, message.wrench.torque
        stamp = seconds(message.header.stamp)
        now = self._now(stamp)
        reading = np.array([f.x, f.y, f.z, t.x, t.y, t.z])
        self._correction.take_wrench(stamp, now, message.header.frame_id, reading)
        if self._orientations is not None:
            self._orientations.take_wrench(stamp, reading)
        if not 0.0 <= now - self._last_tick < EARLY * self._period:
            self._tick(now)

    def _on_timer(self) -> None:
        now = self._now()
        if not 0.0 <= now - self._last_tick < MISSING * self._period:
            self._tick(now)

    def _tick(self, now: float) -> None:
        assert self._correction is not None
        self._last_tick = now
        out = self._correction.tick(now)
        stamp = self._offset.header.stamp
        stamp.sec, stamp.nanosec = int(now), int(now % 1.0 * 1e9)
        fill_offset(self._offset, out, self._offset_frame)
        self._offset_out.publish(self._offset)
        fill_wrench(self._process, stamp, out.wrench_at_tcp)
        self._process_out.publish(self._process)
        self._tell_state(now, out)
        if self._follower_out is not None and not 0.0 <= now - self._followed < FOLLOW_PERIOD:
            self._followed = now
            self._follower.stamp = stamp
            self._follower_out.publish(self._follower)

    def _tell_state(self, now: float, out: Output) -> None:
        assert self._correction is not None
        at, state, reason = self._state_sent
        if state is out.state and 0.0 <= now - at < STATE_PERIOD:
            return
        if state is not out.state:
            text = f"{out.state.name}{': ' + out.reason if out.reason else ''}"
            if out.state in (State.HOLD, State.FADE, State.FAULT):
                self.get_logger().warning(text)
            else:  # rclpy wants one place in the code per severity
                self.get_logger().info(text)
        self._state_sent = (now, out.state, out.reason)
        digest = self._model_file[1] if self._model_file else ""
        fill_state(self._state, self._offset.header.stamp, out, self._correction.counts, self._serial, digest)
        self._state_out.publish(self._state)

    def _on_second(self) -> None:
        if self._correction is None:
            return
        note = ""
        if self._model_file is not None:
            path, _, changed = self._model_file
            try:
                if path.stat().st_mtime != changed:
                    note = f"{path} was changed after it was put in force; the model in force is the one before that"
            except OSError:
                note = f"{path} has gone; the model in force is the one that was read from it"
        self._diagnostics_out.publish(diagnostics(self._now(), self._serial, self._correction, note))


def run(args: list[str] | None, priority: int, refused: str) -> int:
    """Run the node; exit code.

    Args:
        priority: SCHED_FIFO priority of the process, 0: none. refused: why the system did not permit it, or empty.
    """
    if not begin("correction_node", args=args):
        return 2
    try:
        node = CorrectionNode()
    except Exception as error:  # parameters out of range, and whatever else rclpy raises for them
        print(f"correction_node: error: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    for text in [refused, *settle_memory()] if priority else []:
        if text:
            node.get_logger().warning(text)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
    return 0
