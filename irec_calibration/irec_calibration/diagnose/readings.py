# SPDX-License-Identifier: Apache-2.0
"""Whether the readings at the references of a loaded session carry an effect that was found in differences.

What an instrument does to a difference of some millimetres it does to the metres that it reads too: a scale of 3 %, seen in
differences, moves every reading by centimetres. What readings have beyond the controller's positions is known to a millimetre
or so, and follows smoothly from the joint angles. So they tell such a cause from a spring that passes for it in differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..effects import Cause, Effect, Evidence, known_effects
from ..effects.traits import Family
from ..identification.observe import beyond_controller
from ..model import Term, displacement_of
from ..typing import Array, IntArray
from .evidence import Block
from .lasting import LASTING, usually_beyond
from .priors import FACTORS
from .scatter import Scattered
from .settings import SETTINGS
from .study import Study
from .tool_weight import odds_at_references

WIDEST = float(FACTORS.max())  # of the prior of a value, in multiples of its width


@dataclass(frozen=True)
class Readings:
    """What the readings at the references have beyond the controller's positions and beyond what else of the kind is in a model.

    Attributes:
        rows: of the session, one for each reference; values: (rows, 3), m.
        ground: what robots and stations usually leave, columns in standard deviations, (rows, 3, p), m.
        prove: whether they may show an effect; beside one of which they know some combinations only (a geometry error that
            differences show, of centimetres) they may but be against it.
    """

    rows: IntArray
    values: Array
    ground: Array
    prove: bool = True

    @cached_property
    def log_evidence(self) -> float:
        """Without any further cause."""
        return Scattered(self.ground).log_evidence(self.values)

    def beside(self, columns: Array) -> Scattered:
        """With further columns, (rows, 3, p), m."""
        return Scattered(np.concatenate([self.ground, columns], axis=2))


def readings_of(study: Study, effect: Effect) -> Readings | None:
    """The readings that may carry an effect; None where it does not show in them by itself (`Effect.in_readings`), or where
    too few poses were measured."""
    if not effect.in_readings or study.ready.kind != "loaded":
        return None
    scene, session = study.ready, study.session
    rows = np.unique(scene.reference[study.observation.rows])
    seen = beyond_controller(session, scene)
    rows = rows[np.isfinite(seen[rows]).all(axis=1)]
    if len(np.unique(session.pose[rows])) < 2 * LASTING.fewest:
        return None
    values, left_open, prove = seen[rows], [], True
    for other in study.terms:
        if other.effect.id == effect.id:
            continue
        if other.effect.in_readings or _in_course(other.effect):
            values = values - displacement_of(other, scene)[rows]
        if _in_course(other.effect):
            left_open.append(_within_errors(other, study)[rows])
        elif other.effect.in_readings and other.effect.chosen_by_poses:
            left_open.append(_any_of_this_order(study, other.effect, other.theta(other.effect.parameters(study.ready)), rows))
            prove = False
    ground = [_placed(scene.station[rows]), usually_beyond(study, rows), *left_open]
    return Readings(rows, values, np.concatenate(ground, axis=2), prove)


def _in_course(effect: Effect) -> bool:
    """Whether an effect moves readings in the course of a session, whatever the robot does (a drift, a bumped station): what is
    known of it is no error of the instrument that is asked about."""
    return effect.family is Family.TIME and effect.cause is not Cause.LOAD


def _within_errors(term: Term, study: Study) -> Array:
    """How far a term may move each row within the errors of its values, columns in standard deviations, (n, 3, p), m."""
    parameters = term.effect.parameters(study.ready)
    errors = np.array([term.estimates[p.name].se if p.name in term.estimates else 0.0 for p in parameters])
    errors = np.where(np.isfinite(errors), errors, 0.0)
    columns: Array = (term.effect.regressor(study.ready, term.theta(parameters)) * errors)[:, :, errors > 0.0]
    return columns


def carried(study: Study, term: Term) -> float:
    """Log odds that the readings at the references carry an effect, over that they do not.

    Args:
        study: a model of a loaded session with the effect in it.
        term: that effect, with its values.

    Returns:
        natural log; 0 where readings don't tell (`readings_of`). Of an effect of whose values readings tell only together
        (`Effect.chosen_by_poses`) never above 0.
    """
    known = readings_of(study, term.effect)
    if known is None:
        return 0.0
    scene, rows = study.ready, known.rows
    parameters = term.effect.parameters(scene)
    theta = term.theta(parameters)
    if term.effect.chosen_by_poses:
        return min(_of_this_order(study, term.effect, known, theta), 0.0)
    errors = np.array([term.estimates[p.name].se if p.name in term.estimates else 0.0 for p in parameters])
    # what differences know of a value only together with others, they know by its order of magnitude; and where springs and other
    # causes are as likely as they are, no worse than the fit does
    errors = np.where(np.isfinite(errors), errors, np.abs(theta))
    fitted_errors = study.errors_of(term.effect.id)
    errors = np.array([min(e, fitted_errors.get(p.name, np.inf)) for e, p in zip(errors, parameters, strict=True)])
    moved = displacement_of(term, scene)[rows]
    within = (term.effect.regressor(scene, theta)[rows] * errors)[:, :, errors > 0.0]
    with_it, x = known.beside(within).fitted(known.values - moved)
    odds = max(with_it - known.log_evidence, -term.effect.readings_against)
    # something else moves the readings, where that would be far from the value that differences show
    elsewhere = np.abs(x[known.ground.shape[2] :]).max(initial=0.0) > LASTING.farthest
    return min(odds, 0.0) if elsewhere or not known.prove else odds


def _weighed(study: Study, term: Term) -> float:
    """Log odds that the force sensor reads a wrong tool weight at the references, over that it does not; 0: it can't tell."""
    session, value = study.session, next(iter(term.estimates.values()))
    if study.ready.kind != "loaded" or session.contact is not None:  # there references bear a force
        return 0.0
    mass_se = value.se if np.isfinite(value.se) else abs(value.value)
    return odds_at_references(study.observation.scene, session.noise.force_n, value.value, mass_se)


