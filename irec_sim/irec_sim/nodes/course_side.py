# SPDX-License-Identifier: Apache-2.0
"""`sim/run_course`: drives the loaded course of the cell and writes where the TCP really was."""

from __future__ import annotations

import threading
from pathlib import Path

from irec_ros.parameters import P, Parameters
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..cell import Cell
from ..course import RAMP_TIME, CoursePlan, CourseSample, plan_course, write_course
from ..errors import SimError
from ..kinematics import Array, forward
from ..motion import Move, joint_move, linear_move, table_move
from .loop import SimulationLoop
from .robot_side import Order, RobotSide

SPEED_SHARE = 0.25  # of the joint velocity limits, to the start of the course
LINEAR_SPEED = 0.1  # m/s, from above the start onto it, and back at the end
SETTLING_TIME = 1.0  # s that the robot stands after the force has come or gone
PARAMETERS = (P("course_csv", "course.csv", "file that sim/run_course writes the true path of the TCP to", settable=True),)
SAMPLE_STEPS = 5  # steps of the cell between samples of the record


class CourseSide:
    """Serves on a node of its own, so that the cell goes on listening while the course is being driven."""

    def __init__(
        self, node: Node, cell: Cell, loop: SimulationLoop, robot: RobotSide, asked_to_stop: threading.Event
    ) -> None:
        self._node, self._cell, self._loop, self._robot, self._asked_to_stop = node, cell, loop, robot, asked_to_stop
        self._parameters = Parameters(node, PARAMETERS)
        node.create_service(Trigger, "sim/run_course", self._on_run)
        node.create_service(Trigger, "sim/clear_fault", self._on_clear)
        self._plan: CoursePlan | None = None
        self._order: Order | None = None
        self._way = self._level = self._direction = 0.0
        self._until = 0.0
        self._settled = threading.Event()
        self._samples: list[CourseSample] = []
        self._steps = 0

    def after_step(self) -> None:
        """Note the truth and apply the process force for the next step; in the thread of the simulation."""
        plan, cell = self._plan, self._cell
        if plan is None:
            return
        if self._order is not None:
            self._way = self._order.motion.way.distance(cell.time - self._order.since)
            self._steps += 1
            if self._steps % SAMPLE_STEPS == 0:
                self._samples.append(self._sample())
        self._level = min(1.0, max(0.0, self._level + self._direction * cell.period / RAMP_TIME))
        cell.set_process(self._level * plan.force(self._way))
        if cell.time >= self._until:
            self._settled.set()

    def _sample(self) -> CourseSample:
        cell = self._cell
        p_true = cell.true_tcp()
        return CourseSample(
            stamp=cell.time,
            s=self._way,
            p_commanded=_tcp(cell, cell.commanded[0]),
            p_unloaded=p_true - cell.true_deviation(),
            p_true=p_true,
            force_in_tool=cell.true_force(),
            offset=cell.offset.copy(),
        )

    def _on_run(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = str(self._run()), True
        except SimError as error:
            response.message, response.success = str(error), False
        return response

    def _on_clear(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._loop.call(self._cell.clear_fault)
        response.success = True
        return response

    def _run(self) -> Path:
        path = Path(self._parameters["course_csv"]).absolute()
        cell = self._cell
        plan = plan_course(cell.cell)
        self._samples, self._way, self._steps = [], 0.0, 0
        start = self._loop.call(lambda: cell.commanded)
        home = (cell.cell.home, plan.rail)  # from the end of the last course straight to its begin leads through the tooling
        for a, b in ((start, home), (home, (plan.q_approach, plan.rail))):
            self._drive(joint_move(cell.chain, a, b, SPEED_SHARE, self._robot.rail_speed))
        try:
            # the process force stands in for contact from here on: the arm's sag would press it into the tooling
            self._loop.call(lambda: self._begin(plan))
            self._line(plan, plan.q_approach, _tcp(cell, plan.q[0]))
            self._press(+1.0)
            self._drive(table_move(plan.q, plan.rail, plan.length, plan.speed), record=True)
            self._press(-1.0)
            self._line(plan, plan.q[-1], _tcp(cell, plan.q[-1]) + cell.cell.approach_distance * plan.normal[-1])
        finally:
            self._loop.call(self._end)
        write_course(path, plan, self._samples)
        return path

    def _begin(self, plan: CoursePlan) -> None:
        self._plan, self._level, self._direction = plan, 0.0, 0.0

    def _end(self) -> None:
        self._plan = self._order = None
        self._cell.set_process(None)

    def _line(self, plan: CoursePlan, q: Array, p_goal: Array) -> None:
        """Straight from joint angles q to a point in base_link, the tool as it is."""
        R = forward(self._cell.chain, q[None]).R_tool[0]
        self._drive(linear_move(self._cell.chain, q, plan.rail, p_goal, R, LINEAR_SPEED))

    def _drive(self, motion: Move, record: bool = False) -> None:
        """Carry out one move and wait for its end."""
        done, problems = threading.Event(), list[str]()

        def ended(_: float, problem: str) -> None:
            problems.append(problem)
            done.set()

        order = Order(motion, cancelled=lambda: False, feedback=lambda _: None, ended=ended)
        self._robot.begin(order)
        if record:
            self._loop.call(lambda: setattr(self, "_order", order))
        self._wait(done)
        if record:
            self._loop.call(lambda: setattr(self, "_order", None))
        if problems[0]:
            raise SimError(problems[0])

    def _press(self, direction: float) -> None:
        """Let the process force come (+1) or go (-1) and wait until it has, and the arm has settled."""

        def begin() -> None:
            self._direction = direction
            self._until = self._cell.time + RAMP_TIME + SETTLING_TIME
            self._settled.clear()

        self._loop.call(begin)
        self._wait(self._settled)

    def _wait(self, done: threading.Event) -> None:
        while not done.wait(0.2):
            if self._loop.failure is not None or self._asked_to_stop.is_set():
                raise SimError("the simulation has ended")


def _tcp(cell: Cell, q: Array) -> Array:
    """tool0 in base_link by the rigid robot, (3,), m."""
    p: Array = forward(cell.chain, q[None]).p_tcp[0]
    return p
