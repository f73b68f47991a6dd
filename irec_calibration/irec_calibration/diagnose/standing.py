# SPDX-License-Identifier: Apache-2.0
"""Whether the names of a model stand beside each other, and beside what stays without a name.

Asked of all others when an effect has come, and of the whole at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..identification.validation import gain
from .explanation import Explanation, everywhere, implausible, in_one_pose, own_forms, remainder_of, shown_by_readings, without
from .family import Family
from .form_errors import evidence_beside, feigned
from .forms import Forms, bends, courses, forms_of, has_form_of
from .held_out import held_out, only_good_poses
from .more_parts import with_more_parts
from .naming import needed, odds_of
from .parts import without_columns
from .remainder import Part
from .rivals import Check
from .settings import Settings


def pruned(start: Explanation, one: Explanation, family: Family, settings: Settings) -> Explanation:
    """A model without the effects that what came last made needless."""
    while len(one.added) > 1:
        for effect_id in one.ids[:-1]:
            if plainly_needed(one, effect_id, family, settings):
                continue
            bare = without(start, one, effect_id, family)
            if odds_of(start, one, bare, effect_id, family, settings) < settings.nats_to_name:
                one = bare
                break
        else:
            break
    return one


def plainly_needed(one: Explanation, effect_id: str, family: Family, settings: Settings) -> bool:
    """Whether a model without one of its effects would be so much poorer in the linear problem about its fit that no refit of the
    others makes up for it."""
    bare = without_columns(one.study, effect_id)
    before, after = (s.bench.posterior(s.base) for s in (bare, one.study))
    lost = min(after.log_evidence - before.log_evidence, one.study.bench.saved(before.chi2, after.chi2))
    if lost < settings.nats_plainly:
        return False
    forms = replace(own_forms(one, effect_id), steps=frozenset(), angles=frozenset())  # as of `odds_of`
    in_its_place = remainder_of(bare, family, one.remainder.parts, forms)
    return lost + one.remainder.gained - in_its_place.gained >= settings.nats_plainly


def proven(
    start: Explanation, steps: Sequence[Explanation], family: Family, settings: Settings, check: Check = lambda: None
) -> tuple[Explanation, dict[str, float]]:
    """The model with the most names that no structure could feign and that are not too small beside the others; evidence of each.

    A structure of unknown form can feign an effect that moves the marker alike, and so can a named one whose form is not
    quite right. Two names may be too weak only because the later does part of what the other does: then the model stands that
    was there before.

    Args:
        steps: the models on the way, the last has all names. check: raises where the work was cancelled.
    """
    kept, evidence = standing(start, steps[-1], family, settings, check)
    for before in reversed(steps[:-1]):
        if len(before.ids) > len(kept.ids):
            more, odds = standing(start, before, family, settings, check)
            kept, evidence = (more, odds) if len(more.ids) > len(kept.ids) else (kept, evidence)
    return kept, evidence


def standing(
    start: Explanation, one: Explanation, family: Family, settings: Settings, check: Check = lambda: None
) -> tuple[Explanation, dict[str, float]]:
    """A model whose weakest name was taken out until all stand, and the evidence of each.

    What a name explained that what has no name outweighs is no unknown cause beside the others, once it is taken out.
    """
    most = np.inf
    while one.added:
        bare = {i: without(start, one, i, family) for i in one.ids}
        evidence = {i: odds_of(start, one, b, i, family, settings) for i, b in bare.items()}
        # what a name explains further parts of the others may, too, which nobody has asked beside it
        for i in [i for i, nats in evidence.items() if nats < settings.nats_plainly and len(one.added) > 1]:
            bare[i] = with_more_parts(bare[i], family, check, settings)
            evidence[i] = min(evidence[i], odds_of(start, one, bare[i], i, family, settings))
        weak = _weak(start, one, bare, evidence, family, settings)
        if not weak:
            most = min(most, one.remainder.without_a_name)
            weak = [i for i in one.ids if outweighed(one, bare, evidence, i, settings, most)]
        else:
            most = np.inf
        weak = weak or [i for i in one.ids if implausible(one, i)]  # where others' names have moved its values
        if not weak and not (_together(start, one, family, settings) and _helps(start, one)):
            weak = list(one.ids)
        if not weak:
            return one, evidence
        one = bare[min(weak, key=lambda i: evidence[i])]
    return one, {}


def all_stand(start: Explanation, one: Explanation, family: Family, settings: Settings) -> dict[str, float]:
    """Evidence of each name of a model, where all stand; else nothing, as soon as one is too weak, the last added first."""
    bare: dict[str, Explanation] = {}
    evidence: dict[str, float] = {}
    left = feigned(one, settings)
    for i in reversed(one.ids):
        bare[i] = without(start, one, i, family)
        evidence[i] = odds_of(start, one, bare[i], i, family, settings)
        if evidence[i] < _least(one, i, left, settings):
            return {}
    weak = _weak(start, one, bare, evidence, family, settings)
    fall = weak or any(outweighed(one, bare, evidence, i, settings) or implausible(one, i) for i in one.ids)
    return {} if fall else evidence


def _weak(
    start: Explanation, one: Explanation, bare: dict[str, Explanation], evidence: dict[str, float], family: Family,
    settings: Settings,
) -> list[str]:  # fmt: skip
    """Names of a model whose evidence is too small.

    Args:
        bare: the model without each of its names; evidence: of each.
    """
    left = feigned(one, settings)
    everything = max(start.study.bench.posterior(start.study.base).chi2 - one.chi2, 1e-9)
    share = {i: (b.study.bench.posterior(b.study.base).chi2 - one.chi2) / everything for i, b in bare.items()}
    least = {i: _least(one, i, left, settings) for i in one.ids}
    return [
        i
        for i in one.ids
        if evidence[i] < least[i]
        or _beside_larger(one, i, share, settings) < least[i]
        or _mends(start, one, bare[i], i, family, settings)
        or _part_of_another(one, bare[i], i, settings)
        or _of_another_form(one, bare[i], i, settings)
    ]


def _together(start: Explanation, one: Explanation, family: Family, settings: Settings) -> bool:
    """Whether several names have together, over structures in the place of all of them, what each of them needs by itself.

    Two effects may share what one unknown cause does; each is then needed beside the other, and each has evidence.
    """
    ids = [i for i in one.ids if not in_one_pose(one, i) and not shown_by_readings(one, i)]
    if len(ids) < 2:
        return True
    scene = one.study.ready
    own = [forms_of(one.term(i), scene) for i in ids]
    forms = Forms(
        axes=frozenset().union(*(f.axes for f in own)),
        drifts=any(f.drifts for f in own),
        turns=frozenset().union(*(f.turns for f in own)),
        steps=frozenset().union(*(f.steps for f in own)),
        angles=frozenset().union(*(f.angles for f in own)),
        histories=frozenset().union(*(f.histories for f in own)),
    )
    known = one.remainder.parts
    instead = remainder_of(start.study, family, known, forms).gained
    left = remainder_of(one.study, family, known, forms).gained
    return one.named - start.named + left - instead >= sum(needed(one, i, settings) for i in ids)


def _helps(start: Explanation, one: Explanation) -> bool:
    """Whether a model predicts held-out poses no worse than what it started from: one that came in beside another, which has
    fallen since, was asked beside that one. What one pose shows no other pose predicts."""
    if all(in_one_pose(one, i) for i in one.ids):
        return True
    before, after = (only_good_poses(held_out(e.study), one.study, one.remainder) for e in (start, one))
    mean, _, _ = gain(before, after)
    return not mean < 0.0  # not known of too few poses


def outweighed(
    one: Explanation, bare: dict[str, Explanation], evidence: dict[str, float], effect_id: str, settings: Settings,
    most: float = np.inf,
) -> bool:  # fmt: skip
    """Whether what stays without a name in a loaded session explains more than a name does: that is as likely a piece of it,
    unless the evidence of the name is several times what it needs beside that.

    What has the form of another name that explains more than it does is that one's, whose form is not quite right. An absolute
    session starts without springs, and real robots leave structure that has nothing to do with them.

    Args:
        bare: the model without each of its names; evidence: of each over structures in its place; most: evidence of what has no
            name, at most.
    """
    if one.study.ready.kind != "loaded" or in_one_pose(one, effect_id) or shown_by_readings(one, effect_id):
        return False
    own = {i: one.named - b.named for i, b in bare.items()}
    others = [(t, own[t.effect.id]) for t in one.added if t.effect.id != effect_id]

    def mends(part: Part) -> bool:
        return any(e > part.log_evidence and has_form_of(part.structure, t, one.study.ready) for t, e in others)

    if own[effect_id] >= min(most, sum(p.log_evidence for p in one.remainder.structures if not mends(p))):
        return False
    return evidence[effect_id] < settings.times_to_outweigh * _least(one, effect_id, feigned(one, settings), settings)


def _least(one: Explanation, effect_id: str, left: dict[str, float], settings: Settings) -> float:
    """Evidence that a name needs beside what structures that remain could feign of it."""
    # gears and links are there for certain; a base that gives way by more than others do is not, and somebody looks at its bolts
    is_arm = one.term(effect_id).effect.compliance_of is not None
    surely = (everywhere(one, effect_id) and is_arm) or shown_by_readings(one, effect_id)
    return needed(one, effect_id, settings) + (0.0 if surely else left[effect_id])


def _mends(
    start: Explanation, one: Explanation, bare: Explanation, effect_id: str, family: Family, settings: Settings
) -> bool:
    """Whether a law of torque explains little beside another one of the same axes: it may only mend that one's form.

    Args:
        bare: the model without it.
    """
    laws = {t.effect.id: bends(t, one.study.ready) for t in one.added if not t.effect.by_angle}
    mine = laws.get(effect_id)
    for other, axes in laws.items():
        if mine and other != effect_id and mine <= axes:
            first = bare.named - without(start, bare, other, family).named
            if one.named - bare.named < settings.share_of_second_law * first:
                return True
    return False


def _part_of_another(one: Explanation, bare: Explanation, effect_id: str, settings: Settings) -> bool:
    """Whether beside a drift much goes with the load and what the drift follows: that is one cause, such as gears that soften as
    they warm up, and not that drift.

    Args:
        bare: the model without it.
    """
    follows = courses(one.term(effect_id), one.study.ready)
    rest = [p for p in one.remainder.structures if not p.structure.is_drift]
    other = sum(p.log_evidence for p in rest if follows & {*p.structure.variables})
    return bool(other > settings.share_of_same_course * (one.named - bare.named))


def _of_another_form(one: Explanation, bare: Explanation, effect_id: str, settings: Settings) -> bool:
    """Whether beside a compliance that goes with its axis' own angle much of such a compliance is left: no linkage has that form;
    likewise of a base of a loaded session what goes with the first axis: a foot that lifts, or bolts that gape, are no spring.
    An absolute session has little but the weight to tell it by, and much else that goes with that axis.

    Args:
        bare: the model without it.
    """
    term = one.term(effect_id)
    turns = forms_of(term, one.study.ready).turns
    if term.effect.softens_with is not None and one.study.ready.kind == "loaded":
        turns |= {term.effect.softens_with}
    left = sum(p.log_evidence for p in one.remainder.structures if p.structure.softer_by_angle in turns)
    return bool(left > max(settings.nats_for_structure, settings.share_of_same_form * (one.named - bare.named)))


def _beside_larger(one: Explanation, effect_id: str, share: dict[str, float], settings: Settings) -> float:
    """Evidence of an effect beside much larger ones whose form is known only roughly; inf where none is."""
    if shown_by_readings(one, effect_id):  # no form of another effect moves readings
        return np.inf
    larger = [i for i in one.ids if share[effect_id] < settings.share_to_name * share[i]]
    return evidence_beside(one, effect_id, larger, settings) if larger else np.inf
