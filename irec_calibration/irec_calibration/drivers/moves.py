# SPDX-License-Identifier: Apache-2.0
"""Moves of the contract as joint positions over time, for robots that take nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..cell import Cell
from ..errors import IrecError
from ..poses.ik import Chain, solve_pose
from ..procedure.axes import Axes
from ..typing import Array

RAMP = 0.3  # s, from standstill to full speed
KNOT = 5e-3  # m, and TURN_KNOT rad, between the points of a straight line for which joint angles are computed
TURN_KNOT = 0.02
LARGEST_JUMP = 0.25  # rad between two points of a line; more is another branch of the arm, or a singularity
LARGEST_LINE = 20.0  # m
QUATERNION_TOLERANCE = 1e-3


class MoveError(IrecError):
    """A move that can't be carried out; nothing has moved."""


@dataclass
class Way:
    """Distance over time along a way of some length: smooth ramps, constant speed between; `stop` ends it on the way.

    Attributes:
        length: any unit. speed: units per second.
    """

    length: float
    speed: float
    _stopped: tuple[float, float, float] | None = None  # when, where, at what speed

    def __post_init__(self) -> None:
        self.speed = min(self.speed, self.length / RAMP) if self.length > 0.0 else 0.0

    @property
    def duration(self) -> float:
        """s, without a stop."""
        return self.length / self.speed + RAMP if self.speed > 0.0 else 0.0

    def at(self, t: float) -> float:
        """Way done at t s after the start."""
        if self._stopped is None:
            return self._nominal(t)
        since, where, speed = self._stopped
        u = min(max(t - since, 0.0), RAMP)
        return min(where + speed * (u - 0.5 * u * u / RAMP), self.length)

    def done(self, t: float) -> bool:
        """Whether it has ended at t."""
        end = self.duration if self._stopped is None else min(self._stopped[0] + RAMP, self.duration)
        return t >= end

    def stop(self, t: float) -> None:
        """Slow down from t on."""
        if self._stopped is None:
            h = 1e-4
            self._stopped = (t, self._nominal(t), (self._nominal(t + h) - self._nominal(t)) / h)

    def _nominal(self, t: float) -> float:
        if self.speed <= 0.0 or t >= self.duration:
            return self.length
        if t > self.duration - RAMP:
            return self.length - self._ramp(self.duration - t)
        return self._ramp(t) if t < RAMP else self.speed * (t - 0.5 * RAMP)

    def _ramp(self, t: float) -> float:
        return self.speed * (0.5 * t - RAMP / (2.0 * math.pi) * math.sin(math.pi * t / RAMP))


@dataclass
class Motion:
    """Positions of all axes (n, k) at distances (n,) along a way."""

    way: Way
    knots: Array
    positions: Array

    def at(self, t: float) -> Array:
        """Positions of all axes (k,), rad and m, t s after the start."""
        s = self.way.at(t)
        return np.array([np.interp(s, self.knots, column) for column in self.positions.T])

    def fraction(self, t: float) -> float:
        """Share of the way done."""
        return 1.0 if self.way.length <= 0.0 else self.way.at(t) / self.way.length


class Planner:
    """Moves of one cell; positions are those of `axes`: joints in the order of the description, then the rail."""

    def __init__(self, cell: Cell, axes: Axes, rail_speed: float) -> None:
        """rail_speed: m/s."""
        self._cell, self.axes = cell, axes
        self.chain = Chain.of(cell.robot)
        self.n = cell.robot.n_joints
        velocity = np.where(np.isfinite(cell.robot.velocity) & (cell.robot.velocity > 0.0), cell.robot.velocity, 1.0)
        self.velocity = np.array([*velocity, rail_speed])[: len(axes.driver)]

    def joint(self, start: Array, wanted: Mapping[str, float], speed: float) -> Motion:
        """Point to point, all axes at once; start (k,). speed: share of the velocity limits. MoveError."""
        if not 0.0 < speed <= 1.0:
            raise MoveError(f"speed of a joint move is {speed}, a share of the velocity limits in (0, 1] is needed")
        goal = start.copy()
        for name, value in wanted.items():
            if name not in self.axes.driver:
                raise MoveError(f"joint '{name}' is not known; this robot has {', '.join(self.axes.driver)}")
            if not math.isfinite(value):
                raise MoveError(f"position of {name} is {value}, a finite number is needed")
            goal[self.axes.driver.index(name)] = value
        self.refuse_beyond_limits(goal)
        length = float(np.max(np.abs(goal - start) / self.velocity))  # s at full speed
        return Motion(Way(length, speed), np.array([0.0, max(length, 1e-9)]), np.array([start, goal]))

    def linear(self, start: Array, p: Array, quat_xyzw: Sequence[float], speed: float) -> Motion:
        """tool0 along a straight line in base_link, turning evenly; the rail stands.

        Args:
            start: (k,). p: goal, (3,), m. quat_xyzw: of tool0 into base_link. speed: m/s.

        Raises:
            MoveError: no pose, out of reach, beyond a limit, through a singularity.
        """
        if not (speed > 0.0 and math.isfinite(speed)):
            raise MoveError(f"speed of a linear move is {speed}, a positive number in m/s is needed")
        quat = np.asarray(quat_xyzw, dtype=float)
        if not np.isfinite(p).all() or not abs(np.linalg.norm(quat) - 1.0) <= QUATERNION_TOLERANCE:
            raise MoveError(f"pose {p}, {quat} is no pose: finite numbers and a unit quaternion are needed")
        p0, R0, _ = self.chain.forward(start[None, : self.n])
        turn = Rotation.from_matrix([R0[0], Rotation.from_quat(quat).as_matrix()])
        angle = float((turn[0].inv() * turn[1]).magnitude())
        length = float(np.linalg.norm(p - p0[0]))
        if length > LARGEST_LINE:
            raise MoveError(f"the line is {length:.3g} m long, limit {LARGEST_LINE:g} m")
        n = 2 + int(max(length / KNOT, angle / TURN_KNOT))
        share = np.linspace(0.0, 1.0, n)
        rotations = Slerp([0.0, 1.0], turn)(share).as_matrix()
        q = np.empty((n, self.n))
        q[0] = start[: self.n]
        for k in range(1, n):
            goal = p0[0] + share[k] * (p - p0[0])
            solved, ok = solve_pose(self.chain, goal[None], rotations[k][None], q[k - 1][None])
            if not ok[0] or np.abs(solved[0] - q[k - 1]).max() > LARGEST_JUMP:
                raise MoveError(f"the line can't be driven: out of reach or singular after {100 * share[k]:.0f} % of the way")
            q[k] = solved[0]
            self.refuse_beyond_limits(q[k])
        positions = np.hstack([q, np.tile(start[self.n :], (n, 1))])
        extent = max(length, 0.1 * angle, 1e-9)  # a turn in place goes as fast as at a lever of 0.1 m
        slowest = float(np.max(np.abs(np.diff(positions, axis=0)) / self.velocity)) * (n - 1)  # s for the whole way at the limits
        return Motion(Way(extent, min(speed, extent / max(slowest, 1e-9))), share * extent, positions)

    def refuse_beyond_limits(self, positions: Array) -> None:
        """MoveError where an axis would be beyond its limit."""
        for name, value, low, high in zip(self.axes.driver, positions, self.axes.lower, self.axes.upper, strict=False):
            if not low <= value <= high:
                raise MoveError(f"{name} would be at {value:.4g}, its limits are {low:.4g} and {high:.4g}")
