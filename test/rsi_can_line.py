# SPDX-License-Identifier: Apache-2.0
"""A simulated robot that is corrected through the wires alone: RSI to the controller, CAN from the sensor, no ROS in between."""

from __future__ import annotations

import sys
import time
import uuid
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model.file import save_model
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoad, identify_tool_load
from irec_calibration.session import read_session
from irec_correction.conditioning import sensor_in_tool
from irec_sim.cell import Cell
from irec_sim.cellfile import read_cell
from irec_sim.course import CoursePlan, plan_course
from irec_sim.devices.netft_can import NetFtCan, SlcanAdapter
from irec_sim.devices.rsi_controller import RobotState, RsiController
from irec_sim.motion import table_move
from irec_sim.session import generate, write_session
from irec_sim.truth import read_truth
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).parents[1]
CELL, TRUTH = ROOT / "config/cells/afp.yaml", ROOT / "config/truths/default.yaml"
PERIOD = 0.004
PRESS_TIME = 0.6  # s in which the process force comes
RATE_LIMIT = 0.02  # m/s, the default of limit.translation_rate
PAUSE = 0.15  # s between two cycles: a busy machine has stopped this process
AFTER_PAUSE = 2.0  # s of the cell's time
RESOLUTION = 1e-7  # m, of RKorr on the wire
TURNS = (  # joint angles 4, 5, 6 against HOME, rad: the tool turned to all sides, without contact
    (0.0, 0.0, 0.0), (0.0, 0.9, 0.0), (0.0, -1.6, 0.0), (1.5, 0.8, 0.0),
    (-1.5, 0.8, 0.0), (0.7, -1.2, 1.5), (-0.7, -1.2, -1.5), (3.0, 0.6, 0.8),
)  # fmt: skip


def wait_for_port(port: int, seconds: float = 90.0) -> None:
    """Until a process of this machine has this UDP port of 127.0.0.1 open."""
    entry, end = f"0100007F:{port:04X}", time.monotonic() + seconds
    while not any(line.split()[1] == entry for line in Path("/proc/net/udp").read_text().splitlines()[1:]):
        assert time.monotonic() < end, f"nobody listens on port {port} within {seconds} s"
        time.sleep(0.05)


def calibrated_model(folder: Path) -> Path:
    """18-DOF model of the simulated robot, identified from a simulated session."""
    cell = read_cell(str(CELL))
    session = write_session(generate(cell, read_truth(TRUTH, cell.name), 31, 5), folder / "session", "closed loop")
    return save_model(model_of(identify(read_session(session), blank_model(list(EIGHTEEN_DOF)))), folder / "model.yaml")


def stand(cell: Cell, q: np.ndarray, rail: float) -> None:
    """Go there, not in real time, and stand still; a process force of zero stands in for contact."""
    cell.set_process(np.zeros(3))
    for share in np.linspace(0.0, 1.0, 200):
        cell.command((1 - share) * cell.joints()[0] + share * q, rail)
        cell.step()
    for _ in range(150):
        cell.step()


def identified_load(cell: Cell, robot: Robot) -> ToolLoad:
    """What the raw sensor reads without contact, from orientations of the standing robot."""
    home, readings, turned = cell.cell.home, [], []
    R_sensor_in_tool, _ = sensor_in_tool(robot, "ft_sensor")
    for turn in TURNS:
        stand(cell, home + np.r_[np.zeros(3), turn], 0.0)
        rows = []
        for _ in range(100):
            cell.step()
            rows.append(cell.wrench_raw())
        readings.append(np.mean(rows, axis=0))
        turned.append(cell.tcp()[1] @ R_sensor_in_tool)
    return identify_tool_load(np.array(readings), np.array(turned)).load


