# SPDX-License-Identifier: Apache-2.0
"""A whole Procedure 1 on a robot that takes joint trajectories only, in one process and so at a delay of our choice.

The parts are those of ros2_control_driver and of the mock hardware; between them lie not topics but a queue.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_runner import session_of
from irec_calibration.cell import Cell, read_cell
from irec_calibration.drivers.moves import MoveError, Planner
from irec_calibration.drivers.position_robot import Order, PositionRobot
from irec_calibration.drivers.wrench import ProcessWrench
from irec_calibration.effects import find_effect
from irec_calibration.identification.identify import identify
from irec_calibration.model import Term
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.procedure.axes import read_axes
from irec_calibration.procedure.checks import plan_targets
from irec_calibration.procedure.commands import CancelMove, ForceSetpoint, MoveJoint, MoveLinear, Row, SwitchMode
from irec_calibration.procedure.machine import Procedure
from irec_calibration.procedure.plausible import Plausibility
from irec_calibration.procedure.settings import read_settings
from irec_calibration.procedure.standstill import Streams
from irec_calibration.sensors.tool_load import G, ToolLoad
from irec_sim.cell import Cell as SimulatedCell
from irec_sim.cellfile import read_cell as read_simulated
from irec_sim.trajectory import TrajectoryFollower
from irec_sim.truth import make_truth
from scipy.spatial.transform import Rotation

CELL = Path(__file__).parents[1] / "config" / "cells" / "afp.yaml"
TICK = 3  # steps of the plant between two points for the trajectory controller
LONGEST = 300.0  # s of the cell


class Line:
    """Driver, mock hardware and procedure."""

    def __init__(self, cell: Cell, delay: float, n_poses: int) -> None:
        file = read_simulated(CELL)
        self.cell, self.delay = cell, delay
        self.plant = SimulatedCell(file, make_truth(file.name, [], 1, effort=file.chain.effort), 1)
        self.controller = TrajectoryFollower(self.plant)
        self.axes = read_axes(cell)
        self.planner = Planner(cell, self.axes, 0.5)
        self.robot = PositionRobot(self.planner)
        com = tuple(float(v) for v in file.chain.tool_com)
        unloaded = ToolLoad(float(file.chain.tool_mass), com, (0.0,) * 3, (0.0,) * 3)  # type: ignore[arg-type]
        frame = cell.raw["force_sensor"]["frame"]
        R = self.planner.chain.forward(cell.home[None])[1][0]
        bias = self.plant.wrench_raw() - _weight(cell, frame, unloaded, R)  # as irec tool-load finds it
        load = ToolLoad(float(file.chain.tool_mass), com, tuple(bias[:3]), tuple(bias[3:]))  # type: ignore[arg-type]
        self.sensor = ProcessWrench(cell, frame, load)
        settings = read_settings(cell)
        poses = pose_list(cell, make_plan(cell, n_poses, pool_size=60)).poses
        rail = np.array([p.ext.get("rail", 0.0) for p in poses])
        targets = plan_targets(cell, settings, np.array([p.q for p in poses]), rail, [p.index for p in poses])
        self.streams = Streams(5.0 + settings.window_s)
        self.procedure = Procedure(
            targets, cell.forces_in_tool, cell.home, settings, self.streams, {s.name: s.R_in_cell for s in cell.stations},
            seed=3, plausibility=Plausibility(cell),
        )  # fmt: skip
        self.rows: list[Row] = []
        self.largest = 0.0  # N
        self.on_the_way: deque[tuple[float, np.ndarray]] = deque()

    def run(self) -> None:
        while self.robot.waits:  # until it is known where the robot stands
            self._tell_robot(*self.plant.joints())
            self.plant.step()
        self.procedure.watch.robot_said(self.robot.mode)
        self.procedure.start()
        steps = 0
        while self.procedure.state != "finished":
            if self.plant.time > LONGEST:
                raise TimeoutError(f"still in {self.procedure.state}: {self.procedure.message}")
            while self.on_the_way and self.on_the_way[0][0] <= self.plant.time:
                self.controller.take([(2 * TICK * self.plant.period, self.on_the_way.popleft()[1])])
            self.controller.before_step()
            self.plant.step()
            steps += 1
            self._read(steps)
            if steps % TICK == 0:
                for command in self.procedure.step(self.plant.time, self.plant.time):
                    self._carry_out(command)

    def _read(self, steps: int) -> None:
        now = self.plant.time
        q, rail = self.plant.joints()
        positions = np.array([*q, rail])
        self.streams.add_joints(now, self.axes.recorded, tuple(positions))
        p, R, _ = self.planner.chain.forward(q[None])
        self.streams.add_tcp(now, *p[0].tolist(), *Rotation.from_matrix(R[0]).as_quat().tolist())
        wrench = self.sensor.at_tcp(self.sensor.raw(self.plant.wrench_raw()), R[0])
        self.streams.add_wrench(now, tuple(wrench))
        self.largest = max(self.largest, float(np.linalg.norm(wrench[:3])))
        seen = self.plant.tracker()
        if seen is not None:
            self.streams.add_marker(now, *seen[1].tolist(), seen[0])
        if steps % TICK == 0:
            self._tell_robot(q, rail)
            sent = self.robot.tick(now, (now, wrench[:3]))
            if sent is not None:
                self.on_the_way.append((now + self.delay, sent))
            self.procedure.watch.robot_said(self.robot.mode, self.robot.retreating, self.robot.message)

    def _tell_robot(self, q: np.ndarray, rail: float) -> None:
        self.robot.report(self.plant.time, self.plant.time, np.array([*q, rail]))

    def _carry_out(self, command: Any) -> None:
        now = self.plant.time
        if isinstance(command, MoveJoint | MoveLinear):
            try:
                motion = self._planned(command)
                done = self.procedure.move_finished
                self.robot.begin(Order(motion, lambda: False, lambda _: None, lambda _, why: done(not why, why)), now)
            except MoveError as error:
                self.procedure.move_finished(False, str(error))
        elif isinstance(command, SwitchMode):
            try:
                self.robot.switch(command.force, tuple(command.force_in_tool), now)
                self.procedure.mode_switched(True, "", self.robot.settings.lease)
            except MoveError as error:
                self.procedure.mode_switched(False, str(error))
        elif isinstance(command, ForceSetpoint):
            self.robot.set_force(tuple(command.force_in_tool), now)
        elif isinstance(command, Row):
            self.rows.append(command)
        elif isinstance(command, CancelMove):
            raise AssertionError("the run was broken off")

    def _planned(self, command: MoveJoint | MoveLinear) -> Any:
        start = self.robot.commanded
        if isinstance(command, MoveLinear):
            quat = Rotation.from_matrix(np.array(command.R_in_base)).as_quat().tolist()
            return self.planner.linear(start, command.p_in_base, quat, command.speed)
        position = [*command.q, *([] if command.rail is None else [command.rail])]
        return self.planner.joint(start, dict(zip(self.axes.driver, position, strict=False)), command.speed)


def _weight(cell: Cell, frame: str, load: ToolLoad, R_tool: np.ndarray) -> np.ndarray:
    """What the sensor reads of the tool's weight at HOME, without bias (6,)."""
    return load.reading(R_tool @ ProcessWrench(cell, frame, load).R_sensor_in_tool, np.array(G))


@pytest.mark.slow
@pytest.mark.parametrize("delay", [pytest.param(0.0, marks=pytest.mark.long), 0.1])
def test_a_whole_procedure_through_joint_trajectories_gives_a_session_that_is_solved(delay: float, tmp_path: Path) -> None:
    cell = read_cell(CELL)
    line = Line(cell, delay, n_poses=2)
    line.run()
    assert not line.procedure.stopped_because, line.procedure.stopped_because
    assert line.procedure.counts.complete == 2 and line.procedure.counts.rejected == 0
    assert line.largest < 1250.0  # N, at a set point of 1100 N with 280 N across
    session = session_of(cell, line.rows, tmp_path / "session")
    assert len(session) == 12
    for row in np.flatnonzero(session.load_case):
        np.testing.assert_allclose(session.force_in_tool[row], cell.forces_in_tool[session.load_case[row] - 1], atol=16.0)
    solved = identify(session, [Term(find_effect("joint_torsion"))])
    assert float(np.sqrt(np.mean(np.square(solved.residual)))) < 2e-4