def against(study: Study, term: Term) -> str:
    """Why an effect can't be what the differences show as it: the readings at the references do not have it; else empty.

    They are against it by what a name needs over another (`nats_to_prefer`); against a tool weight by any odds, since in
    differences it shows by what it changes in the springs only, which others do too. Of an effect of whose values differences
    know some combinations only, other causes that are still missing bend what they show: these readings are against it where
    they are so plainly (`nats_plainly`). Where readings can be against an effect by so much only (`Effect.readings_against`),
    what differences show may outweigh them.
    """
    also = ""
    if term.effect.evidence is Evidence.REFERENCE_READINGS:
        odds, least = _weighed(study, term), 0.0
    else:
        vague = term.effect.chosen_by_poses
        odds, least = carried(study, term), -(SETTINGS.nats_plainly if vague else SETTINGS.nats_to_prefer)
        if odds < least and np.isfinite(term.effect.readings_against):
            odds, also = odds + _by_differences(study, term.effect.id), " with those of the differences"
    if odds >= least:
        return ""
    return f"the readings at the references do not have it (log odds {odds:.1f}{also}, at least {least:g} needed)"


def _by_differences(study: Study, effect_id: str) -> float:
    """Log evidence of the differences for an effect of a model, everything else as likely as it is."""
    others = [i for i, owner in enumerate(study.owners) if owner != effect_id]
    with_it, without = (study.bench.posterior(b).log_evidence for b in (study.base, study.base.take(others)))
    return with_it - without


def proved(study: Study, effect: Effect) -> bool:
    """Whether readings have an effect beside a model without it, by what a name needs, and differences bear out their values."""
    return by_readings(study, effect)[0] > SETTINGS.nats_to_name and along_readings(study, effect) > SETTINGS.nats_to_prefer


