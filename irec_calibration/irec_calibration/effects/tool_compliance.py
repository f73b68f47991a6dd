# SPDX-License-Identifier: Apache-2.0
"""The end-effector deforms: a spring that is constant in the tool frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .scales import USUAL_SHARE
from .scene import Scene
from .traits import Family

AXES = ("x", "y", "z")
PAIRS = ((0, 1), (0, 2), (1, 2))


class ToolCompliance(Effect):
    id = "tool_compliance"
    label = "tool compliance"
    physics = (
        "The end-effector (spindle, AFP head, sensor, tool changer) deforms between flange and TCP: R K^-1 R^T f with a "
        "symmetric compliance tensor in tool0. Missing, the residual is constant in the tool frame, proportional to the "
        "force and blind to the arm's pose."
    )
    family = Family.SPRING
    elastic = True
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = 1e-7
        straight = [Parameter(f"c_{a}", "m/N", scale, lower=0.0, plausible=(0.0, 5e-6), group="straight") for a in AXES]
        cross = [Parameter(f"c_{AXES[i]}{AXES[j]}", "m/N", 0.3 * scale, plausible=(-2e-6, 2e-6), group="cross") for i, j in PAIRS]
        return (*straight, *cross)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        f = scene.force_in_tool
        in_tool = np.zeros((len(scene), 3, 6))
        for a in range(3):
            in_tool[:, a, a] = f[:, a]
        for c, (i, j) in enumerate(PAIRS):
            in_tool[:, i, 3 + c] = f[:, j]
            in_tool[:, j, 3 + c] = f[:, i]
        return np.einsum("nij,njp->nip", scene.kin.R_tool, in_tool) * scene.moves_with_arm[:, None, None]

    def is_usual(self, values: Mapping[str, float], share: float) -> bool:
        return share <= USUAL_SHARE

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        entries = [(f"tool_{a}", f"tool_{a}", float(v)) for a, v in zip(AXES, theta[:3], strict=True)]
        for (i, j), v in zip(PAIRS, theta[3:], strict=True):
            entries += [(f"tool_{AXES[a]}", f"tool_{AXES[b]}", float(v)) for a, b in ((i, j), (j, i))]
        return Springs(tuple(entries))
