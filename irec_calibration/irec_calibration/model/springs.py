# SPDX-License-Identifier: Apache-2.0
"""How springs answer at one place of the arm. They are linear in the wrench, so what they do is kept and costs a product at any
other wrench: where the force sensor is in doubt, a fit asks for it thousands of times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..effects import Effect, parameters_of
from ..effects.scene import Scene
from ..effects.state import ElasticResponse, Gravity, Rows
from ..typing import Array, BoolArray

ROWS_KEPT = 3000  # of a scene up to which it is kept
STEP = 1e-5  # m and rad, by which joints are moved for a derivative


class Answer(NamedTuple):
    """What springs do at the observed point and seen one metre further in base x, y and z: without a process wrench,
    (n, 3, 4), m, and by each unit of its components in tool0, (n, 3, 4, 6); of their parameters where there is a last axis p."""

    at_rest: Array
    by_wrench: Array

    def at(self, theta: Array) -> Answer:
        """At values of the parameters, (p,)."""
        return Answer(_at(self.at_rest, theta), _at(self.by_wrench, theta))

    def response(self, scene: Scene) -> ElasticResponse:
        """What effects see of it under a scene's wrench."""
        u = self.at_rest + np.einsum("nijk,nk->nij", self.by_wrench, _wrench(scene))
        return ElasticResponse(u[:, :, 0], _rotation(u[:, :, 1:] - u[:, :, :1]), self.by_wrench[:, :, 0])


@dataclass(frozen=True)
class _Kept:
    """An answer with what it was computed for; wrist: which of its parameters are springs of wrist axes, (p,)."""

    effect: Effect
    rows: Rows
    gravity: Gravity
    columns: Answer
    wrist: BoolArray
    values: dict[bytes, Answer]

    def fits(self, effect: Effect, scene: Scene) -> bool:
        return self.effect is effect and self.rows is scene.rows and self.gravity is scene.gravity


def is_kept(effect: Effect, scene: Scene) -> bool:
    """Whether an effect is a spring that is linear in its parameters, on a scene that is not too large to keep what it does."""
    linear = type(effect).displacement is Effect.displacement and not any(p.grid for p in parameters_of(effect, scene))
    return effect.elastic and effect.acts_on == "arm" and linear and len(scene) <= ROWS_KEPT


def response_of(effect: Effect, theta: Array, scene: Scene) -> ElasticResponse:
    """What effects see of a spring at values of its parameters: as it is kept, or asked anew."""
    if is_kept(effect, scene):
        found, known = answer_of(effect, theta, scene).response(scene), _kept(effect, theta, scene)
        if known.wrist.any():
            found = replace(found, of_wrist=_at(known.columns.by_wrench[:, :, 0], theta * known.wrist))
        return found
    u = effect.displacement(scene, theta)
    pressed = [scene.with_wrench(scene.force_in_tool + e[:3], scene.torque_in_tool + e[3:]) for e in np.eye(6)]
    further = [scene.seen_at(scene.p_observed + e) for e in np.eye(3)]
    by_wrench, by_place = (np.stack([effect.displacement(s, theta) - u for s in there], axis=2) for there in (pressed, further))
    of_wrist, wrist = None, theta * effect.in_wrist(scene)
    if wrist.any():
        here = effect.displacement(scene, wrist)
        of_wrist = np.stack([effect.displacement(s, wrist) - here for s in pressed], axis=2)
    return ElasticResponse(u, _rotation(by_place), by_wrench, of_wrist=of_wrist)