def _of_this_order(study: Study, effect: Effect, known: Readings, theta: Array) -> float:
    """Log odds that the readings have an effect with values of the order of theta, (p,), over what else they may have.

    For an effect of whose many values differences and readings each know some combinations only.
    """
    present = {t.effect.id for t in study.terms}
    others = [e for e in known_effects().values() if e.in_readings and e.id not in present and not study.why_not(e)]
    best = max([by_readings(study, e)[0] for e in others], default=0.0)
    return _with_any_of_this_order(study, effect, known, theta) - max(best, 0.0)


def could_carry(study: Study, term: Term) -> float:
    """Log odds, natural log, that the readings have an effect of whose many values they know some combinations only
    (`Effect.chosen_by_poses`), at values of the order that differences show, over that they do not; 0 of any other."""
    known = readings_of(study, term.effect) if term.effect.chosen_by_poses else None
    if known is None:
        return 0.0
    return _with_any_of_this_order(study, term.effect, known, term.theta(term.effect.parameters(study.ready)))


def _with_any_of_this_order(study: Study, effect: Effect, known: Readings, theta: Array) -> float:
    """Log odds that the readings have an effect with any values of the order of theta, (p,), over that they do not: of those
    parameters that differences show, or of all."""
    own = _any_of_this_order(study, effect, theta, known.rows)
    some = (columns for columns in (own, own[:, :, theta != 0.0]) if columns.shape[2])
    odds = [known.beside(c).log_evidence(known.values) - known.log_evidence for c in some]
    return float(np.logaddexp.reduce(odds) - np.log(len(odds))) if odds else 0.0


def _any_of_this_order(study: Study, effect: Effect, theta: Array, rows: IntArray) -> Array:
    """What an effect with any values of the order of theta, (p,), moves in some rows, columns in standard deviations,
    (rows, 3, p), m."""
    scale = np.array([p.scale for p in effect.parameters(study.ready)])
    size = np.sqrt(np.mean((theta / scale)[theta != 0.0] ** 2)) if theta.any() else 1.0
    moved: Array = effect.regressor(study.ready, np.zeros(len(theta)))[rows] * (scale * size)
    return moved


def by_readings(study: Study, effect: Effect) -> tuple[float, Array]:
    """Log odds for an effect by the readings alone, beside a model without it, and its values there, (p,); 0 and none where
    readings don't tell, or tell of its parameters only together (`Effect.chosen_by_poses`)."""
    known = None if effect.chosen_by_poses else readings_of(study, effect)
    if known is None:
        return 0.0, np.zeros(0)
    parameters = effect.parameters(study.ready)
    scale = WIDEST * np.array([p.scale * p.prior_width for p in parameters])
    own = effect.regressor(study.ready, np.zeros(len(parameters)))[known.rows] * scale
    with_it, x = known.beside(own).fitted(known.values)
    odds = with_it - known.log_evidence
    return odds if known.prove else min(odds, 0.0), x[known.ground.shape[2] :] * scale


def along_readings(study: Study, effect: Effect) -> float:
    """Log evidence of the differences for an effect as the readings show it, beside a model without it: one size is left open.

    It is more than that of an effect all of whose values differences have to find.
    """
    theta = by_readings(study, effect)[1]
    if not theta.any():
        return 0.0
    moved = study.columns((effect.regressor(study.ready, theta) @ theta)[:, :, None])
    free = np.full(1, np.inf)
    with_it = study.bench.posterior(study.base + Block(moved, -free, free, np.ones(1)))
    return with_it.log_evidence - study.bench.posterior(study.base).log_evidence


def _placed(station: IntArray) -> Array:
    """Place of each station in base_link, of which differences know nothing: in metres, (rows, 3, 3 stations)."""
    return np.concatenate([(station == s)[:, None, None] * np.eye(3) for s in np.unique(station)], axis=2)
