# SPDX-License-Identifier: Apache-2.0
"""Wrong drivers over DDS against the live procedure and the live check_driver: who is stopped when, with which sentence.

    python tools/wrong_drivers/wrong_drivers.py [NAME ...]      all faults, or those whose name contains one of the words

Prints a table; exit code 1 where a fault was believed, named wrongly or told after the first pose.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tools" / "wrong_drivers")]
CELL = ROOT / "config" / "cells" / "afp.yaml"
PATIENCE = 120.0  # s of the machine's clock for one fault
SPEED = 6.0


@dataclass(frozen=True)
class Expected:
    """What must be said of a fault.

    Attributes:
        procedure: part of the sentence with which the run ends. state: of the procedure at which the fault begins; empty: before.
        check: part of a failed item of check_driver; empty where the passive level can't see the fault.
    """

    procedure: str
    check: str = ""
    state: str = ""


EXPECTED = {
    "wrench in base_link": Expected("wrench: header.frame_id is 'base_link', the contract says 'tool0'", "frame of wrench"),
    "tcp_pose in world": Expected("tcp_pose: header.frame_id is 'world', the contract says 'base_link'", "frame of tcp_pose"),
    "joint angles in degrees": Expected("is it in degrees?", "joint_states are in degrees, radians are needed"),
    "joints of other names": Expected("the cell file can state how the driver names the joints", "robot.joint_names"),
    "stamps of 0": Expected("joint_states: the stamp is 0", "stamps of joint_states"),
    "tcp_pose of the flange": Expected("joint_states and tcp_pose do not agree", "tcp_pose against the joint angles"),
    "marker in mm": Expected("is it in mm?", "tracker/point is in mm, m is needed"),
    "another station": Expected("header.frame_id is 'leica'; the stations of the cell file are 'A'", "frame of tracker/point"),
    "robot/state silent": Expected("robot/state is silent for 3 s", "robot/state is there", "approach"),
    "tcp_pose silent": Expected("tcp_pose is silent", "tcp_pose is there", "approach"),
    "tracker silent": Expected("tracker/point has not sent a single point since the run began", "tracker/point is there"),
    "sign of the force turned": Expected("the force has the wrong sign"),
    "set point ignored": Expected("the force does not follow robot/force_setpoint"),
}


@dataclass
class Said:
    """What came of one fault: end of the run and seconds of the machine's clock; failed items of check_driver."""

    success: bool
    message: str
    poses: int
    seconds: float
    check: list[str] = field(default_factory=list)


