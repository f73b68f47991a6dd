# SPDX-License-Identifier: Apache-2.0
"""Engagement poses for generated sessions: spread over the tooling, reachable, away from limits and singularities."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .cellfile import CellFile
from .errors import SimError
from .files import read_yaml
from .kinematics import Array, forward, inverse

_JOINT_MARGIN = 0.05  # rad
_SINGULARITY = 0.06  # smallest singular value of the Jacobian, unit of length 1 m
_TORQUE_SHARE = 0.8


@dataclass(frozen=True)
class Poses:
    """Engagements: q (n, 6) with the nominal TCP on the surface; rail (n,) m; p, R of tool0 in base_link."""

    q: Array
    rail: Array
    p: Array
    R: Array


def tool_frames(normal: Array, turn: Array) -> Array:
    """tool0 pressed on a surface: z against the outward normal, x down and towards the robot, turned about z by `turn`."""
    z = -normal
    x = np.array([-0.7, 0.0, -0.714]) - z * (z @ np.array([-0.7, 0.0, -0.714]))[:, None]
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(z, x)
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    return np.stack([c * x + s * y, c * y - s * x, z], axis=2)


def _good(cell: CellFile, q: Array, R: Array) -> NDArray[np.bool_]:
    pose = forward(cell.chain, q)
    J = pose.jacobian()
    force = np.einsum("nij,kj->nki", R, cell.load_cases)
    process = np.einsum("nij,nki->nkj", J[:, :3], force)
    moment_arm = cell.chain.tool_mass * 9.81 * np.abs(J[:, 2]) + np.abs(process).max(axis=1)
    chain = cell.chain
    conditions = np.stack(
        [
            (q > chain.lower + _JOINT_MARGIN).all(axis=1),
            (q < chain.upper - _JOINT_MARGIN).all(axis=1),
            np.linalg.svd(J, compute_uv=False)[:, -1] > _SINGULARITY,
            np.abs(q[:, 3]) < 2.6,
            np.abs(q[:, 5]) < 3.1,
            (moment_arm[:, 3:] < _TORQUE_SHARE * chain.effort[3:]).all(axis=1),
        ]
    )
    return np.asarray(conditions.all(axis=0))


def spread_poses(cell: CellFile, n: int, rng: np.random.Generator, margin: float = 0.06) -> Poses:
    """n poses spread over the surface of a cell, in random order.

    Raises:
        SimError: too few good poses found; the cell's surface is out of reach.
    """
    found: list[tuple[Array, Array, Array, Array]] = []
    count = 0
    wanted = max(3 * n, n + 30)
    for _ in range(12):
        p, normal = cell.surface.sample(max(2 * wanted, 60), margin, rng)
        m = len(p)
        rail = np.zeros(m)
        if cell.rail is not None:
            axis, (low, high) = cell.rail
            rail = np.clip(p @ axis + rng.uniform(-0.6, 0.6, m), low, high)
            p = p - rail[:, None] * axis
        R = tool_frames(normal, rng.uniform(-0.7, 0.7, m))
        start = np.tile(cell.home, (m, 1))
        start[:, 0] = -np.arctan2(p[:, 1], p[:, 0])
        start += rng.normal(0.0, 0.1, start.shape)
        start[:, 3] += rng.choice([-0.6, 0.0, 0.6], m)
        q, reached = inverse(cell.chain, p, R, start, iterations=40)
        ok = reached & _good(cell, q, R)
        found.append((q[ok], rail[ok], p[ok], R[ok]))
        count += int(ok.sum())
        if count >= wanted:
            break
    if count < n:
        raise SimError(f"{cell.path}: only {count} of {n} poses found that are reachable, away from singularities and limits")
    q, rail, p, R = (np.concatenate(x) for x in zip(*found, strict=True))
    at = p + (rail[:, None] * cell.rail[0] if cell.rail is not None else 0.0)
    chosen = [int(rng.integers(len(at)))]
    distance = np.linalg.norm(at - at[chosen[0]], axis=1)
    for _ in range(n - 1):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(at - at[chosen[-1]], axis=1))
    order = rng.permutation(chosen)
    return Poses(q[order], rail[order], p[order], R[order])


def poses_of_file(path: str | Path, cell: CellFile) -> Poses:
    """The engagements of a pose file (irec-poses/1), in its order.

    Raises:
        SimError: not a pose file, or of another robot.
    """
    data = read_yaml(path, "pose file")
    poses = data.get("poses") if isinstance(data, dict) and data.get("format") == "irec-poses/1" else None
    if not isinstance(poses, list) or not poses:
        raise SimError(f"{path}: is no pose file: format has to be 'irec-poses/1', and poses a list of one or more")
    if (data.get("robot") or {}).get("serial", cell.serial) != cell.serial:
        raise SimError(f"{path}: planned for robot {data['robot']['serial']!r}, {cell.path} has {cell.serial!r}")
    try:
        q = np.array([p["joints"] for p in poses], dtype=float)
        rail = np.array([(p.get("ext") or {}).get("rail", 0.0) for p in poses], dtype=float)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SimError(f"{path}: a pose has no joint angles that can be read ({error})") from error
    if q.ndim != 2 or q.shape[1] != cell.chain.n or not (np.isfinite(q).all() and np.isfinite(rail).all()):
        raise SimError(f"{path}: each pose needs {cell.chain.n} joint angles in rad, and the rail in m")
    pose = forward(cell.chain, q)
    return Poses(q, rail, pose.p_tcp, pose.R_tool)
