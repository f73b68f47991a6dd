# SPDX-License-Identifier: Apache-2.0
"""Two virtual revolute joints orthogonal to each axis: with joint_torsion the 18-DOF model of the paper (4.1)."""

from __future__ import annotations

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter
from .scales import typical_compliance


class LinkBending(Effect):
    id = "link_bending"
    label = "link bending"
    physics = (
        "Links and bearings bend and tilt orthogonally to the drive axes. Two virtual revolute joints per axis, at the "
        "URDF origin of the joint, turning with it: sum J_v c_v tau_v, Eq. (11). Missing, it leaves residuals along "
        "directions that no axis can produce."
    )
    elastic = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        return tuple(
            Parameter(f"c_{k + 1}{v}", "rad/(N m)", scale[k], lower=0.0, plausible=(0.0, 100.0 * scale[k]), group=f"axis {k + 1}")
            for k in range(scene.n_joints)
            for v in "ab"
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        loaded = scene.kind == "loaded"
        torque = scene.tau_virtual if loaded else scene.tau_virtual + scene.tau_virtual_gravity
        return scene.V * torque[:, None, :]
