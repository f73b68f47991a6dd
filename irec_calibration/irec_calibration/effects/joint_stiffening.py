# SPDX-License-Identifier: Apache-2.0
"""Gear stiffness that grows with torque."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..robot.ratings import rated_torque
from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .joint_backlash import WIDEST
from .live import ColumnLaw, LiveForm, Springs, Tick, drives
from .scales import at_border, comes_near_zero, may_be_wide, typical_compliance
from .scene import Scene
from .traits import Family

FRACTIONS_OF_RATED = (WIDEST, 0.07, 0.18, 0.45, 1.5)
PRIOR_WIDTH = 2.0  # multiples of the scale: a soft zone of 5 % of the rated torque winds up as far as play of the same prior


class JointStiffening(Effect):
    id = "joint_stiffening"
    label = "joint stiffening"
    physics = (
        "A gear is soft at small torque and stiffens as more teeth carry: extra deflection J_k [g(tau_k + tau_g,k) - "
        "g(tau_g,k)] with g(x) = a_k (x - x_0 s(x / x_0)), a_k <= 0: cubic below x_0, above it a piecewise line (s = tanh); "
        "with slow 1/2 softest at no torque at all (s(u) = sign(u) (1 - exp(-|u|))), with slow 1 a stiffness that goes on "
        "growing (s = asinh). The compliance never rises with the torque; what is softer over less than 3 % of the rated torque "
        "is play. What such a gear gives way to the weight from no torque on, a session that presses about that torque does not "
        "show: between reference and row the axis may sag by -J_k w_k a_k max|tau_g,k| tanh(tau_g,k / x_0) more, |w_k| <= 1. "
        "Missing, the residual is odd and nonlinear in the torque of one axis, shifted by its gravity preload."
    )
    family = Family.TORQUE_LAW
    usual_visible = 0.007  # chosen; gears of an outside simulator, soft about zero torque, had 0.7 %, causes 0.74 and more
    needs = ("load", "weight")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        axes = tuple(
            Parameter(
                f"a_{k + 1}",
                "rad/(N m)",
                0.5 * scale[k],
                upper=0.0,
                plausible=(-50.0 * scale[k], 0.0),
                group=f"axis {k + 1}",
                width=PRIOR_WIDTH,
                axis=int(k),
                takes_from=f"c_{k + 1}",
            )
            for k in np.flatnonzero(scene.driven)
        )
        sags = tuple(
            Parameter(f"w_{k + 1}", "1", 1.0, -1.0, 1.0, group=f"axis {k + 1}", width=0.5, axis=int(k), share_of=f"a_{k + 1}")
            for k in np.flatnonzero(scene.driven if scene.kind == "loaded" else [])
        )
        return (
            *axes,
            *sags,
            Parameter("x_0", "share of rated torque", 0.15, WIDEST, 3.0, start=0.15, grid=FRACTIONS_OF_RATED),
            Parameter("slow", "0, 1/2 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 0.5, 1.0), kinds=True),
        )

    def displacement(self, scene: Scene, theta: Array) -> Array:
        a, w = _of_axes(scene, theta)
        return self._columns(scene, *theta[-2:]) @ a - _sag(scene, theta[-2])[:, :, : len(w)] @ (w * a[: len(w)])

    def regressor(self, scene: Scene, theta: Array) -> Array:
        a, w = _of_axes(scene, theta)
        columns, sag = self._columns(scene, *theta[-2:]), _sag(scene, theta[-2])[:, :, : len(w)]
        columns[:, :, : len(w)] -= sag * w
        h = 1e-3 * np.eye(len(theta))[-2]
        by_break = (self.displacement(scene, theta + h) - self.displacement(scene, theta - h)) / 2e-3
        return np.concatenate([columns, -sag * a[: len(w)], by_break[:, :, None], np.zeros((len(scene), 3, 1))], axis=2)

    def by_torque(self, scene: Scene, theta: Array, change: Array, read: bool) -> Array:
        a = np.zeros(scene.n_joints)
        a[scene.driven] = _of_axes(scene, theta)[0]
        saturates = _slope(theta[-1])((scene.tau_acting + scene.tau_gravity) / (theta[-2] * rated_torque(scene.robot)))
        slope = a * (float(read) - saturates)  # springs answer to what is read, by the loaded gear to what is not
        return np.asarray((scene.J * slope[:, None, :]) @ change)

    def _columns(self, scene: Scene, fraction: float, slow: float) -> Array:
        x_0 = fraction * rated_torque(scene.robot)
        saturating = saturation(slow)

        # what answers to a hose answers by the loaded gear already, which is the linear part
        before, acting = scene.preload(), scene.tau_acting + scene.tau_gravity
        bent = scene.tau + scene.tau_gravity - before - x_0 * (saturating(acting / x_0) - saturating(before / x_0))
        return (scene.J * bent[:, None, :])[:, :, scene.driven]

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        driven = np.flatnonzero(scene.driven)
        soft = theta[-2] * rated_torque(scene.robot)[driven]
        wide = may_be_wide(scene, driven, _of_axes(scene, theta)[0], soft, WIDEST).all()
        return "" if wide and not at_border(theta[-2], WIDEST) else "joint_backlash"

    def reached(self, scene: Scene, theta: Array) -> BoolArray:
        bent = comes_near_zero(scene, theta[-2] * rated_torque(scene.robot))[scene.driven]
        return np.concatenate([bent, np.ones(len(theta) - len(bent), dtype=bool)])

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Stiffening(scene, theta)


def _of_axes(scene: Scene, theta: Array) -> tuple[Array, Array]:
    """a_k and w_k of the driven axes; none of the latter in an absolute session, which measures all that an arm sags."""
    n = int(np.count_nonzero(scene.driven))
    return theta[:n], theta[n:-2]


def _sag(scene: Scene, fraction: float) -> Array:
    """Displacement per compliance, (n, 3, driven), m per rad/(N m), of gears that wind up by the largest torque of the weight in
    these rows; 0 where nobody compares with a reference."""
    most = np.abs(scene.tau_gravity).max(axis=0, initial=0.0) * (scene.view.sags > 0.0)
    wound = most * np.tanh(scene.tau_gravity / (fraction * rated_torque(scene.robot)))
    return np.asarray((scene.J * wound[:, None, :])[:, :, scene.driven])


def saturation(slow: float) -> Callable[[Array], Array]:
    """s: how the soft part of a gear's deflection ends with x / x_0, from soon (slow 0) to never (1)."""
    return np.tanh if slow < 0.25 else _cusp if slow <= 0.75 else np.arcsinh


def _slope(slow: float) -> Callable[[Array], Array]:
    """Derivative of `saturation`."""
    if slow < 0.25:
        return lambda u: 1.0 - np.tanh(u) ** 2
    return (lambda u: np.exp(-np.abs(u))) if slow <= 0.75 else (lambda u: 1.0 / np.sqrt(1.0 + u**2))


def _cusp(u: Array) -> Array:
    out: Array = -np.sign(u) * np.expm1(-np.abs(u))
    return out


class _Stiffening(ColumnLaw):
    needs_gravity = True

    def __init__(self, scene: Scene, theta: Array) -> None:
        self.columns = drives(scene.n_joints)
        self._a = np.zeros(scene.n_joints)
        self._a[scene.driven] = _of_axes(scene, theta)[0]
        self._x_0 = theta[-2] * rated_torque(scene.robot)
        self._s = saturation(theta[-1])
        self.springs = Springs(tuple((c, c, float(a)) for c, a in zip(self.columns, self._a, strict=True)))

    def displacement(self, tick: Tick, tau: Array) -> Array:
        x_0, preload = self._x_0, tick.tau_gravity
        out: Array = -self._a * x_0 * (self._s((tau + tick.tau_unseen + preload) / x_0) - self._s(preload / x_0))
        return out
