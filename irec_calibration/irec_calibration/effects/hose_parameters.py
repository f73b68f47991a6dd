# SPDX-License-Identifier: Apache-2.0
"""The parameters of forces on an arm that no sensor reads: scales, bounds, and the places at which a hose is looked for first."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .base import Parameter
from .hoses import (
    AT_FLANGE,
    AXES,
    CELL,
    FOREARM,
    PLACE,
    PRESSED,
    TAUT,
    forearm,
    forearm_frame,
    has_pack,
    has_wrist,
    turning,
    turning_in_tool,
    wrist_centre,
)
from .scales import typical_reach
from .scene import Scene

PLACES = (-0.5, 0.0, 0.5)  # of the reach in each direction, about a place half of it above base_link
FARTHEST = 1.0  # likewise; from farther away a pull is as good as constant
LENGTHS = (0.1, 0.4, 0.7)  # shares of poses in which such a hose is slack
ASIDE = (-0.2, 0.0, 0.2)  # of the forearm, by which it is tied beside the elbow
OVERHEAD = (-0.5, 0.5)  # of the reach in each direction, about a place half of it above base_link
TIED = (-0.2, 0.2)  # m, across tool0
FARTHEST_TIED = 0.6  # m, along each axis
# m and rad, RMS, by which the tool stands otherwise at the references where a hose that always pulls shows: chosen, beyond any
# approach; what less would show of it is as small as what all else leaves
ELSEWHERE_M, ELSEWHERE_RAD = 0.04, 0.1
SHAPED = (PLACE, CELL, TAUT, PRESSED)  # forms that have a place, in the order of their parameters


def parameters_of_pulls(scene: Scene) -> tuple[Parameter, ...]:
    """All parameters of forces that no sensor reads, in their order."""
    kept: dict[str, tuple[Parameter, ...]] = scene.view.kept  # the same whatever the load: asked by every scene of a fit
    return kept.get("pull parameters") or kept.setdefault("pull parameters", _anew(scene))


def _anew(scene: Scene) -> tuple[Parameter, ...]:
    def pull(name: str, group: str) -> Parameter:
        return Parameter(name, "N", 20.0, plausible=(-1000.0, 1000.0), group=group)

    def stiffness(name: str, group: str) -> Parameter:
        return Parameter(name, "N/m", 20.0 / typical_reach(scene), 0.0, plausible=(0.0, 2000.0), group=group)

    largest = 1000.0 * AT_FLANGE
    return (
        *(pull(f"f_{a}", "constant") for a in AXES),
        *(pull(f"f_{a}_tool", "with the tool") for a in AXES),
        stiffness("k", "towards a point"),
        *(pull(f"f_{a}_{t}{k + 1}", f"with axis {k + 1}") for k in turning(scene) for t in ("sin", "cos") for a in AXES),
        *(pull(f"f_{d}_forearm", "with the forearm") for d in FOREARM),
        *(Parameter(f"m_{a}_tool", "N m", 20.0 * AT_FLANGE, plausible=(-largest, largest), group="beside the TCP") for a in AXES),
        *(pull(f"f_{a}_wrist", "at the wrist") for a in AXES),
        stiffness("k_wrist", "at the wrist towards a point"),
        *(
            pull(f"f_{a}_tool_{t}{k + 1}", f"with the tool and axis {k + 1}")
            for k in turning_in_tool(scene)
            for t in ("sin", "cos")
            for a in AXES
        ),
        *(pull(f"f_{d}_pack", "between forearm and flange") for d in FOREARM if has_pack(scene)),
        *(of_place(scene) if scene.kind == "loaded" else ()),
        *(of_moored_hose(scene) if _always_shows(scene) else ()),
        *(of_taut_hose(scene) if has_wrist(scene) and (scene.kind == "absolute" or _always_shows(scene)) else ()),
        *(of_taut_hose(scene, pressed=True) if has_pack(scene) else ()),
    )


def values_of(scene: Scene, theta: Array, group: str) -> Array:
    """Values of a form that has a place, (9,) of a pull towards one and of a hose from the cell, (8,) of one between forearm and
    flange; (0,) where there is none."""
    kept: dict[str, dict[str, slice]] = scene.view.kept
    if "pulls with a place" not in kept:
        groups = [p.group for p in parameters_of_pulls(scene)]
        kept["pulls with a place"] = {g: slice(groups.index(g), groups.index(g) + groups.count(g)) for g in SHAPED if g in groups}
    of = kept["pulls with a place"]
    return theta[of[group]] if group in of else np.zeros(0)


def _always_shows(scene: Scene) -> bool:
    """`stands_elsewhere`, asked once of each session: fits ask thousands of times."""
    kept: dict[str, bool] = scene.view.kept
    if "moored" not in kept:
        kept["moored"] = stands_elsewhere(scene)
    return kept["moored"]


def stands_elsewhere(scene: Scene) -> bool:
    """Whether the tool stands so much otherwise at the references that a hose shows which always pulls."""
    if scene.kind != "loaded" or not scene.rows.under_load.any():
        return False
    moved = np.linalg.norm(scene.change(scene.p_tcp), axis=1)[scene.rows.under_load > 0]
    R_tool = scene.kin.R_tool
    cosine = 0.5 * (np.einsum("nij,nij->n", R_tool, R_tool[scene.reference]) - 1.0)
    turned = np.arccos(np.clip(cosine, -1.0, 1.0))[scene.rows.under_load > 0]
    return bool(np.sqrt(np.mean(moved**2)) > ELSEWHERE_M or np.sqrt(np.mean(turned**2)) > ELSEWHERE_RAD)


def of_place(scene: Scene) -> tuple[Parameter, ...]:
    """Tensions at the tool and at the wrist, by how much more the first is for each metre of the way, the place that they go
    towards, and where in tool0 the first is tied. A hose that gets taut has less than none of the first, as far as it is shorter
    than it is long."""
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
        *(
            Parameter(f"to_{a}", "m", AT_FLANGE, -FARTHEST_TIED, FARTHEST_TIED, grid=(0.0,), group=PLACE, shapes=PLACE)
            for a in AXES
        ),
    )  # fmt: skip


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


def overhead(scene: Scene) -> Array:
    """A place above base_link, against gravity, by half of the arm's reach, (3,), m."""
    reach, weight = typical_reach(scene), float(np.linalg.norm(scene.gravity_in_base))
    return -0.5 * reach * scene.gravity_in_base / weight if weight else np.array([0.0, 0.0, 0.5 * reach])


def between_flange_and_tcp(scene: Scene) -> Array:
    """The place half way from the TCP to the last joint, in tool0, (3,), m: about there a head carries its hoses."""
    return np.asarray(np.round(0.5 * scene.kin.R_tool[0].T @ (scene.kin.origin[0, -1] - scene.p_tcp[0]), 3) + 0.0)
