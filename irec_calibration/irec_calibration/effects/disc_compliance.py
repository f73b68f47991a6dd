# SPDX-License-Identifier: Apache-2.0
"""The disc between tool and tooling gives way: only where the contact stands in for the tracker."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Family

TYPICAL = 5e-7  # m/N; discs of urethane give way by 2 to 10e-7 m/N
VARIES = 0.05  # of the largest force: where it differs by less (RMS) within poses, only the noise of the sensor would tell


class DiscCompliance(Effect):
    id = "disc_compliance"
    label = "disc compliance"
    physics = (
        "Without a tracker the measured point is where the disc stands on the tooling. The tool comes nearer to it as the disc "
        "is compressed and sheared: R diag(c_lateral, c_lateral, c_normal) R^T f, and so does a tooling that gives way. It moves "
        "no tool by itself and is left out of predictions. A spring of the tool has the same form: what is taken for the disc "
        "and belongs to the tool is missing in the prediction. Sessions with a tracker do not see it."
    )
    family = Family.INSTRUMENT
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if not scene.instruments.by_contact:
            return ()
        return tuple(
            Parameter(f"c_{name}", "m/N", TYPICAL, lower=0.0, plausible=(0.0, 1e-5))
            for name, axes in (("normal", (2,)), ("lateral", (0, 1)))
            if _varies(scene, axes)
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        names = [p.name for p in self.parameters(scene)]
        in_tool = np.zeros((len(scene), 3, len(names)))
        for i, name in enumerate(names):
            axes = [2] if name == "c_normal" else [0, 1]
            in_tool[:, axes, i] = scene.force_in_tool[:, axes]
        return np.einsum("nij,njp->nip", scene.kin.R_tool, in_tool)


def _varies(scene: Scene, axes: tuple[int, ...]) -> bool:
    """Whether forces along some axes of tool0 differ within poses, so that their spring shows."""
    change = scene.change(scene.force_in_tool)[:, axes]
    return float(np.sqrt((change**2).sum(axis=1).mean())) > VARIES * float(np.abs(scene.force_in_tool).max(initial=0.0))
