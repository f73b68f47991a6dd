# SPDX-License-Identifier: Apache-2.0
"""A whole run of Procedure 1 at once, without time stepping and without noise: what the plant does and what is seen.

Poses are rows of a batch; the load cases of a pose follow each other in time and carry the plant's memory along.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .cellfile import CellFile
from .kinematics import Array, BoolArray, IntArray, forward
from .plant import Conditions, Plant, State
from .poses import Poses
from .sensing import SensingParameters, beyond_reported, drift_at, force_reading, motor_angles, tracker_reading
from .truth_catalogue import Physics

DISC_NORMAL = 4.0e6  # N/m, of the urethane disc
DISC_TANGENTIAL = 1.5e6


@dataclass(frozen=True)
class Schedule:
    """When and how each row is loaded; N poses, M + 1 rows each (row 0 is the reference).

    Attributes:
        stamp: s, (N, M + 1); force: process force in tool0, environment on robot, N, (N, M + 1, 3), zero in row 0.
        gap: distance of the reference from contact, m, (N,).
        ambient: degC, (N, M + 1); gears: degC, (N, M + 1, joints).
        station: index of the station that sees each pose, (N,).
        lagged: temperatures of `gears` and, first, `ambient` that follow them late, degC, (N, M + 1, joints + 1).
        case: which load case each row is, (N, M + 1), 0 first: load cases follow each other in an order of their own per pose.
    """

    poses: Poses
    stamp: Array
    force: Array
    gap: Array
    ambient: Array
    gears: Array
    station: Array
    case: IntArray
    lagged: Array

    def before(self, j: int) -> Array:
        """Force in tool0 of the row before, (N, 3), N: none before a reference."""
        return self.force[:, j - 1] if j else np.zeros_like(self.force[:, 0])


@dataclass(frozen=True)
class Rows:
    """What a run looks like without noise; all (N, M + 1, ...).

    Attributes:
        q: reported joint angles, rad; p_controller: the controller's TCP in base_link, m.
        p_marker: marker in the frame of the station, m; distance: from it, m.
        force_reading: in tool0, N; wrench_force: true force in tool0, N.
        p_tcp: physical TCP in base_link, m, without what drifts with time, and joint angles that were read early.
        p_unloaded: the same had no process force acted since the reference.
        station: index of the station of each pose, (N,).
        shifted: rows after a station was bumped, (N, M + 1) bool.
        q_before: where each pose's reference was approached from, (N, joints), rad.
        q_link: angles behind the gears, as secondary encoders read them without noise, rad.
    """

    q: Array
    p_controller: Array
    p_marker: Array
    distance: Array
    force_reading: Array
    wrench_force: Array
    p_tcp: Array
    p_unloaded: Array
    station: Array
    shifted: BoolArray
    q_before: Array
    q_link: Array

    @property
    def deflection(self) -> Array:
        """What the process force has caused at the physical TCP, (N, M, 3), m in base_link: against the same arm without it."""
        return (self.p_tcp - self.p_unloaded)[:, 1:]

    def apparent_deflection(self, cell: CellFile) -> Array:
        """Marker displacement minus the controller's, per loaded row, (N, M, 3), m; what a session shows of the arm."""
        lever = np.stack([forward(cell.chain, self.q[:, j]).R_tool @ cell.marker_in_tool0 for j in range(self.q.shape[1])], 1)
        seen = self.p_marker - self.p_marker[:, :1]
        commanded = self.p_controller + lever
        R = np.stack([cell.stations[k][2] for k in self.station])
        in_base = (R[:, None] @ seen[..., None])[..., 0]
        return (in_base - commanded + commanded[:, :1])[:, 1:]


