# SPDX-License-Identifier: Apache-2.0
"""A passive joint follows the drives through rods that give way themselves, or that do not follow what a drive gives way."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Refused, Springs
from .scales import typical_compliance
from .scene import Scene
from .traits import Family


class LinkageCompliance(Effect):
    id = "linkage_compliance"
    label = "linkage compliance"
    physics = (
        "A palletiser keeps its wrist level by rods: a passive joint follows the drives before it. The rods give way to the "
        "torque about that joint, J_p c_p tau_p, and where they are hinged beyond a drive they do not follow all of what it "
        "gives way: x (J_p tau_d + J_d tau_p) for each drive d, with J_d and tau_d of a drive that the rods follow "
        "without play. With x = c_d and c_p their sum the joint stands as if it were locked. Missing, the arm of such a robot "
        "seems to have wrist coupling or a hose."
    )
    family = Family.SPRING
    elastic = True
    completes = "joint_torsion"
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        out = []
        for p, drives in _linkages(scene):
            softest = float(np.max(scale[[p, *drives]]))
            group = f"joint {p + 1}"
            out.append(
                Parameter(
                    f"c_{p + 1}",
                    "rad/(N m)",
                    softest,
                    lower=0.0,
                    plausible=(0.0, 100.0 * softest),
                    group=group,
                    width=3.0,
                    axis=p,
                )
            )
            for d in drives:
                size = float(scale[d])
                out.append(
                    Parameter(
                        f"x_{p + 1}{d + 1}",
                        "rad/(N m)",
                        size,
                        plausible=(-100.0 * size, 100.0 * size),
                        group=group,
                        width=3.0,
                        axis=p,
                    )
                )
        return tuple(out)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        tau, J = scene.load_torque(), scene.J
        columns = []
        for p, drives in _linkages(scene):
            columns.append(J[:, :, p] * tau[:, None, p])
            columns += [J[:, :, p] * tau[:, None, d] + J[:, :, d] * tau[:, None, p] for d in drives]
        return np.stack(columns, axis=2) if columns else np.zeros((len(scene), 3, 0))

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        if not len(theta):
            return Springs(())
        return Refused("the live correction has no joints that follow others through a linkage")


def _linkages(scene: Scene) -> list[tuple[int, list[int]]]:
    """Passive joints and the drives that each follows anywhere; of those that turn."""
    if scene.arm.coupling is None:
        return []
    follows = np.abs(scene.arm.coupling).max(axis=0) > 0.0
    turns = ~scene.kin.is_prismatic
    passive = np.flatnonzero(~scene.driven & turns)
    return [(int(p), [int(d) for d in np.flatnonzero(follows[p] & scene.driven & turns)]) for p in passive]
