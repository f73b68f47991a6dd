# SPDX-License-Identifier: Apache-2.0
"""Whether weights of a session can be: masses of links, payload, and the direction of gravity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import nnls

from ..robot.kinematics import Kinematics, cross_matrices
from ..robot.ratings import rated_torque, rating_known
from ..typing import Array
from .data import Session
from .plausible_load import marker_as_believed
from .registration import registered

G = 9.81  # m/s^2
LARGEST_PAYLOAD, FARTHEST_COM = 5000.0, 5.0  # kg, m
LARGEST_LINK = 1e5  # kg
DENSEST = 5000.0  # kg/m^3 of a block as long, wide and high as the arm reaches; arms have up to 300
PAYLOAD_NOTE, PAYLOAD_MOST = 1.0, 5.0  # of the mass of the arm; arms carry up to a half of theirs
PAYLOAD_ALONE, PAYLOAD_KG = 20.0, 500.0  # of the mass of the arm, and kg, where no torque limit is known
TORQUE_NOTE, TORQUE_MOST = 1.5, 10.0  # of the rated torque, that the payload alone asks for (median)
ROWS = 300  # that tell the direction of gravity
BETTER = 0.7  # misfit (sum of squares) with gravity in another direction over that with the stated one
LIKELIHOOD = 60.0  # and half the change of its logarithm times the number of equations
SHARE = 0.05  # of the misfit without springs that gravity in the other direction explains
CLIP = 4.0  # median residuals beyond which a row counts less


def weights(session: Session) -> tuple[list[str], list[str]]:
    """Masses of links and payload against what arms are: doubts and notes."""
    found: list[str] = []
    notes: list[str] = []
    masses, reach = session.robot.moved_masses, session.robot.reach
    arm, most = float(masses.sum()), DENSEST * session.robot.reach**3
    k = int(masses.argmax())
    if masses[k] > LARGEST_LINK or arm > most:
        found.append(
            f"robot.urdf: joint_{k + 1} moves a link of {masses[k]:.4g} kg, all links weigh {arm:.4g} kg at a reach of "
            f"{reach:.3g} m; at most {LARGEST_LINK:.3g} and {most:.3g} kg are expected (g for kg?)"
        )
    payload = session.payload
    if payload is None:
        return found, notes
    com = float(np.linalg.norm(payload.com))
    if payload.mass > LARGEST_PAYLOAD:
        found.append(f"payload: mass is {payload.mass:g} kg, more than {LARGEST_PAYLOAD:g} kg (g for kg?)")
    if com > FARTHEST_COM:
        found.append(f"payload: com is {com:.4g} m from tool0, more than {FARTHEST_COM:g} m (mm for m?)")
    if found or session.kind != "absolute" or payload.mass <= 0.0:
        return found, notes
    share, joint = _torque_share(session)
    said = f"payload: mass is {payload.mass:g} kg on an arm of {arm:.4g} kg"
    if share > 0.0:
        said += f", and asks of joint_{joint + 1} {share:.3g} times its torque limit (median)"
    # where no torque limit is stated the masses of the links alone are what a payload is held against, and they may be filled in
    alike = len(np.unique(masses[masses > 0.0])) < 3
    absurd = share > TORQUE_MOST if share > 0.0 else payload.mass > max(PAYLOAD_ALONE * arm, PAYLOAD_KG) and not alike
    if arm > 0.0 and payload.mass > PAYLOAD_MOST * arm and absurd:
        found.append(f"{said}; at most {PAYLOAD_MOST:g} times the arm is expected (g for kg?)")
    elif (arm > 0.0 and payload.mass > PAYLOAD_NOTE * arm) or share > TORQUE_NOTE:
        notes.append(f"{said}; robots carry less: is its mass in kg?")
    return found, notes


def _torque_share(session: Session) -> tuple[float, int]:
    """Torque of the payload's weight over the torque limit, median over rows, at the joint where it is largest; that joint."""
    robot = session.robot
    known = rating_known(robot) & ~robot.is_prismatic
    rows = np.unique(np.linspace(0, len(session) - 1, min(len(session), ROWS)).astype(int))
    if session.payload is None or not known.any():
        return 0.0, 0
    kin = robot.kinematics(session.q[rows])
    at = kin.p_tcp + np.einsum("nij,j->ni", kin.R_tool, np.array(session.payload.com))
    weight = session.payload.mass * np.array(session.gravity_in_base)
    torque = np.einsum("nik,i->nk", kin.jacobian(at), weight)
    share = np.where(known, np.median(np.abs(torque), axis=0) / rated_torque(robot), 0.0)
    return float(share.max()), int(share.argmax())


