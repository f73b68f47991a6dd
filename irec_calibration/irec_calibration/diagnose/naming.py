# SPDX-License-Identifier: Apache-2.0
"""Whether an effect may be named on top of a model: its evidence over any nonparametric structure in its place.

Asked when an effect comes in; whether all names of a model stand beside each other: `standing`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects.traits import Family as Alike
from ..identification.validation import HeldOut, gain
from .explanation import (
    Explanation,
    implausible,
    in_one_pose,
    of_axes,
    own_forms,
    remainder_of,
    shown_by_readings,
    without,
)
from .family import Family
from .form_errors import evidence_beside
from .forms import NO_FORMS, Forms, bends, forms_of, steps
from .held_out import held_out, only_good_poses
from .lasting import lasts
from .readings import along_readings
from .settings import Settings


def refused(start: Explanation, current: Explanation, one: Explanation, family: Family, settings: Settings) -> tuple[str, float]:
    """Why an effect is not named on top of a model, or an empty string; and its evidence over any nonparametric structure."""
    odds = odds_of(start, one, current, one.ids[-1], family, settings)
    if len(start.study.bench.poses) < settings.fewest_poses:
        return "there are too few poses to test it on others", odds
    if odds < needed(one, one.ids[-1], settings):
        if current.remainder.structures and one.named - current.named > settings.nats_to_name:
            words = current.remainder.structures[0].structure.words
            return f"what no effect of the catalogue has explains as much: {words}", odds
        return "its evidence is too small", odds
    why = why_not_by_itself(current, one, odds, settings)
    if why:
        return why, odds
    if in_one_pose(one, one.ids[-1]):
        stays = lasts(one.study, one.added[-1])
        if stays < settings.nats_to_name:
            told = "do not have it" if stays < -settings.nats_to_name else "do not tell whether they have it too"
            return f"the readings of later poses {told}, so it may be a knocked reference or reflector", odds
    return "", odds


def why_not_by_itself(current: Explanation, one: Explanation, evidence: float, settings: Settings) -> str:
    """Why an effect is not taken in on top of a model, whatever else explains as much, or an empty string: values that can't be,
    or an error on held-out poses that does not fall.

    Args:
        evidence: of the effect, nats.
    """
    effect_id = one.ids[-1]
    beyond = implausible(one, effect_id)
    if beyond or in_one_pose(one, effect_id):
        return beyond
    helped = _helped(current, one, settings)
    if helped <= 0.0:  # while much has no name yet, poses may predict each other badly whatever is true: it is asked beside that
        helped = _helped(current, one, settings, beside=True) - 1.0
    more = settings.nats_to_name * (1.0 - helped)
    return "it does not help on held-out poses" if evidence < needed(one, effect_id, settings) + more else ""


def _helped(current: Explanation, one: Explanation, settings: Settings, *, beside: bool = False) -> float:
    """By how much the error on held-out poses falls, of what it has to, at most 1; without end below 0 where it does not.

    Args:
        beside: each model with its remainder.
    """

    def found(e: Explanation) -> HeldOut:
        columns = range(e.study.base.A.shape[1], e.remainder.block.A.shape[1]) if beside else ()
        return only_good_poses(held_out(e.study, e.remainder.block.take(list(columns))), one.study, one.remainder)

    mean, se, _ = gain(found(current), found(one))
    return min(mean / max(settings.held_out_sigmas * se, 1e-300), 1.0) if np.isfinite(mean) and mean > 0.0 else -np.inf


def odds_of(start: Explanation, one: Explanation, bare: Explanation, effect_id: str, family: Family, settings: Settings) -> float:
    """What is to be held against `needed`: the evidence of a name over a model without it, or over any nonparametric structure in
    its place, whichever falls shorter of what is asked of it.

    That the effect is there is asked first. Structures, the best of hundreds, need only be told apart from it: over them a name
    may be as weak as `nats_over_structure`, however many readings stand out.

    An effect that every robot has needs evidence of its own; against structures it may be as weak as what is not told apart.

    The general law of an axis' torque is no rival of an effect that is a form of it: it stays out on both sides. Where another
    effect bends the curve of that axis already, it is one: gears follow neither exactly, and the second may only mend the first.
    A drift of another form is no rival unless it explains more than what is not told apart, or is left beside the name and
    explains more than that (in an absolute session the name has to be preferred to it); a curve of an axis' last step is none of
    settling and friction unless it explains more; a link that tilts instead of an axis that turns is none unless it is preferred.
    A curve of few coefficients has a cause's form only nearly: a share of what the nonparametric structures explain counts for
    them. Where the readings at the references have the effect, which no structure moves, none is its rival; and where
    differences bear out the value of the readings, both count.
    """
    shown = shown_by_readings(one, effect_id)
    if shown:
        along = along_readings(bare.study, one.term(effect_id).effect)
        own = max(one.named - bare.named, along)
        return own + shown if along > settings.nats_to_prefer else own
    forms = own_forms(one, effect_id)

    def beside(forms: Forms) -> tuple[float, float]:
        """Evidence of structures in its place, and of those that are left beside it."""
        rest = remainder_of(bare.study, family, one.remainder.parts, forms)
        if not forms:
            return max(rest.gained, bare.remainder.gained), one.remainder.gained
        return rest.gained, remainder_of(one.study, family, one.remainder.parts, forms).gained

    forms, with_exact = replace(forms, steps=frozenset(), angles=frozenset()), forms
    own = one.named - bare.named
    law = one.term(effect_id).effect.family is Alike.TORQUE_LAW
    in_place, left = beside(replace(forms, tilts=law))
    odds = own + left - in_place
    may_be_as_weak = settings.nats_to_separate + settings.nats_to_name
    if of_axes(one, effect_id):
        # to be there it needs no more than to explain as well as what has no name (nothing that is not told apart from it speaks
        # against it); to be of a size that shows, evidence of its own
        return min(odds + may_be_as_weak, own)
    if law:  # gears have laws of their own far more often than bearings: a tilt speaks against one where it is preferred to it
        instead, more = beside(forms)
        # that several gears should bend at once is no likelier than that one bearing gives way
        rare = len(bends(one.term(effect_id), one.study.ready)) > 1
        preferred = 0.0 if rare else settings.nats_over_structure + settings.nats_to_prefer
        odds = min(odds, own - instead + max(left + preferred, more))
        in_place = max(in_place, instead) if rare else in_place
    if forms.drifts:
        instead, more = beside(NO_FORMS)
        # where most of a drift is left to another form of it, the name is not that drift, and has to be told apart from it
        other = sum(p.log_evidence for p in one.remainder.structures if p.structure.is_drift)
        told = may_be_as_weak if other <= own else 0.0
        if one.study.ready.kind == "absolute":  # there a general course in the base frame is such a form: a true drift beats it
            told = min(told, settings.nats_over_structure - settings.nats_to_prefer)
        # another cause whose form is not quite right leaves a drift too, told from this one by nothing: twice the evidence
        odds = min(odds - settings.nats_to_name, own + more - instead + told)
    if in_one_pose(one, effect_id):  # differences don't tell it from a bad pose, the readings of later poses may
        odds += lasts(one.study, one.term(effect_id))
    if (with_exact.steps or with_exact.angles) and _of_form(one, with_exact) < settings.nats_to_name:
        # settling, friction and an encoder's harmonics are exact members of such a curve: where nothing that counts is left
        # beside them, it loses nothing by standing for them, as what else would do in their place does
        in_place, left = beside(with_exact)
        # by its last step an axis turns for these two reasons only: a curve that explains as much is one of them
        told = settings.nats_to_separate if with_exact.steps else 0.0
        odds = min(odds + told, own + left - in_place - settings.share_of_form * max(in_place - left, 0.0))
        # one that by itself explains less than the curve of the angle it stands for is none of these
        odds -= max(_of_form(bare, replace(with_exact, steps=frozenset())) - own, 0.0)
    else:
        odds -= settings.share_of_form * max(in_place - left, 0.0)
    if in_one_pose(one, effect_id):
        return odds
    odds = less_what_is_lent(odds, start, one, bare, effect_id, family, settings)
    odds = max(odds, with_others_by_step(start, one, bare, effect_id, family))
    return max(odds, min(odds + needed(one, effect_id, settings) - settings.nats_over_structure, own))


def _of_form(one: Explanation, forms: Forms) -> float:
    """Evidence of what a model leaves to structures of some forms, nats."""
    return sum(p.log_evidence for p in one.remainder.structures if forms.has(p.structure))


def less_what_is_lent(
    odds: float, start: Explanation, one: Explanation, bare: Explanation, effect_id: str, family: Family, settings: Settings
) -> float:  # fmt: skip
    """Evidence of a name without what it may have from causes beside it, nats: these have their form only nearly; it may mend it.

    A share of theirs, but of friction in the gears, whose forms are many, no more than what is left of it where friction may
    deviate from its form by any smooth function, of which half counts.
    """
    lenders, share = _lenders(one, bare, effect_id, settings)
    lent = share * sum(max(bare.named - without(start, bare, i, family).named, 0.0) for i in lenders)
    friction = [i for i in lenders if "order" in bare.term(i).effect.needs]
    if lent <= 0.0 or not friction or odds < settings.nats_to_name:
        return odds - lent
    return max(odds - lent, min(odds, settings.share_beside_friction * evidence_beside(one, effect_id, friction, settings)))


def _lenders(one: Explanation, bare: Explanation, effect_id: str, settings: Settings) -> tuple[list[str], float]:
    """Effects beside one whose form that one may mend, and the share of their evidence that it may have of them.

    A step in time mends a drift; curves by which axes turn with their own angle mend the pull of a hose; what creeps and what a
    hose pulls mend friction in the gears, of which other parts of the load's history are seen.
    """
    scene, effect = one.study.ready, one.term(effect_id).effect
    mine = forms_of(one.term(effect_id), scene)
    if mine.angles:
        return [t.effect.id for t in bare.added if t.effect.loads_arm], settings.share_feigned
    if scene.kind == "loaded" and (effect.loads_arm or {"time", "load"} <= {*effect.needs}):
        return [t.effect.id for t in bare.added if "order" in t.effect.needs], settings.share_of_second_law
    if effect.family is Alike.TIME and not mine.drifts:
        return [t.effect.id for t in bare.added if forms_of(t, scene).drifts], settings.share_feigned
    return [], 0.0


def with_others_by_step(start: Explanation, one: Explanation, bare: Explanation, effect_id: str, family: Family) -> float:
    """Evidence of an effect of the step just made, over its absence and, together with the others that turn the same axes by that
    step, over any curves of it in the place of all of them; -inf where there are no others.

    Each by itself is told from a curve by little where another one is there: the curve of an axis that settles and has friction
    has both. Together they have to be better than any smooth curve.
    """
    scene = one.study.ready
    mine = steps(one.term(effect_id), scene)
    others = [t.effect.id for t in one.added if t.effect.id != effect_id and steps(t, scene) & mine]
    if not others:
        return -np.inf
    curves = Forms(steps=mine.union(*(steps(one.term(i), scene) for i in others)))
    with_all = one.named + remainder_of(one.study, family, one.remainder.parts, curves).gained
    absent = bare.named + remainder_of(bare.study, family, one.remainder.parts, curves).gained
    none = bare
    for i in others:
        none = without(start, none, i, family)
    instead = none.named + max(remainder_of(none.study, family, one.remainder.parts).gained, none.remainder.gained)
    return min(with_all - absent, with_all - instead)


def one_cause_of_bad_rows(start: Explanation, bare: Explanation, one: Explanation, family: Family, settings: Settings) -> bool:
    """Whether readings that stand out of a model follow one effect by far better than bad luck, at a size that can't be.

    Then they are not bad luck, and its form is not theirs.
    """
    rows, effect_id = bare.remainder.bad_rows, one.ids[-1]
    if not rows or in_one_pose(one, effect_id) or not implausible(one, effect_id):
        return False
    least = needed(one, effect_id, settings) + settings.nats_per_bad_row * len(rows)
    return odds_of(start, one, bare, effect_id, family, settings) >= least


def needed(one: Explanation, effect_id: str, settings: Settings) -> float:
    """Evidence that a name needs where nothing else is left."""
    if of_axes(one, effect_id):
        return settings.nats_to_name
    tails = settings.nats_per_bad_row * len(one.remainder.bad_rows)
    return tails + (settings.nats_in_one_pose if in_one_pose(one, effect_id) else settings.nats_to_name)