class Line:
    """One wrong driver, one procedure, one operator; on the domain of the environment."""

    def __init__(self, start: Callable[[str, list[str]], Any], folder: Path) -> None:
        """start: (name, arguments) -> process, which somebody else ends."""
        import rclpy
        from irec_ros.seen import SeenBy
        from rcl_interfaces.srv import SetParameters
        from rclpy.action import ActionClient

        from irec_msgs.action import RunProcedure

        self._folder, self._count = folder, 0
        driver = str(Path(__file__).parent / "driver.py")
        start("driver", [sys.executable, driver, "--ros-args", "-p", f"cell:={CELL}", "-p", f"speed_factor:={SPEED}"])
        settings = ["-p", f"cell:={CELL}", "-p", f"session_folder:={folder}", "-p", "use_sim_time:=true"]
        start("procedure", [sys.executable, "-m", "irec_calibration.nodes.procedure_node", "--ros-args", *settings])
        self.node = rclpy.create_node("operator")
        self._action = ActionClient(self.node, RunProcedure, "irec/run_procedure")
        self._set = self.node.create_client(SetParameters, "cell/set_parameters")
        self._until(lambda: self._action.server_is_ready() and self._set.service_is_ready(), "driver and procedure")
        self._until(SeenBy.of_action(self.node, "irec/run_procedure"), "procedure that knows the client")
        self._until(SeenBy(self.node, "cell/set_parameters"), "driver that knows the client")

    def _until(self, condition: Callable[[], bool], what: str) -> None:
        import rclpy

        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"no {what} within {PATIENCE:g} s")
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def fault(self, name: str) -> None:
        """From now on; empty: none."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        future = self._set.call_async(SetParameters.Request(parameters=[Parameter("fault", value=name).to_parameter_msg()]))
        self._until(future.done, "answer of the driver")

    def procedure(self, name: str) -> Said:
        """Run Procedure 1 with this fault until it ends."""
        from irec_msgs.action import RunProcedure

        expected = EXPECTED[name]
        states: list[str] = []
        if not expected.state:
            self.fault(name)
        self._count += 1
        begin = time.monotonic()
        goal = RunProcedure.Goal(session_path=str(self._folder / f"session_{self._count}.mcap"))
        sent = self._action.send_goal_async(goal, feedback_callback=lambda m: states.append(m.feedback.state))
        self._until(sent.done, "answer of the procedure")
        if expected.state:
            self._until(lambda: expected.state in states, f"state {expected.state}")
            self.fault(name)
            begin = time.monotonic()
        ended = sent.result().get_result_async()
        try:
            self._until(ended.done, "end of the run")
        finally:
            self.fault("")
        result = ended.result().result
        return Said(result.success, result.message, result.poses_recorded, time.monotonic() - begin)

    def check(self, name: str) -> list[str]:
        """Failed items of the passive level of check_driver with this fault."""
        self.fault(name)
        report = self._folder / "check.json"
        report.unlink(missing_ok=True)
        settings = ["-p", f"cell:={CELL}", "-p", "use_sim_time:=true", "-p", f"report:={report}"]
        settings += ["-p", "level:=moves"]  # it moves nothing where the passive level fails
        command = [sys.executable, "-m", "irec_calibration.nodes.check_driver", "--ros-args", *settings]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        finally:
            self.fault("")
        if not report.is_file():
            return [f"check_driver ended with code {done.returncode}: {done.stderr or done.stdout}"]
        items = json.loads(report.read_text())
        return [f"{i['name']}: {i['figure']}; {i['advice']}" for i in items if not i["passed"]]


def wrong(name: str, said: Said) -> str:
    """What is wrong with what was said of a fault; empty where it is right."""
    expected = EXPECTED[name]
    if said.success:
        return f"believed: {said.message}"
    if expected.procedure not in said.message:
        return f"named otherwise: {said.message}"
    if said.poses:
        return f"told after {said.poses} poses"
    if expected.check and not any(expected.check in item for item in said.check):
        return f"check_driver says: {said.check or 'all passed'}"
    return ""


def main() -> int:
    """All faults asked for, one after the other."""
    from demo_parts.domain import free_domain

    os.environ.update(ROS_DOMAIN_ID=str(free_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    import rclpy
    from demo_parts.processes import _end

    words = sys.argv[1:]
    names = [name for name in EXPECTED if not words or any(word in name for word in words)]
    folder = Path(tempfile.mkdtemp(prefix="irec-wrong-"))
    running: list[subprocess.Popen[bytes]] = []

    def start(name: str, arguments: list[str]) -> None:
        with open(folder / f"{name}.log", "wb") as log:
            running.append(subprocess.Popen(arguments, stdout=log, stderr=subprocess.STDOUT, start_new_session=True))

    bad = 0
    rclpy.init()
    try:
        line = Line(start, folder)
        for name in names:
            said = line.procedure(name)
            said.check = line.check(name) if EXPECTED[name].check else []
            problem = wrong(name, said)
            bad += bool(problem)
            print(f"{'WRONG' if problem else 'right'}  {name}: stopped after {said.seconds:.1f} s", flush=True)
            print(f"       {problem or said.message}", flush=True)
            for item in said.check[:1]:
                print(f"       check_driver: {item}", flush=True)
    finally:
        _end(running)
        rclpy.try_shutdown()
    print(f"{len(names) - bad} of {len(names)} were stopped before the second pose with the right sentence; logs in {folder}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
