# SPDX-License-Identifier: Apache-2.0
"""Model building: effects enter one by one and leave again, each by its evidence given the others and a nonparametric remainder.

At every step the best effects are fitted exactly together with everything that is named already, each with a nonparametric
remainder of its own. One is taken in where model and remainder with it explain the session better, by far, than any
remainder without it. So a cause need not explain all of the residual, and a name never stands for a structure that the
generic family describes as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from .candidates import Option, Trial, options, try_option
from .evidence import Block, Ground
from .explanation import Explanation, explain, reshaped_again, without
from .family import Family
from .forms import bends, forms_of
from .level import family_in_view
from .naming import needed, odds_of, proven, pruned, refused, standing
from .readings import by_readings
from .remainder import grow
from .rivals import Check, rivals_of
from .settings import SETTINGS, Settings
from .study import Study


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
        possible: effects that can act on the session; refused: of these, fitted exactly on top of the final model and not named.
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
    possible: tuple[Option, ...] = ()
    refused: tuple[Explanation, ...] = ()

    @property
    def final(self) -> Explanation:
        return self.steps[-1]


def build(study: Study, check: Check = lambda: None, settings: Settings = SETTINGS) -> Built:
    """Build a model on top of a start as far as the evidence goes."""
    family = family_in_view(study)
    found, skipped = options(study, check=check)
    start = Explanation((), study, 0.0, grow(study.bench, family, study.base))
    trials = tuple(_tried(start, found))
    singles: list[Explanation] = []
    steps, evidence, near = [start], dict[str, float](), dict[str, dict[str, Explanation | None]]()
    closest, reason = None, ""
    tried: list[Explanation] = []
    while len(steps[-1].added) < settings.most_names:
        check()
        current = steps[-1]
        known = trials if len(steps) == 1 else None
        waiting = _waiting(current, found)
        taken = None
        for chosen in ([o for o in found if o.effect.id not in waiting], *([found] if waiting else ())):
            tried = step(start, current, chosen, family, known, check, settings)
            singles = singles or tried
            for one in tried:
                why, odds = refused(start, current, one, family, settings)
                if not why:
                    taken = one
                    evidence[one.ids[-1]] = odds
                    least = one.log_evidence - 2.0 * settings.nats_to_separate
                    near[one.ids[-1]] = {t.ids[-1]: t for t in tried if t is not one and t.log_evidence > least}
                    break
                if closest is None or one.named > closest.named:
                    closest, reason = one, why
            if taken is not None:
                break
        if taken is None:
            both = two_together(start, current, known, found, family, check, settings)
            if both is None:
                break
            taken, odds_of_both = both
            evidence |= odds_of_both
        else:
            taken = reshaped_again(start, taken, family)
        closest, reason = None, ""
        steps.append(taken)
        less = pruned(start, taken, family, settings)
        if less is not taken:
            evidence = {i: e for i, e in evidence.items() if i in less.ids}
            if any(set(s.ids) == set(less.ids) for s in steps):
                break
            steps.append(less)
    final, evidence = proven(start, steps, family, settings)
    gone = _in_their_place(start, steps[-1], final.ids, family, settings)
    if final is not steps[-1]:
        closest, reason = steps[-1], "it is no stronger than the structure that no effect explains"
        steps = [s for s in steps if set(s.ids) < set(final.ids)] + [final]
    rivals = rivals_of(start, steps[-1], near, gone, found, family, check, settings)
    for _ in final.ids:
        likelier = [(o, b) for o, b in rivals.likelier if not any(set(s.ids) == set(o.ids) for s in steps)]
        better = next((pair for pair in likelier if not refused(start, pair[1], pair[0], family, settings)[0]), None)
        if better is None:
            break
        one, bare = better
        new, old = one.ids[-1], next(i for i in steps[-1].ids if i not in bare.ids)
        evidence = {i: evidence[i] for i in bare.ids} | {new: odds_of(start, one, bare, new, family, settings)}
        gone = [*(i for i in gone if i != new), old]
        # what would do for the one would do for the other
        near[new] = {**{i: None for i, _ in rivals.of[old] if i != new}, **near.get(new, {})}
        steps.append(one)
        rivals = rivals_of(start, one, near, gone, found, family, check, settings)
    beyond = tuple(t for t in tried if set(t.ids[:-1]) == set(steps[-1].ids))
    return Built(
        start, family, trials, skipped, tuple(singles), tuple(steps), evidence, closest, reason, rivals.of, tuple(found), beyond
    )


def _in_their_place(
    start: Explanation, whole: Explanation, names: Sequence[str], family: Family, settings: Settings
) -> list[str]:
    """Effects of a model that are not named in the end, where they might do for one that is; none where each name holds beside
    all of them: then each explains something else."""
    gone = [i for i in whole.ids if i not in names]
    if not gone:
        return []
    bare = {i: without(start, whole, i, family) for i in names}
    holds = (odds_of(start, whole, bare[i], i, family, settings) >= needed(whole, i, settings) for i in names)
    return [] if all(holds) else gone


def _waiting(current: Explanation, found: Sequence[Option]) -> set[str]:
    """Effects that are weighed only beside another one (`Effect.beside`), which is possible and not in the model yet."""
    absent = {o.effect.id for o in found} - {t.effect.id for t in current.study.terms}
    return {o.effect.id for o in found if o.effect.beside in absent}


def two_together(
    start: Explanation, current: Explanation, trials: Sequence[Trial] | None, found: Sequence[Option], family: Family,
    check: Check, settings: Settings,
) -> tuple[Explanation, dict[str, float]] | None:  # fmt: skip
    """Two effects that stand together where neither stands alone; None where there are none.

    What two large causes leave has structure that the generic family describes better than either with a remainder. Asked only
    where much is unexplained; each then has to hold against any structure in its place, with the other present.

    Returns:
        the model with both, and the evidence of the names in it.
    """
    if sum(p.log_evidence for p in current.remainder.structures) < settings.nats_for_two:
        return None
    trials = _tried(current, found) if trials is None else trials
    best: tuple[Explanation, dict[str, float]] | None = None
    for trial in trials[: settings.refits]:
        check()
        one = explain(start, current, trial, family)
        if one is None or one.named - current.named < settings.nats_for_two:
            continue
        for two in step(start, one, found, family, None, check, settings)[: settings.refits]:
            if refused(start, one, two, family, settings)[0]:
                continue
            both = reshaped_again(start, two, family)
            kept, evidence = standing(start, both, family, settings)
            if set(kept.ids) == set(both.ids) and (best is None or both.log_evidence > best[0].log_evidence):
                best = both, evidence
    return best


def step(
    start: Explanation, current: Explanation, found: Sequence[Option], family: Family, trials: Sequence[Trial] | None,
    check: Check, settings: Settings,
) -> list[Explanation]:  # fmt: skip
    """The best effects on top of a model, fitted exactly, each with its remainder; best first."""
    open_ = [o for o in found if o.effect.id not in current.ids]
    ids = {o.effect.id for o in open_}
    trials = _tried(current, found) if trials is None else [t for t in trials if t.effect.id in ids]
    chosen = [t for t in trials[: settings.refits] if t.log_evidence > 1.0]
    if current.remainder.parts:
        more = _tried(current, found, current.remainder.block)
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


def _tried(current: Explanation, found: Sequence[Option], beside: Block | None = None) -> list[Trial]:
    """Every effect that a model does not have, on top of it or of more columns, best first."""
    ground = Ground(current.study.bench, current.study.base if beside is None else beside)
    tried = (try_option(ground, o, current.study.ready) for o in found if o.effect.id not in current.ids)
    return sorted(tried, key=lambda t: -t.log_evidence)


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
    top = max(guess)
    reach = max(settings.nats_to_refit, 0.1 * (top - study.bench.posterior(study.base).log_evidence))
    ranked = sorted(zip(guess, range(len(chosen)), strict=True), reverse=True)
    kept = [i for value, i in ranked if value > top - reach][: settings.refits]
    # the strongest without a remainder is fitted too: a general law of torque may have taken its place in the remainder
    return [chosen[i] for i in dict.fromkeys((*kept, 0))]
