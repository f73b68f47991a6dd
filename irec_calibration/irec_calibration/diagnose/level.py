# SPDX-License-Identifier: Apache-2.0
"""The level of a session's noise, from what the session shows itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from ..identification.absolute import near_pairs
from ..identification.marker_noise import at_level, by_marker
from ..identification.noise import InferredNoise, counted_claim, level_of, pure_error
from ..identification.observe import Observation
from ..model import Term
from ..typing import Array
from .accidents import accidents
from .family import Family, Structure, family_of, with_bad_rows
from .ground import Ground
from .remainder import Part, Remainder, grow
from .sag import with_sag_as_seen
from .settings import SETTINGS, Settings
from .study import Study, study_of
from .wander import likelier, wandering

ROUNDS = 3  # in which the noise is shared out among markers, and the sag is seen by another share


@dataclass(frozen=True)
class Repeats:
    """What repeats of the same rows say.

    Attributes:
        chi2, dof: squared scatter within repeats in units of the noise in use; 0 where nothing was repeated.
        beside, beside_dof: squared residual of the model beside that scatter.
        p_value: that the model leaves so much more than repeats scatter.
    """

    chi2: float
    dof: int
    beside: float
    beside_dof: float
    p_value: float


def with_inferred_level(
    observation: Observation, terms: Sequence[Term], settings: Settings = SETTINGS
) -> tuple[Study, tuple[Part, ...], tuple[Part, ...]]:
    """A model fitted to a session at the noise level that model and remainder leave together; rows that stand out, and those of
    them that are accidents for certain."""
    observation = replace(observation, whiten=observation.whiten.scaled(1.0 / observation.whiten.level))
    first, remainder = _beside_wander(study_of(observation, terms), settings)
    level = level_beside(first, remainder, settings)
    found = first.observation
    study = study_of(at_level(found, level), first.terms)
    return study, remainder.bad_rows, accidents(first, remainder, settings)


def _beside_wander(first: Study, settings: Settings) -> tuple[Study, Remainder]:
    """A model under noise that wanders, as far as the session shows it, and its remainder."""
    family = family_in_view(first)
    beside = grow(first.bench, family, first.base, without=_follows_time)
    for _ in range(ROUNDS):
        seen = with_sag_as_seen(first, beside, settings)
        if seen is None:
            break
        first = study_of(seen, first.terms)
        family = family_in_view(first)
        beside = grow(first.bench, family, first.base, without=_follows_time)
    if first.session.kind == "loaded":
        observation = wandering(first.observation, left_beside(first, beside), settings)
        if observation.whiten.wander is None:
            return first, grow(first.bench, family, first.base)
        study = study_of(observation, first.terms)
        return study, grow(study.bench, family_of(study), study.base)
    first, family, beside = _beside_markers(first, family, beside, settings)
    # over a whole session noise that wanders and smooth functions of time pass for each other: each way to see it is weighed
    # together with the remainder that it leaves
    whole = grow(first.bench, family, first.base)
    best, most = (first, whole), _log_evidence(first, whole) + settings.nats_for_wander
    known: set[tuple[float, float, bool]] = set()
    residuals = [_left(Ground(first.bench, first.base), first), left_beside(first, beside), left_beside(first, whole)]
    while residuals:
        observation = wandering(first.observation, residuals.pop(0), settings)
        wander = observation.whiten.wander
        if wander is None or (kind := (wander.share, wander.time, wander.common is None)) in known:
            continue
        known.add(kind)
        study = study_of(observation, first.terms)
        rest = grow(study.bench, family_in_view(study), study.base)
        residuals.append(left_beside(study, rest))  # a fit under correlated noise takes up less of it
        if _log_evidence(study, rest) > most:
            best, most = (study, rest), _log_evidence(study, rest)
    return best


def family_in_view(study: Study) -> Family:
    """Every structure that can show in a session; in an absolute one bad readings may be such as stand out beside the others.

    An absolute session starts without springs: what stands out of its geometry is how far the arm sags. Functions of time are
    left aside, they would take up the step of a reflector that is seated anew.
    """
    family = family_of(study)
    if study.session.kind == "loaded":
        return family
    beside = left_beside(study, grow(study.bench, family, study.base, without=_follows_time))
    return with_bad_rows(family, study, study.fit.residual, beside)


def _beside_markers(study: Study, family: Family, remainder: Remainder, settings: Settings) -> tuple[Study, Family, Remainder]:
    """A model under noise that is shared out among the markers by what it and its remainder leave, its family and that remainder.

    What a model lacks shows in all markers of a pose alike. Shared out by the residual of the model alone, that would pass for
    noise that they have in common.
    """
    for _ in range(ROUNDS):
        again, residual = beside_markers(study, remainder), left_beside(study, remainder)
        if likelier(again, study.observation, residual) <= settings.nats_for_wander:
            break
        study = study_of(again, study.terms)
        family = family_in_view(study)
        remainder = grow(study.bench, family, study.base, without=_follows_time)
    return study, family, remainder


def beside_markers(study: Study, remainder: Remainder) -> Observation:
    """The observation with its noise shared out among the markers by what a model and its remainder leave."""
    if study.session.kind == "loaded":
        return study.observation
    ground = Ground(study.bench, remainder.block)
    taken_up = ground.taken_up.reshape(-1, 3, ground.taken_up.shape[1])
    return by_marker(study.observation, _left(ground, study), study.observation.whiten.undo(taken_up))


def _log_evidence(study: Study, remainder: Remainder) -> float:
    """Of model, remainder and noise together: comparable between noises of different correlation."""
    return remainder.log_evidence - 3.0 * study.observation.whiten.log_size


def log_evidence_beside(observation: Observation, terms: Sequence[Term]) -> float:
    """Log evidence of a model with a remainder and its noise, from the stated level on whatever the level in use: comparable
    between noises of different correlation."""
    return _log_evidence(*_at_stated_level(observation, terms))


def at_level_beside(observation: Observation, terms: Sequence[Term]) -> Observation:
    """The observation at the level of the noise that a model and its remainder leave."""
    study, remainder = _at_stated_level(observation, terms)
    return at_level(study.observation, level_beside(study, remainder))


def _at_stated_level(observation: Observation, terms: Sequence[Term]) -> tuple[Study, Remainder]:
    study = study_of(replace(observation, whiten=observation.whiten.scaled(1.0 / observation.whiten.level)), terms)
    return study, grow(study.bench, family_in_view(study), study.base)


def noise_left(study: Study, remainder: Remainder, family: Family, settings: Settings = SETTINGS) -> Observation | None:
    """The observation with the noise that a finished model and its remainder leave, where that is another than was assumed: much
    less, or correlated in time otherwise; else None."""
    observation = study.observation
    beside = remainder
    if study.session.kind == "loaded" and any(_follows_time(p.structure) for p in remainder.parts):
        beside = grow(study.bench, family, study.base, remainder.parts, without=_follows_time)
    residual = left_beside(study, beside)
    shared_out = wandering(beside_markers(study, beside), residual, settings)
    again = max(
        (wandering(observation, residual, settings), shared_out), key=lambda o: likelier(o, observation, residual)
    )  # fmt: skip
    if likelier(again, observation, residual) > settings.nats_for_wander:
        again_whiten = again.whiten
        squared = (again_whiten(residual) ** 2).sum()
        dof = max(residual.size - Ground(study.bench, beside.block).fitted, 1.0)
        return at_level(again, float(np.sqrt(squared / dof)))
    lower = level_beside(study, remainder, settings)
    return at_level(observation, lower) if lower < settings.weigh_again_below else None


def left_beside(study: Study, remainder: Remainder) -> Array:
    """What a model and a remainder leave of each observed row, (m, 3), m."""
    return _left(Ground(study.bench, remainder.block), study)


def _left(ground: Ground, study: Study) -> Array:
    return study.observation.whiten.undo(ground.residual.reshape(-1, 3))


def _follows_time(structure: Structure) -> bool:
    """Whether a structure could take up noise that wanders."""
    return "stamp" in structure.variables


def level_beside(study: Study, remainder: Remainder, settings: Settings = SETTINGS) -> float:
    """Level of the noise that a model and a remainder leave, in units of the one that is assumed."""
    ground = Ground(study.bench, remainder.block)
    dof = max(len(study.bench.b) - ground.fitted, 0.0)
    believed = settings.noise_dof * counted_claim(study.bench.noise.scale**2, ground.chi2, dof)
    return float(np.sqrt((believed + ground.chi2) / (settings.noise_dof + dof)))


def repeats_of(study: Study, ground: Ground) -> Repeats:
    """How the residual of a model compares with the scatter of repeats.

    Args:
        ground: the model, with a remainder or without one.
    """
    white = ground.residual.reshape(-1, 3)
    session, rows = study.session, study.observation.rows
    of_row = np.stack([session.pose[rows], session.load_case[rows], session.marker[rows]])
    keys = np.unique(of_row, axis=1, return_inverse=True)[1]
    chi2, dof = pure_error(white, keys.ravel())
    if study.ready.kind == "absolute" and dof < SETTINGS.fewest_repeats:
        pairs = near_pairs(study.observation, study.observation.whiten.undo(white))
        if len(pairs.first) >= SETTINGS.absolute.fewest_pairs:
            scatter = ((white[pairs.first] - white[pairs.second]) ** 2).sum() / 2.0
            # pairs that share rows are not independent: no more degrees of freedom than rows
            seen = len(np.unique(np.concatenate([pairs.first, pairs.second])))
            share = min(1.0, seen / 2.0 / len(pairs.first))
            chi2, dof = float(scatter * share), int(3 * len(pairs.first) * share)
    left = max(len(study.bench.b) - ground.fitted - dof, 0.0)
    beside = max(ground.chi2 - chi2, 0.0)
    p = 1.0
    if dof >= SETTINGS.fewest_repeats and left > 1.0:
        p = float(fdtrc(left, dof, beside / left / max(chi2 / dof, 1e-300)))
    return Repeats(chi2, dof, beside, left, p)


def inferred(
    study: Study, ground: Ground, repeats: Repeats, settings: Settings = SETTINGS, apart: Sequence[Part] = ()
) -> InferredNoise:
    """The level of the noise: from repeats alone where they contradict the model, else from repeats and residual.

    Args:
        apart: readings that stand out; how far they do is no size of the noise.
    """
    found = _inferred(study, ground, repeats, settings, apart)
    wander = study.observation.whiten.wander
    return found if wander is None else replace(found, wander_share=wander.share, wander_time_s=wander.time)


def _inferred(study: Study, ground: Ground, repeats: Repeats, settings: Settings, apart: Sequence[Part]) -> InferredNoise:
    usual = ~np.isin(study.observation.rows, [r for p in apart for r in p.structure.rows])
    whiten = study.observation.whiten.only(usual if usual.any() else ~usual)
    to_claim = whiten.level**2
    enough = repeats.dof >= settings.fewest_repeats
    if enough and repeats.p_value < settings.repeats_p:
        return level_of(whiten.claimed_floor, repeats.chi2 * to_claim, repeats.dof, "repeats", settings.noise_dof)
    dof = len(study.bench.b) - ground.fitted
    source = "claim" if dof < settings.fewest_repeats else "repeats and residual" if enough else "residual"
    return level_of(whiten.claimed_floor, ground.chi2 * to_claim, dof, source, settings.noise_dof)
