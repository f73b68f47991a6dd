# SPDX-License-Identifier: Apache-2.0
"""A cell simple enough to know every answer: rigid contact without friction, a robot with one linear compliance."""

from __future__ import annotations

import sys

import numpy as np

from irec_sim.cellfile import CellFile, read_cell
from irec_sim.errors import SimError
from irec_sim.kinematics import Array, forward, rotation_of_vector
from irec_sim.nodes.cell_node import run

POSITION, FORCE = 0, 1
ADVANCE = 5e-3  # m/s before contact
FORCE_TIME = 0.1  # s
COMPLIANCE = 5e-7  # m/N, isotropic


class SimpleCell:
    """The interface of the plant that the nodes need, for a cell file."""

    period = 0.004

    def __init__(self, cell: CellFile) -> None:
        self.cell, self.chain = cell, cell.chain
        self.rail_names = ("ext_rail",) if cell.rail else ()
        self.rail_range = cell.rail[1] if cell.rail else (0.0, 0.0)
        self.time, self.mode = 0.0, POSITION
        self.commanded = (cell.home.copy(), 0.0)
        self.offset, self.late_offsets = np.zeros(3), 0
        self._turn, self._offset_stamp = np.zeros(3), -np.inf
        self._setpoint, self._force = np.zeros(3), np.zeros(3)
        self._contact = False

    def step(self) -> None:
        self.time += self.period
        target = self._setpoint if self.mode == FORCE and self._contact else np.zeros(3)
        before = self._deflection()
        self._force += (target - self._force) * min(1.0, self.period / FORCE_TIME)
        if self.mode == FORCE:
            q, rail = self.commanded
            pose = forward(self.chain, q[None])
            R = pose.R_tool[0]
            if self._contact:
                move = before - self._deflection()
            else:
                step = ADVANCE * self.period * R[:, 2]
                axis = self.cell.rail[0] * rail if self.cell.rail else np.zeros(3)
                gap, _ = self.cell.surface.gap(pose.p_tcp[0] + axis)
                self._contact = gap <= 0.0
                move = np.zeros(3) if self._contact else step
            J = pose.jacobian()[0]
            self.commanded = (q + np.linalg.solve(J, np.r_[move, np.zeros(3)]), rail)

    def _deflection(self) -> Array:
        R = forward(self.chain, self.commanded[0][None]).R_tool[0]
        return COMPLIANCE * (R @ self._force)

    def command(self, q: Array, rail: float) -> None:
        self.commanded = (q, rail)

    def control_force(self, force: Array) -> None:
        self.mode, self._setpoint = FORCE, force

    def control_position(self) -> None:
        self.mode, self._contact = POSITION, False

    def set_force(self, force: Array) -> None:
        if self.mode != FORCE:
            raise SimError("the robot is in position control")
        self._setpoint = force

    def set_offset(self, translation: Array, turn: Array, stamp: float) -> None:
        self.offset, self._turn, self._offset_stamp = translation, turn, stamp

    def joints(self) -> tuple[Array, float]:
        return self.commanded

    def tcp(self) -> tuple[Array, Array]:
        pose = forward(self.chain, self.commanded[0][None])
        return pose.p_tcp[0] + self.offset, rotation_of_vector(self._turn) @ pose.R_tool[0]

    def wrench_raw(self) -> Array:
        return np.r_[self._force + [1.0, 2.0, 3.0], np.zeros(3)]

    def wrench(self) -> Array:
        return np.r_[self._force, np.zeros(3)]

    def tracker(self) -> tuple[str, Array] | None:
        name, p_station, R_station = self.cell.stations[0]
        p, R = self.tcp()
        p_marker = p + self._deflection() + R @ self.cell.marker_in_tool0
        if self.cell.rail:
            p_station = p_station - self.commanded[1] * self.cell.rail[0]
        return name, R_station.T @ (p_marker - p_station)

    def temperatures(self) -> dict[str, float]:
        return {"ambient": 22.0}


if __name__ == "__main__":
    sys.exit(run(lambda node: SimpleCell(read_cell(node.declare_parameter("cell", "afp").value))))
