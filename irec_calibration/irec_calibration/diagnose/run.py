# SPDX-License-Identifier: Apache-2.0
"""Compare, where, which: the whole diagnosis of one session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..errors import Cancelled, SolveError
from ..identify import default_terms
from ..model import Estimate, Model, Term
from ..provenance import model_of
from ..session.data import Session
from .candidates import Trial
from .comparison import compare_observed
from .flexible import flexible_gain
from .held_out import HeldOut, gain, held_out
from .judge import Judgement, cut_down, judge, p_value
from .next_poses import next_measurements
from .parts import parts_in, settle
from .result import Candidate, Diagnosis, Measurement
from .search import NATS_TO_NAME, NATS_TO_SEPARATE, Hypothesis, Search, refit, search
from .study import Study, prepare
from .tool_weight import Readings, reference_readings
from .where import views
from .wording import put_in_words

Progress = Callable[[float, str], None]
TOOL_WEIGHT = "tool_weight"
STATION_SHIFT = "station_shift"


def start_terms(session: Session) -> tuple[Term, ...]:
    """The terms that a diagnosis starts from where no model is named."""
    return default_terms(session)


def diagnose(
    session: Session,
    model: Model | None = None,
    *,
    progress: Progress | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Diagnosis:
    """Find where a model fails on a session and which effect is missing.

    Args:
        session: loaded or absolute.
        model: its list of effects is refitted to the session; the 18-DOF model (absolute: the geometric one) where None.
        progress: called with the share done (0..1) and what is being done.
        cancelled: asked often; True stops with Cancelled.

    Raises:
        SolveError: the session can't be used with this model.
        Cancelled: as asked for.
    """
    return examine(session, model, progress=progress, cancelled=cancelled)[0]


def examine(
    session: Session,
    model: Model | None = None,
    *,
    progress: Progress | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> tuple[Diagnosis, Search, Judgement]:
    """As `diagnose`, with what the diagnosis rests on."""
    say = progress or (lambda share, what: None)

    def check() -> None:
        if cancelled is not None and cancelled():
            raise Cancelled("the diagnosis was cancelled")

    say(0.0, "fitting the model")
    study = prepare(session, model.terms if model else start_terms(session))
    check()
    say(0.1, "trying every effect of the catalogue")
    found = search(study, check)
    say(0.6, "looking for structure without a name")
    readings = reference_readings(study.ready, session.noise.force_n) if session.kind == "loaded" else None
    verdict = judge(found, readings, check)
    say(0.75, "held-out error of each candidate")
    candidates = _candidates(found, verdict, readings, check)
    say(0.85, "views of the residual")
    comparison = compare_observed(study.observation, study.terms, study.fit.rank)
    where = views(study.observation, comparison.residual, comparison.predicted)
    check()
    say(0.9, "what a flexible regression could remove")
    left = verdict.chosen.study if verdict.chosen else study
    flexible = flexible_gain(left.observation, left.fit.residual)
    check()
    say(0.95, "what to measure next")
    planned = _next(found, verdict)
    result = Diagnosis(
        session=session.name,
        model=replace(model_of(study.fit, cv_rms=verdict.held_out_base.rms_m), history=model.history if model else ()),
        fit_rms_m=study.fit.rms,
        cv_rms_m=verdict.held_out_base.rms_m,
        comparison=comparison,
        verdict=put_in_words(study, found, verdict, candidates, comparison, flexible, planned),
        candidates=candidates,
        skipped=found.skipped,
        where=where,
        next_measurements=planned,
        flexible_gain_m=flexible,
        notes=comparison.notes,
    )
    say(1.0, "done")
    return result, found, verdict


def _candidates(found: Search, verdict: Judgement, readings: Readings | None, check: Callable[[], None]) -> tuple[Candidate, ...]:
    """The table of candidates, by error on held-out poses."""
    exact = {h.ids[0]: h for h in found.singles}
    base = verdict.held_out_base
    out = []
    for trial in found.trials:
        check()
        if trial.effect.id == TOOL_WEIGHT:
            if readings is not None:
                out.append(_weight_candidate(trial, readings, base, len(found.trials)))
            continue
        known = exact.get(trial.effect.id)
        hypothesis = known
        if hypothesis is None and trial.log_evidence > NATS_TO_NAME:
            hypothesis = refit(found.study, found.study, trial)
        if hypothesis is not None:
            hypothesis = _needed_parts_only(hypothesis, verdict)
        term = hypothesis.added[0] if hypothesis else _term_of(trial, found.study)
        after = held_out(hypothesis.study) if hypothesis else held_out(found.study, trial.best.block)
        evidence = known.log_evidence if known else trial.log_evidence
        mean, se, _ = gain(base, after)
        out.append(
            Candidate(
                trial.effect.id, parts_in(term, found.study), term, after.rms_m, after.rms_se_m, mean, se, evidence,
                p_value(trial, found.study, len(found.trials)), _plausible(trial, term, found.study),
                {n: {"value": e.value, "se": e.se, "unit": e.unit} for n, e in term.estimates.items()},
            )
        )  # fmt: skip
    blind = _blind_to_held_out_poses(verdict)
    out.sort(key=lambda c: (c.effect not in blind, not np.isfinite(c.cv_rms_m), c.cv_rms_m, -c.log_evidence))
    return tuple(replace(c, confusable_with=_confusable(c, out)) for c in out)


def _blind_to_held_out_poses(verdict: Judgement) -> set[str]:
    """Named effects whose evidence is elsewhere than in the error on held-out poses: they lead the table."""
    out = {STATION_SHIFT} & set(verdict.chosen.ids if verdict.chosen else ())
    weight = verdict.readings is not None and verdict.readings.log_evidence > NATS_TO_NAME
    return out | ({TOOL_WEIGHT} if weight else set())


def _confusable(one: Candidate, all_of_them: Sequence[Candidate]) -> tuple[str, ...]:
    if one.log_evidence < NATS_TO_SEPARATE:
        return ()
    near = [c for c in all_of_them if c is not one and abs(c.log_evidence - one.log_evidence) < NATS_TO_SEPARATE]
    return tuple(c.effect if len(c.groups) != 1 else f"{c.effect}:{c.groups[0]}" for c in near)


def _weight_candidate(trial: Trial, readings: Readings, base: HeldOut, tried: int) -> Candidate:
    unit = {"value": readings.mass, "se": readings.mass_se, "unit": "kg"}
    term = Term(trial.effect, {"dm": Estimate(readings.mass, readings.mass_se, "kg", -500.0, 500.0)})
    p = float(min(1.0, tried * np.exp(-max(readings.log_evidence, 0.0))))
    return Candidate(
        TOOL_WEIGHT,
        (),
        term,
        base.rms_m,
        base.rms_se_m,
        0.0,
        0.0,
        readings.log_evidence,
        p,
        abs(readings.mass) < 100.0,
        {"dm": unit},
    )


def _needed_parts_only(hypothesis: Hypothesis, verdict: Judgement) -> Hypothesis:
    """A single effect on top of the model with the parts that it needs there."""
    if verdict.parts and verdict.chosen is not None and verdict.chosen.ids == hypothesis.ids:
        return verdict.chosen
    return cut_down(hypothesis, settle(hypothesis.study, hypothesis.ids))


def _term_of(trial: Trial, study: Study) -> Term:
    """A tried effect with the values of its linearised fit and their posterior standard deviations."""
    v, p = trial.best, len(trial.best.names)
    columns = study.base + v.block
    H = columns.A.T @ columns.A + np.diag(1.0 / columns.width**2)
    sd = np.sqrt(np.linalg.inv(H).diagonal()[-p:]) * v.scale
    values = trial.posterior.x[-p:] * v.scale
    known = {n: (float(x), float(s)) for n, x, s in zip(v.names, values, sd, strict=True)}
    estimates = {}
    for q in v.effect.parameters(study.ready):
        if q.name in known:
            estimates[q.name] = Estimate(*known[q.name], unit=q.unit, lower=q.lower, upper=q.upper)
        elif q.name in v.shape:
            estimates[q.name] = Estimate(v.shape[q.name], unit=q.unit, lower=q.lower, upper=q.upper)
    return Term(v.effect, estimates)


def _plausible(trial: Trial, term: Term, study: Study) -> bool:
    for p in trial.effect.parameters(study.ready):
        if p.name in term.estimates:
            low, high = p.plausible_range
            if not low - 1e-12 <= term.estimates[p.name].value <= high + 1e-12:
                return False
    return True


def _next(found: Search, verdict: Judgement) -> tuple[Measurement, ...]:
    """Samples that tell the best explanation from its strongest rival."""
    one: Hypothesis | None = verdict.chosen or (found.singles[0] if found.singles else None)
    if one is None:
        return ()
    others = [*verdict.rivals, *(h for h in found.singles if h.ids != one.ids)]
    session = found.study.session
    planned: list[Measurement] = []
    if verdict.other is not None:
        planned += _apart(session, one.study.terms, *verdict.other)
    if verdict.rivals or not planned:
        other = others[0].study.terms if others else found.study.terms
        name = "+".join(others[0].ids) if others else "the model without it"
        planned = [*_apart(session, one.study.terms, other, ("+".join(one.ids), name)), *planned]
    return tuple(planned)


def _apart(session: Session, a: Sequence[Term], b: Sequence[Term], names: tuple[str, str]) -> tuple[Measurement, ...]:
    try:
        return next_measurements(session, a, b, names)
    except SolveError:
        return ()
