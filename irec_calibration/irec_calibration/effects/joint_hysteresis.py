# SPDX-License-Identifier: Apache-2.0
"""Friction in the gear: deflection that depends on the order of the load cases."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..robot.ratings import rated_torque
from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .live import ColumnLaw, LeftOut, LiveForm, Tick, drives
from .scales import LAG, STIFFER_THAN, at_border, largest_lag, typical_compliance
from .scene import Scene
from .traits import Family
from .travel import added_in_turn, clipped_in_turn, travel_to_reference

FRACTIONS_OF_RATED = (0.012, 0.03, 0.075)
APART = 4.0  # factor between the thresholds of the sliders
# 1/rad; the last stands for gears that the way to a reference frees of all, and what moves under the load of nothing: where a
# pose is measured again its reference may be millimetres away, no further than what a controller moves while it presses
ANEW = 1e4
FREED = (0.0, 10.0, 50.0, 250.0, ANEW)
ARRIVED = (-0.5, 0.0, 0.5)
# rad of travel over which friction of an absolute session turns, nearly at once and more gently; twice the last at most
TURNS_OVER = (1e-4, 0.01, 0.08)
RESOLVED = 1e-4  # rad; a smaller step is none
TURNS = 0.01  # rad of travel after which friction points against it
ROUNDING = 1e-9  # of a threshold
SHAPE = 5  # parameters that enter nonlinearly, the last ones
SLIDERS = ("h", "early", "late")  # of each axis, with thresholds r, r / APART, r APART
# share of the deflection, RMS, and axes; chosen: outside simulators whose gears all have some friction have 0.3 to 2.8 %, and
# where friction is a cause 4 % and more
USUAL_FRICTION, USUAL_AXES = 0.03, 3
USUAL_LAG = 5e-5  # rad, of lost motion by friction in an absolute session: a sixth of an arc minute, as sound gears have


class JointHysteresis(Effect):
    id = "joint_hysteresis"
    label = "joint hysteresis"
    physics = (
        "Dry friction inside the gear holds back a part of the wind-up, up to a threshold of torque, until the torque "
        "turns: -J_k sum_i h_ki stop_i(tau_k) (Prandtl-Ishlinskii, from row to row and from pose to pose), or gives way "
        "gradually, as exp(-|change of tau_k| / r) (Dahl). Up to three sliders per axis, with thresholds r / 4, r and 4 r, "
        "since teeth and seals give way one after the other; motion of the joint frees what is held, by 1/e per 1 / freed, or "
        "each way to a reference all of it. Of what the way to a pose has freed a share `arrived` of each threshold is held "
        "in the direction from which the joint came. Missing, "
        "the same load reached from different sides disagrees; repeats reveal it. In absolute sessions the last step "
        "decides: J_k lag_k tanh(step_k / over) / 2, since what is held turns over some travel."
    )
    family = Family.TORQUE_LAW
    needs = ("order",)
    usual_in = ("loaded", "absolute")
    usual_visible = 0.014  # chosen; sound gears of an outside simulator had 0.9 to 1.2 %, gears with a cause 1.6 % and more

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if scene.kind == "absolute":
            limit = largest_lag(scene)
            lags = tuple(
                Parameter(
                    f"lag_{k + 1}", "rad", limit[k] / 30.0, plausible=(-limit[k], limit[k]), group=f"axis {k + 1}", axis=int(k)
                )
                for k in np.flatnonzero(scene.driven)
            )
            sudden, *_, widest = TURNS_OVER
            return (*lags, Parameter("over", "rad", 0.01, sudden, 2.0 * widest, start=sudden, grid=TURNS_OVER))
        scale = typical_compliance(scene.robot)
        axes = tuple(
            Parameter(
                f"{name}_{k + 1}", "rad/(N m)", 0.3 * scale[k], plausible=(-STIFFER_THAN * scale[k], STIFFER_THAN * scale[k]),
                group=f"axis {k + 1}", axis=int(k),
            )
            for name in SLIDERS
            for k in np.flatnonzero(scene.driven)
        )  # fmt: skip
        return (
            *axes,
            Parameter("r", "share of rated torque", 0.03, 0.001, 1.0, start=0.03, grid=FRACTIONS_OF_RATED),
            # models of before have three sliders of equal weight in the place of h where it is above 0
            Parameter("spread", "1", 1.0, 0.0, 2.0, start=0.0, grid=(0.0,)),
            Parameter("freed", "1/rad", 100.0, 0.0, ANEW, start=0.0, grid=FREED),
            Parameter("arrived", "1", 1.0, -1.0, 1.0, start=0.0, grid=ARRIVED),
            Parameter("gradual", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0), kinds=True),
        )

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        if scene.kind == "absolute":
            return max((abs(v) for n, v in values.items() if n.startswith("lag_")), default=0.0) <= USUAL_LAG
        axes = {n.split("_")[1] for n, v in values.items() if n.split("_")[0] in SLIDERS and v != 0.0}
        return share <= USUAL_FRICTION and len(axes) >= USUAL_AXES

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        if scene.kind == "absolute":
            return ""
        theta = np.array([values.get(p.name, (p.start, 0.0))[0] for p in self.parameters(scene)])
        held = np.abs(self._turned(scene, theta)).max(axis=0, initial=0.0)
        k = int(held.argmax())
        if held[k] <= LAG:
            return ""
        most = f"{1e3 * LAG:.2g} mrad at most, as gears and servos do"
        return f"friction would hold axis {k + 1} back by {1e3 * held[k]:.2g} mrad; it may by {most}"

    def ends_at(self, values: Mapping[str, float], scene: Scene) -> str:
        # what turns over more travel than friction does goes with the length of the step
        return "joint_settling" if scene.kind == "absolute" and at_border(values["over"], 2.0 * TURNS_OVER[-1]) else ""

    def displacement(self, scene: Scene, theta: Array) -> Array:
        if scene.kind == "absolute":
            return self._by_last_step(scene, theta[-1]) @ theta[:-1]
        out: Array = np.einsum("nik,nk->ni", scene.J, self._turned(scene, theta))
        return out

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.kind == "absolute":
            step = 1e-3 * theta[-1]
            wider, narrower = (self._by_last_step(scene, theta[-1] + d) @ theta[:-1] for d in (step, -step))
            return np.concatenate([self._by_last_step(scene, theta[-1]), (wider - narrower)[:, :, None] / (2.0 * step)], axis=2)
        h, shape = theta[:-SHAPE], theta[-SHAPE:]
        columns = self._columns(scene, *shape)
        by_shape = np.zeros((len(scene), 3, SHAPE))
        for i, step in ((0, 1e-4), (2, 1e-2), (3, 1e-2)) if np.any(h) else ():  # spread and gradual are never moved
            ahead, behind = shape.copy(), shape.copy()
            ahead[i] += step
            behind[i] -= step
            change = (self._columns(scene, *ahead) - self._columns(scene, *behind)) @ h
            by_shape[:, :, i] = change / (2.0 * step)
        return np.concatenate([columns, by_shape], axis=2)

    def by_torque(self, scene: Scene, theta: Array, change: Array, read: bool) -> Array:
        if scene.kind == "absolute":  # there the last step decides
            return np.zeros((len(scene), 3, change.shape[2]))
        course = _Course(scene, *theta[-SHAPE:])
        h = _of_sliders(scene, theta)[None, :, :, None]
        turned = (by_slider(course.by_torque(change) - change[:, None], 1) * h).sum(axis=1)
        return np.asarray(scene.J @ turned)

    def _by_last_step(self, scene: Scene, over: float) -> Array:
        turned = np.where(np.abs(scene.step) > RESOLVED, np.tanh(scene.step / over), 0.0)
        return (0.5 * scene.J * turned[:, None, :])[:, :, scene.driven]

    def _columns(self, scene: Scene, *shape: float) -> Array:
        """Displacement per unit of each slider."""
        held = self._held(scene, *shape)
        return np.concatenate([(scene.J * held[:, None, i])[:, :, scene.driven] for i in range(len(SLIDERS))], axis=2)

    def _turned(self, scene: Scene, theta: Array) -> Array:
        """Angle by which friction holds each joint back, (n, k), rad."""
        held: Array = (self._held(scene, *theta[-SHAPE:]) * _of_sliders(scene, theta)).sum(axis=1)
        return held

    def _held(self, scene: Scene, *shape: float) -> Array:
        """Minus the part of the torque that each slider holds (the stop operator), (n, sliders, k)."""
        course = _Course(scene, *shape)
        return by_slider(course.played - course.torque[:, None, :], 1)

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        if not theta[:-SHAPE].any():
            return LeftOut("has no value for process forces, only for the last step of an absolute session")
        return _Friction(scene, theta)


def _of_sliders(scene: Scene, theta: Array) -> Array:
    """Compliance that each slider holds back, (sliders, k), rad/(N m)."""
    h = np.zeros((len(SLIDERS), scene.n_joints))
    h[:, scene.driven] = theta[:-SHAPE].reshape(len(SLIDERS), -1)
    return h


def _anew(freed: float) -> bool:
    return freed > 0.5 * ANEW


class _Course:
    """What sliders hold in the course of a session, one row after the other.

    Motion frees what is held: in a pose that which was held before, on the way to another pose towards what that one loads it by;
    there a share of the threshold is held in the direction from which the joint came.

    Attributes:
        torque: about each axis, of process, weight and what no sensor reads, (n, k), N m.
        played: torque less what each slider holds (the play operator), (n, 3 or 5, k).
    """

    def __init__(
        self, scene: Scene, fraction: float, spread: float, freed: float, arrived: float, gradual: float
    ) -> None:  # fmt: skip
        r = np.concatenate(thresholds(fraction, spread)) * rated_torque(scene.robot)
        self._order, self._stands = scene.rows.stands
        self.torque = scene.tau_acting + scene.tau_gravity
        travel, first = travel_to_reference(scene), (scene.previous < 0)[self._order]
        u = self.torque[self._order]
        moved = np.where(scene.previous[:, None] < 0, travel, np.zeros_like(scene.step) if _anew(freed) else scene.step)
        keep = np.exp(-np.abs(freed * moved[self._order]))
        keep[:1] = 0.0  # nothing is known of what was before the session
        came = np.tanh(travel[self._order] / TURNS) * first[:, None]
        points = arrived * ((1.0 - keep) * came)[:, None] * r  # by how much a slider points to where the joint came from
        at = (self._gradually if gradual else self._at_once)(u, r, keep, points, ~first[:, None, None])
        self.played = at[self._stands]

    def _at_once(self, u: Array, r: Array, keep: Array, points: Array, in_pose: BoolArray) -> Array:
        """Play operators that give way at their threshold, in turn, (n, sliders, k)."""
        keep, u = keep[:, None], u[:, None]
        towards = np.where(in_pose, np.concatenate([u[:1], u[:-1]]), u)
        at = clipped_in_turn(keep, (1.0 - keep) * towards + points, u - r, u + r)
        inside = np.abs(at - u) < (1.0 - ROUNDING) * r
        self._kept, freed = np.where(inside, keep, 0.0), np.where(inside, 1.0 - keep, 0.0)
        self._by_last = np.where(in_pose, freed, 0.0)
        self._by_own = np.where(inside, freed - self._by_last, 1.0)
        return at

    def _gradually(self, u: Array, r: Array, keep: Array, points: Array, in_pose: BoolArray) -> Array:
        """The same where each change of torque lets them give way by 1/e per threshold (Dahl)."""
        keep, change = keep[:, None], np.diff(u, axis=0, prepend=u[:1])[:, None]
        left, way = np.exp(-np.abs(change) / r), np.sign(change)
        before, after = np.where(in_pose, keep, 1.0), np.where(in_pose, 1.0, keep)  # a pose frees before the change, a way after
        self._kept = keep * left
        held = added_in_turn(self._kept, after * way * (1.0 - left) * r - points)
        last = before * np.concatenate([np.zeros_like(held[:1]), held[:-1]])
        by_change = after * left * (1.0 - way * last / r)
        self._by_own, self._by_last = 1.0 - by_change, by_change - self._kept
        return np.asarray(u[:, None] - held)

    def by_torque(self, change: Array) -> Array:
        """Change of `played` where the torque changes by each of p parameters: (n, k, p) -> (n, 3 or 5, k, p)."""
        d = change[self._order][:, None]
        out = self._by_own[..., None] * d + self._by_last[..., None] * np.concatenate([d[:1], d[:-1]])
        return added_in_turn(self._kept[..., None], out)[self._stands]


class _Friction(ColumnLaw):
    def __init__(self, scene: Scene, theta: Array) -> None:
        self.columns = drives(scene.n_joints)
        self._h = np.zeros((len(SLIDERS), scene.n_joints))
        self._h[:, scene.driven] = theta[:-SHAPE].reshape(len(SLIDERS), -1)
        fraction, spread, freed, _, gradual = (float(v) for v in theta[-SHAPE:])  # here a course begins with nothing held
        self._freed, self._gradual = 0.0 if _anew(freed) else freed, bool(gradual)
        self._r = np.concatenate(thresholds(fraction, spread)) * rated_torque(scene.robot)
        self.reset()

    def reset(self) -> None:
        self._played = np.zeros_like(self._r)
        self._q: Array | None = None
        self._tau = np.zeros(self._r.shape[1])

    def displacement(self, tick: Tick, tau: Array) -> Array:
        tau = tau + tick.tau_unseen
        if self._freed > 0.0:
            if self._q is not None:
                self._played = released(self._played, self._tau, self._freed * (tick.q - self._q))
            self._q = tick.q.copy()
        if self._gradual:
            change = tau - self._tau
            left = np.exp(-np.abs(change) / self._r)
            self._played = tau - left * (self._tau - self._played) - np.sign(change) * (1.0 - left) * self._r
        else:
            self._played = np.clip(self._played, tau - self._r, tau + self._r)
        self._tau = tau.copy()
        out: Array = (self._h * by_slider(self._played - tau, 0)).sum(axis=0)
        return out


def thresholds(fraction: float, spread: float) -> tuple[Array, Array, Array]:
    """Thresholds as shares of the rated torque of `h` (one, or three about it where spread is above 0), `early`, `late`."""
    middle = np.array([[fraction]]) if spread <= 0.0 else fraction * APART ** (spread * np.array([[-1.0], [0.0], [1.0]]))
    return middle, np.array([[fraction / APART]]), np.array([[fraction * APART]])


def released(played: Array, tau: Array, moved: Array) -> Array:
    """Play operators after a motion that frees what friction holds by 1/e per unit, at the torque before the motion."""
    out: Array = tau + np.exp(-np.abs(moved)) * (played - tau)
    return out


def by_slider(held: Array, axis: int) -> Array:
    """Mean over those that make up `h`, then `early`, `late`."""
    parts = np.split(held, [held.shape[axis] - 2], axis=axis)
    return np.concatenate([parts[0].mean(axis=axis, keepdims=True), parts[1]], axis=axis)