def by_parameters(
    effect: Effect, theta: Array, scene: Scene, columns: Array, mover: Effect | None = None, which: Sequence[int] | None = None
) -> ElasticResponse:
    """Derivative of what effects see of a spring by its parameters at their values, the last axis of each field.

    Args:
        columns: derivative of its displacement, (n, 3, p); all that is known of a spring that is not kept.
        mover: an effect that `moves_joints`, if it is asked what springs do by its parameters; which: by which of these, zeros
            for the others. None: by all.
    """
    if not is_kept(effect, scene):
        n, p = len(scene), columns.shape[2]
        return ElasticResponse(columns, np.zeros((n, 3, p)), np.zeros((n, 3, 6, p)))
    kept = _kept(effect, theta, scene)
    known = kept.columns
    u = known.at_rest + np.einsum("nijkp,nk->nijp", known.by_wrench, _wrench(scene))
    turned = None
    if mover is not None and not effect.completes:
        turned = _by_geometry(effect, scene, mover).under(scene, which)
    by_wrench = known.by_wrench[:, :, 0]
    of_wrist = by_wrench * kept.wrist
    return ElasticResponse(u[:, :, 0], _rotation(u[:, :, 1:] - u[:, :, :1]), by_wrench, turned, of_wrist)


def by_geometry(effect: Effect, theta: Array, scene: Scene, mover: Effect, which: Sequence[int] | None = None) -> Array | None:
    """Derivative of the displacement by a spring by the parameters of an effect that moves the joints, (n, 3, g); None where it
    is not asked: for a spring that is not kept, or that only completes the form of another (some per cent of some per cent).

    Springs turn about lines that lie elsewhere then, and the force that is known in tool0 has another direction.

    Args:
        which: of these parameters; zeros for the others. None: all of them.
    """
    if not is_kept(effect, scene) or effect.completes:
        return None
    return _by_geometry(effect, scene, mover).at(theta, scene, which)


def answer_of(effect: Effect, theta: Array, scene: Scene) -> Answer:
    """What a spring that is kept answers at values of its parameters, whatever the wrench of the scene."""
    known = _kept(effect, theta, scene)
    key = theta.tobytes()
    if key not in known.values:
        known.values.clear()  # a fit asks for the same values under many wrenches, then for others
        known.values[key] = known.columns.at(theta)
    return known.values[key]


def _kept(effect: Effect, theta: Array, scene: Scene) -> _Kept:
    known = scene.view.kept.get(effect.id)
    if not isinstance(known, _Kept) or not known.fits(effect, scene):
        columns = _asked(lambda s: effect.regressor(s, np.zeros_like(theta)), scene)
        known = scene.view.kept[effect.id] = _Kept(effect, scene.rows, scene.gravity, columns, effect.in_wrist(scene), {})
    return known


@dataclass(frozen=True)
class _Turned:
    """What each unit of the wrench does through a spring, by where the joints are and by the spring's parameters,
    (g, n, 3, 6, p), with what it was computed for; `pressed`: under the wrench it was last asked for, by some of where the joints
    are, (n, 3, g, p); `values`: at the values of the parameters it was last asked for, likewise, (6, g, 3, n)."""

    effect: Effect
    mover: Effect
    rows: Rows
    columns: NDArray[np.float32]
    pressed: dict[bytes, Array]
    values: dict[bytes, Array]

    def at(self, theta: Array, scene: Scene, which: Sequence[int] | None = None) -> Array:
        """At values of the spring's parameters, under a scene's wrench, (n, 3, g): a fit asks for many values under one wrench,
        and the derivative by the parameters of a force sensor for many wrenches at the same values."""
        wrench, asked = _wrench(scene), self._asked(which)
        pressed = self.pressed.get(wrench.tobytes() + bytes(asked))
        if pressed is not None:
            return _at(pressed, theta)
        g, n = self.columns.shape[:2]
        key = theta.tobytes() + bytes(asked)
        if key not in self.values:
            self.values.clear()
            found = np.array([_at(self.columns[i], theta) for i in asked]).reshape(len(asked), n, 3, 6)
            self.values[key] = np.ascontiguousarray(found.transpose(3, 0, 2, 1))  # rows last: products over them are long
        out = np.zeros((n, 3, g))
        by_rows = sum((v * w for v, w in zip(self.values[key], wrench.T, strict=True)), np.zeros((len(asked), 3, n)))
        out[:, :, asked] = by_rows.transpose(2, 1, 0)
        return out

    def under(self, scene: Scene, which: Sequence[int] | None = None) -> Array:
        """Under a scene's wrench, (n, 3, g, p); zeros for those of g that are not asked for."""
        wrench, asked = _wrench(scene), self._asked(which)
        key = wrench.tobytes() + bytes(asked)
        if key not in self.pressed:
            self.pressed.clear()
            g, n, _, _, p = self.columns.shape
            out = np.zeros((n, 3, g, p))
            for i in asked:
                out[:, :, i] = np.einsum("nikp,nk->nip", self.columns[i], wrench.astype(self.columns.dtype))
            self.pressed[key] = out
        return self.pressed[key]

    def _asked(self, which: Sequence[int] | None) -> list[int]:
        return list(range(len(self.columns)) if which is None else which)


