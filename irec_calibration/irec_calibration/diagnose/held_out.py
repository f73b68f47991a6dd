# SPDX-License-Identifier: Apache-2.0
"""Held-out error of a prepared model, and what people are shown of a model: the same whichever command asks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..effects import Evidence
from ..errors import SolveError
from ..identification.identify import fit, observe_with_force_noise
from ..identification.provenance import model_of
from ..identification.validation import FEWEST_POSES, HeldOut, held_out_error
from ..lengths import length
from ..model import Model, Term, total_displacement
from ..session.data import Session
from .apart import set_apart
from .evidence import Block
from .expected_error import ExpectedError, expected_error, with_error
from .remainder import Remainder
from .study import Study, prepare, study_of

MOST_ABOVE_PROMISED = 3.0  # times the held-out error of the linear problem that a fit may leave


@dataclass(frozen=True)
class Validated:
    """A model fitted to a session by itself, with its error on held-out poses: the figures that people see."""

    study: Study
    held_out: HeldOut

    @cached_property
    def expected_error(self) -> ExpectedError | None:
        """Of its predictions; None where the session does not tell."""
        return expected_error(self.study, self.held_out)

    @property
    def notes(self) -> tuple[str, ...]:
        """On the session, and on a fit that is not what it should be."""
        fitted = self.study.fit
        if fitted.converged:
            return self.study.session.notes
        effects = " + ".join(t.effect.id for t in fitted.terms)
        note = f"the fit of {effects} did not reach a minimum of the true residual; its values are the best that it came by"
        return (*self.study.session.notes, note)


def held_out(study: Study, block: Block | None = None) -> HeldOut:
    """Held-out error of the model of a study, with further columns where given (a trial)."""
    columns = study.base if block is None else study.base + block
    white = study.bench.held_out(columns) if len(study.bench.poses) > 1 else None
    return held_out_error(study.observation, white)


def held_out_beside(before: Study, after: Study) -> HeldOut:
    """Figures of a later model, with losses at the noise of an earlier one, so that the two can be compared (`gain`).

    Each model by itself has its own noise: what it leaves may pass for noise that wanders, or for bad readings, and cost little.
    """
    own = held_out(after)
    if after.observation is before.observation:
        return own
    beside = held_out(study_of(before.observation, after.terms))
    return replace(own, poses=beside.poses, loss=beside.loss)


def only_good_poses(found: HeldOut, study: Study, remainder: Remainder) -> HeldOut:
    """The same for a comparison (`gain`), without poses in which a row stands out, and those which alone show an effect: no other
    pose can predict a bad reading or a step."""
    rows = [r for p in remainder.bad_rows for r in p.structure.rows]
    steps = [t for t in study.terms if t.effect.evidence is Evidence.ONE_POSE and study.ready.kind == "loaded"]
    if steps:
        moved = study.observation.of(total_displacement(steps, study.observation.scene))
        rows += study.observation.rows[moved.any(axis=1)].tolist()
    keep = ~np.isin(found.poses, study.session.pose[rows])
    return replace(found, poses=found.poses[keep], loss=found.loss[keep]) if keep.sum() >= FEWEST_POSES else found


def fitted_truly(made: Validated) -> Validated:
    """The same, where the true residual is about what the linear problem promises.

    Raises:
        SolveError: it is far above: no values that were found are those of a minimum, and no figure says anything.
    """
    left, promised = made.study.fit.rms, made.held_out.rms_m
    if left > MOST_ABOVE_PROMISED * promised:
        raise SolveError(
            f"{made.study.session.name}: the model could not be fitted: it leaves {length(left)} where its linear problem"
            f" promises {length(promised)} (at most {MOST_ABOVE_PROMISED:g} times that is expected); check masses and centres of"
            " mass of the robot description and the payload (kg, m), and the units of joints, forces and markers"
        )
    return made


def validated(session: Session, terms: Sequence[Term]) -> Validated:
    """Fit a model to a session and hold out each pose, as ESTIMATOR says; nothing counts but the session and the terms.

    Raises:
        SolveError: the session can't be used with this model.
    """
    study = prepare(session, terms)
    return Validated(study, held_out(study))


def on_the_way(whole: Validated, terms: Sequence[Term]) -> Validated:
    """A version with fewer effects than a validated model, on the readings that count for that one and at its noise.

    So versions on the way differ by their effects alone, and cost little: to find out which readings count is most of the work.
    """
    study = replace(study_of(whole.study.observation, terms), apart=whole.study.apart)
    return Validated(study, held_out(study))


def solved(session: Session, terms: Sequence[Term]) -> tuple[Model, tuple[str, ...]]:
    """The model of a session: identified from all its rows, with its held-out error; and notes on the session.

    What `irec solve` and the service write.

    Raises:
        SolveError: the session can't determine it; says what is missing.
    """
    made = fitted_truly(validated(session, terms))
    study, result = made.study, made.study.fit
    whole = observe_with_force_noise(session, terms) if session.kind == "absolute" else study.observation
    if len(whole.rows) != len(study.observation.rows):  # models are compared on fewer poses than there are
        result = fit(study.terms, set_apart(whole, study.apart), prior_width=study.base.width)
    return with_error(model_of(result, held_out=made.held_out), made.expected_error), made.notes
