# SPDX-License-Identifier: Apache-2.0
"""What hoses do to an arm: the wrench in tool0 of each form of a pull that no sensor reads, and the parameters of those that are
tied somewhere."""

from __future__ import annotations

import math

import numpy as np

from ..typing import Array
from .scene import Scene

AXES = ("x", "y", "z")
FOREARM = ("along", "a", "b")  # along the axis of the joint that moves the forearm, and along its two virtual axes
PLACE = "with a tension towards a place"  # as a spring balancer pulls, a hose that is drawn in, or one that hangs
OF_PLACE = 9  # parameters of it
TAUT = "of a hose between forearm and flange"  # tied to both, slack where it is longer than the way
PRESSED = "of a hose between forearm and flange under load"  # of a medium that flows with the process: straight and stiff by it
CELL = "of a hose from the cell that always pulls"  # at the references too, where the arm stands otherwise
AT_FLANGE = 0.15  # m from the TCP; about where a head carries its hoses
TIGHTENS = 0.02  # m, travel over which a hose that sags comes tight
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
    frame = forearm_frame(scene)
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
    """Wrench in tool0 by each of (t, t_wrist, k_place, h_x, h_y, h_z, to_x, to_y, to_z) at these values, (n, 6, 9); (n, 6, 0)
    where there are none."""
    if not len(theta):
        return np.zeros((len(scene), 6, 0))
    (t, t_wrist, k), place, R_tool = theta[:3], theta[3:6], scene.kin.R_tool
    tied = R_tool @ theta[6:]
    way = place - scene.p_tcp - tied
    along, by_way = _directed(way)
    by_way = t * by_way + k * np.eye(3)
    force = np.concatenate([along[:, :, None], way[:, :, None], by_way, -by_way @ R_tool], axis=2)
    at_tool = _tied_to_tool(R_tool, tied, force, t * along + k * way)
    p_wrist = scene.kin.origin[:, wrist_centre(scene)]
    along, by_way = _directed(place - p_wrist)
    force = np.concatenate([along[:, :, None], t_wrist * by_way], axis=2)
    moment = np.swapaxes(np.cross((p_wrist - scene.p_tcp)[:, None], np.swapaxes(force, 1, 2)), 1, 2)
    out = np.zeros((len(scene), 6, OF_PLACE))
    out[:, :, [0, *range(2, OF_PLACE)]] = at_tool
    back = np.swapaxes(R_tool, 1, 2)
    out[:, :, [1, 3, 4, 5]] += np.concatenate([back @ force, back @ moment], axis=1)
    return out * scene.rows.under_load[:, None, None]


def _directed(way: Array) -> tuple[Array, Array]:
    """Direction of each way (n, 3), m, and its derivative by the way, (n, 3, 3), 1/m; none within `NEAREST`."""
    length = np.linalg.norm(way, axis=1)
    at_least = np.maximum(length, NEAREST)[:, None]
    along = way / at_least
    onto = along[:, :, None] * along[:, None, :] * (length > NEAREST)[:, None, None]
    return along, (np.eye(3) - onto) / at_least[:, :, None]


def moored(scene: Scene, theta: Array) -> Array:
    """Wrench in tool0 of a hose between the cell and the tool, by each of its parameters, (n, 6, 9).

    It pulls in each row by t + k way + s way^3: it stiffens as it straightens. What the process causes (`View.measured` is False)
    is what the pull has changed by since the reference.

    Args:
        theta: (t_cell, k_cell, s_cell, from_x, from_y, from_z, at_x, at_y, at_z), or empty: (n, 6, 0) then.
    """
    if not len(theta):
        return np.zeros((len(scene), 6, 0))
    (t, k, s), R_tool = theta[:3], scene.kin.R_tool
    tied = R_tool @ theta[6:]
    way = theta[3:6] - scene.p_tcp - tied
    length = np.maximum(np.linalg.norm(way, axis=1), NEAREST)[:, None]
    along = way / length
    square = length**2
    by_way = (t / length + k + s * square)[:, :, None] * np.eye(3)
    by_way = by_way + (2.0 * s * square - t / length)[:, :, None] * along[:, :, None] * along[:, None, :]
    by_values = [v[:, :, None] for v in (along, way, square * way)]
    force = np.concatenate([*by_values, by_way, -by_way @ R_tool], axis=2)
    pull = t * along + (k + s * square) * way
    return _tied_to_tool(R_tool, tied, *_caused(scene, force, pull, pressed=False))


