# SPDX-License-Identifier: Apache-2.0
"""Which effects would do in the place of one that was added, everything refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ..effects.station_registration import StationRegistration
from ..effects.traits import Family as Alike
from ..model import Term
from .candidates import Option, try_option
from .explanation import (
    Explanation,
    also_called,
    ends_at,
    explain,
    implausible,
    in_one_pose,
    is_simpler,
    rather,
    remainder_of,
    reshaped_again,
    shown_by_readings,
    without,
)  # fmt: skip
from .family import Family
from .forms import Forms, follows_step, forms_of
from .ground import Ground
from .lasting import lasts
from .readings import carried, could_carry, proved
from .remainder import grow
from .settings import Settings
from .study import Study

Check = Callable[[], None]


@dataclass(frozen=True)
class InPlace:
    """A rival in the place of a name.

    Attributes:
        model: with the rival.
        odds: of the name over it, nats; own: of the name over none in its place; share: of own, which the name has to
            bring more.
    """

    model: Explanation
    odds: float
    own: float
    share: float


@dataclass(frozen=True)
class Rivals:
    """What would do in the place of names.

    Attributes:
        of: added effect -> others and the odds against each, nats: it is one of these and itself.
        likelier: models in which another effect stands in a name's place and explains the session better by more than what is not
            told apart, each with the model without either; the likeliest first.
        models: (added effect, rival) -> the rival in its place.
    """

    of: dict[str, tuple[tuple[str, float], ...]] = field(default_factory=dict)
    likelier: tuple[tuple[Explanation, Explanation], ...] = ()
    models: dict[tuple[str, str], InPlace] = field(default_factory=dict)


def rivals_of(
    start: Explanation, final: Explanation, near: dict[str, dict[str, Explanation | None]], gone: Sequence[str],
    found: Sequence[Option], family: Family, check: Check, settings: Settings,
) -> Rivals:  # fmt: skip
    """Which other effects would do in the place of each added one, everything refitted.

    Two laws of an axis' torque (play, stiffening, friction, counterbalance) are told apart by a share of the name's evidence
    more than two other effects: gears follow none of them exactly.
    What explains something else beside the name is no rival. Of an effect and a special form of it (`Effect.special_of`) that are
    not told apart the special form is the likelier, and so is what fitted values are rather (`Effect.rather`).
    Play and a soft gear are told apart by how much torque takes it up: at the border of the two either may do.
    What the readings at the references carry has no rival that they carry less; what they prove without the differences, which
    other causes may bend, has none that does not move them.

    Args:
        near: added effect -> effects that were about as good when it came in, each with its explanation then.
        gone: effects that were taken in and are no longer.
    """
    out: dict[str, tuple[tuple[str, float], ...]] = {}
    likelier: list[tuple[float, Explanation, Explanation]] = []
    models: dict[tuple[str, str], InPlace] = {}
    by_id = {o.effect.id: o for o in found}
    for term in final.added:
        others: dict[str, Explanation | None] = {i: e for i, e in near.get(term.effect.id, {}).items() if i not in final.ids}
        # those of its family too, before which something else may have come in
        by_step = follows_step(term.effect, final.study.ready)
        alike = [
            o.effect.id
            for o in found
            if o.effect.family is term.effect.family
            or (by_step and follows_step(o.effect, final.study.ready))
            or (term.effect.turns_by_angle and o.effect.turns_by_angle)
            or o.effect.special_of == term.effect.id
        ]
        others |= {i: None for i in (*alike, *gone) if i not in final.ids and i not in others}
        also = also_called(term, final.study.ready)
        if also and also not in final.ids:
            out[term.effect.id] = ((also, 0.0),)
        if not others:
            continue
        check()
        bare = without(start, final, term.effect.id, family)
        rest = bare.study
        ground = Ground(rest.bench, rest.base)
        forms = forms_of(term, final.study.ready)
        whole = _without_forms(final, family, forms)
        shown = shown_by_readings(final, term.effect.id)
        sure = proved(rest, term.effect)
        # another effect leaves that pose to a bad reading, after which nothing has the step
        stays = lasts(final.study, term) if in_one_pose(final, term.effect.id) else 0.0
        same, no_rival = [], set[str]()
        for other, then in others.items():
            option = by_id[other].on(rest)
            if not option.tables:
                continue
            trial = try_option(ground, option, rest.ready)
            if then is None and trial.log_evidence < settings.nats_to_prefer:
                continue
            one = explain(start, bare, trial, family)
            if one is None or implausible(one, other):  # no value that can be is no rival
                continue
            if in_one_pose(one, other) and lasts(one.study, one.term(other)) < settings.nats_to_name:
                continue  # it may as well be a bad reading, which is asked beside both
            could = could_carry(one.study, one.term(other)) if shown else 0.0
            if shown - max(shown_by_readings(one, other), could) > settings.nats_to_separate:
                continue
            if sure and not one.term(other).effect.in_readings:
                continue
            law = (term.effect.family is Alike.TORQUE_LAW or by_step) and other in alike
            if law:  # as the shapes of the model with the name were found beside each other, so are these
                one = reshaped_again(start, one, family)
            if then is not None and set(then.ids) == set(one.ids):
                # beside it the shapes of the others may have been better than beside the one named
                one = max(one, then, key=lambda e: e.log_evidence)
            own_forms = forms_of(one.term(other), one.study.ready)
            own = _without_forms(one, family, own_forms) - _without_forms(bare, family, own_forms)
            by_themselves, by_rival, by_none = _beside_bad_rows((final, one, bare), family)
            if own < settings.nats_to_prefer or by_rival - by_none < settings.share_of_rival * (by_themselves - by_none):
                continue  # what has no name explains it there, not this effect
            # whether a reading stands out a little is asked beside both
            more = (0.0 if in_one_pose(one, other) else stays) + _unread(final, term.effect.id, one, other)
            odds = max(whole, _without_forms(final, family, forms, one)) - _without_forms(one, family, forms, final) + more
            raw = min(odds, by_themselves - by_rival + more)
            if other == term.effect.special_of and raw > -settings.nats_to_separate and is_simpler(term):  # not told apart
                continue
            # an arm that tilts or bends gives way in its gears too: without these it is named only where they explain far less
            beside = settings.share_beside if other == term.effect.beside else 0.0
            share = (settings.share_of_form if by_step else settings.share_between_laws) if law else beside
            counts = as_they_count(raw, by_themselves - by_none, share)
            if _is_the_name(final, term.effect.id, one, other, raw, settings):
                no_rival.add(other)
                continue
            # what has no name may tell them apart no better than they do themselves
            if odds < settings.nats_to_name or counts < settings.nats_over_rival:
                if not law and has_a_cause_of_its_own(start, (final, one, bare), by_id[other], family, settings):
                    continue
                same.append((other, counts))
                models[term.effect.id, other] = InPlace(one, raw, by_themselves - by_none, share)
                better = _takes_its_place(final, term.effect.id, one, other, raw, settings)
                if better and one.term(other).effect.beside != term.effect.id:
                    likelier.append((raw, one, bare))
        known = {i for i, _ in same} | no_rival
        same += [one for one in out.get(term.effect.id, ()) if one[0] not in known]
        out.pop(term.effect.id, None)
        if same:
            out[term.effect.id] = tuple(sorted(same, key=lambda t: t[1]))
    return Rivals(out, tuple((one, bare) for _, one, bare in sorted(likelier, key=lambda t: t[0])), models)


def _is_the_name(final: Explanation, effect_id: str, one: Explanation, other: str, odds: float, settings: Settings) -> bool:
    """Whether the values of a rival are rather the name itself: a rival that came to a bound would go on where the name begins,
    unless that came to the same bound. A name that has no fewer values to fit needs to be preferred by more.

    Args:
        odds: of the name over it.
    """
    if ends_at(one, other) == effect_id:
        as_many = len(final.term(effect_id).estimates) >= len(one.term(other).estimates)
        least = settings.nats_to_separate if as_many else settings.nats_to_prefer
        return ends_at(final, effect_id) != other and odds > least
    return rather(one, other) == effect_id


def _takes_its_place(final: Explanation, effect_id: str, one: Explanation, other: str, odds: float, settings: Settings) -> bool:
    """Whether a rival is named instead: it explains by far more; of what is not told apart the simpler form, or what the name's
    values are rather. A name that came to a bound may as well begin there, so that other one has to be preferred.

    Args:
        odds: of the name over it.
    """
    if odds < -settings.nats_to_separate:
        return True
    rival = one.term(other)
    if rival.effect.special_of == effect_id and is_simpler(rival) and odds < settings.nats_to_separate:
        return True
    if rather(final, effect_id) != other:
        return False
    return odds < -settings.nats_to_prefer or ends_at(final, effect_id) != other


def _unread(final: Explanation, effect_id: str, one: Explanation, other: str) -> float:
    """Log odds of a name over a rival by how far the readings at the references are against either, nats; none between stations
    that are turned and a first axis that stands otherwise, which turn the same readings."""
    if all(_turns_all(e.term(i), e.study) for e, i in ((final, effect_id), (one, other))):
        return 0.0
    of_name, of_rival = (min(carried(e.study, e.term(i)), 0.0) for e, i in ((final, effect_id), (one, other)))
    return of_name - of_rival


def _turns_all(term: Term, study: Study) -> bool:
    """Whether an effect turns all that stations see of the arm alike: turned stations, or errors of the first axis alone."""
    if isinstance(term.effect, StationRegistration):
        return True
    if not term.effect.chosen_by_poses:
        return False
    return {p.axis for p in term.effect.parameters(study.ready) if p.name in term.estimates} == {0}


def has_a_cause_of_its_own(
    start: Explanation, models: tuple[Explanation, Explanation, Explanation], rival: Option, family: Family, settings: Settings
) -> bool:
    """Whether a rival explains beside a name most of what it does in its place, and the name beside the rival what a name has to.

    Args:
        models: with the name, with the rival in its place, and with neither.
    """
    final = models[0]
    option = rival.on(final.study)
    if not option.tables:
        return False
    both = explain(start, final, try_option(Ground(final.study.bench, final.study.base), option, final.study.ready), family)
    if both is None or implausible(both, option.effect.id):
        return False
    by_both, by_name, by_rival, by_none = _beside_bad_rows((both, *models), family)
    rivals_own, names_own = by_both - by_name, by_both - by_rival
    return rivals_own > settings.share_of_own * (by_rival - by_none) and min(rivals_own, names_own) > settings.nats_to_name


def as_they_count(odds: float, own: float, share: float) -> float:
    """Odds of a name over a rival as they are held against `nats_over_rival`, nats.

    Args:
        odds: as they are; own: evidence of the name over none in its place; share: of that, which the name has to bring more than
            the rival. A law of torque has the gear's form only nearly, and may win by as much as that loses.
    """
    if not share:
        return odds
    return max(odds - share * own, min(odds, 0.01))  # the likelier of two stays the likelier


def _beside_bad_rows(models: Sequence[Explanation], family: Family) -> list[float]:
    """Log evidence of models without what has no name, but for the readings that stand out of any of them.

    A step in one pose would else be a rival of everything in a session with a bad reading: it alone explains that one.
    """
    bad = {id(p.structure): p for one in models for p in one.remainder.bad_rows}
    if not bad:
        return [one.named for one in models]
    return [one.named + grow(one.study.bench, family, one.study.base, tuple(bad.values()), most=0).gained for one in models]


def _without_forms(one: Explanation, family: Family, forms: Forms, other: Explanation | None = None) -> float:
    """Log evidence of a model whose remainder holds none of some structures.

    Args:
        other: whose bad rows are tried too, where they are not the same.
    """
    known = {id(p.structure) for p in one.remainder.parts}
    more = tuple(p for p in other.remainder.bad_rows if id(p.structure) not in known) if other is not None else ()
    if not more and not any(forms.has(p.structure) for p in one.remainder.structures):
        return one.log_evidence
    return one.named + remainder_of(one.study, family, (*one.remainder.parts, *more), forms).gained
