# SPDX-License-Identifier: Apache-2.0
"""What hoses do to an arm: the wrench in tool0 of each form of a pull that no sensor reads, and the parameters of those that are
tied somewhere."""

from __future__ import annotations

import math

import numpy as np

from ..typing import Array
from .base import Parameter
from .scales import typical_reach
from .scene import Scene

AXES = ("x", "y", "z")
FOREARM = ("along", "a", "b")  # along the axis of the joint that moves the forearm, and along its two virtual axes
PLACE = "with a tension towards a place"  # as a spring balancer pulls, a hose that is drawn in, or one that hangs
OF_PLACE = 6  # parameters of it
PLACES = (-0.5, 0.0, 0.5)  # of the reach in each direction, about a place half of it above base_link
FARTHEST = 1.0  # likewise; from farther away a pull is as good as constant
TAUT = "of a hose between forearm and flange"  # tied to both, slack where it is longer than the way
OF_HOSE = 8  # parameters of it
PRESSED = "of a hose between forearm and flange under load"  # of a medium that flows with the process: straight and stiff by it
LENGTHS = (0.1, 0.4, 0.7)  # shares of poses in which such a hose is slack
ASIDE = (-0.2, 0.0, 0.2)  # of the forearm, by which it is tied beside the elbow
CELL = "of a hose from the cell that always pulls"  # at the references too, where the arm stands otherwise
OF_CELL = 9  # parameters of it
OVERHEAD = (-0.5, 0.5)  # of the reach in each direction, about a place half of it above base_link
TIED = (-0.2, 0.2)  # m, across tool0
FARTHEST_TIED = 0.6  # m, along each axis
# m and rad, RMS, by which the tool stands otherwise at the references where a hose that always pulls shows: chosen, beyond any
# approach; what less would show of it is as small as what all else leaves
ELSEWHERE_M, ELSEWHERE_RAD = 0.04, 0.1
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
    """Wrench in tool0 by each of (t, t_wrist, k_place, h_x, h_y, h_z) at these values, (n, 6, 6); (n, 6, 0) where there are
    none."""
    out = np.zeros((len(scene), 6, len(theta)))
    if not len(theta):
        return out
    in_tool = np.swapaxes(scene.kin.R_tool, 1, 2)
    for i, point in enumerate((scene.p_tcp, scene.kin.origin[:, wrist_centre(scene)])):
        way = theta[3:] - point
        length = np.maximum(np.linalg.norm(way, axis=1), NEAREST)[:, None]
        along, away = way / length, np.linalg.norm(way, axis=1) > NEAREST
        turned = (np.eye(3) - along[:, :, None] * along[:, None, :] * away[:, None, None]) / length[:, :, None]
        force = np.concatenate([along[:, :, None], theta[i] * turned], axis=2)  # by the tension, and by the place
        moment = np.swapaxes(np.cross((point - scene.p_tcp)[:, None], np.swapaxes(force, 1, 2)), 1, 2)
        wrench = np.concatenate([in_tool @ force, in_tool @ moment], axis=1)
        out[:, :, [i, 3, 4, 5]] += wrench
    out[:, :3, 2] = np.einsum("nij,nj->ni", in_tool, theta[3:] - scene.p_tcp)
    out[:, :3, 3:] += theta[2] * in_tool
    return out * scene.rows.under_load[:, None, None]


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
    if not scene.view.measured:
        force, pull = scene.change(force), scene.change(pull)
    return _tied_to_tool(R_tool, tied, force, pull)


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
    if pressed:
        under_load = scene.rows.under_load[:, None]
        force, pull = force * under_load[:, :, None], pull * under_load
    elif not scene.view.measured:
        force, pull = scene.change(force), scene.change(pull)
    return _tied_to_tool(R_tool, R_tool @ in_tool0, force, pull)


def pull_when_tight(theta: Array, way: Array) -> Array:
    """Force on the flange of a hose of these values (8,) whose end on the forearm is `way` (3,), m, from that on the tool, (3,),
    N."""
    length = max(math.sqrt(float(way @ way)), NEAREST)
    longer, _ = stretched(length - theta[1])
    return np.asarray(theta[0] * longer / length * way)


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
    """Whether a pull between forearm and flange is looked for: a session without process shows too little beside the weight."""
    return scene.kind == "loaded" and scene.wrist[0] > 0


def stands_elsewhere(scene: Scene) -> bool:
    """Whether the tool stands so much otherwise at the references that a hose from the cell shows which always pulls."""
    if scene.kind != "loaded" or not scene.rows.under_load.any():
        return False
    moved = np.linalg.norm(scene.change(scene.p_tcp), axis=1)[scene.rows.under_load > 0]
    R_tool = scene.kin.R_tool
    cosine = 0.5 * (np.einsum("nij,nij->n", R_tool, R_tool[scene.reference]) - 1.0)
    turned = np.arccos(np.clip(cosine, -1.0, 1.0))[scene.rows.under_load > 0]
    return bool(np.sqrt(np.mean(moved**2)) > ELSEWHERE_M or np.sqrt(np.mean(turned**2)) > ELSEWHERE_RAD)


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


