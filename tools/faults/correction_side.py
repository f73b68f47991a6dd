# SPDX-License-Identifier: Apache-2.0
"""One fault at one phase of the correction: a scripted publisher in place of the cell, the real node on the other side."""

from __future__ import annotations

import hashlib
import math
import re
import signal
import threading
import time
from array import array
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from catalogue import ACTIVE, CORRECTION_PHASES, FADE, FAULT, HOLD, INACTIVE, RAMP_IN, CorrectionFault
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_calibration.cell import read_cell
from irec_calibration.effects import find_effect
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.model.file import save_model
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from stack import CELL, START, NotReached, Stack
from std_msgs.msg import String
from table import Row

from irec_msgs.msg import CorrectionState
from irec_msgs.srv import ActivateModel

PERIOD = 0.004  # s
Q = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3])
WRENCH = np.array([150.0, -80.0, -900.0, 5.0, 3.0, -1.0])
NAMES = [*(f"joint_{k}" for k in range(1, 7)), "ext_rail"]
LIMIT = 8.0e-5 + 1e-9  # m per tick: limit.translation_rate / rate
LAST = 2.6  # s of the cell's clock for which a fault lasts: longer than hold and fade together
NO_CLOCK = 4.0  # s longer where the simulated clock stops: the node goes on with the steady one after 3 s


class Script:
    """Publishes clock, wrench and joint states at 250 Hz in a thread; `fault` spoils them. Time goes on whatever happens."""

    def __init__(self, stack: Stack) -> None:
        node = stack.node
        self._clock = node.create_publisher(Clock, "/clock", 10)
        self._wrench = node.create_publisher(WrenchStamped, "wrench", 10)
        self._joints = node.create_publisher(JointState, "joint_states", 10)
        self.fault, self.hush = "", ""
        self.now, self.since = 1000.0, math.inf
        self._rng = np.random.default_rng(5)
        self._frozen = WRENCH.copy()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="script", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            due += PERIOD
            time.sleep(max(0.0, due - time.monotonic()))
            due = max(due, time.monotonic() - 0.05)
            self.now += PERIOD
            self._publish(self.fault)

    def _publish(self, fault: str) -> None:
        if fault == "partition":
            return
        shift = {"clock forward": 1000.0, "clock back": -500.0}.get(fault, 0.0)  # of the driver's clock, not of /clock
        self._clock.publish(Clock(clock=_time(self.now)))
        if not (self.hush == "joints" or fault == "joints gap"):
            self._joints.publish(_joints(fault, self.now + shift))
        reading = WRENCH + self._rng.normal(0.0, 0.5, 6)
        if self.hush == "force" or fault == "force silent":
            return
        if fault == "force frozen":
            reading = self._frozen
        self._frozen = reading
        self._wrench.publish(_wrench(fault, self.now + shift, reading.copy()))


