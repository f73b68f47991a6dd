# SPDX-License-Identifier: Apache-2.0
"""The carriage of an external axis: a base spring whose stiffness varies along the travel."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .base_compliance import base_spring_regressor, tilt_across
from .live import ColumnLaw, LiveForm, Tick
from .scene import Scene
from .traits import Family

DOF = ("t_x", "t_y", "t_z", "r_x", "r_y", "r_z")
SPRINGS = (*DOF, "r_xy")
PLACES = 9  # along the travel of the session, at which the softest place is looked for
WIDTHS = (0.1, 0.17, 0.235, 0.28, 0.33, 0.39, 0.46, 0.55, 0.66)  # of the travel; as close as what repeats over it asks for
TILTS = [DOF.index("r_x"), DOF.index("r_y")]
SHAPE = 3  # parameters, the last: s_0, w, posts
SHORTEST = 0.1  # m, of a travel
NARROWEST = 0.3  # m, of a soft place; a carriage stands on more of the rail than that
CLOSEST_POSTS = 0.4  # m; a rail on posts that stand closer is carried alike everywhere
FURTHEST = 100.0  # m from 0, of a place on a rail whose travel is not known


class RailCompliance(Effect):
    id = "rail_compliance"
    label = "rail compliance"
    physics = (
        "The carriage and its rail give way like a base spring, differently along the travel: each of six compliances, neither "
        "part negative, and r_xy is a constant part and one that is largest at the place s_0. That one fades over the distance "
        "w (0.3 m at least), c + soft exp(-((s - s_0)/w)^2), or is there between all posts, which stand w apart (0.4 m at "
        "least): c + soft cos^2(pi (s - s_0)/w). "
        "Missing, the residual depends on the rail position."
    )
    family = Family.SPRING
    elastic = True
    needs = ("ext", "load")

    obsolete = (r".*_s[012]",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        position = _position(scene)
        low, high = float(position.min()), float(position.max())
        travel = max(high - low, SHORTEST)
        places = tuple(float(s) for s in np.linspace(low, high, PLACES)) if high > low else (low,)
        springs = tuple(
            Parameter(
                name, "m/N" if d[0] == "t" else "rad/(N m)", 1e-8 if d[0] == "t" else 2e-8, lower=0.0 if d in DOF else -np.inf,
                plausible=(0.0 if d in DOF else -2e-6, 1e-6 if d[0] == "t" else 2e-6), group=d,
            )
            for d in SPRINGS
            for name in (d, f"{d}_soft")
        )  # fmt: skip
        widths = tuple(dict.fromkeys(max(share * travel, NARROWEST) for share in WIDTHS))
        # rows of one position, as where a model comes into force, tell no travel that the place would have to be within
        within = (low - travel, high + travel) if high > low else (-FURTHEST, FURTHEST)
        return (
            *springs,
            Parameter("s_0", "m", travel, *within, start=places[len(places) // 2], grid=places),
            Parameter("w", "m", travel, NARROWEST, 100.0, start=widths[0], grid=widths),
            Parameter("posts", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0), kinds=True),
        )

    def same_shape(self, scene: Scene, shape: Mapping[str, float]) -> dict[str, float]:
        if shape["posts"] < 0.5:
            return dict(shape)
        position = _position(scene)
        middle = 0.5 * float(position.min() + position.max())
        spans = round((middle - shape["s_0"]) / shape["w"])
        return {**shape, "s_0": shape["s_0"] + spans * shape["w"]}

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return np.asarray(self._columns(scene, *theta[-SHAPE:]) @ theta[:-SHAPE])

    def regressor(self, scene: Scene, theta: Array) -> Array:
        *values, place, width, posts = theta
        h = 1e-4 * width

        def columns(s_0: float, w: float) -> Array:
            return self._columns(scene, s_0, w, posts)

        by_place = (columns(place + h, width) - columns(place - h, width)) @ values / (2 * h)
        by_width = (columns(place, width + h) - columns(place, width - h)) @ values / (2 * h)
        by_shape = np.stack([by_place, by_width, np.zeros_like(by_place)], axis=2)  # posts are there or not
        return np.concatenate([columns(place, width), by_shape], axis=2)

    def _columns(self, scene: Scene, place: float, width: float, posts: float) -> Array:
        """Displacement per unit of each compliance, (n, 3, 14)."""
        spring = np.concatenate([base_spring_regressor(scene), tilt_across(scene)[:, :, None]], axis=2)
        soft = softness(_position(scene), place, width, posts)[:, None, None]
        return np.stack([spring, spring * soft], axis=3).reshape(len(scene), 3, -1)

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Carriage(theta[:-SHAPE].reshape(-1, 2), *theta[-SHAPE:])


def _position(scene: Scene) -> Array:
    """Of the first external axis, (n,), m; 0 where it was not logged."""
    position = next(iter(scene.ext.values()), np.zeros(len(scene)))
    return np.where(np.isfinite(position), position, 0.0)


def softness(position: Array, place: float, width: float, posts: float) -> Array:
    """Share of the soft part at positions along the rail, (n,), m -> (n,): 1 at the softest place, 0 where posts stand too close
    for a rail to be softer between them."""
    if posts >= 0.5 and width < CLOSEST_POSTS:
        return np.zeros_like(position)
    away = (position - place) / width
    return np.asarray(np.cos(np.pi * away) ** 2 if posts >= 0.5 else np.exp(-(away**2)))


class _Carriage(ColumnLaw):
    columns = tuple(f"base_{d}" for d in DOF)
    elastic = True

    def __init__(self, compliances: Array, place: float, width: float, posts: float) -> None:
        self._constant, self._soft = compliances.T
        self._place, self._width, self._posts = float(place), float(width), posts >= 0.5
        if self._posts and self._width < CLOSEST_POSTS:
            self._soft = np.zeros_like(self._soft)

    def displacement(self, tick: Tick, tau: Array) -> Array:
        away = (tick.rail_position - self._place) / self._width
        soft = math.cos(math.pi * away) ** 2 if self._posts else math.exp(-(away**2))
        *along, across = self._constant + soft * self._soft
        out: Array = np.array(along) * tau
        out[TILTS] += across * tau[TILTS[::-1]]
        return out
