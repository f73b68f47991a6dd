# SPDX-License-Identifier: Apache-2.0
"""What hoses do to an arm: the wrench in tool0 of each form of a pull that no sensor reads."""

from __future__ import annotations

import math

import numpy as np

from ..typing import Array
from .scene import Scene

NEAREST = 0.05  # m; nearer to its place than that a pull has no direction


def wrenches(scene: Scene) -> tuple[Array, Array]:
    """Wrench in tool0 by one of each parameter, N and N m: of those that pull at the arm, (n, 6, p), and of those that pull
    between forearm and flange, which are the last, (n, 6, q); kept with the view, since fits ask thousands of times."""
    rows, known = scene.view.kept.get("pulls", (None, None))
    if rows is not scene.rows:
        known = _wrenches_anew(scene)
        scene.view.kept["pulls"] = scene.rows, known
    on_arm, pack = known
    return on_arm, pack


def _wrenches_anew(scene: Scene) -> tuple[Array, Array]:
    in_tool = np.swapaxes(scene.kin.R_tool, 1, 2)  # of each unit force in base_link
    none, unit = np.zeros_like(in_tool), np.tile(np.eye(3), (len(scene), 1, 1))
    by_wrist = [in_tool * t(scene.q[:, k])[:, None, None] for k in turning(scene) for t in (np.sin, np.cos)]
    k = forearm(scene)
    frame = np.concatenate([scene.kin.axis[:, k, :, None], np.swapaxes(scene.kin.virtual_axis[:, k], 1, 2)], axis=2)
    p_wrist = scene.kin.origin[:, wrist_centre(scene)]

    def at(point: Array) -> Array:
        """Of each unit force in base_link at a point, (n, 6, 3)."""
        moments = in_tool @ np.stack([np.cross(point - scene.p_tcp, e) for e in np.eye(3)], axis=2)
        return np.concatenate([in_tool, moments], axis=1)

    force = [in_tool, unit, -in_tool @ scene.p_tcp[:, :, None], *by_wrist, in_tool @ frame]
    wrist = at(p_wrist)
    by_wrist_in_tool = [unit * t(scene.q[:, k])[:, None, None] for k in turning_in_tool(scene) for t in (np.sin, np.cos)]
    on_arm = [
        *(np.concatenate([columns, np.zeros_like(columns)], axis=1) for columns in force),
        np.concatenate([none, unit], axis=1),
        wrist,
        -wrist @ p_wrist[:, :, None],
        *(np.concatenate([columns, none], axis=1) for columns in by_wrist_in_tool),
    ]
    pack = at(scene.kin.origin[:, -1]) @ frame if has_pack(scene) else np.zeros((len(scene), 6, 0))
    under_load = scene.rows.under_load[:, None, None]
    return np.concatenate(on_arm, axis=2) * under_load, pack * under_load


def to_place(scene: Scene, theta: Array) -> Array:
    """Wrench in tool0 by each of (t, t_wrist, h_x, h_y, h_z) at these values, (n, 6, 5); (n, 6, 0) where there are none."""
    out = np.zeros((len(scene), 6, len(theta)))
    if not len(theta):
        return out
    in_tool = np.swapaxes(scene.kin.R_tool, 1, 2)
    for i, point in enumerate((scene.p_tcp, scene.kin.origin[:, wrist_centre(scene)])):
        way = theta[2:] - point
        length = np.maximum(np.linalg.norm(way, axis=1), NEAREST)[:, None]
        along, away = way / length, np.linalg.norm(way, axis=1) > NEAREST
        turned = (np.eye(3) - along[:, :, None] * along[:, None, :] * away[:, None, None]) / length[:, :, None]
        force = np.concatenate([along[:, :, None], theta[i] * turned], axis=2)  # by the tension, and by the place
        moment = np.swapaxes(np.cross((point - scene.p_tcp)[:, None], np.swapaxes(force, 1, 2)), 1, 2)
        wrench = np.concatenate([in_tool @ force, in_tool @ moment], axis=1)
        out[:, :, [i, 2, 3, 4]] += wrench
    return out * scene.rows.under_load[:, None, None]


def drawn(tension: float, place: Array, point: Array) -> Array:
    """Force of one tension on a point that is drawn towards a place, (3,), N."""
    way = place - point
    return np.asarray(tension * way / max(math.sqrt(float(way @ way)), NEAREST))


def turning(scene: Scene) -> list[int]:
    """Joints with whose angle a pull may change: those of the wrist and, in a loaded session, the first, where a hose comes from
    the cell (in an absolute one an arm that swings about has too much else that goes with it)."""
    wrist = scene.wrist
    return wrist if scene.kind == "absolute" or wrist[0] == 0 or scene.kin.is_prismatic[0] else [0, *wrist]


def turning_in_tool(scene: Scene) -> list[int]:
    """Joints of the wrist with whose angle a pull along axes of tool0 may change: what is fixed to a link of the wrist turns so.
    A session without process shows too little beside the weight to tell it."""
    return scene.wrist if scene.kind == "loaded" else []


def has_pack(scene: Scene) -> bool:
    """Whether a pull between forearm and flange is looked for: a session without process shows too little beside the weight."""
    return scene.kind == "loaded" and scene.wrist[0] > 0


def forearm(scene: Scene) -> int:
    """The joint that moves the forearm, the last one before the wrist."""
    return max(scene.wrist[0] - 1, 0)


def wrist_centre(scene: Scene) -> int:
    """The joint whose origin is where the axes of a wrist meet."""
    wrist = scene.wrist
    return wrist[len(wrist) // 2]
