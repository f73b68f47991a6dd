# SPDX-License-Identifier: Apache-2.0
"""Relaxation of gears, tool or rubber under sustained load."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .live import ElasticLaw, LiveForm, Tick
from .scales import typical_compliance
from .scene import Scene
from .state import ElasticResponse
from .traits import Family

SAME_LOAD = 0.05  # without memory the clock starts anew where the elastic deflection changes by more than this share of itself
APART_OR_NOT = (0.0, 1.0, 2.0)
CARRIED = 1.5  # `apart` from which gears keep from pose to pose what they have crept
SHORTEST = 0.05  # s, time constant at least
LARGEST_EXPONENT = 300.0  # of what is summed up, far below where numbers end
APART = 5.0  # factor between three time constants where `spread` is 1


class Creep(Effect):
    id = "creep"
    label = "creep"
    physics = (
        "Gears, tool or rubber go on yielding under a load that stays: a share of the elastic deflection times 1 - "
        "exp(-t/T), t since the load was applied; with memory 1 what was reached under the load before is kept "
        "(Kelvin-Voigt), with 0 another load begins anew. With spread 0 there is one time constant T, else three about it "
        "(generalised Kelvin-Voigt). With apart 1 gears differ: the one of axis k creeps by a compliance d_k beside that share; "
        "with apart 2 they do so alone, and keep from pose to pose what they have crept, under the weight of the arm too. "
        "Missing, the residual grows with the dwell under load."
    )
    family = Family.TIME
    needs = ("time", "load")
    needs_elastic = True
    usual_at_most = 0.035  # chosen; sound gears creep by two or three per cent, most of which looks like softer gears
    usual_visible = 0.013  # chosen; sound gears of two outside simulators had up to 1.2 %, as what structure is usual

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        shortest = _shortest_seen(scene)
        grid = tuple(T for T in (1.0, 4.0, 15.0, 60.0) if T >= shortest)
        soft = typical_compliance(scene.robot)
        gears = tuple(
            Parameter(f"d_{k + 1}", "rad/(N m)", 0.1 * soft[k], plausible=(-5.0 * soft[k], 5.0 * soft[k]), axis=int(k))
            for k in np.flatnonzero(scene.driven)
        )
        how = APART_OR_NOT[: 3 if scene.kind == "loaded" else 2]
        return (
            Parameter("share", "1", 0.1, lower=0.0, plausible=(0.0, 1.0)),
            Parameter("T", "s", 10.0, min(shortest, 10.0), 1e5, start=10.0, grid=grid or (10.0,)),
            Parameter("memory", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0)),
            Parameter("spread", "1", 1.0, 0.0, 2.0, start=0.0, grid=(0.0, 1.0)),
            *gears,
            Parameter("apart", "0, 1 or 2", 1.0, 0.0, 2.0, start=0.0, grid=how, kinds=True),
        )

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        theta = np.array([values.get(p.name, (0.0, 0.0))[0] for p in self.parameters(scene)])
        elastic = scene.response.displacement
        of_gears = np.einsum("nik,nk->ni", scene.J[:, :, scene.driven], scene.tau[:, scene.driven] * theta[4:-1])
        in_the_end = theta[0] * (theta[-1] < CARRIED) * elastic + of_gears * (theta[-1] >= 0.5)
        if np.vdot(in_the_end, elastic) >= 0.0:
            return ""
        return "it would take deflection back under a load that stays, as a force sensor that creeps may and no gear does"

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return self._columns(scene, theta) @ _linear(theta)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        columns, of_gears = self._columns(scene, theta), slice(4, len(theta) - 1)
        h = 0.01 * theta[1] * np.eye(len(theta))[1]
        out = np.zeros((len(scene), 3, len(theta)))
        out[:, :, 0], out[:, :, of_gears] = columns[:, :, 0], columns[:, :, 1:]
        out[:, :, 1] = (self._columns(scene, theta + h) - self._columns(scene, theta - h)) @ _linear(theta) / (2.0 * h[1])
        return out

    def _columns(self, scene: Scene, theta: Array) -> Array:
        """What has crept per unit of share and of each gear's further compliance, (n, 3, 1 + gears), m."""
        _, T, memory, spread, *_, apart = theta
        gears = (scene.J * scene.tau[:, None, :])[:, :, scene.driven] * (apart >= 0.5)
        elastic = np.zeros((len(scene), 3)) if scene.elastic is None else scene.elastic.displacement
        out = self._crept(scene, np.concatenate([elastic[:, :, None], gears], axis=2), T, memory, spread)
        if apart >= CARRIED:
            reached = np.mean([_carried(scene, t) for t in time_constants(T, spread)], axis=0)
            out[:, :, 0] = 0.0  # what springs and links yield is not known by axis
            out[:, :, 1:] = (scene.J * reached[:, None, :])[:, :, scene.driven]
        return out

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array:
        share, T, memory, spread, *_, apart = theta
        return np.asarray(share * (apart < CARRIED) * self._crept(scene, change.displacement, T, memory, spread))

    def _crept(self, scene: Scene, v: Array, T: float, memory: float, spread: float) -> Array:
        """What has crept of displacements v, (n, 3[, p]), under loads that have the elastic response of the scene."""
        along, constants = (-1, *[1] * (v.ndim - 1)), time_constants(T, spread)
        if memory < 0.5:
            age = np.maximum(scene.stamp - _same_load_since(scene), 0.0)
            return np.asarray(v * np.mean([-np.expm1(-age / t) for t in constants], axis=0).reshape(along))
        dwell, out = np.maximum(scene.stamp - scene.load_since, 0.0), np.zeros_like(v)
        for t in constants:
            reached = -np.expm1(-dwell / t).reshape(along)
            crept = v * reached
            for rows in scene.rows.in_turn[1:]:
                before = crept[scene.previous[rows]]
                crept[rows] = before + (v[rows] - before) * reached[rows]
            out += crept / len(constants)
        return out

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        gears = np.zeros(scene.n_joints)
        gears[scene.driven] = theta[4:-1] * (theta[-1] >= 0.5)
        share, T, memory, spread = theta[:4]
        if theta[-1] >= CARRIED:
            share, memory = 0.0, 1.0
        return _Creep(share, T, memory, spread, gears)


