# SPDX-License-Identifier: Apache-2.0
"""Gear stiffness that grows with torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ..robot.ratings import rated_torque, rating_known
from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .joint_backlash import WIDEST
from .live import ColumnLaw, LiveForm, Springs, Tick, drives
from .scales import COUNTS, at_border, comes_near_zero, may_be_wide, typical_compliance
from .scene import Scene
from .traits import Family

FRACTIONS_OF_RATED = (WIDEST, 0.07, 0.18, 0.45, 1.5)
PRIOR_WIDTH = 2.0  # multiples of the scale: a soft zone of 5 % of the rated torque winds up as far as play of the same prior
RANGES_DIFFER = 0.5  # log; chosen: curves of gears of several makes bend at 0.1 to 0.3 of their rated torque
RANGES_OF_GUESSED = 1.0  # log; the same where the rated torque is a guess, which for an axis without weight is poor
WIDER = 2.0  # log; of u_k to either side: a factor of seven
# times the largest torque that a session shows, up to which a limit that is not stated may be: processes and weights load drives
# to a third of it and more (chosen: play of outside simulators was soft over up to 0.082 of that torque, soft gears from 0.11 on)
MAY_BE_RATED = 3.0
GUESSED_TOO_LARGE = 10.0  # times what a drive is rated for that no weight loads, by the guess


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
        "Each gear has a range of its own, x_0 exp(u_k) in the place of x_0. "
        "Missing, the residual is odd and nonlinear in the torque of one axis, shifted by its gravity preload."
    )
    family = Family.TORQUE_LAW
    usual_visible = 0.007  # chosen; gears of an outside simulator, soft about zero torque, had 0.7 %, causes 0.74 and more
    needs = ("load", "weight")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale, driven = typical_compliance(scene.robot), np.flatnonzero(scene.driven)
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
                goes_with=f"c_{k + 1}",
            )
            for k in driven
        )
        sags = tuple(
            Parameter(f"w_{k + 1}", "1", 1.0, -1.0, 1.0, group=f"axis {k + 1}", width=0.5, axis=int(k), share_of=f"a_{k + 1}")
            for k in (driven if scene.kind == "loaded" else [])
        )
        stated = rating_known(scene.robot)
        ranges = tuple(
            Parameter(
                f"u_{k + 1}",
                "1",
                1.0,
                -WIDER,
                WIDER,
                group=f"axis {k + 1}",
                width=RANGES_DIFFER if stated[k] else RANGES_OF_GUESSED,
                axis=int(k),
                share_of=f"a_{k + 1}",
            )
            for k in driven
        )
        return (
            *axes,
            *sags,
            *ranges,
            Parameter("x_0", "share of rated torque", 0.15, WIDEST, 3.0, start=0.15, grid=FRACTIONS_OF_RATED),
            Parameter("slow", "0, 1/2 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 0.5, 1.0), kinds=True),
        )

    def displacement(self, scene: Scene, theta: Array) -> Array:
        a, w, _ = _of_axes(scene, theta)
        bent, sag = _turned(scene, theta)
        return np.asarray(scene.J[:, :, scene.driven] @ (a * bent - w * a * sag)[:, :, None])[:, :, 0]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        a, w, u = _of_axes(scene, theta)
        J, (bent, sag), h = scene.J[:, :, scene.driven], _turned(scene, theta), 1e-4
        step = np.zeros_like(theta)
        step[-2 - len(u) : -2] = h
        (bent_more, sag_more), (bent_less, sag_less) = _turned(scene, theta + step), _turned(scene, theta - step)
        by_range = (a * (bent_more - bent_less) - w * a * (sag_more - sag_less)) / (2.0 * h)
        turned = [bent - w * sag, *([-a * sag] if scene.kind == "loaded" else []), by_range]
        columns = [J * t[:, None, :] for t in (*turned, by_range / theta[-2])]
        columns[-1] = columns[-1].sum(axis=2, keepdims=True)
        return np.concatenate([*columns, np.zeros((len(scene), 3, 1))], axis=2)

    def by_torque(self, scene: Scene, theta: Array, change: Array, read: bool) -> Array:
        a, x_0 = np.zeros(scene.n_joints), np.ones(scene.n_joints)
        a[scene.driven], x_0[scene.driven] = _of_axes(scene, theta)[0], _x_0(scene, theta)
        saturates = _slope(theta[-1])((scene.tau_acting + scene.tau_gravity) / x_0)
        slope = a * (float(read) - saturates)  # springs answer to what is read, by the loaded gear to what is not
        return np.asarray((scene.J * slope[:, None, :]) @ change)

    def rather(self, values: Mapping[str, float], compliance: Mapping[str, float], scene: Scene) -> str:
        theta = np.array([values.get(p.name, p.start) for p in self.parameters(scene)])
        driven, a = np.flatnonzero(scene.driven), _of_axes(scene, theta)[0]
        if rating_known(scene.robot)[driven][np.abs(a) >= COUNTS * np.abs(a).max(initial=1e-300)].any():
            return ""
        # where no limit is stated, what is soft over 3 % of the largest torque that the session shows is play for certain
        soft = _x_0(scene, theta) * _ends_at(theta[-1])
        return "" if may_be_wide(scene, driven, a, soft, WIDEST).any() else "joint_backlash"

    def ends_at(self, values: Mapping[str, float], scene: Scene) -> str:
        theta = np.array([values.get(p.name, p.start) for p in self.parameters(scene)])
        driven, a = np.flatnonzero(scene.driven), _of_axes(scene, theta)[0]
        if np.isinf(_ends_at(theta[-1])):  # a stiffness that goes on growing is no play, however soon it begins to
            return ""
        counts = np.abs(a) >= COUNTS * np.abs(a).max(initial=1e-300)
        shares = (_x_0(scene, theta) / rated_torque(scene.robot)[driven])[counts]
        stated = rating_known(scene.robot)[driven][counts]
        return "joint_backlash" if stated.all() and all(at_border(s, WIDEST) for s in shares) else ""

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        driven = np.flatnonzero(scene.driven)
        a, soft = _of_axes(scene, theta)[0], _x_0(scene, theta) * _ends_at(theta[-1])
        wide = may_be_wide(scene, driven, a, soft, MAY_BE_RATED * WIDEST).all()
        stated = (a != 0.0) & rating_known(scene.robot)[driven]
        shares = (soft / rated_torque(scene.robot)[driven])[stated]
        return "" if wide and not any(at_border(s, WIDEST) for s in shares) else "joint_backlash"

    def reached(self, scene: Scene, theta: Array) -> BoolArray:
        x_0 = np.zeros(scene.n_joints)
        x_0[scene.driven] = _x_0(scene, theta)
        bent = comes_near_zero(scene, x_0)[scene.driven]
        return np.concatenate([bent, np.ones(len(theta) - len(bent), dtype=bool)])

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Stiffening(scene, theta)


def _of_axes(scene: Scene, theta: Array) -> tuple[Array, Array, Array]:
    """a_k, w_k and u_k of the driven axes; w_k is 0 in an absolute session, which measures all that an arm sags."""
    n = int(np.count_nonzero(scene.driven))
    return theta[:n], theta[n : 2 * n] if scene.kind == "loaded" else np.zeros(n), theta[-2 - n : -2]


def _x_0(scene: Scene, theta: Array) -> Array:
    """Range of torque over which the gear of each driven axis is soft, (driven,), N m."""
    share = np.maximum(theta[-2] * np.exp(_of_axes(scene, theta)[2]), _least_share(scene)[scene.driven])
    return np.asarray(share * rated_torque(scene.robot)[scene.driven])


def _least_share(scene: Scene) -> Array:
    """Share of the rated torque over which play ends, (k,): of a guess a tenth, which may be ten times too large."""
    return np.where(rating_known(scene.robot), WIDEST, WIDEST / GUESSED_TOO_LARGE)


def _turned(scene: Scene, theta: Array) -> tuple[Array, Array]:
    """Torques, N m: what the soft part of each driven gear has not turned by since the reference, for its compliance, and what
    it winds up by under the largest torque of the weight in these rows where nobody compares with a reference; (n, driven)."""
    x_0, s, driven = _x_0(scene, theta), saturation(theta[-1]), scene.driven
    gravity = scene.tau_gravity[:, driven]
    before, acting = scene.preload()[:, driven], scene.tau_acting[:, driven] + gravity
    # what answers to a hose answers by the loaded gear already, which is the linear part
    bent = scene.tau[:, driven] + gravity - before - x_0 * (s(acting / x_0) - s(before / x_0))
    most = np.abs(gravity).max(axis=0, initial=0.0) * (scene.view.sags > 0.0)
    return bent, most * np.tanh(gravity / x_0)


def saturation(slow: float) -> Callable[[Array], Array]:
    """s: how the soft part of a gear's deflection ends with x / x_0, from soon (slow 0) to never (1)."""
    return np.tanh if slow < 0.25 else _cusp if slow <= 0.75 else np.arcsinh


def _ends_at(slow: float) -> float:
    """Where nine tenths of the soft part of a gear's deflection are taken up, over where they are for tanh."""
    return 1.0 if slow < 0.25 else np.log(10.0) / np.arctanh(0.9) if slow <= 0.75 else np.inf


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
        self._x_0 = np.ones(scene.n_joints)
        self._x_0[scene.driven] = _x_0(scene, theta)
        self._s = saturation(theta[-1])
        self.springs = Springs(tuple((c, c, float(a)) for c, a in zip(self.columns, self._a, strict=True)))

    def displacement(self, tick: Tick, tau: Array) -> Array:
        x_0, preload = self._x_0, tick.tau_gravity
        out: Array = -self._a * x_0 * (self._s((tau + tick.tau_unseen + preload) / x_0) - self._s(preload / x_0))
        return out
