# SPDX-License-Identifier: Apache-2.0
"""Pedestal and floor: a spring of six degrees of freedom between the ground and base_link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .passive import why_no_spring
from .scales import TWIST_UNDER_OWN_WEIGHT, USUAL_SHARE, typical_give
from .scene import Scene
from .traits import Ageing, Family

AXES = ("x", "y", "z")
# Of a base that has come loose, which a check over the years must find: 8 % of the deflection of a 120 kg robot on its rail.
LOOSE_TRANSLATION, LOOSE_ROTATION = 3.0e-9, 3.0e-8  # m/N, rad/(N m)
ROTATION, SOFTEST_ROTATION = 2e-8, 2e-6  # rad/(N m); of the base of a heavy robot, and the largest that is physically likely
SOFTEST_TRANSLATION = 1e-6  # m/N; of the base of a heavy robot; where the typical arm is softer, as soft as that
TILT_UNDER_OWN_WEIGHT = 2e-4  # rad; ROTATION under the 10 kN m of a heavy robot with its payload
# What gives way under a force at a height h tilts too: a pedestal by 3 / h^2 of it per N m, a plate on mounts by more. With the
# TCP a metre or two above and beside the base the tilt is the larger part; a base slides without tilting only where it is loose.
ONLY_SLIDES = -3.0  # odds of 20 against it, natural log
# What tilts, tilts about a line elsewhere: at the foot of a pedestal, an edge of the plate, the wheels of a platform. So a moment
# about y moves base_link along x and z too, and a force along x or z at base_link tilts it: one coupling of both each.
COUPLED = (("x", "y"), ("y", "x"), ("z", "x"), ("z", "y"))  # translation along, tilt about
PLACE, FARTHEST = 0.3, 3.0  # m; typical distance of that line, and the largest that is physically likely
ELSEWHERE_ALONE = -5.0  # odds of 150 against a place of tilting without a tilt, natural log
BETWEEN = {"r_xy": ("r_x", "r_y")} | {f"tr_{t}{r}": (f"t_{t}", f"r_{r}") for t, r in COUPLED}  # what couples which two
LOOK = "check the bolts of the base, the pedestal and the floor"


def base_spring_regressor(scene: Scene) -> Array:
    """Displacement per unit of each spring compliance, (n, 3, 6): x, y, z [m/N], then rotations [rad/(N m)]."""
    f, moment = scene.load_wrench_at_base()
    out = np.zeros((len(scene), 3, 6))
    for a in range(3):
        out[:, a, a] = f[:, a]
        turn = np.zeros((len(scene), 3))
        turn[:, a] = moment[:, a]
        out[:, :, 3 + a] = np.cross(turn, scene.p_observed)
    return out


def tilt_across(scene: Scene) -> Array:
    """Displacement per unit of compliance by which a moment about x tilts the base about y, and one about y about x, (n, 3)."""
    _, moment = scene.load_wrench_at_base()
    crossed = np.stack([moment[:, 1], moment[:, 0], np.zeros(len(scene))], axis=1)
    return np.cross(crossed, scene.p_observed)


def _rotation(scene: Scene) -> tuple[float, float]:
    """Typical and largest likely compliance against rotation, rad/(N m).

    A light robot stands on what is lighter too: how far it tilts under its own weight is alike.
    """
    own = scene.gravity.largest_at_base
    if scene.kind != "absolute" and own == 0.0:  # a loaded session may be of a robot without masses in its description
        return ROTATION, SOFTEST_ROTATION
    moment = max(own, TILT_UNDER_OWN_WEIGHT / SOFTEST_ROTATION)
    return max(ROTATION, TILT_UNDER_OWN_WEIGHT / moment), max(SOFTEST_ROTATION, TWIST_UNDER_OWN_WEIGHT / moment)


def tilt_elsewhere(scene: Scene) -> Array:
    """Displacement per unit of each coupling of a translation with a tilt (`COUPLED`, m/(N m)), (n, 3, 4), in base_link."""
    f, moment = scene.load_wrench_at_base()
    out = np.zeros((len(scene), 3, len(COUPLED)))
    for c, (along, about) in enumerate((AXES.index(t), AXES.index(r)) for t, r in COUPLED):
        out[:, along, c] += moment[:, about]
        out[:, :, c] += np.cross(np.eye(3)[about], scene.p_observed) * f[:, along, None]
    return out


class BaseCompliance(Effect):
    id = "base_compliance"
    label = "base compliance"
    physics = (
        "Pedestal and floor give way: a 6-DOF spring at base_link loaded by the force and its moment r x f; r_xy where it is "
        "softest about a horizontal axis between x and y; tr_xy, tr_yx, tr_zx, tr_zy where it tilts about a line off base_link, "
        "as at the foot of a pedestal or an edge of its plate (tr_xy: a moment about y moves it along x). Missing, the residual "
        "is constant in the base frame and grows with reach. Rotation about the base z axis is the same as torsion of axis 1."
    )
    family = Family.SPRING
    usual_in = ("loaded", "absolute")
    softens_with = 0  # it stands still where the first axis turns the arm
    usual_visible = 0.009  # chosen; floors with a cause had 1.2 % and more on outside simulators
    everywhere = ("absolute",)  # there the weight of the arm tilts it, whatever it stands on
    beside = "joint_torsion"
    elastic = True
    needs = ("load", "weight")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale, limit = _rotation(scene)
        most, far = max(SOFTEST_TRANSLATION, typical_give(scene.robot)), FARTHEST * limit
        return (
            *(Parameter(f"t_{a}", "m/N", 1e-8, lower=0.0, plausible=(0.0, most), group="translation") for a in AXES),
            *(Parameter(f"r_{a}", "rad/(N m)", scale, lower=0.0, plausible=(0.0, limit), group="rotation") for a in AXES),
            Parameter("r_xy", "rad/(N m)", scale, plausible=(-limit, limit), group="rotation"),
            *(
                Parameter(
                    f"tr_{t}{r}", "m/(N m)", PLACE * scale, plausible=(-far, far), group="place of tilting",
                    refines=scene.kind == "absolute",  # under the weight alone much else passes for it
                )
                for t, r in COUPLED
            ),
        )

    def log_odds_of(self, groups: Sequence[str]) -> float:
        if "place of tilting" in groups and "rotation" not in groups:
            return ELSEWHERE_ALONE
        return ONLY_SLIDES if tuple(groups) == ("translation",) else 0.0

    def regressor(self, scene: Scene, theta: Array) -> Array:
        return np.concatenate([base_spring_regressor(scene), tilt_across(scene)[:, :, None], tilt_elsewhere(scene)], axis=2)

    def ageing(self, scene: Scene) -> tuple[Ageing, ...]:
        slides = "base: gives way {{:.0f}} um/kN more along {}"
        tilts = "base: tilts {{:.2f}} mrad/(kN m) more about {}"
        return (
            *(Ageing(f"t_{a}", slides.format(a), 1e9 * LOOSE_TRANSLATION, LOOSE_TRANSLATION, "loose", LOOK) for a in AXES),
            *(Ageing(f"r_{a}", tilts.format(a), 1e6 * LOOSE_ROTATION, LOOSE_ROTATION, "loose", LOOK) for a in AXES),
        )

    def where_to_look(self, values: Mapping[str, float], proven: Sequence[str]) -> str:
        soft = max(values.get("r_x", 0.0), values.get("r_y", 0.0))
        if not {"rotation", "place of tilting"} <= {*proven} or soft <= 0.0:
            return ""
        v = {name: values.get(name, 0.0) / soft for name in ("tr_zy", "tr_xy", "tr_zx", "tr_yx")}
        if values.get("r_y", 0.0) == soft:  # about (x, z): a tilt of one moves base_link by -z along x and by x along z
            about, at = "y", f"x = {v['tr_zy']:.2f} m, z = {-v['tr_xy']:.2f} m"
        else:
            about, at = "x", f"y = {-v['tr_zx']:.2f} m, z = {v['tr_yx']:.2f} m"
        return f"it tilts most about {about}, about a line near {at} in base_link; look at the bolts and what it stands on there"

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        return why_no_spring(values, BETWEEN)

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        return share <= USUAL_SHARE

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        columns = [f"base_{p.name}" for p in self.parameters(scene)[:6]]
        pairs = [("base_r_x", "base_r_y"), *((f"base_t_{t}", f"base_r_{r}") for t, r in COUPLED)]
        between = [entry for (a, b), v in zip(pairs, theta[6:], strict=True) for entry in ((a, b, float(v)), (b, a, float(v)))]
        return Springs((*((c, c, float(v)) for c, v in zip(columns, theta[:6], strict=True)), *between))
