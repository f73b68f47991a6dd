# SPDX-License-Identifier: Apache-2.0
"""A force that no sensor sees: dress pack, hoses, cable drag."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter

AXES = ("x", "y", "z")


class ExternalForce(Effect):
    id = "external_force"
    label = "unmeasured external force"
    physics = (
        "Dress pack, hoses and cables pull at the tool with a force that the sensor does not see and that is not the same "
        "at the reference and under load: J C J^T f_0, constant in base_link or turning with a wrist axis. Missing, the "
        "residual is there whatever the process force and depends on the pose only. A force that stays the same cancels."
    )
    needs_elastic = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        out = [Parameter(f"f_{a}", "N", 20.0, plausible=(-1000.0, 1000.0), group="constant") for a in AXES]
        for k in self._wrist(scene):
            out += [
                Parameter(f"f_{a}_{t}{k + 1}", "N", 20.0, plausible=(-1000.0, 1000.0), group=f"with axis {k + 1}")
                for t in ("sin", "cos")
                for a in AXES
            ]
        return tuple(out)

    def _wrist(self, scene: Scene) -> list[int]:
        return [k for k in range(scene.n_joints) if scene.driven[k]][-3:]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.elastic is None:
            return np.zeros((len(scene), 3, len(self.parameters(scene))))
        by_force_in_base = np.einsum("nij,nkj->nik", scene.elastic.compliance[:, :, :3], scene.kin.R_tool)
        loaded = by_force_in_base * ((scene.load_case > 0) | (scene.kind == "absolute"))[:, None, None]
        blocks = [loaded]
        for k in self._wrist(scene):
            blocks += [loaded * t(scene.q[:, k])[:, None, None] for t in (np.sin, np.cos)]
        return np.concatenate(blocks, axis=2)
