# SPDX-License-Identifier: Apache-2.0
"""Whether a step that one pose of a loaded session shows lasts.

A station that was bumped moves every later reading; a knocked reference reading moves none, and a reflector that was seated anew
turns with the tool. Differences to the reference hide this, absolute readings do not: what they have beyond the controller's
positions is a smooth function of the joint angles (station, marker, geometry), and a step in time beside it if there is one.
"""

from __future__ import annotations

import numpy as np

from ..identification.observe import beyond_controller
from ..model import Term, total_displacement, whole_sag_of
from ..typing import Array, IntArray
from .scatter import Scattered
from .settings import SETTINGS
from .study import Study

LASTING = SETTINGS.lasting
TIMES, NEXT = 6, 2  # other times at which a step is tried; readings next to it that a smooth function may make up for
POSE_LEVELS = np.array([0.0, 1.0 / 3.0, 1.0, 3.0])  # multiples of `pose_m`


def lasts(study: Study, shift: Term) -> float:
    """Log odds that the poses after a step carry it in base_link, over that they do not or that it turns with the tool.

    Args:
        study: a model of a loaded session with the step in it.
        shift: that step: parameters d_x, d_y, d_z (m) and t_shift (s).

    Returns:
        natural log; 0 where too few poses stand before or after it.
    """
    scene, session = study.observation.scene, study.session
    value = {n: e.value for n, e in shift.estimates.items()}
    d, moment = np.array([value[f"d_{a}"] for a in "xyz"]), value["t_shift"]
    seen = beyond_controller(session, scene)
    seen = seen - total_displacement([t for t in study.terms if t.effect.id != shift.effect.id], scene)
    rows, mean, begin, end = _blocks(session.pose, session.repeat, session.stamp, seen)
    broken = (begin <= moment) & (end > moment)
    if not broken.any():
        return 0.0
    here = int(rows[np.flatnonzero(broken)[0]])
    used = ~broken & (session.station[rows] == session.station[here]) & np.isfinite(mean).all(axis=1)
    after = (begin > moment)[used]
    if min(after.sum(), (~after).sum()) < LASTING.fewest:
        return 0.0
    rows, mean = rows[used], mean[used]
    R = scene.kin.R_tool
    in_base = after[:, None] * d
    with_tool = after[:, None] * (R[rows] @ (R[here].T @ d))
    # the station may stand anywhere, in metres, and be turned, and the marker sit elsewhere: causes that may have no name yet
    anywhere, turned = np.tile(np.eye(3), (len(rows), 1, 1)), LASTING.turned_rad * _all_turn(scene.p_observed[rows])
    plain = np.concatenate([anywhere, turned, LASTING.elsewhere_m * R[rows], usually_beyond(study, rows)], axis=2)
    drifts = LASTING.drifts_m * _course(study, rows)[:, :, None, None] * np.eye(3)
    drifting = np.concatenate([plain, *np.moveaxis(drifts, 1, 0)], axis=2)
    again = _same_pose(session.pose[rows])
    grounds = _beside_poses((plain, drifting), again)  # either likely beforehand
    once, turns = (_log_evidence(mean - step, grounds) for step in (0.0 * in_base, with_tool))
    # a station that is bumped tilts, too: about where it was bumped, of which the step itself knows nothing
    tilts = LASTING.tilt_rad * _all_turn(scene.p_observed[rows] - scene.p_observed[here])

    def carried(late: Array) -> float:
        """Log evidence of a step, straight or with a tilt, that the readings marked by 1 have, (rows,)."""
        left = mean - late[:, None] * d
        tilted = tuple(np.concatenate([g, late[:, None, None] * tilts], axis=2) for g in (plain, drifting))
        return float(np.logaddexp(_log_evidence(left, grounds), _log_evidence(left, _beside_poses(tilted, again))) - np.log(2.0))

    mine, others = carried(after.astype(float)), max(once, turns)
    for late in _later(begin[used], moment):
        if mine <= others:
            break
        others = max(others, carried(late))
    return mine - others


def _later(begin: Array, moment: float) -> list[Array]:
    """Which readings would have a step that came at other times, 1 or 0, (rows,) each.

    What smooth functions do not fit of absolute readings may look like a step anywhere; a true one is likeliest in its time.
    """
    order = np.sort(begin)
    between = 0.5 * (order[1:] + order[:-1])
    mine = int(np.searchsorted(order, moment)) - 1  # of `between`
    there = np.array([i for i in range(len(between)) if abs(i - mine) > NEXT], dtype=int)
    some = there[np.unique(np.linspace(0, len(there) - 1, min(TIMES, len(there))).astype(int))] if len(there) else there
    return [(begin > between[i]).astype(float) for i in some]


