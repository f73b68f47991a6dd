# SPDX-License-Identifier: Apache-2.0
"""Model building: effects enter one by one and leave again, each by its evidence given the others and a nonparametric remainder.

At every step the best effects are fitted exactly together with everything that is named already, each with a nonparametric
remainder of its own. One is taken in where model and remainder with it explain the session better, by far, than any
remainder without it. So a cause need not explain all of the residual, and a name never stands for a structure that the
generic family describes as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import log

import numpy as np

from ..effects import Evidence
from ..identification.validation import gain
from ..model import Term
from ..typing import Array
from .candidates import Option, Trial, options, supported, try_option
from .evidence import Ground
from .family import Family, family_of
from .forms import NO_FORMS, Forms, forms_of
from .held_out import held_out, only_good_poses
from .lasting import lasts
from .priors import FACTORS
from .remainder import Part, Remainder, grow
from .settings import SETTINGS, Settings
from .shape import refit, reshaped
from .study import Study, study_of

Check = Callable[[], None]


@dataclass(frozen=True)
class Explanation:
    """A model with effects added, fitted exactly, and what is left beside it.

    Attributes:
        added: the terms added to the start, in order.
        named: log evidence of the added terms alone, relative to the start alone.
        log_evidence: the same together with the remainder.
    """

    added: tuple[Term, ...]
    study: Study
    named: float
    remainder: Remainder

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(t.effect.id for t in self.added)

    @property
    def log_evidence(self) -> float:
        return self.named + self.remainder.gained


@dataclass(frozen=True)
class Built:
    """Outcome of model building.

    Attributes:
        start: the model without anything added; family: the generic structures on this session.
        trials: every effect on top of the start, best first; skipped: effect id -> why it can't show.
        singles: the effects fitted exactly at the first step, best first.
        steps: the start and every model on the way, the last is the result; evidence: of the name that each step added.
        closest: the best name that was refused at the end, and why.
        rivals: added effect -> others that would do in its place, each with the odds against it in nats.
    """

    start: Explanation
    family: Family
    trials: tuple[Trial, ...]
    skipped: dict[str, str]
    singles: tuple[Explanation, ...]
    steps: tuple[Explanation, ...]
    evidence: dict[str, float]
    closest: Explanation | None = None
    reason: str = ""
    rivals: dict[str, tuple[tuple[str, float], ...]] = field(default_factory=dict)

    @property
    def final(self) -> Explanation:
        return self.steps[-1]


def build(study: Study, check: Check = lambda: None, settings: Settings = SETTINGS) -> Built:
    """Build a model on top of a start as far as the evidence goes."""
    family = family_of(study)
    found, skipped = options(study, check=check)
    start = Explanation((), study, 0.0, grow(study.bench, family, study.base))
    ground = Ground(study.bench, study.base)
    trials = tuple(sorted((try_option(ground, o, study.ready) for o in found), key=lambda t: -t.log_evidence))
    singles: list[Explanation] = []
    steps, evidence, near = [start], dict[str, float](), dict[str, list[str]]()
    closest, reason = None, ""
    while len(steps[-1].added) < settings.most_names:
        check()
        current = steps[-1]
        tried = _step(start, current, found, family, trials if len(steps) == 1 else None, check, settings)
        singles = singles or tried
        taken = None
        for one in tried:
            why, odds = _refused(start, current, one, family, settings)
            if not why:
                taken = one
                evidence[one.ids[-1]] = odds
                least = one.log_evidence - 2.0 * settings.nats_to_separate
                near[one.ids[-1]] = [t.ids[-1] for t in tried if t is not one and t.log_evidence > least]
                break
            if closest is None or one.named > closest.named:
                closest, reason = one, why
        if taken is None:
            break
        closest, reason = None, ""
        taken = _reshaped(start, taken, family)
        steps.append(taken)
        pruned = _pruned(start, taken, family, settings)
        if pruned is not taken:
            evidence = {i: e for i, e in evidence.items() if i in pruned.ids}
            if any(set(s.ids) == set(pruned.ids) for s in steps):
                break
            steps.append(pruned)
    proven = _proven(start, steps[-1], family, settings)
    evidence = proven[1]
    if proven[0] is not steps[-1]:
        closest, reason = steps[-1], "it is no stronger than the structure that no effect explains"
        steps = [s for s in steps if set(s.ids) < set(proven[0].ids)] + [proven[0]]
    rivals = _rivals(start, steps[-1], near, found, family, check, settings)
    return Built(start, family, trials, skipped, tuple(singles), tuple(steps), evidence, closest, reason, rivals)


def _step(
    start: Explanation, current: Explanation, found: Sequence[Option], family: Family, trials: Sequence[Trial] | None,
    check: Check, settings: Settings,
) -> list[Explanation]:  # fmt: skip
    """The best effects on top of a model, fitted exactly, each with its remainder; best first."""
    scene = current.study.ready
    open_ = [o for o in found if o.effect.id not in current.ids]
    if trials is None:
        ground = Ground(current.study.bench, current.study.base)
        trials = sorted((try_option(ground, o, scene) for o in open_), key=lambda t: -t.log_evidence)
    chosen = [t for t in trials[: settings.refits] if t.log_evidence > 1.0]
    if current.remainder.parts:
        beside = Ground(current.study.bench, current.remainder.block)
        more = sorted((try_option(beside, o, scene) for o in open_), key=lambda t: -t.log_evidence)
        known = {t.effect.id for t in chosen}
        chosen += [t for t in more[: settings.refits] if t.log_evidence > 1.0 and t.effect.id not in known]
    out = []
    for trial in _screened(current, chosen, family, settings):
        check()
        one = explain(start, current, trial, family)
        if one is not None:
            out.append(one)
    return sorted(out, key=lambda e: -e.log_evidence)


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
    top = max(guess)
    reach = max(settings.nats_to_refit, 0.1 * (top - study.bench.posterior(study.base).log_evidence))
    ranked = sorted(zip(guess, range(len(chosen)), strict=True), reverse=True)
    kept = [i for value, i in ranked if value > top - reach][: settings.refits]
    # the strongest without a remainder is fitted too: a general law of torque may have taken its place in the remainder
    return [chosen[i] for i in dict.fromkeys((*kept, 0))]


def explain(start: Explanation, current: Explanation, trial: Trial, family: Family) -> Explanation | None:
    """A model with a tried effect added, fitted exactly, and its remainder; None where the fit fails."""
    fitted = refit(current.study, trial)
    if fitted is None:
        return None
    before, after = (s.bench.posterior(s.base) for s in (current.study, fitted))
    saved = current.study.bench.saved(before.chi2, max(after.chi2, fitted.true_chi2))
    named = supported(after.log_evidence - before.log_evidence - log(len(FACTORS)), saved) + trial.best.log_prior
    if not current.added:  # the trial tried more prior widths, but there no spring gives way to an effect
        named = max(named, supported(trial.log_evidence, saved))
    added = fitted.terms[len(start.study.terms) :]
    rest = _remainder(fitted, family, current.remainder.parts)
    return Explanation(added, fitted, current.named + named, rest)


def _reshaped(start: Explanation, one: Explanation, family: Family) -> Explanation:
    """A model of several added effects with their shapes found again beside each other."""
    study = reshaped(one.study, one.ids) if len(one.added) > 1 else one.study
    if study is one.study:
        return one
    before, after = (s.bench.posterior(s.base) for s in (one.study, study))
    named = one.named + supported(after.log_evidence - before.log_evidence, one.study.bench.saved(before.chi2, after.chi2))
    return Explanation(study.terms[len(start.study.terms) :], study, named, _remainder(study, family, one.remainder.parts))


def _remainder(study: Study, family: Family, known: Sequence[Part], forms: Forms = NO_FORMS) -> Remainder:
    """The better of a remainder from nothing and of one that starts from known structures.

    Args:
        forms: structures that are left out.
    """
    without = forms.has if forms else None
    fresh = grow(study.bench, family, study.base, without=without)
    if not known:
        return fresh
    again = grow(study.bench, family, study.base, known, without=without)
    return max(fresh, again, key=lambda r: r.gained)


def _refused(start: Explanation, current: Explanation, one: Explanation, family: Family, settings: Settings) -> tuple[str, float]:
    """Why an effect is not named on top of a model, or an empty string; and its evidence over any nonparametric structure."""
    odds = _odds(one, current, one.ids[-1], family, settings)
    if len(start.study.bench.poses) < settings.fewest_poses:
        return "there are too few poses to test it on others", odds
    if odds < needed(one, one.ids[-1], settings):
        if current.remainder.structures and one.named - current.named > settings.nats_to_name:
            words = current.remainder.structures[0].structure.words
            return f"structure that is no effect explains as much: {words}", odds
        return "its evidence is too small", odds
    beyond = implausible(one, one.ids[-1])
    if beyond:
        return beyond, odds
    before, after = (only_good_poses(held_out(e.study), one.study, one.remainder) for e in (current, one))
    mean, se, _ = gain(before, after)
    helps = np.isfinite(mean) and mean > settings.held_out_sigmas * se
    if not helps and not in_one_pose(one, one.ids[-1]):
        return "it does not help on held-out poses", odds
    if in_one_pose(one, one.ids[-1]):
        stays = lasts(one.study, one.added[-1])
        if stays < settings.nats_to_name:
            told = "do not have it" if stays < -settings.nats_to_name else "do not tell whether they have it too"
            return f"the readings of later poses {told}, so it may be a knocked reference or reflector", odds
    return "", odds


def _odds(one: Explanation, bare: Explanation, effect_id: str, family: Family, settings: Settings) -> float:
    """Evidence of a name: of a model with it, over one without it and any nonparametric structure in its place.

    An effect that every robot has needs evidence of its own; against structures it may be as weak as what is not told apart.

    The general law of an axis' torque is no rival of an effect that is a form of it: it stays out on both sides. So does a drift
    of another form, unless it explains more than what is not told apart. A curve of few coefficients has a cause's form only
    nearly: a share of what the nonparametric structures explain counts for them.
    """
    forms = forms_of(_term(one, effect_id), one.study.ready)

    def beside(forms: Forms) -> tuple[float, float]:
        """Evidence of structures in its place, and of those that are left beside it."""
        rest = _remainder(bare.study, family, one.remainder.parts, forms)
        if not forms:
            return max(rest.gained, bare.remainder.gained), one.remainder.gained
        return rest.gained, _remainder(one.study, family, one.remainder.parts, forms).gained

    own = one.named - bare.named
    in_place, left = beside(forms)
    odds = own + left - in_place
    may_be_as_weak = settings.nats_to_separate + settings.nats_to_name
    if everywhere(one, effect_id):
        # to be there it needs no more than to explain as well as what has no name (nothing that is not told apart from it speaks
        # against it); to be of a size that shows, evidence of its own
        return min(odds + may_be_as_weak, own)
    if forms.drifts:
        instead, more = beside(NO_FORMS)
        # another cause whose form is not quite right leaves a drift too, told from this one by nothing: twice the evidence
        odds = min(odds - settings.nats_to_name, own + more - instead + may_be_as_weak)
    if in_one_pose(one, effect_id):  # differences don't tell it from a bad pose, the readings of later poses may
        odds += lasts(one.study, _term(one, effect_id))
    return odds - settings.share_of_form * max(in_place - left, 0.0)


def _term(one: Explanation, effect_id: str) -> Term:
    return next(t for t in one.added if t.effect.id == effect_id)


def implausible(one: Explanation, effect_id: str) -> str:
    """The first value of an effect beyond what is physically likely, with its limit, in words; empty where there is none."""
    term = _term(one, effect_id)
    for p in term.effect.parameters(one.study.ready):
        low, high = p.plausible_range
        value = term.estimates[p.name].value if p.name in term.estimates else low
        if not low - 1e-12 <= value <= high + 1e-12:
            limit = low if value < low else high
            unit = "" if p.unit == "1" else f" {p.unit}"
            return f"{p.name} = {value:.3g}{unit} is beyond what is physically likely ({limit:.3g}{unit})"
    return ""


def without(start: Explanation, one: Explanation, effect_id: str, family: Family) -> Explanation:
    """A model without one of its added effects, refitted, with a remainder that may take its place."""
    if len(one.added) == 1:
        rest = _remainder(start.study, family, one.remainder.parts)
        return replace(start, remainder=max(rest, start.remainder, key=lambda r: r.gained))
    terms = tuple(t for t in one.study.terms if t.effect.id != effect_id)
    rest_study = study_of(one.study.observation, terms)
    with_it, bare = (s.bench.posterior(s.base) for s in (one.study, rest_study))
    lost = with_it.log_evidence - log(len(FACTORS)) - bare.log_evidence
    added = tuple(t for t in rest_study.terms if t.effect.id in one.ids)
    rest = _remainder(rest_study, family, one.remainder.parts)
    return Explanation(added, rest_study, one.named - min(lost, one.study.bench.saved(bare.chi2, with_it.chi2)), rest)


def _pruned(start: Explanation, one: Explanation, family: Family, settings: Settings) -> Explanation:
    """A model without the effects that what came last made needless."""
    while len(one.added) > 1:
        for effect_id in one.ids[:-1]:
            bare = without(start, one, effect_id, family)
            if _odds(one, bare, effect_id, family, settings) < settings.nats_to_name:
                one = bare
                break
        else:
            break
    return one


def _proven(start: Explanation, one: Explanation, family: Family, settings: Settings) -> tuple[Explanation, dict[str, float]]:
    """A model without names that nonparametric structure could feign, or that are too small beside the others; evidence of each.

    A structure of unknown form can feign an effect that moves the marker alike, and so can a named one whose form is not
    quite right.
    """
    while one.added:
        left = feigned(one)
        everything = max(start.study.bench.posterior(start.study.base).chi2 - _chi2(one), 1e-9)
        bare = {i: without(start, one, i, family) for i in one.ids}
        evidence = {i: _odds(one, b, i, family, settings) for i, b in bare.items()}
        share = {i: (b.study.bench.posterior(b.study.base).chi2 - _chi2(one)) / everything for i, b in bare.items()}
        least = {i: needed(one, i, settings) + (0.0 if everywhere(one, i) else left[i]) for i in one.ids}
        weak = [i for i in one.ids if evidence[i] < least[i] or share[i] < settings.share_to_name]
        if not weak:
            return one, evidence
        one = bare[min(weak, key=lambda i: evidence[i])]
    return one, {}


def everywhere(one: Explanation, effect_id: str) -> bool:
    """Whether every robot has an effect: it is preferred to a nonparametric structure that explains no more."""
    return _term(one, effect_id).effect.everywhere


def in_one_pose(one: Explanation, effect_id: str) -> bool:
    """Whether an effect shows in the differences of one pose only."""
    return _term(one, effect_id).effect.evidence is Evidence.ONE_POSE and one.study.ready.kind == "loaded"


def needed(one: Explanation, effect_id: str, settings: Settings) -> float:
    """Evidence that a name needs where nothing else is left."""
    if everywhere(one, effect_id):
        return settings.nats_to_name
    tails = settings.nats_per_bad_row * len(one.remainder.bad_rows)
    return tails + (settings.nats_in_one_pose if in_one_pose(one, effect_id) else settings.nats_to_name)


def feigned(one: Explanation) -> dict[str, float]:
    """How much of each name's evidence the structures that remain could feign: their own, as far as they move the marker alike.

    Likeness is the correlation of the two displacements beside everything else in the model.
    """
    block, study = one.remainder.block, one.study
    x = study.bench.posterior(block).x
    rest = [i for i, owner in enumerate(study.owners) if owner not in one.ids]
    ground = Ground(study.bench, study.base.take(rest))
    at = study.base.A.shape[1]
    moved = []
    for part in one.remainder.parts:
        own = slice(at, at + part.structure.columns.stop - part.structure.columns.start)
        at = own.stop
        if not part.structure.is_bad_row:
            moved.append((part, ground.beside(block.A[:, own] @ x[own])))
    out = {}
    for effect_id in one.ids:
        columns = [i for i, owner in enumerate(study.owners) if owner == effect_id]
        mine = ground.beside(block.A[:, columns] @ x[columns])
        forms = forms_of(_term(one, effect_id), one.study.ready)
        others = [(p.log_evidence, v) for p, v in moved if not forms.has(p.structure)]
        out[effect_id] = sum(e * abs(_cosine(mine, v)) for e, v in others)
    return out


def _cosine(a: Array, b: Array) -> float:
    return float(a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300))


def _chi2(one: Explanation) -> float:
    return one.study.bench.posterior(one.study.base).chi2


def _rivals(
    start: Explanation, final: Explanation, near: dict[str, list[str]], found: Sequence[Option], family: Family, check: Check,
    settings: Settings,
) -> dict[str, tuple[tuple[str, float], ...]]:  # fmt: skip
    """Which other effects would do in the place of each added one, everything refitted."""
    out = {}
    by_id = {o.effect.id: o for o in found}
    for term in final.added:
        others = [i for i in near.get(term.effect.id, []) if i not in final.ids]
        if not others:
            continue
        check()
        bare = without(start, final, term.effect.id, family)
        rest = bare.study
        ground = Ground(rest.bench, rest.base)
        forms = forms_of(term, final.study.ready)
        whole = _without_forms(final, family, forms)
        same = []
        for other in others:
            one = explain(start, bare, try_option(ground, by_id[other], rest.ready), family)
            if one is None or implausible(one, other):  # no value that can be is no rival
                continue
            own_forms = forms_of(_term(one, other), one.study.ready)
            own = _without_forms(one, family, own_forms) - _without_forms(bare, family, own_forms)
            if own < settings.nats_to_prefer:  # what has no name explains it there, not this effect
                continue
            odds = whole - _without_forms(one, family, forms)
            if odds < settings.nats_to_separate:
                same.append((other, odds))
        if same:
            out[term.effect.id] = tuple(sorted(same, key=lambda t: t[1]))
    return out


def _without_forms(one: Explanation, family: Family, forms: Forms) -> float:
    """Log evidence of a model whose remainder holds none of some structures."""
    if not any(forms.has(p.structure) for p in one.remainder.structures):
        return one.log_evidence
    return one.named + _remainder(one.study, family, one.remainder.parts, forms).gained