def taut(scene: Scene, theta: Array, *, pressed: bool = False) -> Array:
    """Wrench in tool0 on the flange of a hose that is tied to it and to the forearm, by each of its parameters, (n, 6, 8).

    It pulls by k (way - l) where its ends are farther apart than it is long, and hardly where it is slack: in each row, and what
    the process causes (`View.measured` is False) is what the pull has changed by since the reference; or under load only.

    Args:
        theta: stiffness, length, where it is tied in the frame of the forearm (3,) and in tool0 (3,), or empty: (n, 6, 0) then.
        pressed: whether it pulls under load only.
    """
    if not len(theta):
        return np.zeros((len(scene), 6, 0))
    (k, slack), in_forearm, in_tool0 = theta[:2], theta[2:5], theta[5:8]
    frame, R_tool = forearm_frame(scene), scene.kin.R_tool
    way = scene.kin.origin[:, forearm(scene)] + frame @ in_forearm - scene.p_tcp - R_tool @ in_tool0
    length = np.maximum(np.linalg.norm(way, axis=1), NEAREST)
    along, longer, tight = way / length[:, None], *(f[:, None, None] for f in stretched(length - slack))
    onto, longer = along[:, :, None] * along[:, None, :], longer[:, 0]
    by_way = k * (tight * onto + (longer / length[:, None])[:, :, None] * (np.eye(3) - onto))
    by_slack = -k * along[:, :, None] * tight
    force = np.concatenate([(longer * along)[:, :, None], by_slack, by_way @ frame, -by_way @ R_tool], axis=2)
    pull = k * longer * along
    return _tied_to_tool(R_tool, R_tool @ in_tool0, *_caused(scene, force, pull, pressed))


def pull_when_tight(theta: Array, way: Array) -> Array:
    """Force on the flange of a hose of these values (8,) whose end on the forearm is `way` (3,), m, from that on the tool, (3,),
    N."""
    length = max(math.sqrt(float(way @ way)), NEAREST)
    longer, _ = stretched(length - theta[1])
    return np.asarray(theta[0] * longer / length * way)


def _caused(scene: Scene, force: Array, pull: Array, pressed: bool) -> tuple[Array, Array]:
    """What of a pull is there in each row: all of it under load, or always, of which the process causes the change since the
    reference; an absolute session has none."""
    if pressed:
        under_load = scene.rows.under_load[:, None]
        return force * under_load[:, :, None], pull * under_load
    if scene.kind == "absolute" or scene.view.measured:
        return force, pull
    return scene.change(force), scene.change(pull)


def _tied_to_tool(R_tool: Array, tied: Array, force: Array, pull: Array) -> Array:
    """Wrench in tool0, N and N m, by each of p parameters of a pull at a point of the tool, (n, 6, p); the last three are where
    in tool0 that is.

    Args:
        R_tool: (n, 3, 3); tied: from the TCP to the point, in base_link, (n, 3), m. force: by each, in base_link, (n, 3, p);
            pull: itself, in base_link, (n, 3), N.
    """
    moment = np.swapaxes(np.cross(tied[:, None], np.swapaxes(force, 1, 2)), 1, 2)
    moment[:, :, -3:] += np.swapaxes(np.cross(np.swapaxes(R_tool, 1, 2), pull[:, None]), 1, 2)
    back = np.swapaxes(R_tool, 1, 2)
    return np.concatenate([back @ force, back @ moment], axis=1)


def stretched(longer: Array | float) -> tuple[Array, Array]:
    """How far a hose is stretched whose ends are by so much farther apart than it is long, m, and the derivative: it sags, and
    comes tight over some travel."""
    root = np.sqrt(longer**2 + TIGHTENS**2)
    return 0.5 * (longer + root), 0.5 * (1.0 + longer / root)


def drawn(tension: float, place: Array, point: Array, stiffness: float = 0.0) -> Array:
    """Force on a point that is drawn towards a place by a tension, N, and more by a stiffness times the way, N/m, (3,), N."""
    way = place - point
    return np.asarray((tension / max(math.sqrt(float(way @ way)), NEAREST) + stiffness) * way)


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
    """Whether a constant pull between forearm and flange is looked for, and one under load: a session without process shows too
    little of the first beside the weight."""
    return scene.kind == "loaded" and has_wrist(scene)


def has_wrist(scene: Scene) -> bool:
    """Whether there is a forearm before the wrist, to which a hose may be tied."""
    return scene.wrist[0] > 0


def forearm(scene: Scene) -> int:
    """The joint that moves the forearm, the last one before the wrist."""
    return max(scene.wrist[0] - 1, 0)


def forearm_frame(scene: Scene) -> Array:
    """The axis of the joint that moves the forearm and its two virtual axes, as columns in base_link, (n, 3, 3)."""
    k = forearm(scene)
    return np.concatenate([scene.kin.axis[:, k, :, None], np.swapaxes(scene.kin.virtual_axis[:, k], 1, 2)], axis=2)


def wrist_centre(scene: Scene) -> int:
    """The joint whose origin is where the axes of a wrist meet."""
    wrist = scene.wrist
    return wrist[len(wrist) // 2]