def _same_pose(pose: IntArray) -> Array:
    """A place of each pose by itself, the same in all its repeats, (rows, 3, p): what no smooth function of the joint angles has.

    Repeats agree far better than such a function fits, so a pose on either side of a step tells of it by itself.
    """
    mine = (pose[:, None] == np.unique(pose)).astype(float)
    return np.asarray(np.einsum("np,ij->nipj", mine, np.eye(3)).reshape(len(pose), 3, -1))


def _beside_poses(sets: tuple[Array, ...], again: Array) -> list[Scattered]:
    """Columns, of several sets that are equally likely, with a place of each pose whose size is left open between none and
    millimetres.

    Where nothing was measured twice such a place is scatter, which is left open anyway.
    """
    levels = POSE_LEVELS if again.shape[2] < 3 * len(again) else POSE_LEVELS[:1]
    return [Scattered(np.concatenate([c, LASTING.pose_m * size * again], axis=2)) for c in sets for size in levels]


def _log_evidence(values: Array, grounds: list[Scattered]) -> float:
    """Log evidence of readings, (rows, 3), m, under columns that are equally likely."""
    return float(np.logaddexp.reduce([g.log_evidence(values) for g in grounds]) - np.log(len(grounds)))


def _blocks(pose: IntArray, repeat: IntArray, stamp: Array, seen: Array) -> tuple[IntArray, Array, Array, Array]:
    """Of each pose and repeat: its first row, the median of what its rows show, first and last stamp."""
    _, of = np.unique(np.stack([pose, repeat]), axis=1, return_inverse=True)
    of = of.ravel()
    first, mean, begin, end = [], [], [], []
    for k in range(of.max() + 1):
        mine = np.flatnonzero(of == k)
        first.append(mine[np.argmin(stamp[mine])])
        mean.append(np.median(seen[mine], axis=0))
        begin.append(stamp[mine].min())
        end.append(stamp[mine].max())
    return np.array(first), np.array(mean), np.array(begin), np.array(end)


def usually_beyond(study: Study, rows: IntArray) -> Array:
    """What absolute readings have beyond the controller's positions, in standard deviations of each cause, (rows, 3, p), m."""
    usual, scene = LASTING, study.observation.scene
    p, q, J = scene.p_observed[rows], scene.q[rows], scene.J[rows]
    station = scene.station[rows]
    turn = np.concatenate([_all_turn(p) * (station == s)[:, None, None] for s in np.unique(station)], axis=2)  # each by itself
    course = _course(study, rows)[:, 0]
    # whether a base that rides is seen from where it stands or from the cell, and how straight its way is
    rides = [(v[rows] - v[rows].mean())[:, None, None] * np.eye(3) for v in scene.ext.values() if np.isfinite(v[rows]).all()]
    return np.concatenate(
        [
            *rides,
            usual.place_m * np.tile(np.eye(3), (len(rows), 1, 1)), usual.angle_rad * turn, usual.place_m * scene.kin.R_tool[rows],
            usual.angle_rad * J, usual.angle_rad * scene.V[rows],
            usual.place_m * scene.kin.R_joint[rows].swapaxes(1, 2).reshape(len(rows), 3, -1),
            usual.periodic_rad * J * np.sin(q)[:, None], usual.periodic_rad * J * np.cos(q)[:, None],
            usual.course_m * course[:, None, None] * np.eye(3), usual.soft * J * scene.tau_gravity[rows][:, None, :],
            whole_sag_of(study.terms, scene)[rows][:, :, None],
        ], axis=2,
    )  # fmt: skip


def _course(study: Study, rows: IntArray) -> Array:
    """Time over the session, from -1/2 to 1/2 about its mean, and its square, (rows, 2)."""
    stamp = study.observation.scene.stamp[rows]
    course = (stamp - stamp.mean()) / max(float(np.ptp(stamp)), 1e-9)
    return np.stack([course, course**2], axis=1)


def _all_turn(p: Array) -> Array:
    """What places in base_link move by if all turn about its origin, for each axis and radian, (n, 3, 3), m."""
    return np.asarray(np.cross(np.eye(3)[None], p[:, None]).swapaxes(1, 2))
