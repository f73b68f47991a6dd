# SPDX-License-Identifier: Apache-2.0
"""Compare, where, which: the whole diagnosis of one session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects.of_session import carrying
from ..errors import Cancelled, SolveError
from ..identification.identify import default_terms
from ..identification.provenance import model_of
from ..identification.validation import HeldOut, gain
from ..model import Estimate, Model, Term
from ..session.data import Session
from ..typing import Json
from .again import built_either_way
from .assessment import Assessment, assess, bad_luck, p_value
from .bad_readings import one_note_each, rows_json
from .candidates import Trial
from .comparison import compare_observed
from .held_out import fitted_truly, held_out, validated
from .next_poses import next_measurements
from .parts import parts_in, without_columns
from .payload import with_payload_as_shown
from .proposals import proposals
from .questions import Question, questions
from .result import Candidate, Diagnosis, Measurement
from .shown import Shown, shown_of
from .study import Study, completed_study
from .tool_weight import READ_AT_REFERENCES, Readings, reference_readings
from .where import views
from .wording import verdict_of

Progress = Callable[[float, str], None]


def start_terms(session: Session) -> tuple[Term, ...]:
    """The terms that a diagnosis starts from where no model is named."""
    return default_terms(session)


@dataclass(frozen=True)
class _Done:
    """Shares of the time of a diagnosis after its steps."""

    fitted: float
    built: float
    weighed: float
    tried: float


# as sessions took that last longer than some seconds, since those have causes (medians)
DONE = {"loaded": _Done(0.06, 0.78, 0.96, 0.97), "absolute": _Done(0.08, 0.83, 0.94, 0.97)}


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
) -> tuple[Diagnosis, Assessment, Shown]:
    """As `diagnose`, with what the diagnosis rests on."""
    say, done = progress or (lambda share, what: None), DONE[session.kind]

    def check() -> None:
        if cancelled is not None and cancelled():
            raise Cancelled("the diagnosis was cancelled")

    say(0.0, "fitting the model")
    if model is not None:
        session = carrying(session, model.carried)
    terms = model.terms if model else start_terms(session)
    first = fitted_truly(validated(session, terms))
    check()
    study = completed_study(first.study.to_weigh)
    check()
    loaded = with_payload_as_shown(session, study, check)
    if loaded is not session:
        session, first = loaded, fitted_truly(validated(loaded, terms))
        study = completed_study(first.study.to_weigh)
    asked = first.study.to_weigh
    check()
    say(done.fitted, "building a model from the effects of the catalogue")
    asked, study, built = built_either_way(asked, study, check, lambda words: say(0.5 * (done.fitted + done.built), words))
    say(done.built, "weighing the evidence")
    relaxed = session.kind == "loaded" and session.contact is None  # references bear no force
    readings = reference_readings(study.ready, session.noise.force_n) if relaxed else None
    assessment, shown = shown_of(session, first, assess(asked, built, readings, check), check)
    say(done.weighed, "held-out error of each candidate")
    candidates = _candidates(assessment, readings, check)
    left_over = assessment.status == "unexplained" or assessment.remaining_m > 0.0
    proposed = proposals(assessment.study, assessment.remainder, assessment.depends_on, check) if left_over else ()
    say(done.tried, "views of the residual")
    whiten = study.observation.whiten
    observation = replace(study.observation, whiten=whiten.scaled(assessment.noise.inferred_m / whiten.floor))
    comparison = compare_observed(observation, first.study.terms, first.study.fit.rank)
    bad, aside = study.observation.bad, assessment.stand_out
    later = shown.best.study.observation.bad
    comparison = replace(comparison, notes=one_note_each(comparison.notes, bad, aside, later))
    where = views(observation, comparison.residual, comparison.predicted)
    check()
    say(0.98, "what to measure next")
    planned = _next(assessment)
    result = Diagnosis(
        session=session.name,
        model=replace(model_of(first.study.fit, held_out=first.held_out), history=model.history if model else ()),
        fit_rms_m=first.study.fit.rms,
        cv_rms_m=first.held_out.rms_m,
        cv_rms_se_m=first.held_out.rms_se_m,
        cv_rms_after_m=shown.best.held_out.rms_m,
        cv_rms_se_after_m=shown.best.held_out.rms_se_m,
        comparison=comparison,
        verdict=verdict_of(assessment, shown, candidates, comparison, planned),
        candidates=candidates,
        skipped={i: why for i, why in built.skipped.items() if i not in {c.effect for c in candidates}},
        where=where,
        next_measurements=planned,
        flexible_gain_m=assessment.flexible.gain_m,
        notes=one_note_each((*comparison.notes, *first.notes, *shown.best.notes), bad, aside, later),
        noise=assessment.noise,
        bad_rows=rows_json(session, bad, aside),
        proposals=proposed,
        expected_error=shown.best.expected_error,
    )
    say(1.0, "done")
    return result, assessment, shown


def _candidates(assessment: Assessment, readings: Readings | None, check: Callable[[], None]) -> tuple[Candidate, ...]:
    """The table of candidates as the verdict ranks them: named ones first, then by evidence."""
    built = assessment.built
    study = built.start.study
    exact = {e.ids[0]: e for e in built.singles}
    base = assessment.held_out_base
    out = []
    for trial in built.trials:
        check()
        if trial.effect.id == READ_AT_REFERENCES.id:
            continue
        known = exact.get(trial.effect.id)
        added = {t.effect.id: t for t in assessment.study.terms if t.effect.id in assessment.added}
        term = added.get(trial.effect.id) or (known.added[0] if known else _term_of(trial, study))
        after = held_out(known.study) if known else held_out(study, trial.best.block)
        alone = known.named if known else built.evidence.get(trial.effect.id, trial.log_evidence)  # on top of the model as it is
        mean, se, _ = gain(base, after)
        luck = bad_luck(built, trial)
        out.append(
            Candidate(
                trial.effect.id, parts_in(term, study), term, after.rms_m, after.rms_se_m, mean, se, alone - luck,
                p_value(alone - luck), _plausible(term, study), _values(term),
            )
        )  # fmt: skip
    if readings is not None:  # whether the differences have it or, in readings at one and the same joint angles, not at all
        out.append(_weight_candidate(readings, base))
    out += [_beside_others(i, assessment) for i in assessment.added if i not in {c.effect for c in out}]
    order = _ranking(assessment)
    out.sort(key=lambda c: (order.get(c.effect, len(order)), -c.log_evidence))
    return tuple(replace(c, confusable_with=_confusable(c, assessment, out)) for c in out)


def _beside_others(effect_id: str, assessment: Assessment) -> Candidate:
    """An added effect that moves nothing on top of the start alone, as a hose without springs: on top of the others."""
    study, term = assessment.study, next(t for t in assessment.study.terms if t.effect.id == effect_id)
    before, after = held_out(without_columns(study, effect_id)), held_out(study)
    mean, se, _ = gain(before, after)
    evidence = assessment.built.evidence.get(effect_id, float("nan"))
    return Candidate(
        effect_id, parts_in(term, study), term, after.rms_m, after.rms_se_m, mean, se, evidence, p_value(evidence),
        _plausible(term, study), _values(term),
    )  # fmt: skip


def _values(term: Term) -> dict[str, Json]:
    """Value, standard error and unit of each parameter."""
    return {n: {"value": e.value, "se": e.se, "unit": e.unit} for n, e in term.estimates.items()}


def _ranking(assessment: Assessment) -> dict[str, int]:
    """Place of each effect that the verdict speaks of."""
    weight = (READ_AT_REFERENCES.id,) if assessment.weight_wrong else ()
    first = [*assessment.names, *weight, *(i for s in assessment.one_of for i in s)]
    near = sorted(assessment.built.singles, key=lambda e: -e.log_evidence)
    ids = [*first, *(e.ids[0] for e in near)]
    return {i: n for n, i in enumerate(dict.fromkeys(ids))}


def _confusable(one: Candidate, assessment: Assessment, all_of_them: Sequence[Candidate]) -> tuple[str, ...]:
    """Effects that would do in the place of an added one."""
    rivals = [i for i, _ in assessment.built.rivals.get(one.effect, ())]
    rivals += [i for s in assessment.one_of if one.effect in s for i in s if i != one.effect]
    parts = {c.effect: c.groups for c in all_of_them}
    return tuple(f"{i}:{parts[i][0]}" if len(parts.get(i, ())) == 1 else i for i in dict.fromkeys(rivals))


def _weight_candidate(readings: Readings, base: HeldOut) -> Candidate:
    unit = {"value": readings.mass, "se": readings.mass_se, "unit": "kg"}
    term = Term(READ_AT_REFERENCES, {"dm": Estimate(readings.mass, readings.mass_se, "kg", -500.0, 500.0)})
    p = p_value(readings.log_evidence)
    plausible = abs(readings.mass) < 100.0
    return Candidate(
        READ_AT_REFERENCES.id, (), term, base.rms_m, base.rms_se_m, 0.0, 0.0, readings.log_evidence, p, plausible, {"dm": unit}
    )


def _term_of(trial: Trial, study: Study) -> Term:
    """A tried effect with the values of its linearised fit and their posterior standard deviations."""
    v, p = trial.best, len(trial.best.names)
    columns = study.base + v.block
    H = columns.A.T @ columns.A + np.diag(1.0 / columns.width**2)
    sd = np.sqrt(np.linalg.inv(H).diagonal()[-p:]) * v.scale
    values = trial.posterior.x * v.scale
    known = {n: (float(x), float(s)) for n, x, s in zip(v.names, values, sd, strict=True)}
    estimates = {}
    for q in v.effect.parameters(study.ready):
        if q.name in known:
            estimates[q.name] = Estimate(*known[q.name], unit=q.unit, lower=q.lower, upper=q.upper)
        elif q.name in v.shape:
            estimates[q.name] = Estimate(v.shape[q.name], unit=q.unit, lower=q.lower, upper=q.upper)
    return Term(v.effect, estimates)


def _plausible(term: Term, study: Study) -> bool:
    for p in term.effect.parameters(study.ready):
        if p.name in term.estimates:
            low, high = p.plausible_range
            if not low - 1e-12 <= term.estimates[p.name].value <= high + 1e-12:
                return False
    return True


def _next(assessment: Assessment) -> tuple[Measurement, ...]:
    """Samples that answer what the diagnosis leaves open: of each name against its likeliest rival, then of axes; else whether
    the likeliest effect that lacks evidence is there."""
    try:
        asked = questions(assessment)
    except SolveError:
        return ()
    likeliest: dict[str, Question] = {}
    for question in asked:
        likeliest.setdefault("" if question.is_presence else question.names[0], question)
    planned: list[Measurement] = []
    for question in likeliest.values():
        try:
            planned += next_measurements(assessment.study.session, question, assessment.noise.ratio)
        except SolveError:
            continue
    return tuple(planned)
