# SPDX-License-Identifier: Apache-2.0
"""A fitted model as a rival sees it: what it predicts of samples that were not measured, and what it could still make up for.

The effect in question is free in all its axes and in its shape, within its priors: a model that is wrong takes whatever form
of it helps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects import parameters_of
from ..identification.observe import Observation
from ..identification.system import linearise
from ..identification.validation import floored
from ..model import Estimate, Term, total_displacement
from ..typing import Array
from .study import Study

SHAPE_STEP = 0.05  # relative, for derivatives by a shape value
SHAPE_WIDTH = 0.7  # of the logarithm of a shape value: a factor of two either way, one standard deviation


class Freed:
    """A fitted model with the effects in question free.

    Attributes:
        covariance: of its parameters after its session, in the units of `columns`, (p, p).
    """

    def __init__(self, study: Study, effect_ids: set[str]) -> None:
        self._terms = study.terms
        scene = study.ready
        asked = [t.effect.id in effect_ids for t in study.terms]
        own = [parameters_of(t.effect, scene) for t in study.terms]
        self._freed = tuple(t.whole(p) if a else t for t, p, a in zip(study.terms, own, asked, strict=True))
        self._shapes = [  # but places, which have no logarithm
            (i, p.name) for i, t in enumerate(self._freed) if asked[i] for p in own[i]
            if p.grid and not p.kinds and not p.shapes and p.name in t.estimates and t.estimates[p.name].value > 0.0
        ]  # fmt: skip
        A = self.columns(study.observation)
        G = A.T @ A
        precision = floored(self._width(study) ** -2.0, G, study.bench.rounding)
        self.covariance = np.asarray(np.linalg.inv(G + np.diag(precision)))

    def seen(self, observation: Observation) -> Array:
        """What the rows of an observation see of the model, (m, 3), m."""
        return observation.of(total_displacement(self._terms, observation.scene))

    def columns(self, observation: Observation) -> Array:
        """Derivatives of the whitened observation by the parameters, scaled, and the logarithms of the shape values, (3m, p)."""
        terms, scene = self._freed, observation.scene
        here = total_displacement(terms, scene)
        by_shape = []
        for i, name in self._shapes:
            e = terms[i].estimates[name]
            further = {**terms[i].estimates, name: Estimate(e.value * float(np.exp(SHAPE_STEP)))}
            there = (*terms[:i], replace(terms[i], estimates=further), *terms[i + 1 :])
            by_shape.append(observation.whiten(observation.of(total_displacement(there, scene) - here)).ravel() / SHAPE_STEP)
        return np.column_stack([linearise(terms, observation, here).A, *by_shape])

    def _width(self, study: Study) -> Array:
        """Prior standard deviations; those of axes that the fitted model does without are as of its others."""
        known = {(o, p.name): w for o, p, w in zip(study.owners, study.parameters, study.base.width, strict=True)}
        out = []
        for term in self._freed:
            own = parameters_of(term.effect, study.ready)
            usual = [w for (owner, _), w in known.items() if owner == term.effect.id]
            for i in term.free(own):
                width = float(np.median(usual)) if usual else own[i].prior_width
                out.append(known.get((term.effect.id, own[i].name), width))
        return np.array([*out, *[SHAPE_WIDTH] * len(self._shapes)])


def in_question(name: str, terms: tuple[Term, ...]) -> set[str]:
    """Effects of a model that a question names: an id, an id with its axes, or several joined by `+`."""
    return {t.effect.id for t in terms if t.effect.id in {n.partition(":")[0] for n in name.split("+")}}
