# SPDX-License-Identifier: Apache-2.0
"""Identification of any list of effects from a session: Eq. (1)-(19).

The observation system is in `system`, what it tells about each parameter in `identifiability`, the model made of a fit in
`provenance`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import find_effect
from ..effects.disc_compliance import DiscCompliance
from ..model import EIGHTEEN_DOF, Combination, Term, blank_model, elastic_response, total_displacement
from ..model.springs import ROWS_KEPT
from ..robot.ratings import rated_torque, rating_known
from ..session.data import Session
from ..typing import Array, BoolArray
from .absolute import base_terms, completed, near_pairs, noted, repeating, with_better_joints
from .force_readings import scatter, without_noise
from .gauss_newton import SETTLED, Minimum, fitted
from .identifiability import identifiability
from .marker_noise import by_marker
from .observe import Observation, observe
from .outliers import again, treated
from .system import System
from .validation import rms


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        terms: the terms with values.
        residual: measured minus predicted, in base_link, (m, 3), m.
        rms: sqrt(mean |r|^2) over samples, m.
        chi2: sum of whitened squared residuals; dof: equations minus rank.
        rank: numerical rank of the observation matrix.
        combinations: what is known of parameters that can't be told apart.
        system: the linearised equations about the values.
        converged: the iteration reached a minimum of the true residual; where not, the best values that it came by are here.
    """

    terms: tuple[Term, ...]
    observation: Observation
    residual: Array
    rms: float
    chi2: float
    dof: int
    rank: int
    condition: float
    combinations: tuple[Combination, ...]
    system: System
    converged: bool = True


def identify(session: Session, terms: Sequence[Term], sag_share: float = 1.0) -> Fit:
    """Identify a model from a session: Eq. (1)-(19).

    Args:
        sag_share: see `Model.sag_share`.

    Raises:
        SolveError: the session can't determine it; says what is missing.
    """
    observation = observe_with_force_noise(session, terms, sag_share=sag_share)
    return fit(terms, observation)