def of_taut_hose(scene: Scene, *, pressed: bool = False) -> tuple[Parameter, ...]:
    """Stiffness of a hose that is tied to forearm and flange, its length, and where it is tied.

    Args:
        pressed: whether it pulls under load only. What flows in it draws it together whatever the way: its length without a
            pull may be below zero.
    """
    group, of, tied = (PRESSED, "press", "press") if pressed else (TAUT, "hose", "tied")
    frame, origin = forearm_frame(scene)[0], scene.kin.origin[0]
    forearm_m = max(float(np.linalg.norm(origin[wrist_centre(scene)] - origin[forearm(scene)])), AT_FLANGE)
    at_tool0 = between_flange_and_tcp(scene)
    way = scene.kin.origin[:, forearm(scene)] - scene.p_tcp - scene.kin.R_tool @ at_tool0
    slack = np.quantile(np.linalg.norm(way, axis=1), LENGTHS)
    lengths = [0.0, slack[1]] if pressed else slack
    towards_wrist = int(np.argmax(np.abs(frame.T @ (origin[wrist_centre(scene)] - origin[forearm(scene)]))))
    grid = {d: (0.0,) if i == towards_wrist else tuple(forearm_m * s for s in ASIDE) for i, d in enumerate(FOREARM)}
    longest = 3.0 * typical_reach(scene)

    def shape(name: str, scale: float, low: float, high: float, at: tuple[float, ...]) -> Parameter:
        return Parameter(name, "m", scale, low, high, start=at[len(at) // 2], grid=at, group=group, shapes=group)

    return (
        Parameter(f"k_{of}", "N/m", 1000.0, 0.0, plausible=(0.0, 50000.0), group=group),
        shape(f"l_{of}", AT_FLANGE, -longest if pressed else 0.0, longest, tuple(float(v) for v in lengths)),
        *(shape(f"{tied}_{d}", 2.0 * ASIDE[2] * forearm_m, -forearm_m, forearm_m, grid[d]) for d in FOREARM),
        *(shape(f"{tied}_{a}", AT_FLANGE, c - 0.5, c + 0.5, (c,)) for a, c in zip(AXES, at_tool0.tolist(), strict=True)),
    )


def between_flange_and_tcp(scene: Scene) -> Array:
    """The place half way from the TCP to the last joint, in tool0, (3,), m: about there a head carries its hoses."""
    return np.asarray(np.round(0.5 * scene.kin.R_tool[0].T @ (scene.kin.origin[0, -1] - scene.p_tcp[0]), 3) + 0.0)


def of_moored_hose(scene: Scene) -> tuple[Parameter, ...]:
    """Tension and stiffness of a hose that is tied to the cell and to the tool, how it stiffens, and where it is tied."""
    reach, above = typical_reach(scene), overhead(scene)
    about = [float(v) for v in between_flange_and_tcp(scene)]
    tied = [tuple(c + s for s in TIED) for c in about[:2]] + [(about[2],)]  # across and along tool0
    return (
        Parameter("t_cell", "N", 20.0, plausible=(-1000.0, 1000.0), group=CELL),
        Parameter("k_cell", "N/m", 20.0 / reach, 0.0, plausible=(0.0, 2000.0), group=CELL),
        Parameter("s_cell", "N/m^3", 20.0 / reach**3, 0.0, plausible=(0.0, 2000.0), group=CELL),
        *(
            Parameter(
                f"from_{a}", "m", reach, float(c) - FARTHEST * reach, float(c) + FARTHEST * reach, start=float(c),
                grid=tuple(float(c) + reach * p for p in OVERHEAD), group=CELL, shapes=CELL,
            )
            for a, c in zip(AXES, above, strict=True)
        ),
        *(
            Parameter(f"at_{a}", "m", TIED[1], c - FARTHEST_TIED, c + FARTHEST_TIED, start=c, grid=at, group=CELL, shapes=CELL)
            for a, c, at in zip(AXES, about, tied, strict=True)
        ),
    )  # fmt: skip


def overhead(scene: Scene) -> Array:
    """A place above base_link, against gravity, by half of the arm's reach, (3,), m."""
    reach, weight = typical_reach(scene), float(np.linalg.norm(scene.gravity_in_base))
    return -0.5 * reach * scene.gravity_in_base / weight if weight else np.array([0.0, 0.0, 0.5 * reach])


def of_place(scene: Scene) -> tuple[Parameter, ...]:
    """Tensions at the TCP and at the wrist, by how much more the first is for each metre of the way, and the place that they go
    towards. A hose that gets taut has less than none of the first, as far as it is shorter than it is long."""
    reach, above = typical_reach(scene), overhead(scene)
    return (
        *(Parameter(n, "N", 20.0, low, plausible=(low, 1000.0), group=PLACE) for n, low in (("t", -1000.0), ("t_wrist", 0.0))),
        Parameter("k_place", "N/m", 20.0 / reach, 0.0, plausible=(0.0, 2000.0), group=PLACE),
        *(
            Parameter(
                f"h_{a}", "m", reach, float(c) - FARTHEST * reach, float(c) + FARTHEST * reach, start=float(c),
                grid=tuple(float(c) + reach * p for p in PLACES), group=PLACE, shapes=PLACE,
            )
            for a, c in zip(AXES, above, strict=True)
        ),
    )  # fmt: skip
