# SPDX-License-Identifier: Apache-2.0
"""Eccentric encoder disc or gear: a joint error that is periodic in the joint angle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..robot.ratings import rated_torque
from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .scales import SURELY
from .scene import Scene
from .traits import Cause, Family

LARGEST = 2.5e-3  # rad; a disc that sits a tenth of a millimetre beside its axis, read at 40 mm
UPRIGHT = 0.01  # of the rated torque, up to which the weight of the arm says nothing of the side on which play lies
WELL_KNOWN = 10.0  # standard errors; what is known less well has no shape
UNLIKE = 0.06  # of a curve's square, that no play has; chosen: harmonics fitted to play of any width had up to 0.05 in 19 of 20
SIDES = np.linspace(-np.pi, np.pi, 73)[:-1]  # rad, angles at which an axis may cross its play
WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # sine of the angle over which it does
CANCEL = 8.0  # times what the curve of an axis deviates from its mean; harmonics so much larger take each other away


class EncoderHarmonics(Effect):
    id = "encoder_harmonics"
    label = "encoder harmonics"
    physics = (
        "An eccentric encoder disc or gear makes a joint error that is periodic in the angle: J_k (a sin q_k + b cos q_k), "
        "also with 2 q_k. Missing, the residual is periodic in one joint angle and blind to load; in a loaded session it "
        "all but cancels."
    )
    family = Family.ANGLE_ERROR
    cause = Cause.STATE
    turns_by_angle = True
    needs = ("tracker", "weight")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        # in a loaded session only errors far above those of a sound encoder show at all
        size = 1e-3 if scene.kind == "loaded" else 1e-4
        return tuple(
            Parameter(f"{t}{m}_{k + 1}", "rad", size, plausible=(-LARGEST, LARGEST), group=f"axis {k + 1}", axis=int(k))
            for k in np.flatnonzero(self._turning(scene))
            for m in (1, 2)
            for t in ("a", "b")
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        columns = scene.J[:, :, :, None] * self._waves(scene)[:, None]
        n = len(scene)
        return columns[:, :, self._turning(scene)].reshape(n, 3, -1)

    def not_told(self, scene: Scene) -> str:
        told = scene.kind != "loaded"
        return "" if told else "between a reference and its load cases they all but cancel; an absolute session tells them"

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        """Any in a loaded session: between a reference and its load cases they all but cancel, and what goes with the angles by
        which a reference stands elsewhere is a joint or link that is wrong, a hose, or a link that warms up, far more often.

        Else harmonics of the axis with the largest curve that cancel but for a small difference: over the travel of that axis
        they describe some smooth curve, and no encoder."""
        never = self.not_told(scene)
        if never:
            return never
        none = np.array([0.0, 0.0])
        found = np.array([values.get(p.name, none) for p in self.parameters(scene)]).reshape(-1, 4, 2)  # axis, wave, (value, se)
        if not len(found):
            return ""
        curves = np.einsum("nkw,kw->nk", self._waves(scene)[:, self._turning(scene)], found[:, :, 0])
        k = int(np.argmax(curves.std(axis=0)))
        size, error = np.linalg.norm(found[k], axis=0)
        curve = float(curves[:, k].std())
        if size - SURELY * np.nan_to_num(error) <= CANCEL * curve:
            return ""
        axis = int(np.flatnonzero(self._turning(scene))[k]) + 1
        return f"its harmonics of axis {axis}, {size:.2g} rad, cancel but for {curve:.2g} rad: some smooth curve of the angle"

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        """Harmonics of axes that the weight does not turn may be play: which side they lie on, leaning a little, goes with their
        angle as well. Not where the curve of one of them has another shape than play."""
        if scene.kind != "absolute":
            return ""
        waves, (by_axis, errors) = self._waves(scene), (v.reshape(-1, 4) for v in (theta, se))
        size, error = np.linalg.norm(by_axis, axis=1), np.linalg.norm(errors, axis=1)
        of_axes = np.flatnonzero(self._turning(scene))
        loaded = np.abs(scene.tau_gravity).max(axis=0) > UPRIGHT * rated_torque(scene.robot)
        sure = size > SURELY * error
        if not sure.any() or loaded[of_axes[sure]].any():
            return ""
        known = size > WELL_KNOWN * error
        curves = ((scene.q[:, of_axes[i]], waves[:, of_axes[i]] @ by_axis[i]) for i in np.flatnonzero(known))
        return "" if any(_unlike_play(*curve) > UNLIKE for curve in curves) else "joint_backlash"

    def _waves(self, scene: Scene) -> Array:
        """sin q, cos q, sin 2q, cos 2q of each joint, (n, joints, 4)."""
        return np.stack([f(m * scene.q) for m in (1, 2) for f in (np.sin, np.cos)], axis=2)

    def _turning(self, scene: Scene) -> BoolArray:
        turning: BoolArray = scene.driven & ~scene.kin.is_prismatic
        return turning


def _unlike_play(angle: Array, curve: Array) -> float:
    """The share of the square of a curve over a joint's angle that is left beside play, crossed anywhere, at once or slowly.

    Args:
        angle: of the joint, (n,), rad; curve: by which it is off, (n,), rad. What does not change is a zero of the joint.
    """
    off = curve - curve.mean()
    sides = np.tanh(np.sin(angle[:, None, None] - SIDES[:, None]) / WIDTHS).reshape(len(angle), -1)
    sides -= sides.mean(axis=0)
    squares = np.maximum((sides**2).sum(axis=0), 1e-12)
    return float(1.0 - ((sides.T @ off) ** 2 / squares).max() / max(float(off @ off), 1e-300))
