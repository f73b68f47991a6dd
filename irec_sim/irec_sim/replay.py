# SPDX-License-Identifier: Apache-2.0
"""The rows of a generated session again under other physics, at the joint angles and force readings that were recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .kinematics import Array, forward
from .observe import arrived, conditions_at
from .plant import Conditions, Frames, Plant, State
from .sensing import SensingParameters, drift_at, motor_angles, tracker_reading, true_force
from .session import Generated
from .truth import Truth
from .truth_catalogue import Physics

STEP = 1e-3  # of a finite difference, in widths of what is changed


class _Course:
    """The arm along the rows of one pass, with the process force or without, as other physics bend it.

    Lever arms are taken from the true equilibrium; the change by other parameters is of first order in the deflection.
    """

    def __init__(self, made: Generated, repeat: int, physics: Physics, process: bool) -> None:
        self.cell, self.schedule, self.rows = made.cell, made.schedules[repeat], made.rows[repeat]
        self._true, self._process = physics, process
        self._frames: list[Frames] = []
        self._e: list[Array] = []
        self._motor = self._motor_angles(physics.sensing)
        plant = Plant(self.cell.chain, physics.plant, whole=True)
        state: State | None = None
        frames = before = None
        for j in range(self.rows.q.shape[1]):
            R = self._frames[-1].R_tool if self._frames else forward(self.cell.chain, self.rows.q[:, 0]).R_tool
            conditions = self._conditions(j, self.schedule.force[:, j] * process, R)
            if state is None:
                state = plant.relaxed(self._motor[0], conditions, arrived(self.rows.q[:, 0]))
            elif frames is not None and before is not None and np.isfinite(physics.plant.release):
                state = plant.released(frames, self._motor[j - 1], before, state, self._motor[j] - self._motor[j - 1])
            before = conditions
            state, frames = plant.equilibrium(self._motor[j], conditions, state, self._dt(j), tolerance=1e-11)
            self._frames.append(frames)
            self._e.append(state.e)
        self.turns = plant.turns

    def _dt(self, j: int) -> Array:
        stamp = self.schedule.stamp
        return stamp[:, j] - stamp[:, j - 1] if j else np.zeros(len(stamp))

    def step(self, j: int) -> Array:
        q = self.rows.q
        return np.asarray(q[:, j] - (q[:, j - 1] if j else self.rows.q_before))

    def _motor_angles(self, sensing: SensingParameters) -> list[Array]:
        return [motor_angles(sensing, self.rows.q[:, j], self.step(j)) for j in range(self.rows.q.shape[1])]

    def _conditions(self, j: int, force: Array, R_tool: Array) -> Conditions:
        axis = self.cell.rail[0] if self.cell.rail is not None else np.zeros(3)
        conditions = conditions_at(self.schedule, j, self.schedule.poses.rail[:, None] * axis, force)
        if not self._process:
            return replace(conditions, process_on=np.zeros(len(force), dtype=bool))
        return replace(conditions, force=(R_tool @ force[:, :, None])[..., 0]) if j else conditions

    def strains(self, physics: Physics, readings: Array) -> list[tuple[Frames, Array]]:
        """Configuration from which lever arms are taken, and change of the elastic coordinates against it, row by row.

        readings: of the force sensor, (N, M + 1, 3), N; without the process force not read.
        """
        sensing = physics.sensing
        plant = Plant(self.cell.chain, physics.plant, whole=True)
        motor = self._motor_angles(sensing)
        moved = any(np.any(a != b) for a, b in zip(motor, self._motor, strict=True))
        moved = moved or _geometry(physics) != _geometry(self._true)
        state: State | None = None
        last = before = None
        force, out = np.zeros((len(self.rows.q), 3)), []
        for j, (frames, e_true) in enumerate(zip(self._frames, self._e, strict=True)):
            if moved:
                frames = plant.frames(motor[j], e_true)
            if self._process:
                force = true_force(
                    sensing, self.cell.sensor_axis, readings[:, j], frames.R_tool, force, self.schedule.ambient[:, j]
                )
            conditions = self._conditions(j, force, frames.R_tool)
            if state is None:
                state = plant.at_rest(frames, motor[j], conditions, arrived(self.rows.q[:, 0]))
            elif last is not None and before is not None and np.isfinite(physics.plant.release):
                state = plant.released(last, motor[j - 1], before, state, motor[j] - motor[j - 1])
            last, before = frames, conditions
            state, _ = plant.respond(frames, motor[j], conditions, state, plant.compliance(motor[j], conditions), self._dt(j))
            out.append((frames, state.e - e_true))
        return out


class Replay:
    """What the rows of one pass show under other physics, at the joint angles and force readings that were recorded."""

    def __init__(self, made: Generated, repeat: int, physics: Physics, readings: Array) -> None:
        """readings: of the force sensor, (N, M + 1, 3), N."""
        self.cell, self.schedule, self.rows, self.readings = made.cell, made.schedules[repeat], made.rows[repeat], readings
        self._course, self._without = (_Course(made, repeat, physics, process) for process in (True, False))

    def __call__(self, physics: Physics) -> tuple[Array, Array]:
        """Displacement of the marker since the reference, seen with the stated stations, and of the TCP by the process force,
        (N, M, 3) each, m."""
        sensing, tcp, seen = physics.sensing, [], []
        without = self._without.strains(physics, self.readings)
        for j, (frames, de) in enumerate(self._course.strains(physics, self.readings)):
            p = frames.p_tcp + (de[:, None] @ frames.lever)[:, 0]
            turn = (de[:, None] @ self._course.turns(frames))[:, 0]
            arm = (frames.R_tool @ (self.cell.marker_in_tool0 + sensing.marker_error)[:, None])[..., 0]
            frames, de = without[j]
            tcp.append(p - frames.p_tcp - (de[:, None] @ frames.lever)[:, 0])
            drifted = p + drift_at(sensing, self.schedule.stamp[:, j], self.schedule.ambient[:, j])
            seen.append(self._measured(sensing, drifted + arm + np.cross(turn, arm), j))
        return since_reference(np.stack(seen, axis=1)), np.stack(tcp[1:], axis=1)

    def compliance_columns(self, truth: Truth) -> tuple[Array, Array]:
        """Derivative of both displacements by the logarithm of each compliance of the joints, (3 n, N, M, 3) each, m.

        All are changed at once: a spring's own angle answers to its own compliance only.
        """
        softer = replace(truth, axial=truth.axial * (1.0 + STEP), transverse=truth.transverse * (1.0 + STEP))
        joints = slice(6, 6 + 3 * self.cell.chain.n)

        def by_springs(course: _Course) -> list[tuple[Frames, Array]]:
            both = (course.strains(t.physics(), self.readings) for t in (truth, softer))
            return [(frames, (b - a)[:, joints, None] / STEP) for (frames, a), (_, b) in zip(*both, strict=True)]

        seen, tcp = [], []
        for (frames, de), (free, de_free) in zip(by_springs(self._course), by_springs(self._without), strict=True):
            arm = (frames.R_tool @ self.cell.marker_in_tool0[:, None])[..., 0]
            at_tcp = de * frames.lever[:, joints]
            tcp.append(at_tcp - de_free * free.lever[:, joints])
            seen.append(at_tcp + np.cross(de * frames.axis[:, joints], arm[:, None]))
        return since_reference(np.stack(seen, axis=1).transpose(2, 0, 1, 3), 2), np.stack(tcp[1:], axis=1).transpose(2, 0, 1, 3)

    def _measured(self, sensing: SensingParameters, p_marker: Array, j: int) -> Array:
        """In base_link with the stated pose of the station."""
        out = np.empty_like(p_marker)
        axis = self.cell.rail[0] if self.cell.rail is not None else np.zeros(3)
        in_cell = p_marker + self.schedule.poses.rail[:, None] * axis
        for s, (_, p_station, R_station) in enumerate(self.cell.stations):
            by = self.schedule.station == s
            shifted = self.rows.shifted[by, j]
            out[by] = tracker_reading(sensing, in_cell[by], s, p_station, R_station, shifted) @ R_station.T
        return out


def since_reference(x: Array, axis: int = 1) -> Array:
    reference = x.take([0], axis)
    return np.delete(x, 0, axis) - reference


def _geometry(physics: Physics) -> bytes:
    plant = physics.plant
    ends = (plant.hose.attach, plant.hose.anchor) if plant.hose is not None else ()
    return b"".join(np.asarray(x).tobytes() for x in (plant.joint_zero, plant.p_error, plant.turn_error, plant.centre, *ends))
