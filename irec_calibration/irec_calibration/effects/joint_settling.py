# SPDX-License-Identifier: Apache-2.0
"""The reported joint angle was read before the arm had settled."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Family
from .travel import travel_to_reference

OVER = (0.5, 1.5, 1000.0)  # rad; the last: in proportion to any travel
LARGE = 300.0  # of which cosh is still a number


class JointSettling(Effect):
    id = "joint_settling"
    label = "joint settling"
    physics = (
        "The controller's joint angle was read while the arm was still creeping into place: J_k a_k times the step of "
        "joint k since the previous row; a > 0: the arm was further along the step than reported. With travel 1 the "
        "reference of a loaded session was read too early as well, after the travel from the pose before; what is left of a "
        "long one grows no further: over tanh(step / over). Missing, the residual is proportional to the step just made, "
        "not to its sign: it imitates backlash."
    )
    family = Family.ANGLE_ERROR
    cause = Cause.MOTION
    needs = ("step",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        loaded = scene.kind == "loaded"
        axes = tuple(
            Parameter(
                f"a_{k + 1}", "1", 1e-2 if loaded else 1e-4, -1.0, 1.0, plausible=(-0.5, 0.5), group=f"axis {k + 1}", axis=int(k)
            )
            for k in np.flatnonzero(scene.driven)
        )
        shortest, *_, longest = OVER
        travel = Parameter("travel", "0 or 1", 1.0, 0.0, 1.0, start=1.0, grid=(0.0, 1.0))
        over = Parameter("over", "rad", 1.0, 0.5 * shortest, longest, start=longest, grid=OVER)
        return (*axes, travel, over) if loaded else (*axes, over)

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        a, over = [v for n, (v, _) in values.items() if n.startswith("a_")], values.get("over", (OVER[-1], 0.0))[0]
        largest = max(a, key=abs, default=0.0)
        if scene.kind != "absolute" or largest >= 0.0 or over >= OVER[0]:
            return ""
        return f"the arm would be behind, and by no more after steps longer than {over:.2g} rad, as friction holds it back"

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return self._columns(scene, theta) @ theta[: int(scene.driven.sum())]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        columns, driven = self._columns(scene, theta), int(scene.driven.sum())
        x = _step(scene, theta) / theta[-1]
        by_over = (scene.J * (np.tanh(x) - x / np.cosh(np.minimum(np.abs(x), LARGE)) ** 2)[:, None, :])[:, :, scene.driven]
        by_travel = np.zeros((len(scene), 3, len(theta) - driven - 1))
        return np.concatenate([columns, by_travel, (by_over @ theta[:driven])[:, :, None]], axis=2)

    def _columns(self, scene: Scene, theta: Array) -> Array:
        step = theta[-1] * np.tanh(_step(scene, theta) / theta[-1])
        return (scene.J * step[:, None, :])[:, :, scene.driven]


def _step(scene: Scene, theta: Array) -> Array:
    """Motion just before each row, (n, k), rad."""
    read_early = scene.kind == "loaded" and theta[-2] >= 0.5
    return scene.step + travel_to_reference(scene) if read_early else scene.step
