# SPDX-License-Identifier: Apache-2.0
"""Commanded motion in position control: the way along a path over time, and the paths of the two kinds of move."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import SimError
from .kinematics import Chain, forward, inverse, rotation_of_vector, rotation_vector

Array = NDArray[np.float64]

RAMP = 0.25  # s, from standstill to full speed
KNOT = 5e-3  # m between the points of a straight line for which the joint angles are computed
TURN_KNOT = 0.01  # rad, the same for its turn


class Way:
    """Distance over time along a path of given length (any unit): smooth ramps and constant speed between.

    `stop` ends the motion on the path, with the same ramp.
    """

    def __init__(self, length: float, speed: float, ramp: float = RAMP) -> None:
        self.length = length
        self.ramp = ramp
        self.speed = min(speed, length / ramp) if length > 0 else 0.0
        self.duration = length / self.speed + ramp if self.speed > 0 else 0.0
        self._stopped_at: float | None = None

    def distance(self, t: float) -> float:
        """Way done at time t (s) since the start."""
        if self._stopped_at is None:
            return self._nominal(t)
        u = min(t - self._stopped_at, self.ramp)
        v = self._speed(self._stopped_at)
        gone = v * (u / 2 + self.ramp / (2 * math.pi) * math.sin(math.pi * u / self.ramp))
        return min(self._nominal(self._stopped_at) + gone, self.length)

    def done(self, t: float) -> bool:
        """Whether the motion has ended at time t."""
        end = self.duration if self._stopped_at is None else self._stopped_at + self.ramp
        return t >= min(end, self.duration)

    def stop(self, t: float) -> None:
        """Slow down from time t on."""
        if self._stopped_at is None:
            self._stopped_at = t

    def _nominal(self, t: float) -> float:
        if self.speed <= 0 or t >= self.duration:
            return self.length
        if t > self.duration - self.ramp:
            return self.length - self._ramp_way(self.duration - t)
        return self._ramp_way(t) if t < self.ramp else self.speed * (t - self.ramp / 2)

    def _ramp_way(self, t: float) -> float:
        return self.speed * (t / 2 - self.ramp / (2 * math.pi) * math.sin(math.pi * t / self.ramp))

    def _speed(self, t: float) -> float:
        u = min(t, self.duration - t, self.ramp)
        return self.speed * (1 - math.cos(math.pi * u / self.ramp)) / 2 if u > 0 else 0.0


@dataclass
class Move:
    """A move: joint angles (n,) rad and rail position m as functions of the way done; both at its start and end too."""

    way: Way
    at: Callable[[float], tuple[Array, float]]

    def fraction(self, t: float) -> float:
        """Share of the way done at time t (s) since the start."""
        return 1.0 if self.way.length <= 0 else self.way.distance(t) / self.way.length


def joint_move(chain: Chain, start: tuple[Array, float], goal: tuple[Array, float], share: float, rail_speed: float) -> Move:
    """Point to point in joint space, all axes at once.

    Args:
        start, goal: joint angles (n,), rad, and rail position, m.
        share: of the velocity limits, 0 < share <= 1.
        rail_speed: velocity limit of the rail, m/s.

    Raises:
        SimError: a goal beyond a joint limit.
    """
    outside = np.flatnonzero((goal[0] < chain.lower) | (goal[0] > chain.upper))
    if outside.size:
        k = int(outside[0])
        raise SimError(
            f"{chain.joint_names[k]} can't go to {goal[0][k]:.4f} rad: its limits are {chain.lower[k]:.4f} and "
            f"{chain.upper[k]:.4f} rad"
        )
    change, rail_change = goal[0] - start[0], goal[1] - start[1]
    time = max(float((np.abs(change) / chain.velocity).max()), abs(rail_change) / rail_speed) / share
    way = Way(time, 1.0)
    scale = 1.0 / time if time > 0 else 0.0
    return Move(way, lambda s: (start[0] + s * scale * change, start[1] + s * scale * rail_change))


def linear_move(chain: Chain, q: Array, rail: float, p_goal: Array, R_goal: Array, speed: float) -> Move:
    """Straight line of tool0 in base_link from joint angles q (n,) rad, the tool turning evenly; speed in m/s.

    Raises:
        SimError: part of the line can't be reached.
    """
    pose = forward(chain, q[None])
    p_start, R_start = pose.p_tcp[0], pose.R_tool[0]
    turn = rotation_vector(R_goal @ R_start.T)
    length = float(np.linalg.norm(p_goal - p_start))
    angle = float(np.linalg.norm(turn))
    knots = 4 + int(max(length / KNOT, angle / TURN_KNOT))
    share = np.linspace(0.0, 1.0, knots)
    p = p_start + share[:, None] * (p_goal - p_start)
    R = rotation_of_vector(share[:, None] * turn) @ R_start
    angles = [q]
    for k in range(1, knots):
        guess = angles[-1] if k == 1 else 2 * angles[-1] - angles[-2]
        found, reached = inverse(chain, p[k : k + 1], R[k : k + 1], guess[None])
        if not reached[0]:
            raise SimError(
                f"the line from {np.round(p_start, 3)} to {np.round(p_goal, 3)} m can't be followed beyond "
                f"{1e3 * share[k - 1] * length:.0f} mm: out of reach, singular or beyond a joint limit"
            )
        angles.append(found[0])
    equivalent = max(length, angle * 0.5)  # a pure turn runs as if its points were 0.5 m from the TCP
    return table_move(np.array(angles), rail, equivalent, speed)


def table_move(q: Array, rail: float, length: float, speed: float) -> Move:
    """Along joint angles q (k, n), k > 2, at equal steps of a path of given length (m), cubic between; speed in m/s."""
    last = len(q) - 1

    def at(s: float) -> tuple[Array, float]:
        x = last * (s / length if length > 0 else 1.0)
        k = min(int(x), last - 1)
        return _cubic(q, k, x - k), rail

    return Move(Way(length, speed), at)


def _cubic(table: Array, k: int, u: float) -> Array:
    """Catmull-Rom interpolation between rows k and k + 1; beyond its ends the table goes on as a cubic (3 rows: parabola)."""
    a, b, n = table[k], table[k + 1], len(table)
    if k > 0:
        before = table[k - 1]
    else:
        before = 4 * a - 6 * b + 4 * table[k + 2] - table[k + 3] if n > 3 else 3 * a - 3 * b + table[k + 2]
    if k + 2 < n:
        after = table[k + 2]
    else:
        after = 4 * b - 6 * a + 4 * table[k - 1] - table[k - 2] if n > 3 else 3 * b - 3 * a + table[k - 1]
    m0, m1 = (b - before) / 2, (after - a) / 2
    return a + u * (m0 + u * (3 * (b - a) - 2 * m0 - m1 + u * (2 * (a - b) + m0 + m1)))
