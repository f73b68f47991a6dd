# SPDX-License-Identifier: Apache-2.0
"""Add one justified effect at a time, and stop when the evidence does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from ..effects import Effect, find_effect
from ..errors import Cancelled, EffectError, ModelError
from ..model import Estimate, Model, Term
from ..provenance import model_of
from ..session.data import Session
from ..typing import Json
from .candidates import try_effect
from .held_out import HeldOut, gain, held_out
from .judge import judge
from .parts import Parts, parts_json, settle
from .result import Diagnosis, finite
from .run import Progress, examine
from .search import NATS_TO_NAME, Hypothesis, refit, search
from .study import Study, prepare, study_of
from .tool_weight import reference_readings

LADDER_FORMAT = "irec-ladder/1"
MOST_EFFECTS = 4
HELPS_SIGMAS = 3.0  # by which the held-out loss must fall for an effect that is known to be there


@dataclass(frozen=True)
class Rung:
    """One model version on the way.

    Attributes:
        added: effect that this version has and the one before has not; empty for the first.
        cv_rms_m, cv_rms_se_m: error on held-out poses and its standard error over poses; fit_rms_m: on the poses of the fit.
        log_evidence: for the addition.
        parts: of each effect that was added so far: which axes or directions the session proves.
    """

    added: str
    effects: tuple[str, ...]
    fit_rms_m: float
    cv_rms_m: float
    cv_rms_se_m: float
    log_evidence: float
    model: Model
    parts: dict[str, Parts] = field(default_factory=dict)


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
            }
            for r in self.rungs
        ]
        data = {
            "format": LADDER_FORMAT,
            "session": self.session,
            "noise_floor_m": self.noise_floor_m,
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

    before, found, verdict = examine(session, model, progress=lambda s, what: say(0.5 * s, what), cancelled=cancelled)
    study = found.study
    rungs = [_rung(study, "", 0.0, model)]
    stopped = "no further effect is justified"
    sag = _sag(study) if verdict.status == "unexplained" else None
    if sag is not None:
        study = sag.study
        rungs.append(_rung(study, sag.ids[-1], sag.log_evidence, rungs[-1].model))
        say(0.6, f"looking for a further effect beside {', '.join(rungs[-1].effects)}")
        verdict = judge(search(study, check), None, check)
    while len(rungs) <= MOST_EFFECTS:
        if verdict.chosen is None or verdict.status != "missing_effect":
            if verdict.status == "unexplained":
                stopped = "what is left has structure, but no effect explains it"
            break
        for step in _one_by_one(study, verdict.chosen):
            # an effect that was added before may need fewer axes now
            settled = settle(step.study, (*(r.added for r in rungs if r.added), step.ids[-1]))
            study = settled.study
            rungs.append(_rung(study, step.ids[-1], step.log_evidence, rungs[-1].model, settled.parts))
        say(min(0.95, 0.5 + 0.15 * len(rungs)), f"looking for a further effect beside {', '.join(rungs[-1].effects)}")
        verdict = judge(search(study, check), None, check)
    else:
        stopped = f"{MOST_EFFECTS} effects were added"
    readings = reference_readings(found.study.ready, session.noise.force_n) if session.kind == "loaded" else None
    if readings is not None and readings.log_evidence > NATS_TO_NAME and "tool_weight" not in rungs[-1].effects:
        term = next(c.term for c in before.candidates if c.effect == "tool_weight")
        last = rungs[-1]
        heavier = replace(last.model, terms=(*last.model.terms, term))
        rungs.append(
            replace(
                last,
                added="tool_weight",
                effects=(*last.effects, "tool_weight"),
                log_evidence=readings.log_evidence,
                model=heavier,
            )
        )
    say(1.0, "done")
    return Ladder(session.name, before.comparison.noise_floor_m, tuple(rungs), before, stopped)


def _sag(study: Study) -> Hypothesis | None:
    """Joint torsion on top of a model of an absolute session, where it helps on held-out poses; None elsewhere.

    That joints give way under gravity needs no naming: it is known of every arm. So it goes in although it does not explain most
    of what is left, provided that it earns it.
    """
    effect = find_effect("joint_torsion")
    if study.session.kind != "absolute" or effect.id in (t.effect.id for t in study.terms) or study.why_not(effect):
        return None
    trial = try_effect(study, effect)
    found = refit(study, study, trial) if trial is not None and trial.log_evidence > NATS_TO_NAME else None
    if found is None:
        return None
    mean, se, _ = gain(held_out(study), held_out(found.study))
    return found if mean > HELPS_SIGMAS * se else None


def _one_by_one(study: Study, chosen: Hypothesis) -> list[Hypothesis]:
    """The hypotheses that lead from a model to the chosen one, one effect at a time."""
    steps = []
    for n in range(1, len(chosen.added)):
        part = study_of(study.observation, (*study.terms, *chosen.added[:n]))
        steps.append(Hypothesis(chosen.added[:n], part, float("nan")))
    return [*steps, chosen]


def _rung(study: Study, added: str, evidence: float, parent: Model | None, parts: dict[str, Parts] | None = None) -> Rung:
    cv = held_out(study)
    return Rung(
        added, tuple(t.effect.id for t in study.terms), study.fit.rms, cv.rms_m, cv.rms_se_m, evidence,
        versioned(study, cv, parent, f"added {added}" if added else "start", parts or {}), parts or {},
    )  # fmt: skip


def versioned(study: Study, cv: HeldOut, parent: Model | None, change: str, parts: dict[str, Parts] | None = None) -> Model:
    """The model of a study with its history: one entry for each version.

    Args:
        parts: which axes or directions of the added effects the session proves.
    """
    new = model_of(study.fit, cv_rms=cv.rms_m)
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
    old = prepare(session, model.terms)
    why = old.why_not(effect)
    if effect.id == "tool_weight" and not why:
        return _with_weight(model, effect, old)
    trial = None if why else try_effect(old, effect)
    if trial is None:
        raise EffectError(
            f"effect '{effect.id}' can't be identified from {session.name}: {why or 'it moves nothing in this session'}"
        )
    found = refit(old, old, trial)
    if found is None:
        raise EffectError(f"effect '{effect.id}' could not be fitted to {session.name} together with {', '.join(model.effects)}")
    settled = settle(found.study, found.ids)
    new = versioned(settled.study, held_out(settled.study), model, f"added {effect.id}", settled.parts)
    return new, old, settled.study


def _with_weight(model: Model, effect: Effect, old: Study) -> tuple[Model, Study, Study]:
    readings = reference_readings(old.ready, old.session.noise.force_n)
    if readings is None:
        raise EffectError(f"effect '{effect.id}' needs force readings at the references of a loaded session")
    term = Term(effect, {"dm": Estimate(readings.mass, readings.mass_se, "kg", -500.0, 500.0)})
    new = versioned(old, held_out(old), model, f"added {effect.id}")
    return replace(new, terms=(*new.terms, term)), old, old


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
    study = prepare(session, rest)
    return versioned(study, held_out(study), model, f"removed {effect_id}"), study


def remaining(terms: Sequence[Term], effect_id: str) -> tuple[Term, ...]:
    """The terms without one effect."""
    return tuple(t for t in terms if t.effect.id != effect_id)