def simulate(
    cell: CellFile, physics: Physics, schedule: Schedule, came_from: Array | None = None, bumped: float | None = None
) -> Rows:
    """Run Procedure 1 in the plant.

    Args:
        came_from: joint angles before the first pose, (joints,), rad; None: it stood there already.
        bumped: moment at which a station was bumped, s, where that was in a pass before; None: in this one, if at all.
    """
    bumped = bump(schedule, physics.sensing) if bumped is None else bumped
    rows = _run(cell, physics, schedule, None, bumped)
    first = rows.q[:1, 0] if came_from is None else came_from[None]
    q_before = np.concatenate([first, rows.q[:-1, -1]])
    if np.any(physics.sensing.settle):
        return _run(cell, physics, schedule, q_before, bumped)
    return replace(rows, q_before=q_before)


def _run(cell: CellFile, physics: Physics, schedule: Schedule, q_before: Array | None, bumped: float) -> Rows:
    plant, sensing, chain = Plant(cell.chain, physics.plant), physics.sensing, cell.chain
    N, rows = schedule.stamp.shape
    poses = schedule.poses
    R_command = poses.R
    axis = cell.rail[0] if cell.rail is not None else np.zeros(3)
    base_in_cell = poses.rail[:, None] * axis
    p_reference = poses.p - poses.R[:, :, 2] * schedule.gap[:, None]
    q = poses.q
    for _ in range(4):
        pose = forward(chain, q)
        q = q + _solve(pose.jacobian(), p_reference - pose.p_tcp)
    kept = ("q", "controller", "marker", "distance", "reading", "tcp", "unloaded", "link")
    collected: dict[str, list[Array]] = {k: [] for k in kept}
    shifted = schedule.stamp >= bumped
    state: State | None = None
    frees = np.isfinite(physics.plant.release)
    p_contact = np.zeros((N, 3))
    for j in range(rows):
        idle = conditions_at(schedule, j, base_in_cell, schedule.force[:, j])
        if state is None:
            if q_before is None:
                q_before = q
            step = q - q_before
            motor = motor_angles(sensing, q, step)
            state = plant.relaxed(motor, idle, arrived(q))
            state, frames = plant.equilibrium(motor, idle, state)
            p_contact = frames.p_tcp + frames.R_tool[:, :, 2] * schedule.gap[:, None]
            q_last, motor_last, loaded = q, motor, idle
            unloaded, without, frames_without = idle, state, frames
        else:
            before, force = loaded, schedule.force[:, j]
            give = np.stack([-force[:, 0] / DISC_TANGENTIAL, -force[:, 1] / DISC_TANGENTIAL, -force[:, 2] / DISC_NORMAL], axis=1)
            goal = p_contact + (R_command @ give[:, :, None])[..., 0]
            dt = schedule.stamp[:, j] - schedule.stamp[:, j - 1]
            begin = last = state
            frames_last = frames
            for _ in range(2):  # the contact moves by nanometres then, and each row is in equilibrium where it is
                motor = motor_angles(sensing, q, q - q_last)
                begin = plant.released(frames_last, motor_last, before, last, motor - motor_last) if frees else last
                in_base = (frames.R_tool @ force[:, :, None])[..., 0]
                loaded = replace(idle, force=in_base)
                state, frames = plant.equilibrium(motor, loaded, replace(begin, e=state.e), dt, tolerance=1e-9)
                q = q + _solve(forward(chain, q).jacobian(), goal - frames.p_tcp)
            step = q - q_last
            motor = motor_angles(sensing, q, step)
            begin = plant.released(frames_last, motor_last, before, last, motor - motor_last) if frees else last
            loaded = replace(loaded, force=(frames.R_tool @ force[:, :, None])[..., 0])
            state, frames = plant.equilibrium(motor, loaded, replace(begin, e=state.e), dt)
            if frees:
                without = plant.released(frames_without, motor_last, unloaded, without, motor - motor_last)
            unloaded = replace(conditions_at(schedule, j, base_in_cell, np.zeros((N, 3))), process_on=np.zeros(N, dtype=bool))
            without, frames_without = plant.equilibrium(motor, unloaded, without, dt)
            q_last, motor_last = q, motor
        controller = forward(chain, q)
        drifted = frames.p_tcp + drift_at(sensing, schedule.stamp[:, j], schedule.ambient[:, j])
        p_marker = drifted + (frames.R_tool @ (cell.marker_in_tool0 + sensing.marker_error)[:, None])[..., 0]
        measured, distance = np.empty((N, 3)), np.empty(N)
        for s, (_, p_station, R_station) in enumerate(cell.stations):
            by = schedule.station == s
            in_cell = p_marker[by] + base_in_cell[by]
            measured[by] = tracker_reading(sensing, in_cell, s, p_station, R_station, shifted[by, j])
            distance[by] = np.linalg.norm(in_cell - p_station, axis=1)
        reading = force_reading(
            sensing, cell.sensor_axis, schedule.force[:, j], frames.R_tool, schedule.before(j), schedule.ambient[:, j]
        )
        collected["q"].append(q)
        collected["controller"].append(controller.p_tcp)
        collected["marker"].append(measured)
        collected["distance"].append(distance)
        collected["reading"].append(reading)
        collected["link"].append(motor + state.e[:, plant.axial])
        early = beyond_reported(sensing, controller.jacobian(), step)
        collected["tcp"].append(frames.p_tcp - early)
        collected["unloaded"].append(frames_without.p_tcp - early)
    stacked = {k: np.stack(v, axis=1) for k, v in collected.items()}
    return Rows(
        stacked["q"], stacked["controller"], stacked["marker"], stacked["distance"], stacked["reading"], schedule.force,
        stacked["tcp"], stacked["unloaded"], schedule.station, shifted, q if q_before is None else q_before,
        stacked["link"],
    )  # fmt: skip