def fit(
    terms: Sequence[Term],
    observation: Observation,
    *,
    prior_width: Array | None = None,
    settled: float = SETTLED,
    start: Minimum | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Fit:
    """Fit all parameters of the terms jointly (Gauss-Newton with bounds and step control; one step where all is linear).

    Args:
        terms: effects with start values.
        observation: what was measured.
        prior_width: see `solve`.
        settled, start: see `fitted`.
        cancelled: called between iterations; returning True stops.

    Raises:
        SolveError: fewer equations than needed, or an effect of the model can't act on this session.
        Cancelled: as asked for.
    """
    found = fitted(terms, observation, prior_width=prior_width, settled=settled, start=start, cancelled=cancelled)
    return _describe(found, observation)


def _describe(found: Minimum, observation: Observation) -> Fit:
    terms, system = found.terms, found.linearised(observation)
    residual = observation.y - observation.of(found.moved)
    chi2 = float((observation.whiten(residual) ** 2).sum())
    named = list(zip(system.owner, system.parameters, strict=True))
    values = np.array([terms[i].estimates[p.name].value for i, p in named])
    known = identifiability(system, [f"{terms[i].effect.id}.{p.name}" for i, p in named], values)
    dof = residual.size - known.rank
    # an absolute session's residual holds what the robot does besides: errors that only the data sheet backs would be too small
    excess = max(1.0, float(np.sqrt(chi2 / max(dof, 1)))) if observation.session.kind == "absolute" else 1.0
    return Fit(
        terms=_with_errors(terms, system, excess * known.se, known.alone),
        observation=observation,
        residual=residual,
        rms=rms(residual),
        chi2=chi2,
        dof=dof,
        rank=known.rank,
        condition=known.condition,
        combinations=tuple(replace(c, se=excess * c.se) for c in known.combinations),
        system=system,
        converged=found.converged,
    )


def _with_errors(terms: tuple[Term, ...], system: System, se: Array, single: BoolArray) -> tuple[Term, ...]:
    out = []
    for i, term in enumerate(terms):
        estimates = dict(term.estimates)
        for j, (owner, p) in enumerate(zip(system.owner, system.parameters, strict=True)):
            if owner == i:
                value = estimates[p.name].value
                well_known = bool(single[j] and se[j] < 0.5 * max(abs(value), p.scale))
                estimates[p.name] = replace(estimates[p.name], se=float(se[j]), identified=well_known)
        out.append(replace(term, estimates=estimates))
    return tuple(out)


def observe_with_force_noise(
    session: Session, terms: Sequence[Term], lasting: Sequence[int] = (), sag_share: float = 1.0
) -> Observation:
    """The observation of a session without rows that are plainly wrong (`outliers`), with the force sensor's noise carried
    through a first fit of the terms' springs, and left out of the forces where the arm does not follow it (`force_readings`):
    what every fit, comparison and verdict rests on.

    What was found stands in the observation's `bad` and in the notes of its session.

    Args:
        lasting: see `outliers.treated`. sag_share: see `Model.sag_share`.
    """
    whole = _whole(session).seeing(sag_share)
    first = treated(whole, terms, lasting)
    if session.kind == "absolute":
        residual = first.y - first.of(fitted(terms, first).moved)
        note = repeating(near_pairs(first, residual))
        return by_marker(replace(noted(first, note), repeating=note) if note else first, residual)
    if session.noise.force_n <= 0.0 or not any(t.effect.elastic for t in terms):
        return first
    springs = fitted([t for t in terms if t.effect.elastic], first)
    compliance = elastic_response(springs.terms, first.scene).compliance[:, :, :3]
    found = scatter(first, first.y - first.of(springs.moved), compliance)
    noise = session.noise.force_n
    if found is not None and (found.followed < 1.0).any():
        noise = found.noise_left(session)
        whole = observe(without_noise(whole.session, found)).seeing(sag_share)
        first = replace(first, session=replace(first.session, notes=(*first.session.notes, whole.session.notes[-1])))
    return again(whole.with_force_noise(compliance, noise), first)


def _whole(session: Session) -> Observation:
    """The observation of all rows of a session, with what is assumed of it in its notes. Many models are fitted to one session,
    and what springs of the arm do in its rows is the same for all: so a session that is not large keeps it."""
    known = session.kept.get("observation")
    if isinstance(known, Observation):
        return known
    whole = observe(session.kept.get("seated anew") or _with_notes(with_better_joints(session)))
    if len(session) <= ROWS_KEPT:
        session.kept["observation"] = whole
    return whole


def keep_seated_anew(session: Session, marker: int, stamp: float, words: str) -> None:
    """From now on take a reflector of a session as another one from a moment on, at which it was seated anew.

    Args:
        session: as it was read. words: what happened, for people.
    """
    as_used = _whole(session).session
    one = as_used.markers[marker]
    anew = replace(one, name=f"{one.name}, from {stamp:g} s on", known=False, anew=words)
    later = (as_used.marker == marker) & (as_used.stamp >= stamp)
    markers = (*as_used.markers, anew)
    session.kept["seated anew"] = replace(as_used, markers=markers, marker=np.where(later, len(as_used.markers), as_used.marker))
    session.kept.pop("observation", None)


def _with_notes(session: Session) -> Session:
    """A session with notes on what is assumed of it: ratings of drives, external axes that move nothing."""
    notes = []
    robot = session.robot
    known = rating_known(robot)
    if not known.all():
        rated = rated_torque(robot)
        named = ", ".join(f"{n} {r:.3g} N m" for n, r, k in zip(robot.joint_names, rated, known, strict=True) if not k)
        notes.append(f"the robot description gives no torque limit for some drives; taken from the arm's own weight: {named}")
    carried = {a.name for a in session.ext_axes} | set(robot.branch_joints)
    loose = [n for n in session.ext if n not in carried]
    if loose:
        named = ", ".join(f"ext_{n}" for n in loose)
        notes.append(f"{named}: no joint of the robot description and none of ext_axes; used as a variable only")
    return replace(session, notes=(*session.notes, *notes)) if notes else session


def default_terms(session: Session) -> tuple[Term, ...]:
    """What a fit starts from where no model is named: 18 DOF, or the geometric model for an absolute session."""
    return base_terms() if session.kind == "absolute" else with_disc(blank_model(EIGHTEEN_DOF), session)


def with_disc(terms: Sequence[Term], session: Session) -> tuple[Term, ...]:
    """The terms, with that of the disc where the contact stands in for the tracker and nobody has stated its stiffness."""
    there = any(t.effect.id == DiscCompliance.id for t in terms)
    wanted = session.contact is not None and not session.contact.disc_known
    return (*terms, Term(find_effect(DiscCompliance.id))) if wanted and not there else tuple(terms)


def with_registration(terms: Sequence[Term], observation: Observation) -> tuple[Term, ...]:
    """A model's terms with stations and markers placed for this very session and everything else as it is.

    Where the instruments stand belongs to a session, not to the robot: it is fitted anew before a model is compared with one.
    """
    if observation.session.kind != "absolute":
        return tuple(terms)
    rest = [t for t in terms if not t.effect.registers]
    placed = observation.y - observation.of(total_displacement(rest, observation.scene))
    placing = [t for t in completed((), observation)]
    if not placing:
        return tuple(rest)
    return (*fit(placing, replace(observation, y=placed)).terms, *rest)
