# SPDX-License-Identifier: Apache-2.0
"""Lost motion: gear play that is crossed when the total torque of an axis changes sign."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..robot.ratings import rated_torque, rating_known
from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .live import ColumnLaw, LiveForm, Tick, drives
from .scales import at_border, comes_near_zero
from .scene import Scene
from .traits import Ageing, Family
from .travel import clipped_in_turn

AT_ONCE = 1e-3  # share of the rated torque below which the side on which the gear lies is not defined
TAKEN_UP_OVER = (AT_ONCE, 0.004, 0.015)
# Gear makers read lost motion at +-3 % of the rated torque. What is soft over a wider range is a spring: joint_stiffening.
WIDEST = 0.03
INSIDE = 0.7  # of that, from which on play may as well begin there; chosen: plays of outside simulators came to 0.68 of it
HELD_UP_TO = 1.5  # times the range over which play is taken up; chosen: nine tenths of the play are held without load then
SHAPE = 3  # parameters that enter nonlinearly, the last ones
LARGEST = 0.015  # rad; some fifty arc minutes, of a small gear of a wrist that is worn out
PLAY = 1.0e-4  # rad, of one gear, that a check over the years must find
# Sound gears have lost motion of up to an arc minute, 2.9e-4 rad; chosen: what was found in several axes of such robots, at most
USUAL_PLAY, USUAL_AXES = 1.0e-4, 2.3
SOUND_PLAY = 7e-5  # rad, of one gear; chosen: outside simulators have 6.8e-5 where it is no cause, 1e-4 and more where it is


class JointBacklash(Effect):
    id = "joint_backlash"
    label = "joint backlash"
    physics = (
        "Gear play: the joint moves by a fixed angle b_k when its total torque (process and gravity) changes sign: J_k b_k "
        "tanh(tau / w)/2, w the range of torque over which tooth by tooth the play is taken up. Where a seal, a brake or a brush "
        "holds the gear to one side it is crossed beside zero, and the axis turns by p_k tanh(tau / w)^2/2 more (uneven 1; to "
        "first order in the shift). Where they hold it on whichever side it lies, a gear stays there, from pose to pose, until "
        f"the torque is {HELD_UP_TO:g} w the other way (held 1). Missing, the residual jumps by the same angle whatever the "
        "load. An axis whose total torque never changes sign shows nothing."
    )
    family = Family.TORQUE_LAW
    usual_visible = 0.007  # chosen; gears of an outside simulator, soft about zero torque, had 0.7 %, causes 0.74 and more

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        axes = tuple(
            Parameter(f"b_{k + 1}", "rad", 1e-4, lower=0.0, plausible=(0.0, LARGEST), group=f"axis {k + 1}", axis=int(k))
            for k in np.flatnonzero(scene.driven)
        )
        beside = tuple(
            Parameter(f"p_{p.name[2:]}", "rad", 1e-4, plausible=(-LARGEST, LARGEST), group=p.group, axis=p.axis) for p in axes
        )
        return (
            *axes, *beside, Parameter("w", "share of rated torque", AT_ONCE, 1e-4, WIDEST, start=AT_ONCE, grid=TAKEN_UP_OVER),
            Parameter("uneven", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0), kinds=True),
            Parameter("held", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0), kinds=True),
        )  # fmt: skip

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return self._columns(scene, *theta[-SHAPE:]) @ theta[:-SHAPE]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        linear, (w, uneven, held) = theta[:-SHAPE], theta[-SHAPE:]
        h = 1e-3 * w
        by_range = (self._columns(scene, w + h, uneven, held) - self._columns(scene, w - h, uneven, held)) @ linear / (2 * h)
        kinds = np.zeros((len(scene), 3, SHAPE - 1))
        return np.concatenate([self._columns(scene, w, uneven, held), by_range[:, :, None], kinds], axis=2)

    def by_torque(self, scene: Scene, theta: Array, change: Array, read: bool) -> Array | None:
        w, uneven, held = theta[-SHAPE:]
        if held >= 0.5:
            return None
        half, beside = np.zeros((2, scene.n_joints))
        driven = int(scene.driven.sum())
        half[scene.driven], beside[scene.driven] = 0.5 * theta[:driven], 0.5 * theta[driven:-SHAPE] * (uneven >= 0.5)
        side = _side(scene, w, held)
        slope = (half + 2.0 * beside * side) * (1.0 - side**2) / (w * rated_torque(scene.robot))
        return np.asarray((scene.J * slope[:, None, :]) @ change)

    def _columns(self, scene: Scene, w: float, uneven: float, held: float) -> Array:
        side = _side(scene, w, held)
        turned = np.concatenate([0.5 * side, 0.5 * side**2 * (uneven >= 0.5)], axis=1)
        J, driven = np.concatenate([scene.J, scene.J], axis=2), np.concatenate([scene.driven, scene.driven])
        return (J * turned[:, None, :])[:, :, driven]

    def reached(self, scene: Scene, theta: Array) -> BoolArray:
        near = comes_near_zero(scene, theta[-SHAPE] * rated_torque(scene.robot))[scene.driven]
        return np.concatenate([near, near, [True] * SHAPE])

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        play = [v for n, v in values.items() if n.startswith("b_")]
        axes = sum(play) ** 2 / max(sum(v**2 for v in play), 1e-300)  # how many it is spread over, counted by size
        most = max(play, default=0.0)
        return most <= SOUND_PLAY or (most <= USUAL_PLAY and axes >= USUAL_AXES)

    def rather(self, values: Mapping[str, float], compliance: Mapping[str, float], scene: Scene) -> str:
        # up to the border it was drawn by a gear that is soft over more; where no limit is stated nobody knows where that is
        return "joint_stiffening" if rating_known(scene.robot).all() and at_border(values["w"], WIDEST) else ""

    def ends_at(self, values: Mapping[str, float], scene: Scene) -> str:
        # of a guess of the limit nobody knows what three per cent are
        return "joint_stiffening" if rating_known(scene.robot).all() and values["w"] > INSIDE * WIDEST else ""

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        return "joint_stiffening" if at_border(theta[-SHAPE], WIDEST) else ""

    def ageing(self, scene: Scene) -> tuple[Ageing, ...]:
        return tuple(
            Ageing(p.name, p.group + ": play of {:.0f} urad", 1e6 * PLAY, PLAY, "play", f"check the gear of {p.group} for play")
            for p in self.parameters(scene)
            if p.name.startswith("b_")
        )

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Backlash(scene, theta)


def _side(scene: Scene, w: float, held: float) -> Array:
    """On which side of its play each axis lies, -1 to 1, (n, k)."""
    soft = w * rated_torque(scene.robot)
    torque = scene.tau_acting + scene.tau_gravity
    if held >= 0.5:
        order, r = np.arange(len(scene)) if scene.clock == "none" else scene.rows.in_time, HELD_UP_TO * soft
        torque[order] = clipped_in_turn(1.0, 0.0, torque[order] - r, torque[order] + r)  # the play operator
    return np.asarray(np.tanh(torque / soft))


class _Backlash(ColumnLaw):
    needs_gravity = True

    def __init__(self, scene: Scene, theta: Array) -> None:
        self.columns = drives(scene.n_joints)
        self._half, self._beside = np.zeros(scene.n_joints), np.zeros(scene.n_joints)
        driven = int(scene.driven.sum())
        w, uneven, held = theta[-SHAPE:]
        self._half[scene.driven] = 0.5 * theta[:driven]
        self._beside[scene.driven] = 0.5 * theta[driven:-SHAPE] * (uneven >= 0.5)
        self._soft = w * rated_torque(scene.robot)
        self._r = HELD_UP_TO * self._soft * (held >= 0.5)
        self.reset()

    def reset(self) -> None:
        self._played: Array | None = None
        self._before = np.zeros_like(self._soft)

    def displacement(self, tick: Tick, tau: Array) -> Array:
        preload = tick.tau_gravity
        whole = tau + tick.tau_unseen + preload
        self._before = np.clip(self._before, preload - self._r, preload + self._r)
        last = self._before if self._played is None else self._played  # a course begins without a load
        self._played = np.clip(last, whole - self._r, whole + self._r)
        side, before = np.tanh(self._played / self._soft), np.tanh(self._before / self._soft)
        out: Array = self._half * (side - before) + self._beside * (side**2 - before**2)
        return out
