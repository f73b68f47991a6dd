# SPDX-License-Identifier: Apache-2.0
"""Predicted against measured, and how much of the residual could be explained at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import fdtr, fdtrc

from ..identification.identify import observe_with_force_noise, with_registration
from ..identification.observe import Observation
from ..identification.validation import rms
from ..lengths import length
from ..model import Term, total_displacement
from ..session.data import Session
from ..typing import Array
from .result import Comparison
from .settings import SETTINGS


def compare(session: Session, terms: Sequence[Term], sag_share: float = 1.0) -> Comparison:
    """Compare a model with values, as it is, with a session; noise of tracker, reference and force propagated.

    Stations and markers whose place is an unknown of the session are placed anew: they do not belong to the robot.

    Args:
        sag_share: see `Model.sag_share`.

    Raises:
        SolveError: the session has no usable row.
    """
    observation = observe_with_force_noise(session, terms, sag_share=sag_share)
    return compare_observed(observation, with_registration(terms, observation))


def _about_repeats(repeat_floor: float, observation: Observation, more: bool) -> str:
    """Repeats scatter more, or less, than the noise that the residual is weighed by."""
    floor = observation.whiten.floor
    if observation.whiten.level == 1.0:
        return (
            f"repeats scatter by {length(repeat_floor)}, the data sheet says {length(floor)}: the noise in session.yaml is too "
            f"{'small' if more else 'large'}, or the history of the load matters (hysteresis)"
        )
    seen = f"repeats scatter by {length(repeat_floor)}, all rows together show a noise of {length(floor)}"
    if more:
        return f"{seen}: something differs between a row and its repeat (the history of the load, or what moved in between)"
    return f"{seen}: part of what looks like noise comes back with the pose"


def compare_observed(observation: Observation, terms: Sequence[Term], fitted: int = 0) -> Comparison:
    """As `compare`, for an observation that exists already.

    Args:
        fitted: how many combinations of parameters were fitted to this very session.
    """
    session = observation.session
    predicted = observation.of(total_displacement(terms, observation.scene))
    residual = observation.y - predicted
    left, floor = rms(residual), observation.whiten.floor
    chi2 = float((observation.whiten(residual) ** 2).sum())
    repeat_floor, repeat_dof, ratio = repeat_noise(observation, residual)
    notes = list(session.notes)
    if repeat_dof >= SETTINGS.fewest_repeats:
        p = 2.0 * min(fdtrc(repeat_dof, 1e6, ratio), fdtr(repeat_dof, 1e6, ratio))
        if p < SETTINGS.stated_p:
            notes.append(_about_repeats(repeat_floor, observation, more=ratio > 1))
    variance_ratio = chi2 / max(residual.size - fitted, 1)
    if variance_ratio < SETTINGS.quieter_than_stated and observation.whiten.level == 1.0:
        notes.append(
            f"the residual, {length(left)}, is well below the noise that session.yaml states, {length(floor)}: "
            "the instruments "
            "did better than their data sheet, and an effect smaller than the stated noise would not be found; state their real "
            "repeatability under `noise`"
        )
    case = session.load_case[observation.rows]
    return Comparison(
        rows=observation.rows,
        measured=observation.y,
        predicted=predicted,
        residual=residual,
        rms_m=left,
        noise_floor_m=floor,
        repeat_floor_m=repeat_floor,
        explainable_m=float(np.sqrt(max(left**2 - floor**2, 0.0))),
        chi2_per_dof=variance_ratio,
        by_pose={int(p): rms(residual[observation.pose == p]) for p in observation.poses},
        by_load_case={session.case_name(int(j)): rms(residual[case == j]) for j in np.unique(case)},
        by_axis=tuple(float(np.sqrt((residual[:, a] ** 2).mean())) for a in range(3)),  # type: ignore[arg-type]
        notes=tuple(notes),
    )


def repeat_noise(observation: Observation, residual: Array) -> tuple[float, int, float]:
    """Noise from repeats of the same pose and load case, after what the model predicts for each.

    Returns:
        RMS per sample (m, NaN where nothing was repeated), degrees of freedom, variance relative to the data sheet's.
    """
    session, rows = observation.session, observation.rows
    keys: dict[tuple[int, int, int], list[int]] = {}
    for i, row in enumerate(rows):
        keys.setdefault((int(session.pose[row]), int(session.load_case[row]), int(session.marker[row])), []).append(i)
    variance = observation.whiten.sigma**2 + observation.whiten.sigma_reference**2
    total, dof, relative = 0.0, 0, 0.0
    for same in keys.values():
        if len(same) > 1:
            spread = ((residual[same] - residual[same].mean(axis=0)) ** 2).sum()
            total += float(spread)
            relative += float(spread / variance[same].mean())
            dof += 3 * (len(same) - 1)
    if not dof:
        return float("nan"), 0, 1.0
    return float(np.sqrt(3.0 * total / dof)), dof, relative / dof