class Line:
    """Cell, controller and sensor in this process; correction in others."""

    def __init__(self, timeout: int = 100) -> None:
        self.cell = Cell(read_cell(str(CELL)), read_truth(TRUTH, "afp"), seed=3)
        self.robot = Robot.from_urdf(ROOT / "config/robots/kr120_r2700_extra_ha.urdf")
        self.load = identified_load(self.cell, self.robot)
        self.plan = plan_course(self.cell.cell)
        stand(self.cell, self.plan.q[0], self.plan.rail)
        noise = np.random.default_rng(7)  # so that a pause of this process does not look like a frozen sensor
        self.sensor = NetFtCan(lambda: self.cell.wrench_raw() + noise.normal(0.0, 0.05, 6))
        self.adapter = SlcanAdapter(self.sensor)
        self.timeout = timeout
        self.controller: RsiController | None = None
        self.block = f"irec_test_{uuid.uuid4().hex}"
        self.pauses: list[float] = []

    def start(self, start_process: Callable, model: Path, port: int) -> tuple:
        """The two processes of the correction, as an integrator would start them."""
        load = self.load
        vectors = {"com": load.com, "bias_force": load.bias_force, "bias_torque": load.bias_torque}
        sensor = start_process(
            self._command(
                "can_ft_node", interface="slcan", channel=self.adapter.channel, rate=200.0, block=self.block, realtime_priority=50
            ),
            name="can_ft_node",
        )
        bridge = start_process(
            self._command(
                "rsi_bridge", cell=CELL, port=port, wrench_block=self.block, model_path=model, raw_wrench="true",
                **{"tool_load.mass": load.mass}, **{f"tool_load.{k}": [float(x) for x in v] for k, v in vectors.items()},
                **{"wrench_rate": 200.0, "watch.wrench_timeout": 1.0, "watch.joints_timeout": 1.0, "watch.force_jump": 2000.0},
                realtime_priority=50, start_load=10.0,
            ),
            name="rsi_bridge",
        )  # fmt: skip
        wait_for_port(port)  # a controller that was running before would get no answer: it might hold a correction
        self.controller = RsiController(("127.0.0.1", port), timeout=10**6)
        return sensor, bridge

    @property
    def sent(self) -> list[np.ndarray]:
        """Translation of the offset that acted in the controller, one per cycle, m."""
        return self.controller.acted if self.controller is not None else [np.zeros(3)]

    @staticmethod
    def _command(node: str, **parameters: object) -> list[str]:
        given = [item for k, v in parameters.items() for item in ("-p", f"{k}:={v}")]
        return [sys.executable, "-m", f"irec_correction.nodes.{node}", "--ros-args", *given]

    def cycle(self, until: float) -> None:
        """One interpolation cycle: the robot moves, tells where it is, gets its correction."""
        assert self.controller is not None
        cell = self.cell
        cell.step()
        q, rail = cell.joints()
        p, R = cell.tcp()
        abc = Rotation.from_matrix(R).as_euler("ZYX")
        # nothing holds a controller up: where this process was, the cycle gets longer, not the time to answer shorter
        until = max(until, time.perf_counter() + 0.75 * PERIOD)
        correction = self.controller.cycle(RobotState(q, p, abc, rail), until)
        if self.controller.stopped:
            return
        turn = Rotation.from_euler("ZYX", correction.abc).as_rotvec()
        cell.set_offset(correction.translation, turn, cell.time)

    def drive(self, seconds: float, each: Callable[[float], None] = lambda _: None) -> None:
        """Cycles in real time; `each` is told the time since the beginning before each one."""
        due = before = time.perf_counter()
        for i in range(round(seconds / PERIOD)):
            if time.perf_counter() - before > PAUSE:
                self.pauses.append(self.cell.time)
            before = time.perf_counter()
            each(i * PERIOD)
            due += PERIOD
            self.cycle(due)
            due = max(due, time.perf_counter())
            if self.controller is not None and self.controller.stopped:
                return
            time.sleep(max(0.0, due - time.perf_counter()))

    def until(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what} not within {seconds} s; {self.controller.counts}"  # type: ignore[union-attr]
            self.drive(0.05)

    def close(self) -> None:
        """Take sensor and controller away."""
        self.adapter.unplug()
        if self.controller is not None:
            self.controller.close()

    def press(self, t: float) -> None:
        """The process force of the course's beginning comes within PRESS_TIME."""
        self.cell.set_process(min(1.0, t / PRESS_TIME) * self.plan.force(0.0))

    def undisturbed(self, times: np.ndarray) -> np.ndarray:
        """Which times were not preceded by a pause of this process, after which the correction ramps in again."""
        return np.array([not any(p <= t <= p + AFTER_PAUSE for p in self.pauses) for t in times])

    @property
    def largest_step(self) -> float:
        """Between two cycles of the controller, whatever was lost between them."""
        return float(np.linalg.norm(np.diff(np.array(self.sent), axis=0), axis=1).max())


def course_deviation(
    cell: Cell, plan: CoursePlan, run: Callable[[float, Callable[[float], None]], None], speed: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times of the cell (n,), s, and deviation of the physical TCP along the course, one row per 0.2 s, (n, 3), m.

    Args:
        run: drives for a time, calling back before each cycle with the time since the beginning.
    """
    move = table_move(plan.q, plan.rail, plan.length, speed)
    rows: list[np.ndarray] = []
    times: list[float] = []

    def each(t: float) -> None:
        s = move.way.distance(t)
        q, rail = move.at(s)
        cell.command(q, rail)
        cell.set_process(plan.force(s))
        if round(t / PERIOD) % 50 == 25:
            rows.append(cell.true_deviation())
            times.append(cell.time)

    run(plan.length / speed + 0.5, each)
    return np.array(times), np.array(rows)


def without_correction(line: Line, speed: float) -> np.ndarray:
    """The same course on a cell of its own, not in real time."""
    cell = Cell(line.cell.cell, read_truth(TRUTH, "afp"), seed=3)
    stand(cell, line.plan.q[0], line.plan.rail)
    cell.set_process(line.plan.force(0.0))

    def run(seconds: float, each: Callable[[float], None]) -> None:
        for i in range(round(seconds / PERIOD)):
            each(i * PERIOD)
            cell.step()

    return course_deviation(cell, replace(line.plan), run, speed)[1]
