# SPDX-License-Identifier: Apache-2.0
"""Mass, centre of mass and bias behind a force sensor, from readings in several orientations without contact.

The sensor reads, in its own frame, force = b_f + A R^T m g and torque = b_t + c x (R^T m g) with A a small rotation (the
sensor turned against where the robot description puts it), R the sensor's rotation in base_link and g the acceleration of
free fall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ..errors import SolveError
from ..typing import Array

G = (0.0, 0.0, -9.81)
MIN_SPREAD = 0.15  # smallest singular value of the directions of gravity over sqrt(n); below it a bias can't be told from weight
MIN_ORIENTATIONS = 4
MIN_READINGS = 20  # in one standing time


@dataclass(frozen=True)
class ToolLoad:
    """What a force sensor reads without contact.

    Attributes:
        mass: kg. com: centre of mass in the sensor frame, m.
        bias_force, bias_torque: reading without any load, N and N m.
        alignment: rotation vector from the stated sensor frame to the true one, rad.
    """

    mass: float = 0.0
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bias_force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bias_torque: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alignment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _A: Array = field(init=False, repr=False, compare=False)
    _bias: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_A", Rotation.from_rotvec(self.alignment).as_matrix().T)
        object.__setattr__(self, "_bias", np.array([*self.bias_force, *self.bias_torque]))

    def reading(self, R_sensor_in_base: Array, gravity_in_base: Array) -> Array:
        """What the sensor shows in one orientation (3, 3), (6,), N and N m; gravity_in_base (3,), m/s^2."""
        fx, fy, fz = weight = self.mass * (self._A @ (R_sensor_in_base.T @ gravity_in_base))
        cx, cy, cz = self.com
        out = np.array([*weight, cy * fz - cz * fy, cz * fx - cx * fz, cx * fy - cy * fx])
        out += self._bias
        return out

    def aligned(self, wrench: Array) -> Array:
        """A wrench (6,) as the true sensor shows it, in the sensor frame of the robot description."""
        return np.concatenate([self._A.T @ wrench[:3], self._A.T @ wrench[3:]])


@dataclass(frozen=True)
class ToolLoadFit:
    """A tool load with what is known about it.

    Attributes:
        se: standard error of each number, same names as in `load` (each a float or a tuple).
        residual_force, residual_torque: RMS per axis, N and N m.
        worst: index of the orientation that fits worst, and its force residual, N: a contact or a hose that pulls shows here.
        spread: how evenly the orientations turn gravity in the sensor, 0 .. 0.58 (1/sqrt(3)).
        orientations: number of them.
    """

    load: ToolLoad
    se: dict[str, float | tuple[float, ...]]
    residual_force: float
    residual_torque: float
    worst: tuple[int, float]
    spread: float
    orientations: int


def identify_tool_load(
    readings: Array, R_sensor_in_base: Array, gravity_in_base: tuple[float, float, float] = G, alignment: bool = False
) -> ToolLoadFit:
    """Least squares over readings that stand still without contact.

    Args:
        readings: one averaged reading per orientation, (n, 6), N and N m, sensor frame.
        R_sensor_in_base: (n, 3, 3).
        gravity_in_base: m/s^2.
        alignment: also ask how the sensor is turned against the robot description. Weight alone shows it only where
            gravity comes from several sides.

    Raises:
        SolveError: too few orientations, or too much alike; says what to add.
    """
    readings, R = np.asarray(readings, dtype=float), np.asarray(R_sensor_in_base, dtype=float)
    n = len(readings)
    needed = MIN_ORIENTATIONS + (1 if alignment else 0)
    if n < needed:
        raise SolveError(
            f"{n} orientations without contact; at least {needed} are needed, better 8, with the tool turned to all sides"
        )
    g = np.einsum("nji,j->ni", R, np.asarray(gravity_in_base, dtype=float))
    directions = g / np.linalg.norm(gravity_in_base)
    spread = float(np.linalg.svd(directions - directions.mean(axis=0), compute_uv=False)[-1] / math.sqrt(n))
    if spread < MIN_SPREAD:
        raise SolveError(
            f"the orientations are too much alike: spread {spread:.3f}, at least {MIN_SPREAD} is needed; add orientations "
            "that tilt the"
            " tool about two axes by 60 degrees and more"
        )
    force, torque = readings[:, :3], readings[:, 3:]
    scale_f, scale_t = _weights(force, torque, g)

    def residual(x: Array) -> Array:
        m, first, b_f, b_t, turn = x[0], x[1:4], x[4:7], x[7:10], x[10:]
        weight_per_mass = g @ Rotation.from_rotvec(turn).as_matrix() if alignment else g
        r_f = b_f + m * weight_per_mass - force
        r_t = b_t + np.cross(first, weight_per_mass) - torque
        return np.concatenate([(r_f / scale_f).ravel(), (r_t / scale_t).ravel()])

    start = np.zeros(13 if alignment else 10)
    start[0] = 1.0
    fit = least_squares(residual, start, x_scale="jac")
    r = residual(fit.x)
    n_f = 3 * n
    dof_f, dof_t = max(n_f - 4.0, 1.0), max(n_f - 6.0, 1.0)
    # each kind of equation has its own noise: estimate both, then weigh again
    scale_f, scale_t = (
        scale_f * max(math.sqrt(float(r[:n_f] @ r[:n_f]) / dof_f), 1e-12),
        scale_t * max(math.sqrt(float(r[n_f:] @ r[n_f:]) / dof_t), 1e-12),
    )
    fit = least_squares(residual, fit.x, x_scale="jac")
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    x, m = fit.x, float(fit.x[0])
    if not m > 0.0:
        raise SolveError(f"the readings give a tool mass of {m:.3f} kg: sign or frame of the wrench is not what was stated")
    by_com = np.zeros((3, len(x)))
    by_com[:, 0], by_com[:, 1:4] = -x[1:4] / m**2, np.eye(3) / m
    se = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    se_com = np.sqrt(np.maximum(np.diag(by_com @ covariance @ by_com.T), 0.0))
    r = residual(x)
    load = ToolLoad(m, _three(x[1:4] / m), _three(x[4:7]), _three(x[7:10]), _three(x[10:]) if alignment else (0.0, 0.0, 0.0))
    errors: dict[str, float | tuple[float, ...]] = {
        "mass": float(se[0]), "com": _three(se_com), "bias_force": _three(se[4:7]), "bias_torque": _three(se[7:10]),
    }  # fmt: skip
    if alignment:
        errors["alignment"] = _three(se[10:])
    by_force, by_torque = r[:n_f].reshape(n, 3) * scale_f, r[n_f:].reshape(n, 3) * scale_t
    worst = int(np.argmax(np.linalg.norm(by_force, axis=1)))
    return ToolLoadFit(
        load=load,
        se=errors,
        residual_force=float(np.sqrt(np.mean(by_force**2))),
        residual_torque=float(np.sqrt(np.mean(by_torque**2))),
        worst=(worst, float(np.linalg.norm(by_force[worst]))),
        spread=spread,
        orientations=n,
    )


@dataclass(frozen=True)
class Standing:
    """Means over the times at which the robot stood still: joint angles (s, k), rad, and readings (s, 6), N and N m."""

    q: Array
    readings: Array


def standing(
    q_stamp: Array, q: Array, wrench_stamp: Array, wrench: Array, shortest: float = 0.5, settle: float = 0.3, still: float = 5e-4
) -> Standing:
    """Find where the robot stands still and average the readings there.

    Args:
        q_stamp (n,), s, q (n, k), rad; wrench_stamp (m,), s, wrench (m, 6): as recorded, in the order of time.
        shortest: s of standing that counts. settle: s left out at its beginning. still: rad that a joint may differ from where it
            stood first.
    """
    begin, spans = 0, []
    for i in range(1, len(q_stamp) + 1):
        moved = i == len(q_stamp) or bool(np.any(np.abs(q[i] - q[begin]) > still))
        if moved:
            if q_stamp[i - 1] - q_stamp[begin] >= shortest + settle:
                spans.append((begin, i))
            begin = i
    means_q, means_w = [], []
    for first, end in spans:
        inside = (wrench_stamp >= q_stamp[first] + settle) & (wrench_stamp <= q_stamp[end - 1])
        if np.count_nonzero(inside) >= MIN_READINGS:
            means_q.append(q[first:end].mean(axis=0))
            means_w.append(wrench[inside].mean(axis=0))
    k = q.shape[1]
    return Standing(np.array(means_q).reshape(-1, k), np.array(means_w).reshape(-1, 6))


def _weights(force: Array, torque: Array, g: Array) -> tuple[float, float]:
    """Starting scales of both kinds of equation: how much the readings vary at all."""
    return max(float(force.std()), 1e-6), max(float(torque.std()), 1e-6)


def _three(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(a) for a in v)
    return x, y, z