def gravity_elsewhere(session: Session) -> Iterator[str]:
    """A note where springs under gravity explain an absolute session far better if gravity has another direction.

    Geometry of every axis, stations and markers are free, so that only what goes with the torque of gravity counts, and springs
    give way along it: with gravity turned round they would have to stiffen.
    """
    rows = np.flatnonzero(session.marker_seen & session.on_tool)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), ROWS)).astype(int))] if len(rows) else rows
    g = np.array(session.gravity_in_base)
    if not len(rows) or not np.any(g):
        return
    some = session.select(rows)
    kin = some.robot.kinematics(some.q)
    placed = registered(some, kin)
    R = np.stack([s.R_in_base for s in placed.stations])[placed.station]
    t = np.array([s.xyz for s in placed.stations])[placed.station]
    believed = marker_as_believed(placed)
    residual = np.einsum("nij,nj->ni", R, placed.p_marker_in_station) + t - believed
    J = kin.jacobian(believed)
    free = np.concatenate([_geometry(kin, believed), _places(placed, kin, believed)], axis=2)
    if 2 * free.shape[2] > 3 * len(rows):  # many markers of few readings
        return
    free = free / np.maximum(np.linalg.norm(free, axis=(0, 1)), 1e-12)
    torque_by = [some.robot.gravity_torque(some.q, tuple(e), some.payload) for e in np.eye(3)]
    full = np.concatenate([free, *(J * torque[:, None, :] * 1e-6 for torque in torque_by)], axis=2)
    weight = _weights(residual, full)
    U = _basis((free * weight[:, None, None]).reshape(-1, free.shape[2]))
    b = (residual * weight[:, None]).ravel()
    b = b - U @ (U.T @ b)
    without = float(b @ b)

    def left(direction: Array) -> float:
        torque = sum(float(d) * by for d, by in zip(direction, torque_by, strict=True))
        springs = (J * np.asarray(torque)[:, None, :] * weight[:, None, None]).reshape(-1, J.shape[2])
        springs = springs - U @ (U.T @ springs)
        size = np.linalg.norm(springs, axis=0)
        kept = size > 1e-9 * max(float(size.max()), 1e-30)
        return float(nnls(springs[:, kept] / size[kept], b)[1] ** 2) if kept.any() else without

    stated = left(g)
    size = float(np.linalg.norm(g))
    others = {name: size * np.array(e, dtype=float) for name, e in _DIRECTIONS.items()}
    others = {name: v for name, v in others.items() if np.dot(v, g) < 0.9 * size * size}
    found = {name: left(v) for name, v in others.items()}
    best = min(found, key=lambda k: found[k])
    n = len(b) - U.shape[1]
    gain = 0.5 * n * np.log(max(stated, 1e-30) / max(found[best], 1e-30))
    if found[best] < BETTER * stated and gain > LIKELIHOOD and without - found[best] > SHARE * without:
        x, y, z = others[best]
        yield (
            f"joints give way as if gravity were ({x:.4g}, {y:.4g}, {z:.4g}) in base_link ({best}), stated or default is "
            f"({g[0]:.4g}, {g[1]:.4g}, {g[2]:.4g}): what springs leave falls to {100 * found[best] / stated:.0f} %; does the "
            "robot hang? gravity: in session.yaml"
        )


_DIRECTIONS = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "upward": (0, 0, 1), "downward": (0, 0, -1),
}  # fmt: skip


def _geometry(kin: Kinematics, believed: Array) -> Array:
    """Columns of the marker, (n, 3, 6 k), for small turns and shifts of each joint's frame."""
    shifts = np.swapaxes(kin.R_joint, 1, 2).reshape(len(believed), 3, -1)
    return np.concatenate([kin.jacobian(believed), kin.virtual_jacobian(believed), shifts], axis=2)


def _places(placed: Session, kin: Kinematics, believed: Array) -> Array:
    """Columns of the marker, (n, 3, 6 per station and 3 per marker), for small turns and shifts of these."""
    out = []
    turn = cross_matrices(believed)
    for s in range(len(placed.stations)):
        mine = (placed.station == s)[:, None, None]
        out += [turn * mine, np.broadcast_to(np.eye(3), turn.shape) * mine]
    for m in range(len(placed.markers)):
        out.append(kin.R_tool * (placed.marker == m)[:, None, None])
    return np.concatenate(out, axis=2)


def _weights(residual: Array, columns: Array) -> Array:
    """Root weights of rows, (n,), by what the columns leave of them: rows with a mistake of their own do not count."""
    weight = np.ones(len(residual))
    for _ in range(3):
        A = (columns * weight[:, None, None]).reshape(-1, columns.shape[2])
        U = _basis(A)
        b = (residual * weight[:, None]).ravel()
        left = np.linalg.norm((b - U @ (U.T @ b)).reshape(-1, 3), axis=1) / np.maximum(weight, 1e-9)
        weight = np.minimum(1.0, CLIP * float(np.median(left)) / np.maximum(left, 1e-30))
    return weight


def _basis(A: Array) -> Array:
    """Orthonormal basis of what the columns span."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s[0]])