def arrived(q: Array) -> Array:
    """Direction from which the joints came to each pose, in the order of the run, -1 .. 1, (N, joints)."""
    return np.tanh(np.diff(q, axis=0, prepend=q[:1]) / 0.05)


def conditions_at(schedule: Schedule, j: int, base_in_cell: Array, force_in_tool: Array) -> Conditions:
    """What acts on the arm in row j of every pose but for the process force in base_link; force_in_tool (N, 3) is for causes
    outside the catalogue that follow it."""
    N = len(force_in_tool)
    known = {f"force_{a}": force_in_tool[:, i] for i, a in enumerate("xyz")}
    known |= {"side": np.linalg.norm(force_in_tool[:, :2], axis=1)}
    known |= {"stamp": schedule.stamp[:, j], "ext_rail": schedule.poses.rail}
    known |= {"temp_ambient": schedule.ambient[:, j], "lag_ambient": schedule.lagged[:, j, 0]}
    for k in range(schedule.gears.shape[2]):
        known |= {f"temp_gear_{k + 1}": schedule.gears[:, j, k], f"lag_gear_{k + 1}": schedule.lagged[:, j, k + 1]}
    return Conditions(
        np.zeros((N, 3)), schedule.poses.rail, schedule.gears[:, j], np.full(N, j > 0), base_in_cell, known
    )  # fmt: skip


def bump(schedule: Schedule, sensing: SensingParameters) -> float:
    """The moment at which the station is bumped, s: in the midst of a pose that it sees, where it can be noticed; inf: never."""
    rows = schedule.stamp.shape[1]
    seen = np.flatnonzero(schedule.station == sensing.shift_station)
    place = sensing.shift_share * len(seen)
    if int(place) >= len(seen):
        return np.inf
    row = 1 + int((place - int(place)) * (rows - 1))
    return float(schedule.stamp[seen[int(place)], row])


def _solve(jacobian: Array, dp: Array) -> Array:
    """Joint step that moves the TCP by dp (n, 3) and keeps its orientation."""
    twist = np.concatenate([dp, np.zeros_like(dp)], axis=1)
    return np.linalg.solve(jacobian, twist[:, :, None])[..., 0]
