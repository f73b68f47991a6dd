# SPDX-License-Identifier: Apache-2.0
"""What is tried on top of a model at one step of model building: the best effects, fitted exactly, each with its remainder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..effects import Axes, Evidence
from ..effects.scene import Scene
from ..effects.traits import Family as Alike
from .candidates import Option, Trial, try_option
from .evidence import Block
from .explanation import Explanation, explain, reshaped_again
from .family import Family
from .forms import bends, forms_of
from .ground import Ground
from .naming import refused
from .priors import FORM_LEVELS, log_odds_of_form
from .readings import by_readings
from .remainder import grow
from .rivals import Check
from .settings import Settings
from .standing import all_stand
from .study import Study

LESS_FORM = (0.5, 0.25, 0.125)  # of the level


def waiting(current: Explanation, found: Sequence[Option]) -> set[str]:
    """Effects that are weighed only beside another one (`Effect.beside`), which is possible and not in the model yet."""
    absent = {o.effect.id for o in found} - {t.effect.id for t in current.study.terms}
    return {o.effect.id for o in found if o.effect.beside in absent}


def two_together(
    start: Explanation, current: Explanation, trials: Sequence[Trial] | None, found: Sequence[Option], family: Family,
    check: Check, settings: Settings,
) -> tuple[Explanation, dict[str, float]] | None:  # fmt: skip
    """Two effects that stand together where neither stands alone; None where there are none.

    What two large causes leave has structure that the generic family describes better than either with a remainder. Asked only
    where much is unexplained; each then has to hold against any structure in its place, with the other present. A hose that
    outweighs the payload hides the springs, and without springs it moves nothing: these two are tried whatever springs alone say.

    Returns:
        the model with both, and the evidence of the names in it.
    """
    if current.remainder.without_a_name < settings.nats_for_two:
        return None
    trials = tried_on(current, found) if trials is None else trials
    pairs: list[Explanation] = []  # one may be there twice, with other shapes: each was found beside the one taken first
    by_springs = [o for o in found if o.effect.id not in current.ids and not o.on(current.study).tables]
    for i, trial in enumerate(trials):
        springs = bool(by_springs) and trial.effect.compliance_of is Axes.ACTUATED
        if i >= settings.refits and not springs:
            continue
        check()
        one = explain(start, current, trial, family)
        if one is None:
            continue
        if one.named - current.named >= settings.nats_for_two:
            seconds = step(start, one, found, family, None, check, settings)[: settings.refits]
        elif springs:  # they are as stiff as gravity alone has them, so that only the exact fit shows what loads them
            fitted = (explain(start, one, t, family) for t in tried_on(one, by_springs))
            seconds = [two for two in fitted if two is not None]
        else:
            continue
        pairs += [reshaped_again(start, two, family) for two in seconds if not refused(start, one, two, family, settings)[0]]
    for both in sorted(pairs, key=lambda e: -e.log_evidence):
        check()
        evidence = all_stand(start, both, family, settings)
        if evidence:
            return both, evidence
    return None


def step(
    start: Explanation, current: Explanation, found: Sequence[Option], family: Family, trials: Sequence[Trial] | None,
    check: Check, settings: Settings,
) -> list[Explanation]:  # fmt: skip
    """The best effects on top of a model, fitted exactly, each with its remainder; best first."""
    open_ = [o for o in found if o.effect.id not in current.ids]
    ids = {o.effect.id for o in open_}
    trials = tried_on(current, found) if trials is None else [t for t in trials if t.effect.id in ids]
    chosen = [t for t in trials[: settings.refits] if t.log_evidence > 1.0]
    if current.remainder.parts:
        more = tried_on(current, found, current.remainder.block)
        known = {t.effect.id for t in chosen}
        chosen += [t for t in more[: settings.refits] if t.log_evidence > 1.0 and t.effect.id not in known]
    # what the readings at the references have is tried whatever differences say by themselves, and so is what every robot has
    kind = current.study.ready.kind
    always = {o.effect.id for o in open_ if by_readings(current.study, o.effect)[0] > settings.nats_to_name}
    always |= {t.effect.id for t in trials if kind in t.effect.everywhere and t.log_evidence > settings.nats_to_name}
    kept = _screened(current, chosen, family, settings)
    names = {t.effect.id for t in kept}
    out = []
    for trial in (*kept, *(t for t in trials if t.effect.id in always - names)):
        check()
        one = explain(start, current, trial, family)
        if one is not None:
            out.append(one)
    return laws_by_themselves(sorted(out, key=lambda e: -e.log_evidence))


def tried_on(current: Explanation, found: Sequence[Option], beside: Block | None = None) -> list[Trial]:
    """Every effect that a model does not have, on top of it or of more columns, best first."""
    study = current.study
    more = study.base.take([]) if beside is None else beside.take(list(range(study.base.A.shape[1], beside.A.shape[1])))
    ground = Ground(study.bench, study.base + more)
    weaker = [(Ground(study.bench, base + more), odds) for base, odds in _with_less_form(study)]
    open_ = (o.on(study) for o in found if o.effect.id not in current.ids)
    tried = (_tried(ground, weaker, o, study.ready) for o in open_ if o.tables)
    return sorted(tried, key=lambda t: -t.log_evidence)


def _with_less_form(study: Study) -> Iterator[tuple[Block, float]]:
    """The model with lower levels of what completes the form of its springs, and their log odds over the level that it has.

    Without a soft tool or base the form of springs may have been found so large that it stands for them.
    """
    for share in LESS_FORM:
        form = {effect: level * share for effect, level in study.form.items() if level * share >= min(FORM_LEVELS)}
        if form:
            odds = log_odds_of_form(np.array([[study.form[e], level] for e, level in form.items()]))
            yield study.with_form(form), float((odds[:, 1] - odds[:, 0]).sum())


def _tried(ground: Ground, weaker: Sequence[tuple[Ground, float]], option: Option, scene: Scene) -> Trial:
    """An effect on a ground, or on one with less of what completes the form of springs where a spring is likelier there."""
    best = try_option(ground, option, scene)
    if option.effect.family is not Alike.SPRING:
        return best
    for less, odds in weaker:
        trial = try_option(less, option, scene)
        gained = trial.log_evidence + less.log_evidence + odds - ground.log_evidence
        if gained > best.log_evidence:
            best = replace(trial, log_evidence=gained)
    return best


def laws_by_themselves(tried: Sequence[Explanation]) -> list[Explanation]:
    """Explanations, best first, in which laws that bend the curve of one axis change places where one explains more by itself.

    Beside each, the general law of that axis mends its form; with it the poorer law may be the likelier one.
    """

    def bent(one: Explanation) -> frozenset[int]:
        return bends(one.added[-1], one.study.ready)

    def by_itself(one: Explanation) -> float:
        forms = forms_of(one.added[-1], one.study.ready)
        return one.named + sum(p.log_evidence for p in one.remainder.parts if not forms.has(p.structure))

    places = [i for i, e in enumerate(tried) if any(bent(e) & bent(o) for o in tried if o is not e)]
    out = list(tried)
    for i, one in zip(places, sorted((tried[i] for i in places), key=lambda e: -by_itself(e)), strict=True):
        out[i] = one
    return out


def _screened(current: Explanation, chosen: Sequence[Trial], family: Family, settings: Settings) -> list[Trial]:
    """The tried effects that are worth an exact fit: those within reach of the best, each with its remainder."""
    study = current.study
    guess = []
    for trial in chosen:
        with_it = study.base + trial.best.block
        rest = grow(study.bench, family, with_it, current.remainder.parts)
        guess.append(rest.log_evidence + trial.best.log_prior)
    if not guess:
        return []
    # what one pose shows is proven by later readings, and may be refused whatever it explains: others are not measured by it
    one_pose = [t.effect.evidence is Evidence.ONE_POSE and study.ready.kind == "loaded" for t in chosen]
    top = max([v for v, alone in zip(guess, one_pose, strict=True) if not alone] or guess)
    reach = max(settings.nats_to_refit, 0.1 * (top - study.bench.posterior(study.base).log_evidence))
    ranked = sorted(zip(guess, range(len(chosen)), strict=True), reverse=True)
    kept = [i for value, i in ranked if value > top - reach][: settings.refits]
    # the strongest without a remainder is fitted too: a general law of torque may have taken its place in the remainder
    return [chosen[i] for i in dict.fromkeys((*kept, 0))]
