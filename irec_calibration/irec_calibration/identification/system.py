# SPDX-License-Identifier: Apache-2.0
"""The observation system Eq. (14)-(18) of any list of effects and its bounded solution Eq. (19).

Rows are weighted by the noise of the instruments, rows of one pose share the noise of their reference. Columns are scaled by
typical magnitudes, since compliances of 1e-7 would stop solvers early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import Parameter, parameters_of
from ..effects.scene import Scene
from ..errors import SolveError
from ..model import Estimate, Term, prepared, regressors, total_displacement
from ..typing import Array, BoolArray, IntArray
from .bounded import solve_bounded_gram
from .observe import Observation

RIDGE = 1e-10  # relative to the largest diagonal entry: makes the solution unique along unobserved directions


@dataclass(frozen=True)
class System:
    """The linearised observation system of some terms, whitened and scaled; 3m equations, p parameters.

    Attributes:
        A: (3m, p), standard deviations per scaled parameter.
        b: right side, (3m,), in standard deviations: residual plus A times the values linearised at.
        scale: physical value of one scaled unit, (p,).
        parameters: (p,), in order of the terms; owner: index of the term of each.
        lower, upper: bounds in scaled units, (p,).
        centre: value of each scaled parameter from which x counts, (p,): the present one where nothing but the session says
            anything about it (`Parameter.flat`), else 0.
        pose: pose number of each equation, (3m,).
    """

    A: Array
    b: Array
    scale: Array
    parameters: tuple[Parameter, ...]
    owner: tuple[int, ...]
    lower: Array
    upper: Array
    centre: Array
    pose: IntArray


def linearise(terms: Sequence[Term], observation: Observation, moved: Array | None = None) -> System:
    """The observation system of the terms about their values, without parameters that enter by a grid (held fixed).

    A term that names some of its effect's parameters has only those; the others are held where they start.

    Args:
        moved: displacement by the terms in each row of the session, (n, 3), m, where it is known already.
    """
    scene = observation.scene
    ready = prepared(terms, scene)
    moved = total_displacement(terms, scene, ready) if moved is None else moved
    blocks, parameters, owner = [], [], []
    for i, (term, block) in enumerate(zip(terms, regressors(terms, scene, ready), strict=True)):
        own = parameters_of(term.effect, scene)
        free = term.free(own)
        blocks.append(block[:, :, free])
        parameters += [own[j] for j in free]
        owner += [i] * len(free)
    if not parameters:
        raise SolveError("the model has no parameter that this session could determine")
    scale = np.array([p.scale for p in parameters])
    A_rows = observation.of(np.concatenate(blocks, axis=2)) * scale
    at_none = System(
        A=observation.whiten(A_rows).reshape(-1, len(parameters)),
        b=np.zeros(0),
        scale=scale,
        parameters=tuple(parameters),
        owner=tuple(owner),
        lower=np.array([p.lower for p in parameters]) / scale,
        upper=np.array([p.upper for p in parameters]) / scale,
        centre=np.zeros(len(parameters)),
        pose=np.repeat(observation.pose, 3),
    )
    return moved_to(at_none, terms, observation, moved)


def moved_to(system: System, terms: Sequence[Term], observation: Observation, moved: Array) -> System:
    """The equations about the values of the terms, with the derivatives that they have.

    Args:
        moved: displacement by the terms in each row of the session, (n, 3), m.
    """
    x = values_of(terms, system) + system.centre
    centre = np.where([p.flat for p in system.parameters], x, 0.0)
    residual = observation.whiten(observation.y - observation.of(moved)).ravel()
    away = centre - system.centre
    return replace(
        system, b=residual + system.A @ (x - centre), lower=system.lower - away, upper=system.upper - away, centre=centre
    )


def values_of(terms: Sequence[Term], system: System) -> Array:
    """Present values of the parameters, scaled, counted from the system's centre, (p,)."""
    at = [terms[i].estimates[p.name].value for i, p in zip(system.owner, system.parameters, strict=True)]
    return np.array(at) / system.scale - system.centre


def solve(system: System, rows: BoolArray | None = None, prior_width: Array | None = None) -> Array:
    """Bounded least squares, Eq. (19), in scaled units, (p,).

    Args:
        system: from `linearise`.
        rows: mask of equations to use, (3m,); all where None.
        prior_width: standard deviation of a normal prior about 0 for each scaled parameter, (p,); none where None.
    """
    A, b = (system.A, system.b) if rows is None else (system.A[rows], system.b[rows])
    G, h = A.T @ A, A.T @ b
    ridge = RIDGE * max(float(G.diagonal().max()), 1e-30)
    extra = np.full(len(h), ridge) if prior_width is None else np.maximum(1.0 / prior_width**2, ridge)
    return solve_bounded_gram(G + np.diag(extra), h, system.lower, system.upper)


def with_values(terms: Sequence[Term], system: System, x: Array) -> tuple[Term, ...]:
    """The terms with the scaled values x (counted from the system's centre); parameters that are not part of the system keep
    theirs."""
    out = []
    for i, term in enumerate(terms):
        estimates = dict(term.estimates)
        for j, (owner, p) in enumerate(zip(system.owner, system.parameters, strict=True)):
            if owner == i:
                value = float((x[j] + system.centre[j]) * system.scale[j])
                estimates[p.name] = Estimate(value, unit=p.unit, lower=p.lower, upper=p.upper)
        out.append(replace(term, estimates=estimates))
    return tuple(out)


def free_regressors(terms: Sequence[Term], scene: Scene) -> list[Array]:
    """Regressors of the parameters that `linearise` keeps (those without a grid), list of (n, 3, p)."""
    out = []
    for term, block in zip(terms, regressors(terms, scene), strict=True):
        out.append(block[:, :, term.free(parameters_of(term.effect, scene))])
    return out