def _by_geometry(effect: Effect, scene: Scene, mover: Effect) -> _Turned:
    name = f"{effect.id} by {mover.id}"
    known = scene.view.kept.get(name)
    if isinstance(known, _Turned) and known.effect is effect and known.mover is mover and known.rows is scene.rows:
        return known
    zero = np.zeros(len(parameters_of(effect, scene)))
    count = len(parameters_of(mover, scene))
    here = _kept(effect, zero, scene).columns.by_wrench[:, :, 0]
    columns = np.empty((count, len(scene), 3, 6, len(zero)), dtype=np.float32)  # some per cent of some per cent, and most to read
    for g, step in enumerate(np.eye(count) * STEP):
        there = mover.standing(scene, step)
        columns[g] = (_by_unit(lambda s: effect.regressor(s, zero), there) - here) / STEP
    known = scene.view.kept[name] = _Turned(effect, mover, scene.rows, columns, {}, {})
    return known


def displacement_at(effect: Effect, theta: Array, scene: Scene) -> Array:
    """Displacement of the observed point by a spring that is kept, (n, 3), m."""
    found = answer_of(effect, theta, scene)
    moved: Array = found.at_rest[:, :, 0] + np.einsum("nik,nk->ni", found.by_wrench[:, :, 0], _wrench(scene))
    return moved


def _at(columns: Array | NDArray[np.float32], theta: Array) -> Array:
    """Columns (..., p) times values (p,): as one product, since numpy makes thousands of small ones of it."""
    each = columns.shape[:-1]
    return np.asarray(columns.reshape(prod(each), len(theta)) @ theta.astype(columns.dtype, copy=False)).reshape(each)


def _rotation(further: Array) -> Array:
    """Small rotation, (n, 3), by which the displacement is more by (n, 3, 3) one metre further in x, y and z: rotation x e."""
    x, y, z = np.moveaxis(further, 2, 0)
    return np.stack([y[:, 2], z[:, 0], x[:, 1]], axis=1)


def _wrench(scene: Scene) -> Array:
    return np.concatenate([scene.force_in_tool, scene.torque_in_tool], axis=1)


def _asked(answer: Callable[[Scene], Array], scene: Scene) -> Answer:
    none = np.zeros((len(scene), 3))
    at_rest, by_wrench = [], []
    for e in np.concatenate([np.zeros((1, 3)), np.eye(3)]):
        there = scene.seen_at(scene.p_observed + e)
        at_rest.append(answer(there.with_wrench(none, none)))
        by_wrench.append(_by_unit(answer, there, at_rest[-1]))
    # in the order of memory that a product with values of the parameters needs
    return Answer(np.ascontiguousarray(np.stack(at_rest, axis=2)), np.ascontiguousarray(np.stack(by_wrench, axis=2)))


def _by_unit(answer: Callable[[Scene], Array], scene: Scene, rest: Array | float = 0.0) -> Array:
    """An answer to each unit of the wrench in tool0, less that to none, (n, 3, 6, ...)."""
    none = np.zeros((len(scene), 3))
    return np.stack([answer(scene.with_wrench(none + e[:3], none + e[3:])) - rest for e in np.eye(6)], axis=2)
