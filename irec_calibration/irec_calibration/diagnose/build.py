# SPDX-License-Identifier: Apache-2.0
"""Model building: effects enter one by one and leave again, each by its evidence given the others and a nonparametric remainder.

At every step the best effects are fitted exactly together with everything that is named already, each with a nonparametric
remainder of its own. One is taken in where model and remainder with it explain the session better, by far, than any
remainder without it. So a cause need not explain all of the residual, and a name never stands for a structure that the
generic family describes as well.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from ..identification.observe import Observation
from .candidates import Option, Trial, options
from .explanation import Explanation, reshaped_again, without
from .family import Family
from .level import family_in_view
from .more_parts import with_more_parts
from .naming import needed, odds_of, refused
from .remainder import grow
from .rivals import Check, InPlace, Rivals, rivals_of
from .settings import SETTINGS, Settings
from .several import Tried, several_together
from .standing import all_stand, proven, pruned
from .study import Study
from .swapped import as_rather, told_apart
from .tries import step, tried_on, two_together, waiting

Look = Callable[[Explanation, Family], "Observation | None"]  # the observation as a model asks to see it, if that is otherwise
ROUNDS = 4  # in which a model of an absolute session is built on without the names that have fallen


@dataclass(frozen=True)
class Built:
    """Outcome of model building.

    Attributes:
        start: the model without anything added; family: the generic structures on this session.
        trials: every effect on top of the start, best first; skipped: effect id -> why it can't show.
        singles: the effects fitted exactly at the first step, best first.
        steps: the start and every model on the way, the last is the result; evidence: of the name that each step added.
        closest: the best name that was refused at the end, and why.
        rivals: added effect -> others that would do in its place, each with the odds against it in nats; rival_models: the
            models with these, by both.
        possible: effects that can act on the session; tried: added effects of a model -> of these, fitted exactly on top of it.
        seen: the observation as the last model asks to see it (`Look`), where that is otherwise; then nothing else is final.
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
    rival_models: dict[tuple[str, str], InPlace] = field(default_factory=dict)
    possible: tuple[Option, ...] = ()
    tried: Tried = field(default_factory=dict)
    seen: Observation | None = None

    @property
    def final(self) -> Explanation:
        return self.steps[-1]


@dataclass
class _Way:
    """The models on the way of one build; attributes as of `Built`.

    Attributes:
        found: effects that can act on the session; near: added effect -> those that were about as good when it came in.
        tried: what was fitted exactly on top of the last model.
        looked_at: the model that the observation was last asked of; beyond: what was fitted exactly on top of what has all names.
    """

    start: Explanation
    family: Family
    found: Sequence[Option]
    trials: tuple[Trial, ...]
    check: Check
    look: Look
    settings: Settings
    steps: list[Explanation]
    evidence: dict[str, float] = field(default_factory=dict)
    near: dict[str, dict[str, Explanation | None]] = field(default_factory=dict)
    singles: tuple[Explanation, ...] = ()
    tried: Sequence[Explanation] = ()
    closest: Explanation | None = None
    reason: str = ""
    looked_at: Explanation | None = None
    beyond: Tried = field(default_factory=dict)

    def otherwise(self) -> Observation | None:
        """The observation as the last model asks to see it; None where that is as it is."""
        if self.looked_at is self.steps[-1]:
            return None
        self.looked_at = self.steps[-1]
        return self.look(self.steps[-1], self.family)

    def go_on(self, fallen: Collection[str]) -> Observation | None:
        """Take effects in as long as one has the evidence, but none of those that have fallen.

        Returns:
            the observation as the model asks to see it, where that is otherwise before two effects are tried together, which is
            most of the work.
        """
        found = [o for o in self.found if o.effect.id not in fallen]
        while True:
            wider = with_more_parts(self.steps[-1], self.family, self.check, self.settings)
            one, odds = as_rather(self.start, wider, self.evidence, found, self.family, self.settings)
            self.steps[-1], self.evidence = told_apart(self.start, one, odds, found, self.family, self.settings)
            if len(self.steps[-1].added) >= self.settings.most_names:
                return None
            self.check()
            known = [t for t in self.trials if t.effect.id not in fallen] if len(self.steps) == 1 else None
            taken = self._one(found, known)
            if taken is None and self.looked_at is None:
                seen = self.otherwise()
                if seen is not None:
                    return seen
            taken = taken or self._two(found, known)
            if taken is None:
                return None
            self.closest, self.reason = None, ""
            self.steps.append(taken)
            less = pruned(self.start, taken, self.family, self.settings)
            if less is not taken:
                self.evidence = {i: e for i, e in self.evidence.items() if i in less.ids}
                if any(set(s.ids) == set(less.ids) for s in self.steps):
                    return None
                self.steps.append(less)

    def _one(self, found: Sequence[Option], known: Sequence[Trial] | None) -> Explanation | None:
        """The last model with one effect more; those that are weighed beside another come after all others."""
        start, current, family, settings = self.start, self.steps[-1], self.family, self.settings
        wait = waiting(current, found)
        for chosen in ([o for o in found if o.effect.id not in wait], *([found] if wait else ())):
            self.tried = step(start, current, chosen, family, known, self.check, settings)
            self.singles = self.singles or tuple(self.tried)
            taken = self._likeliest(current)
            if taken is not None:
                one, odds = taken
                self.evidence[one.ids[-1]] = odds
                least = one.log_evidence - 2.0 * settings.nats_to_separate
                others = (t for t in self.tried if t is not one and t.log_evidence > least)
                self.near[one.ids[-1]] = {t.ids[-1]: t for t in others}
                return reshaped_again(start, one, family)
        return None

    def _likeliest(self, current: Explanation) -> tuple[Explanation, float] | None:
        """The best of what was tried that is not refused, with its evidence; of those that are not told apart from it the one
        that explains most by itself, since beside it less is left without a name."""
        taken: tuple[Explanation, float] | None = None
        least = -np.inf
        for one in self.tried:
            if one.log_evidence < least:
                break
            if taken is not None and one.named <= taken[0].named:
                continue
            why, odds = refused(self.start, current, one, self.family, self.settings)
            if not why:
                least = one.log_evidence - self.settings.nats_to_separate if taken is None else least
                taken = one, odds
            elif taken is None and (self.closest is None or one.named > self.closest.named):
                self.closest, self.reason = one, why
        return taken

    def _two(self, found: Sequence[Option], known: Sequence[Trial] | None) -> Explanation | None:
        both = two_together(self.start, self.steps[-1], known, found, self.family, self.check, self.settings)
        if both is None:
            return None
        self.evidence |= both[1]
        return both[0]

    def several(self) -> None:
        """Take in several effects that stand only together."""
        current = self.steps[-1]
        tried = [t for t in self.tried if set(t.ids[:-1]) == set(current.ids)]
        found = several_together(self.start, current, self.found, tried, self.family, self.check, self.settings)
        self.beyond = found.tried
        if found.model is not None:
            self.evidence = found.evidence
            self.near |= found.near
            self.closest, self.reason = None, ""
            self.steps.append(found.model)

    def back(self) -> Explanation:
        """Leave the names that do not stand; returns the last model, which may have had more."""
        whole = self.steps[-1]
        final, self.evidence = proven(self.start, self.steps, self.family, self.settings, self.check)
        if final is not whole:
            self.closest, self.reason = whole, "it is no stronger than the structure that no effect explains"
            self.steps = [s for s in self.steps if set(s.ids) < set(final.ids)] + [final]
        return whole

    def rivals(self, gone: Sequence[str]) -> Rivals:
        """What would do in the place of the names; a name gives way to another effect that explains by far more in its place."""
        start, family, settings = self.start, self.family, self.settings
        found = rivals_of(start, self.steps[-1], self.near, gone, self.found, family, self.check, settings)
        for _ in self.steps[-1].ids:
            likelier = [(o, b) for o, b in found.likelier if not any(set(s.ids) == set(o.ids) for s in self.steps)]
            better = next(
                (
                    (one, bare)
                    for one, bare in likelier
                    if not refused(start, bare, one, family, settings)[0] and all_stand(start, one, family, settings)
                ),
                None,
            )
            if better is None:
                break
            one, bare = better
            new, old = one.ids[-1], next(i for i in self.steps[-1].ids if i not in bare.ids)
            self.evidence = {i: self.evidence[i] for i in bare.ids} | {new: odds_of(start, one, bare, new, family, settings)}
            gone = [*(i for i in gone if i != new), old]
            # what would do for the one would do for the other
            self.near[new] = {**{i: None for i, _ in found.of[old] if i != new}, **self.near.get(new, {})}
            self.steps.append(one)
            found = rivals_of(start, one, self.near, gone, self.found, family, self.check, settings)
        return found


