# SPDX-License-Identifier: Apache-2.0
"""The end-effector deforms: a spring that is constant in the tool frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .passive import why_no_spring
from .scales import STIFFER_THAN, USUAL_SHARE, typical_compliance, typical_give
from .scene import Scene
from .traits import Family

AXES = ("x", "y", "z")
SOFTEST = 5e-6  # m/N, that is physically likely of the tool of a heavy robot
USUAL_SHARE_OF_SAG = 0.005  # chosen: of what all springs give way by under the weight, RMS; a tool with less is no cause
OVER_ARM = 3.0  # times the typical arm: a softer tool could not be guided
PAIRS = ((0, 1), (0, 2), (1, 2))
BETWEEN = {f"c_{AXES[i]}{AXES[j]}": (f"c_{AXES[i]}", f"c_{AXES[j]}") for i, j in PAIRS}
BACK = (0.0, 0.35, 0.7)  # of the way from tool0 to the last joint, where a tool may be soft; the best is refined


class ToolCompliance(Effect):
    id = "tool_compliance"
    label = "tool compliance"
    physics = (
        "The end-effector (spindle, AFP head, sensor, tool changer) deforms between flange and TCP: R K^-1 R^T f with a "
        "symmetric compliance tensor in tool0. In an absolute session the payload's weight bends it, and turns it about axes "
        "parallel to tool0's through the place where it is soft, which is `back` of the way from tool0 to the last joint. "
        "Missing, the residual is constant in the tool frame, proportional to the force and blind to the arm's pose."
    )
    family = Family.SPRING
    usual_in = ("loaded", "absolute")
    usual_visible = 0.015  # chosen; links and bearings of outside simulators left up to 1.5 %, tools with a cause 1.2 % and more
    elastic = True
    needs = ("load", "weight")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = 1e-7
        most = max(SOFTEST, OVER_ARM * typical_give(scene.robot))
        straight = [Parameter(f"c_{a}", "m/N", scale, lower=0.0, plausible=(0.0, most), group="straight") for a in AXES]
        across = (-0.4 * most, 0.4 * most)
        cross = [Parameter(f"c_{AXES[i]}{AXES[j]}", "m/N", 0.3 * scale, plausible=across, group="cross") for i, j in PAIRS]
        stiff = typical_compliance(scene.robot)[np.flatnonzero(scene.driven)[-1]]
        limit = STIFFER_THAN * stiff
        turning = [Parameter(f"r_{a}", "rad/(N m)", stiff, lower=0.0, plausible=(0.0, limit), group="turning") for a in AXES]
        if scene.kind != "absolute":
            return (*straight, *cross, *turning)
        # models of before turn about tool0
        return (*straight, *cross, *turning, Parameter("back", "share", 0.3, 0.0, 1.0, start=0.0, grid=BACK))

    def regressor(self, scene: Scene, theta: Array) -> Array:
        f, torque = scene.load_wrench_in_tool()
        in_tool = np.zeros((len(scene), 3, len(theta)))
        for a in range(3):
            in_tool[:, a, a] = f[:, a]
        for c, (i, j) in enumerate(PAIRS):
            in_tool[:, i, 3 + c] = f[:, j]
            in_tool[:, j, 3 + c] = f[:, i]
        if scene.kind == "absolute":  # a loaded session and a correction know the force at the TCP, about which it turns nothing
            kin = scene.kin
            away = theta[9] * np.einsum("nji,nj->ni", kin.R_tool, kin.origin[:, -1] - kin.p_tcp)  # from tool0 to where it is soft
            beyond = np.einsum("nji,nj->ni", kin.R_tool, scene.p_observed - kin.p_tcp) - away
            torque = torque - np.cross(away, f)
            for a in range(3):
                in_tool[:, :, 6 + a] = np.cross(np.eye(3)[a] * torque[:, a, None], beyond)
        return np.einsum("nij,njp->nip", scene.kin.R_tool, in_tool) * scene.moves_with_arm[:, None, None]

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        return why_no_spring(values, BETWEEN)

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        return share <= (USUAL_SHARE if scene.kind == "loaded" else USUAL_SHARE_OF_SAG)

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        entries = [(f"tool_{a}", f"tool_{a}", float(v)) for a, v in zip(AXES, theta[:3], strict=True)]
        for (i, j), v in zip(PAIRS, theta[3:6], strict=True):
            entries += [(f"tool_{AXES[a]}", f"tool_{AXES[b]}", float(v)) for a, b in ((i, j), (j, i))]
        return Springs(tuple(entries))