def _time(t: float) -> Time:
    seconds, rest = divmod(round(1e9 * t), 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def _joints(fault: str, now: float) -> JointState:
    q, names, rail = Q.copy(), list(NAMES), 0.1
    if fault in ("joints jump", "joints outside"):
        q = q + (0.3 if fault == "joints jump" else 1.2)
    elif fault == "joints NaN":
        q[2] = math.nan
    elif fault == "joints names":
        names = [f"axis_{k}" for k in range(1, 8)]
        names[0] = "joint_1"
    elif fault == "rail NaN":
        rail = math.nan
    elif fault == "rail elsewhere":
        rail = 3.0
    position = [*q.tolist(), rail]
    message = JointState(name=names, position=array("d", position[:3] if fault == "joints length" else position))
    message.header.stamp = _time(now)
    return message


def _wrench(fault: str, now: float, w: np.ndarray) -> WrenchStamped:
    message = WrenchStamped()
    message.header.frame_id = "base_link" if fault == "force frame" else "tool0"
    message.header.stamp = _time(now - 2.0 if fault == "force late" else now)
    if fault == "force NaN":
        w[1] = math.nan
    elif fault == "force saturated":
        w[2] = -1.2e5
    elif fault == "force jump":
        w[2] -= 600.0
    f, t = message.wrench.force, message.wrench.torque
    f.x, f.y, f.z, t.x, t.y, t.z = w.tolist()
    return message


class CorrectionSide:
    """All combinations of one node, one after the other."""

    def __init__(self, stack: Stack) -> None:
        self.stack = stack
        self.script = Script(stack)
        self._offsets: list[tuple[float, np.ndarray]] = []
        self._said: list[str] = []
        self._counters: dict[str, int] = {}  # of the node's diagnostics
        self._newest = ""
        self.state: CorrectionState | None = None
        node = stack.node
        node.create_subscription(TransformStamped, "irec/offset", self._on_offset, 500)
        node.create_subscription(CorrectionState, "irec/correction/state", self._on_state, 100)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = node.create_publisher(String, "robot_description", latched)
        self._service = node.create_client(ActivateModel, "irec/correction/activate_model")
        cell = read_cell(CELL)
        self._urdf = cell.robot.urdf_text
        self.model = self._write("model.yaml", cell.serial)
        self._foreign = self._write("foreign.yaml", "another robot")
        self._soft = self._write("soft.yaml", cell.serial, scale=5000.0)
        self._nan = self._write("nan.yaml", cell.serial, scale=math.nan)
        self._digest = hashlib.sha256(Path(self.model).read_bytes()).hexdigest()

    def close(self) -> None:
        self.script.close()

    def _write(self, name: str, serial: str, scale: float = 1.0) -> str:
        stiffness = (2.5e-7, 2.0e-7, 3.0e-7, 1.0e-6, 1.2e-6, 1.8e-6)
        torsion = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(scale * c) for k, c in enumerate(stiffness, 1)})
        envelope = Envelope(tuple((Q - 0.5).tolist()), tuple((Q + 0.5).tolist()), 1200.0, 20.0)
        model = Model((torsion,), serial=serial, urdf_sha256=read_cell(CELL).robot.sha256, envelope=envelope)
        path = self.stack.folder / name
        try:
            return str(save_model(replace(model), path))
        except Exception:  # our own writer refuses what can't be; somebody else's would not
            text = Path(self.model).read_text().replace("2.5e-07", ".nan")
            path.write_text(text)
            return str(path)

    # --- what is heard -----------------------------------------------------------------------------------------------

    def _on_offset(self, m: TransformStamped) -> None:
        t = m.transform.translation
        self._offsets.append((m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec, np.array([t.x, t.y, t.z])))

    def _on_state(self, m: CorrectionState) -> None:
        self.state = m
        if m.reason:
            self._said.append(m.reason)

    def _on_diagnostics(self, m: DiagnosticArray) -> None:
        for s in m.status:
            self._said.append(s.message)
            for v in s.values:
                if v.key == "newest_finding":
                    if v.value != self._newest:  # the one of the combination before says nothing
                        self._said.append(v.value)
                    self._newest = v.value
                elif v.key.startswith("fault."):
                    if int(v.value) > self._counters.get(v.key, 0):
                        self._said.append(f"{v.key}: {v.value}")
                    self._counters[v.key] = int(v.value)

    # --- one combination ---------------------------------------------------------------------------------------------

    def run(self, fault: CorrectionFault, phase: str) -> Row:
        row = Row("correction", fault.name, phase)
        try:
            self._ready()
            self._reach(phase, fault.name)
            self._said.clear()
            self._offsets.clear()
            self._inject(fault, row)
            self._wait(LAST + NO_CLOCK if fault.name == "partition" else LAST)
            self._judge(fault, phase, row)
        except NotReached as error:
            row.fail(str(error))
        finally:
            self._clear(fault)
        return row

    def _wait(self, seconds: float) -> None:
        end = self.script.now + seconds
        self.stack.until(lambda: self.script.now >= end, "the clock", 20.0 * seconds + 5.0)

    def _ready(self) -> None:
        s = self.stack
        process = s.processes.get("correction")
        if process is None or process.child.poll() is not None:
            self.state = None
            self._counters.clear()
            s.start("correction", "irec_correction.nodes.correction_node",
                    {"cell": CELL, "autostart": True, "use_sim_time": True, "time.hold": 0.6, "start_load": 10.0})  # fmt: skip
        self._description.publish(String(data=self._urdf))
        s.until(self._service.service_is_ready, "the correction answers", START)
        self._wait(0.2)
        if not self._in(INACTIVE):
            self._ask("")
            s.until(lambda: self._in(INACTIVE, FAULT) or self.state is None, "the correction is at rest", 15.0)

    def _in(self, *states: int) -> bool:
        return self.state is not None and self.state.state in states

    def _ask(self, path: str) -> Any:
        future = self._service.call_async(ActivateModel.Request(model_path=path))
        self.stack.until(future.done, "an answer of activate_model", 20.0)
        return future.result()

    def _reach(self, phase: str, fault: str) -> None:
        """Come to a phase. HOLD is caused by the other input: what the fault touches goes on until it begins."""
        s = self.stack
        answer = self._ask(self.model)
        if not answer.success:
            raise NotReached(f"the model was not put in force: {answer.message}")
        wanted = CORRECTION_PHASES[phase]
        if wanted == RAMP_IN:
            s.until(lambda: self._in(RAMP_IN), phase, 15.0)
            self._wait(0.2)
            return
        s.until(lambda: self._in(ACTIVE), "active", 15.0)
        if wanted == HOLD:
            self.script.hush = "force" if fault.startswith("joints") else "joints"
            s.until(lambda: self._in(HOLD), phase, 15.0)
        elif wanted == FADE:
            self._ask("")
            s.until(lambda: self._in(FADE), phase, 15.0)

    def _inject(self, fault: CorrectionFault, row: Row) -> None:
        s, name = self.stack, fault.name
        process = s.processes["correction"]
        self.script.hush = ""
        if name == "robot changed":
            self._description.publish(String(data=self._urdf.replace("<robot", "<!-- other --><robot", 1)))
        elif name == "model refused":
            for path in (self._foreign, self._soft, self._nan, str(s.folder / "none.yaml")):
                answer = self._ask(path)
                self._said.append(str(answer.message))
                if answer.success:
                    row.fail(f"{Path(path).name} was put in force")
        elif name == "model file changed":
            self._kept = Path(self.model).read_bytes()
            time.sleep(0.02)  # another time of modification
            Path(self.model).write_bytes(self._kept + b"# changed\n")
        elif name == "other sender":
            self._rival = s.node.create_publisher(TransformStamped, "irec/offset", 10)
        elif name.startswith("SIG"):
            process.send(signal.SIGKILL if name.startswith("SIGKILL") else signal.SIGSTOP)
        else:
            self.script.fault = name

    def _clear(self, fault: CorrectionFault) -> None:
        self.script.fault, self.script.hush = "", ""
        if fault.name == "other sender":
            self.stack.node.destroy_publisher(self._rival)
        if fault.name == "model file changed":
            Path(self.model).write_bytes(self._kept)
        if fault.name == "SIGSTOP correction":
            self.stack.processes["correction"].send(signal.SIGCONT)
        if fault.name == "SIGKILL correction":
            self.state = None
            process = self.stack.processes.pop("correction", None)
            if process is not None:
                process.end()
                end = time.monotonic() + 15.0
                while self._service.service_is_ready() and time.monotonic() < end:
                    self.stack.spin()

    # --- for those who let it run for long ---------------------------------------------------------------------------

    def start(self) -> None:
        """The node, with the model in force."""
        self._ready()
        self._reach("active", "")

    def happen(self, event: str) -> None:
        """`swap`: the model is put in force again; else an input fails for so long that the offset fades out, and comes back."""
        if event != "swap":
            self.script.fault = event
            self._wait(LAST)
            self.script.fault = ""
            self._wait(0.2)
        self._ask(self.model)

    def forget(self) -> None:
        """What was heard so far."""
        self._said.clear()
        self._offsets.clear()

    # --- what is judged ----------------------------------------------------------------------------------------------

    def _judge(self, fault: CorrectionFault, phase: str, row: Row) -> None:
        s = self.stack
        if fault.name == "SIGSTOP correction":
            s.processes["correction"].send(signal.SIGCONT)
            self._wait(2.0)
        row.largest_step = self._largest_step()
        if row.largest_step > LIMIT:
            row.fail(f"the offset makes a step of {1e6 * row.largest_step:.0f} um in a tick, limit {1e6 * LIMIT:.0f} um")
        if fault.name == "SIGKILL correction":
            row.robot, row.cause = "no offset comes; the robot's own fade", "its diagnostics fall silent"
            if self._offsets and self._offsets[-1][0] > self.script.now - 1.0:
                row.fail("offsets of a killed node")
            return
        state = self.state
        if state is None:
            row.fail("no state is told")
            return
        last = float(np.linalg.norm(self._offsets[-1][1])) if self._offsets else math.nan
        row.robot = f"{_name(state.state)}, {1e3 * last:.3f} mm"
        ends = (INACTIVE,) if phase == "fade" else fault.ends
        if phase == "fade" and state.state == FAULT:
            ends = (FAULT,)  # lost on the way to zero
        if state.state not in ends:
            row.fail(f"ends in {_name(state.state)} ({state.reason}), expected {' or '.join(_name(e) for e in ends)}")
        if state.state in (INACTIVE, FAULT) and not last <= 1e-8:
            row.fail(f"an offset of {1e3 * last:.3f} mm is left")
        row.cause = next((t for t in self._said if re.search(fault.cause, t)), "") if fault.cause else ""
        if not row.cause and phase == "fade":
            row.cause = "on its way to zero already"
        elif not row.cause:
            row.fail("nothing names the cause")
        if state.model_sha256 != self._digest:
            row.fail(f"another model is in force: {state.model_sha256[:12]}")

    def _largest_step(self) -> float:
        largest = 0.0
        for (t0, a), (t1, b) in zip(self._offsets, self._offsets[1:], strict=False):
            ticks = max(1, round((t1 - t0) / PERIOD))
            largest = max(largest, float(np.linalg.norm(b - a)) / ticks)
        return largest


def _name(state: int) -> str:
    names = {INACTIVE: "INACTIVE", RAMP_IN: "RAMP_IN", ACTIVE: "ACTIVE", HOLD: "HOLD", FADE: "FADE", FAULT: "FAULT"}
    return names.get(state, str(state))
