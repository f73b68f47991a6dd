# SPDX-License-Identifier: Apache-2.0
"""The processes of one cell that outlive many faults, and the node that watches them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from irec_msgs.action import RunProcedure
from irec_msgs.msg import LoadCaseRecord, ProcedureStatus, RobotState

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "config" / "cells" / "afp.yaml"
SPEED = 8.0  # simulated s per s of the machine's clock while nothing is judged
START = 90.0  # s for a node to come up on a busy machine
GRACE = 10.0  # s for a process to end by itself
PROFILE = ROOT / "config" / "fastdds_localhost.xml"
LEASE = 6  # s after which DDS forgets a process that was killed, in place of 20


class NotReached(RuntimeError):
    """Something did not come in time; the message says what, and what was last heard."""


class Process:
    """A child in a group of its own, its output in a file."""

    def __init__(self, arguments: list[str], log: Path, environment: dict[str, str]) -> None:
        with open(log, "ab") as file:
            self.child = subprocess.Popen(
                arguments, stdout=file, stderr=subprocess.STDOUT, env={**os.environ, **environment}, start_new_session=True
            )
        self.log = log

    @property
    def pid(self) -> int:
        return self.child.pid

    def send(self, number: int) -> None:
        """A signal, to it alone."""
        if self.child.poll() is None:
            os.kill(self.child.pid, number)

    def end(self) -> None:
        """SIGCONT, SIGINT, and SIGKILL to its group where that does not help."""
        for number in (signal.SIGCONT, signal.SIGINT):
            self.send(number)
        try:
            self.child.wait(GRACE)
        except subprocess.TimeoutExpired:
            os.killpg(self.child.pid, signal.SIGKILL)
            self.child.wait(GRACE)


def quick_cell(folder: Path) -> Path:
    """The AFP cell with quick moves between the poses: what is waited for there shows nothing."""
    text = CELL.read_text().replace("../robots/", f"{CELL.parent.parent / 'robots'}/")
    text = text.replace("home_speed: 0.5", "home_speed: 1.0")
    path = folder / "cell.yaml"
    path.write_text(text.replace("linear_speed: 0.15", "linear_speed: 0.3"))
    return path


class Stack:
    """Starts, restarts and ends the nodes; holds what they have said since `mark`."""

    def __init__(self, folder: Path, domain: int, speed: float = SPEED) -> None:
        self.folder, self.speed = folder, speed
        folder.mkdir(parents=True, exist_ok=True)
        self.cell = quick_cell(folder)
        profile = Path(tempfile.mkdtemp(prefix="irec-faults-")) / "dds.xml"
        profile.write_text(PROFILE.read_text().replace("<leaseDuration><sec>20<", f"<leaseDuration><sec>{LEASE}<"))
        self._environment = {
            "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile), "ROS_LOG_DIR": str(folder / "ros"),
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]),
        }  # fmt: skip
        os.environ.update(self._environment)
        self.processes: dict[str, Process] = {}
        rclpy.init()
        self.node = rclpy.create_node("faults_watch")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.texts: list[str] = []
        self.rows: list[LoadCaseRecord] = []
        self.events: list[dict[str, Any]] = []
        self.states: list[str] = []
        self.report: dict[str, Any] = {"id": 0}
        self.robot: RobotState | None = None
        self.status: ProcedureStatus | None = None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listen = self.node.create_subscription
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        listen(RobotState, "robot/state", self._on_robot, 50)
        listen(ProcedureStatus, "irec/procedure/status", self._on_status, latched)
        listen(LoadCaseRecord, "irec/procedure/load_case", self.rows_append, 200)
        listen(String, "irec/procedure/event", self._on_event, 200)
        listen(String, "faults/report", self._on_report, 50)
        self._arm = self.node.create_publisher(String, "faults/arm", 10)
        self.action = ActionClient(self.node, RunProcedure, "irec/run_procedure")

    # --- what is heard -----------------------------------------------------------------------------------------------

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.texts += [f"{s.name}: {s.message}" for s in message.status if s.message]

    def _on_robot(self, message: RobotState) -> None:
        self.robot = message
        if message.message:
            self.texts.append(f"robot/state: {message.message}")

    def _on_status(self, message: ProcedureStatus) -> None:
        self.status = message
        self.states.append(message.state)
        if message.message:
            self.texts.append(f"procedure: {message.message}")

    def rows_append(self, row: LoadCaseRecord) -> None:
        self.rows.append(row)

    def _on_event(self, message: String) -> None:
        self.events.append(json.loads(message.data))
        self.texts.append(f"event: {self.events[-1]['text']}")

    def _on_report(self, message: String) -> None:
        self.report = json.loads(message.data)

    def mark(self) -> None:
        """Forget what was said so far."""
        for heard in (self.texts, self.rows, self.events, self.states):
            heard.clear()

    # --- waiting -----------------------------------------------------------------------------------------------------

    def spin(self, seconds: float = 0.05) -> None:
        self._executor.spin_once(timeout_sec=seconds)

    def until(self, condition: Callable[[], Any], what: str, seconds: float) -> Any:
        """Raises NotReached."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                last = "nothing" if self.status is None else f"{self.status.state} ({self.status.message})"
                raise NotReached(f"{what}: not within {seconds:g} s; the procedure's state is {last}")
            self.spin()
        return condition()

    def arm(self, **order: Any) -> None:
        """To the faulty cell."""
        self._arm.publish(String(data=json.dumps(order)))

    # --- processes ---------------------------------------------------------------------------------------------------

    def start(self, name: str, module: str, parameters: dict[str, object], *remaps: str) -> Process:
        arguments = [sys.executable, "-m", module, "--ros-args"]
        for key, value in parameters.items():
            arguments += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
        for remap in remaps:
            arguments += ["-r", remap]
        self.processes[name] = Process(arguments, self.folder / f"{name}.log", self._environment)
        return self.processes[name]

    def start_driver(self) -> None:
        self.robot, self.report = None, {"id": 0}
        self.start("driver", "faulty_cell",
                   {"cell": self.cell, "speed_factor": self.speed, "rail_speed": 5.0, "rate.wrench_raw": 0.0,
                    "rate.joint_states": 50.0, "rate.tcp_pose": 50.0, "rate.clock": 50.0})  # fmt: skip

    def start_procedure(self) -> None:
        self.start("procedure", "irec_calibration.nodes.procedure_node",
                   {"cell": self.cell, "session_folder": self.folder, "use_sim_time": True, "order_seed": 7})  # fmt: skip

    def start_calibration(self) -> None:
        self.start("calibration", "irec_calibration.nodes.calibration_node",
                   {"cell": self.cell, "calibration_folder": self.folder / "calibrations"})  # fmt: skip

    def start_recorder(self) -> None:
        self.recording = self.folder / f"recorded_{time.monotonic_ns()}"
        topics = "[wrench, joint_states, robot/state, irec/procedure/status]"
        self.start("recorder", "irec_calibration.nodes.recorder_node",
                   {"output": self.recording, "topics": topics, "use_sim_time": True})  # fmt: skip

    def ensure(self, *names: str) -> bool:
        """Start what has ended; whether anything had."""
        started = False
        for name in names:
            process = self.processes.get(name)
            if process is None or process.child.poll() is not None:
                getattr(self, f"start_{name}")()
                started = True
        return started

    def close(self) -> None:
        for process in self.processes.values():
            process.end()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()