def build(
    study: Study, check: Check = lambda: None, look: Look = lambda *_: None, settings: Settings = SETTINGS,
    without: Mapping[str, str] = MappingProxyType({}),
) -> Built:  # fmt: skip
    """Build a model on top of a start as far as the evidence goes.

    Args:
        check: raises where the work was cancelled; look: asked once before the most work, and of the result.
        without: effects that are left out, and why.
    """
    family = family_in_view(study)
    found, skipped = options(study, check=check)
    found, skipped = [o for o in found if o.effect.id not in without], {**skipped, **without}
    start = Explanation((), study, 0.0, grow(study.bench, family, study.base))
    way = _Way(start, family, found, tuple(tried_on(start, found)), check, look, settings, [start])
    fallen: dict[str, set[str]] = {}  # effect -> the names that stood when it fell
    gone: list[str] = []
    # an absolute session starts without springs, of which what has fallen may have kept some out; in a loaded one what explains
    # it once names have fallen may be the same unknown cause in another guise
    for _ in range(ROUNDS if study.ready.kind == "absolute" else 1):
        # beside names that have come since, what has fallen may stand: it fell for what these explain
        seen = way.go_on([i for i, beside in fallen.items() if beside >= set(way.steps[-1].ids)])
        if seen is not None:
            return Built(start, family, way.trials, skipped, way.singles, tuple(way.steps), way.evidence, seen=seen)
        whole = way.back()
        gone += _in_their_place(start, whole, way.steps[-1].ids, family, settings)
        if whole is way.steps[-1]:
            break
        stand = set(way.steps[-1].ids)
        fallen |= {i: stand for i in whole.ids if i not in stand}
    way.several()
    names = way.steps[-1].ids
    rivals = way.rivals([i for i in dict.fromkeys(gone) if i not in names])
    return Built(
        start, family, way.trials, skipped, way.singles, tuple(way.steps), way.evidence, way.closest, way.reason, rivals.of,
        rivals.models, tuple(found), way.beyond, way.otherwise(),
    )  # fmt: skip


def _in_their_place(
    start: Explanation, whole: Explanation, names: Sequence[str], family: Family, settings: Settings
) -> list[str]:
    """Effects of a model that are not named in the end, where they might do for one that is; none where each name holds beside
    all of them: then each explains something else."""
    gone = [i for i in whole.ids if i not in names]
    if not gone or not set(names) <= set(whole.ids):
        return gone
    bare = {i: without(start, whole, i, family) for i in names}
    holds = (odds_of(start, whole, bare[i], i, family, settings) >= needed(whole, i, settings) for i in names)
    return [] if all(holds) else gone
