# SPDX-License-Identifier: Apache-2.0
"""Add one justified effect at a time, and stop when the evidence does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from ..effects import Effect, Evidence
from ..effects.formula import FormulaEffect
from ..effects.of_session import carrying
from ..errors import Cancelled, EffectError, ModelError
from ..identification.provenance import model_of
from ..identification.validation import ESTIMATOR
from ..lengths import length
from ..model import Estimate, Model, Term
from ..session.data import Session
from ..typing import Json
from .assessment import Assessment
from .candidates import try_effect
from .expected_error import with_error
from .held_out import Validated, on_the_way, validated
from .part_sets import Parts
from .parts import parts_json, prune
from .result import Diagnosis, finite
from .run import Progress, examine
from .shape import refit
from .study import Study
from .tool_weight import READ_AT_REFERENCES, reference_readings

LADDER_FORMAT = "irec-ladder/1"


@dataclass(frozen=True)
class Rung:
    """One model version on the way.

    Attributes:
        added: effect that this version has and the one before has not; empty for the first.
        cv_rms_m, cv_rms_se_m: error on held-out poses and its standard error over poses; fit_rms_m: on the poses of the fit.
        log_evidence: for the addition.
        parts: of each effect that was added so far: which axes or directions the session proves.
        one_of: the addition and the effects that would do in its place, where the session does not tell which it is.
        named: the addition is a cause that the session shows; False: it is one of several, or predicts other poses and stands in
            for what has no name.
        usual: the addition is there as in every robot, no cause to look for; `named` is False then.
    """

    added: str
    effects: tuple[str, ...]
    fit_rms_m: float
    cv_rms_m: float
    cv_rms_se_m: float
    log_evidence: float
    model: Model
    parts: dict[str, Parts] = field(default_factory=dict)
    named: bool = True
    one_of: tuple[str, ...] = ()
    usual: bool = False

    @property
    def title(self) -> str:
        """The model in a table or under a figure: its effects, or what it has more than the one before."""
        if not self.added:
            return " + ".join(self.effects)
        if self.one_of:
            return f"+ {' or '.join(self.one_of)}"
        if self.stands_in:
            law = self._law
            return f"+ {law.in_short if law else self.added} (no name)"
        return f"+ {self.added}{' (usual)' if self.usual else ''}"

    @property
    def formula(self) -> str:
        """The formula of the addition where it is one, else an empty string."""
        return self._law.formula if self._law else ""

    @property
    def _law(self) -> FormulaEffect | None:
        added = (t.effect for t in self.model.terms if t.effect.id == self.added)
        return next((e for e in added if isinstance(e, FormulaEffect)), None)

    @property
    def stands_in(self) -> bool:
        """The addition predicts what has no name."""
        return not (self.named or self.one_of or self.usual)


@dataclass(frozen=True)
class Ladder:
    """How the held-out error fell, model by model, and the diagnosis of the first and the last model."""

    session: str
    noise_floor_m: float
    rungs: tuple[Rung, ...]
    before: Diagnosis
    stopped: str

    @property
    def model(self) -> Model:
        return self.rungs[-1].model

    def to_json(self) -> Json:
        """The content of `ladder.json`."""
        steps = [
            {
                "added": r.added,
                "effects": list(r.effects),
                "fit_rms_m": r.fit_rms_m,
                "cv_rms_m": r.cv_rms_m,
                "cv_rms_se_m": r.cv_rms_se_m,
                "log_evidence": r.log_evidence,
                "parts": parts_json(r.parts),
                "named": r.named,
                "one_of": list(r.one_of),
                "usual": r.usual,
                **({"formula": r.formula} if r.formula else {}),
            }
            for r in self.rungs
        ]
        data = {
            "format": LADDER_FORMAT,
            "session": self.session,
            "noise_floor_m": self.noise_floor_m,
            "estimator": ESTIMATOR,
            "steps": steps,
            "stopped": self.stopped,
        }
        return finite(data)  # type: ignore[no-any-return]


def improve(
    session: Session,
    model: Model | None = None,
    *,
    progress: Progress | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Ladder:
    """Improve a model on a session as far as the evidence goes. Arguments and errors as of `diagnose`."""
    say = progress or (lambda share, what: None)

    def check() -> None:
        if cancelled is not None and cancelled():
            raise Cancelled("the improvement was cancelled")

    before, assessment, shown = examine(session, model, progress=lambda s, what: say(0.9 * s, what), cancelled=cancelled)
    session = carrying(session, shown.asked.study.session.payload)
    start, added = assessment.built.start.study, assessment.built.final
    rungs = [_rung(shown.asked, "", 0.0, model)]
    base, whole = list(shown.asked.study.terms), shown.without_form or shown.after
    if shown.completed is not None:
        rungs.append(_rung(shown.completed, "+".join(shown.form), shown.form_evidence, rungs[-1].model))
        base = list(start.terms)
    for n, effect in enumerate(added.ids, start=1):
        check()
        is_last = n == len(added.ids)
        one = whole if is_last else on_the_way(whole, [*base, *added.added[:n]])
        evidence = assessment.built.evidence.get(effect, float("nan"))
        rung = _rung(one, effect, evidence, rungs[-1].model, assessment.parts if is_last else {})
        one_of = next(((effect, *(i for i in s if i != effect)) for s in assessment.one_of if effect in s), ())
        usual = effect in assessment.usual
        rungs.append(replace(rung, one_of=one_of, usual=usual, named=effect in assessment.names))
    if shown.without_form is not None:
        rungs.append(_rung(shown.after, "+".join(shown.form), shown.form_evidence, rungs[-1].model, assessment.parts))
    for extra in shown.stand_ins:
        rungs.append(replace(_rung(extra.model, extra.effect.id, extra.evidence, rungs[-1].model), named=False))
    rungs[-1] = replace(rungs[-1], model=with_error(rungs[-1].model, shown.best.expected_error))
    readings = assessment.readings
    if assessment.weight_wrong and readings is not None and READ_AT_REFERENCES.id not in rungs[-1].effects:
        term = next(c.term for c in before.candidates if c.effect == READ_AT_REFERENCES.id)
        rungs.append(with_term(rungs[-1], term, readings.log_evidence))
    say(1.0, "done")
    stopped = _stopped(assessment, bool(shown.stand_ins))
    return Ladder(session.name, before.comparison.noise_floor_m, tuple(rungs), before, stopped)


def with_term(last: Rung, term: Term, evidence: float) -> Rung:
    """A version with a named effect that moves nothing in the session: the errors stay as they are."""
    effects, model = (*last.effects, term.effect.id), replace(last.model, terms=(*last.model.terms, term))
    return replace(
        last, added=term.effect.id, effects=effects, log_evidence=evidence, model=model, named=True, one_of=(), usual=False
    )


def _stopped(assessment: Assessment, has_stand_ins: bool) -> str:
    """Why no further effect is added."""
    if assessment.evidence:
        why = f": {assessment.reason}" if assessment.reason else ""
        beside = " beside what has a name" if has_stand_ins else ""
        left = f"what is left{beside}, {length(assessment.remaining_m)}, has structure"
        return f"{left}, but no effect of the catalogue explains it{why}"
    return "no further effect is justified"


def _rung(made: Validated, added: str, evidence: float, parent: Model | None, parts: dict[str, Parts] | None = None) -> Rung:
    cv, fit = made.held_out, made.study.fit
    return Rung(
        added, tuple(t.effect.id for t in made.study.terms), fit.rms, cv.rms_m, cv.rms_se_m, evidence,
        versioned(made, parent, f"added {added}" if added else "start", parts or {}), parts or {},
    )  # fmt: skip


def versioned(made: Validated, parent: Model | None, change: str, parts: dict[str, Parts] | None = None) -> Model:
    """The model that was fitted to a session, with its history: one entry for each version.

    Args:
        parts: which axes or directions of the added effects the session proves.
    """
    study, cv = made.study, made.held_out
    new = model_of(study.fit, held_out=cv)
    entry = {
        "change": change,
        "effects": list(new.effects),
        "session": study.session.name,
        "date": new.made["date"],
        "cv_rms_m": float(cv.rms_m) if cv.rms_m == cv.rms_m else None,
        "fit_rms_m": float(study.fit.rms),
        "noise_floor_m": float(study.observation.whiten.floor),
    }
    if parts:
        entry["parts"] = finite(parts_json(parts))
    return replace(new, history=(*(parent.history if parent else ()), entry))


def add_effect(model: Model, effect: Effect, session: Session) -> tuple[Model, Study, Study]:
    """A model with one more effect, refitted jointly; its best variant on this session is taken.

    Returns:
        the new model, the study of the old effects and that of the new ones on this session.

    Raises:
        ModelError: the model has it already. EffectError: it can't act on this session.
    """
    if effect.id in model.effects:
        raise ModelError(f"the model has the effect '{effect.id}' already; its effects are {', '.join(model.effects)}")
    session = carrying(session, model.carried)
    before = validated(session, model.terms)
    old = before.study if effect.completes else before.study.to_weigh
    why = old.why_not(effect)
    if effect.evidence is Evidence.REFERENCE_READINGS and not why:
        return _with_weight(model, effect, before)
    trial = None if why else try_effect(old, effect)
    if trial is None:
        raise EffectError(
            f"effect '{effect.id}' can't be identified from {session.name}: {why or 'it moves nothing in this session'}"
        )
    found = refit(old, trial)
    if found is None:
        raise EffectError(f"effect '{effect.id}' could not be fitted to {session.name} together with {', '.join(model.effects)}")
    pruned = prune(found, (effect.id,))
    made = validated(session, pruned.study.terms)
    new = with_error(versioned(made, model, f"added {effect.id}", pruned.parts), made.expected_error)
    return new, before.study, made.study


def _with_weight(model: Model, effect: Effect, before: Validated) -> tuple[Model, Study, Study]:
    old = before.study.to_weigh
    readings = reference_readings(old.ready, old.session.noise.force_n)
    if readings is None:
        raise EffectError(f"effect '{effect.id}' needs force readings at the references of a loaded session")
    term = Term(effect, {"dm": Estimate(readings.mass, readings.mass_se, "kg", -500.0, 500.0)})
    new = with_error(versioned(before, model, f"added {effect.id}"), before.expected_error)
    return replace(new, terms=(*new.terms, term)), before.study, before.study


def remove_effect(model: Model, effect_id: str, session: Session) -> tuple[Model, Study]:
    """A model without one effect, refitted.

    Raises:
        ModelError: the model does not have it, or has nothing else.
    """
    if effect_id not in model.effects:
        raise ModelError(f"the model has no effect '{effect_id}'; its effects are {', '.join(model.effects)}")
    rest = remaining(model.terms, effect_id)
    if not rest:
        raise ModelError(f"'{effect_id}' is the model's only effect: nothing would be left")
    made = validated(carrying(session, model.carried), rest)
    return with_error(versioned(made, model, f"removed {effect_id}"), made.expected_error), made.study


def remaining(terms: Sequence[Term], effect_id: str) -> tuple[Term, ...]:
    """The terms without one effect."""
    return tuple(t for t in terms if t.effect.id != effect_id)