def _carried(scene: Scene, T: float) -> Array:
    """What the torque about each axis has become behind a lag of T s over a whole session, (n, k), N m, less that of the weight
    when all is done. By what the weight still does the tool moves between reference and row too; the live correction, which knows
    no reference, leaves that out."""
    tau = scene.tau + scene.tau_gravity
    order = scene.rows.in_time
    out = np.empty_like(tau)
    out[order] = _lagged(tau[order], scene.stamp[order] / T)
    return np.asarray(out - scene.tau_gravity)


def _lagged(x: Array, t: Array) -> Array:
    """What each column of x (n, k), which are held from one row to the next, has become at the times t (n,) behind a lag of 1.

    y_i = x_i + (y_{i-1} - x_i) exp(t_{i-1} - t_i), summed up in stretches that are short enough for exp.
    """
    y, taken = np.empty_like(x), -np.expm1(-np.diff(t, prepend=-np.inf))
    begin = 0
    while begin < len(t):
        end = int(np.searchsorted(t, t[begin] + LARGEST_EXPONENT, side="right"))
        grown = np.exp(t[begin:end] - t[begin])
        y[begin:end] = np.cumsum((taken[begin:end] * grown)[:, None] * x[begin:end], axis=0)
        if begin:
            y[begin:end] += np.exp(t[begin - 1] - t[begin]) * y[begin - 1]
        y[begin:end] /= grown[:, None]
        begin = end
    return y


def _linear(theta: Array) -> Array:
    """The share and the further compliance of each gear."""
    return np.append(theta[0], theta[4:-1])


def _shortest_seen(scene: Scene) -> float:
    """Shortest time constant that the rows of a scene can show, s: of a shorter one less than a seventh is left at their first
    readings, which friction or an arm that is still settling does as well."""
    return max(0.5 * scene.rows.short_dwell, SHORTEST)


def _changed(u: Array, applied: Array) -> BoolArray:
    """Whether the load is another one than that from which the clock runs, by what it does, (..., 3) -> (...)."""
    return np.asarray(_squared(u - applied) > SAME_LOAD**2 * np.maximum(_squared(u), _squared(applied)))


def _squared(v: Array) -> Array:
    return np.asarray((v * v).sum(axis=-1))


def _same_load_since(scene: Scene) -> Array:
    """The stamp from which the load of each row has acted, rows before with the same load counted, (n,), s."""
    u = scene.response.displacement
    since, applied = np.array(scene.load_since), u.copy()
    for rows in scene.rows.in_turn[1:]:
        before = scene.previous[rows]
        same = ~_changed(u[rows], applied[before])
        since[rows] = np.where(same, since[before], since[rows])
        applied[rows] = np.where(same[:, None], applied[before], applied[rows])
    return since


def time_constants(T: float, spread: float) -> list[float]:
    """s; one, or three of equal weight."""
    return [T] if spread <= 0.0 else [T * APART ** (spread * e) for e in (-1.0, 0.0, 1.0)]


class _Creep(ElasticLaw):
    def __init__(self, share: float, T: float, memory: float, spread: float, gears: Array) -> None:
        self._share, self._T, self._remembers = float(share), time_constants(float(T), spread), memory >= 0.5
        self._gears = gears
        self.reset()

    def reset(self) -> None:
        self._crept = [np.zeros(1)] * len(self._T)
        self._applied, self._age = np.zeros(3), 0.0

    def displacement(self, tick: Tick, elastic: Array, tcp: Array) -> Array:
        in_the_end = self._share * elastic
        in_the_end[tick.drives] += self._gears * tick.tau
        if self._remembers:
            steps = [1.0 - math.exp(-tick.dt / T) for T in self._T]
            self._crept = [c + step * (in_the_end - c) for c, step in zip(self._crept, steps, strict=True)]
            return np.asarray(np.mean(self._crept, axis=0))
        if _changed(tcp, self._applied):
            self._applied, self._age = tcp, 0.0
        self._age += tick.dt
        return np.asarray(np.mean([1.0 - math.exp(-self._age / T) for T in self._T]) * in_the_end)
