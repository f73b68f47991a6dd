# SPDX-License-Identifier: Apache-2.0
"""Two virtual revolute joints orthogonal to each axis: with joint_torsion the 18-DOF model of the paper (4.1)."""

from __future__ import annotations

import numpy as np

from ..robot.kinetostatics import deflection_per_compliance
from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .scales import softest, typical_compliance
from .scene import Scene
from .traits import Axes, Family

# Links and bearings of heavy robots are 3 to 30 times stiffer across the axes 1-3 than about them, and 1 to 5 times across the
# wrist's axes. These weak priors keep 18 free compliances from standing in for another cause.
WIDTH_OF_ARM, WIDTH_OF_WRIST = 0.5, 1.2  # multiples of the scale
WRIST_AXES = 3


class LinkBending(Effect):
    id = "link_bending"
    label = "link bending"
    physics = (
        "Links and bearings bend and tilt orthogonally to the drive axes. Two virtual revolute joints per axis, at the "
        "URDF origin of the joint, turning with it: sum J_v c_v tau_v, Eq. (11). Missing, it leaves residuals along "
        "directions that no axis can produce."
    )
    family = Family.SPRING
    everywhere = ("loaded", "absolute")
    beside = "joint_torsion"
    elastic = True
    compliance_of = Axes.VIRTUAL

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        limit = softest(scene, np.repeat(scale, 2), scene.gravity.largest_virtual)
        return tuple(
            Parameter(
                f"c_{k + 1}{v}", "rad/(N m)", scale[k], lower=0.0, plausible=(0.0, limit[2 * k + "ab".index(v)]),
                group=f"axis {k + 1}",
                width=WIDTH_OF_WRIST if k >= scene.n_joints - WRIST_AXES else WIDTH_OF_ARM, axis=k,
            )
            for k in range(scene.n_joints)
            for v in "ab"
        )  # fmt: skip

    def log_odds(self, scene: Scene) -> float:
        # in an absolute session, which starts without springs, that of a drive is the likelier one beside a drive's axis
        return -3.0 if scene.kind == "absolute" else 0.0

    def regressor(self, scene: Scene, theta: Array) -> Array:
        return deflection_per_compliance(scene.V, scene.load_torque_virtual())

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        columns = [f"joint_{k + 1}{v}" for k in range(scene.n_joints) for v in "ab"]
        return Springs(tuple((c, c, float(v)) for c, v in zip(columns, theta, strict=True)))
