# SPDX-License-Identifier: Apache-2.0
"""The verdict in one plain paragraph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..effects import Family as Alike
from ..effects import find_effect
from ..effects.base import weightless
from ..effects.formula import in_words
from ..identification.noise import InferredNoise
from ..identification.provenance import too_few
from ..lengths import length
from ..robot.ratings import rating_known
from ..typing import Json
from .assessment import Assessment
from .error_falls import how_the_error_falls
from .expected_error import ExpectedError
from .explanation import also_called, implausible
from .part_sets import Parts
from .result import Candidate, Comparison, Measurement, Verdict
from .settings import SETTINGS
from .shown import Shown
from .study import Study
from .tool_weight import READ_AT_REFERENCES

SETS_SHOWN = 3  # sets of axes in a sentence
ROWS_SHOWN = 4

SHOWN_BY = {
    "readings_that_stand_out": "so many readings, or whole poses, stand out and had to be put aside that it is no bad luck",
    "few_poses": "readings of few poses follow one law together far better than bad luck does, too few to test it on others",
    "wandering": "within a pose readings wander by far more than such an instrument does, as if floor, stand or tool moved",
    "repeats": "repeats of the same sample agree better than that",
    "held_out_structure": "a smooth function of these variables lowers the error on held-out poses",
    "flexible_regression": "a flexible regression lowers the error on held-out poses",
}


def verdict_of(
    assessment: Assessment,
    shown: Shown,
    candidates: Sequence[Candidate],
    comparison: Comparison,
    planned: Sequence[Measurement],
) -> Verdict:
    """The verdict with its text."""
    study = assessment.built.start.study
    poses = len(study.bench.poses)
    weight, where, ids = assessment.weight_wrong, _where(assessment, shown), _named(assessment)
    parts = [
        f"The model leaves {length(comparison.rms_m)} ({length(shown.asked.held_out.rms_m)} on held-out poses);"
        f" noise explains {length(assessment.noise.inferred_m)}."
    ]
    if not np.any(np.abs(study.base.A) > 1e-6):
        parts.append("Nothing in this session loads the model: it can't identify anything.")
    if assessment.status == "missing_effect" and assessment.names:
        parts += _missing(assessment, shown, candidates, where)
    few = too_few(study.fit)
    if assessment.status == "adequate" and not few:
        more = " and what every robot has" if assessment.usual or assessment.usual_m else ""
        parts.append(f"Nothing shows any other cause than noise{more}.")
    parts += [f"One of {', '.join(_label(i) for i in s)} is missing: these data do not tell which." for s in assessment.one_of]
    parts += _why_either(assessment)
    if weightless(study.ready):
        parts.append(
            "The robot description gives no masses: what the arm's own weight does is not known, and may pass for something else."
            " State the masses (<inertial>)."
        )
    evidence = assessment.evidence
    if assessment.status == "unexplained" and not evidence:
        evidence = ("held_out_structure",)  # what either effect describes, and needed to be taken in
        if assessment.depends_on:
            parts.append(f"What is missing depends on {', '.join(assessment.depends_on)}.")
    parts += _rest(assessment)
    parts += _form(shown)
    parts += [f"The improved model has {_label(i)} as every robot has it: no cause to look for." for i in assessment.usual]
    parts += [
        f"The improved model has {_label(i)} too, which is no diagnosis: {_doubt(assessment, i)}." for i in assessment.unproven
    ]
    parts += _stands_in(shown)
    parts += _misplaced(assessment.study)
    parts += _noise(assessment.noise)
    parts += _bad_rows(assessment)
    if assessment.status == "adequate" and not few:
        parts += _could_hide(assessment)
    elif assessment.status != "adequate":
        repeating = study.observation.repeating
        parts += [f"{repeating[0].upper()}{repeating[1:]}."] if repeating else []
    if weight and assessment.readings is not None:
        parts.append(
            f"The force sensor reads {assessment.readings.rms_before:.1f} N where nothing touches the tool, turning with the"
            f" flange: a tool mass wrong by {assessment.readings.mass:.2f} +- {assessment.readings.mass_se:.2f} kg"
            " in the weight removal."
        )
    parts += _rivals_apart(assessment, planned)
    if assessment.status == "missing_effect":
        parts += _apart(assessment, planned)
    if shown.best.expected_error is not None and not few:
        parts += _expected(shown.best.expected_error)
    if few:
        cases = len(np.unique(study.session.load_case[study.observation.rows]))
        parts.append(
            f"{poses} pose(s) with {cases} load case(s) determine {study.fit.rank} combinations of parameters with"
            f" {study.fit.dof} equations to spare: too little to judge a model, or to find a missing effect. Measure more poses."
        )
    return Verdict(
        status=assessment.status,
        text=" ".join(parts),
        effects=ids,
        depends_on=assessment.depends_on,
        size_m=_size(assessment, shown),
        explained=assessment.explained,
        confident=not assessment.one_of,
        remaining_m=assessment.remaining_m,
        evidence=evidence,
        one_of=assessment.one_of,
        usual=assessment.usual,
        hidden_m=assessment.hidden_m,
        too_few=few and assessment.status == "adequate",
        parts={i: p for i, p in assessment.parts.items() if i in assessment.names},
        where=where,
    )


def _expected(error: ExpectedError) -> list[str]:
    """How far the improved model is to be trusted in production."""
    out = [f"At poses and forces like these the TCP is expected to be predicted to {length(error.at_tcp_m)}."]
    return [*out, f"Caution: {error.caution}."] if error.caution else out


def _size(assessment: Assessment, shown: Shown) -> float:
    """RMS of what is in the residual beyond noise, m."""
    if assessment.status == "adequate":
        return 0.0
    rms = shown.asked.study.fit.rms
    return float(max(np.sqrt(max(rms**2 - assessment.noise.inferred_m**2, 0.0)), assessment.remaining_m))


def _named(assessment: Assessment) -> tuple[str, ...]:
    """Ids of what is missing, each once; a tool weight may be shown by differences and by the readings at the references."""
    return tuple(dict.fromkeys((*assessment.names, *([READ_AT_REFERENCES.id] if assessment.weight_wrong else ()))))


def _label(effect_id: str) -> str:
    return find_effect(effect_id).label


def _at(m: Measurement) -> str:
    return f"pose {m.pose}" if m.pose else "a new pose (see next_measurements)"


def _noise(noise: InferredNoise) -> list[str]:
    """How the noise differs from what is stated, and whether it wanders; empty where neither is so."""
    wanders = []
    if noise.wander_share > 0.0:
        wanders = [f"{100 * noise.wander_share:.0f} % of its variance wander within some {noise.wander_time_s:.0f} s."]
    if not noise.differs or noise.source == "claim":
        return [f"Of the noise, {wanders[0]}"] if wanders else []
    times = max(noise.ratio, 1.0 / max(noise.ratio, 1e-9))
    where = {"repeats": "repeats show", "residual": "the residual shows"}.get(noise.source, "repeats and residual show")
    small = "small" if noise.ratio > 1.0 else "large"
    return [
        f"The noise that the session states, {length(noise.claimed_m)}, is {times:.1f} times too {small}:"
        f" {where} {length(noise.inferred_m)} ({length(noise.low_m)} to {length(noise.high_m)}).",
        *wanders,
    ]


def _misplaced(study: Study) -> list[str]:
    """Stations whose place is stated and found farther from it than a robot's first axis is from base_link."""
    placed: dict[str, Json] = {}
    for term in study.terms:
        if term.effect.registers:
            values = {n: e.value for n, e in term.estimates.items()}
            placed |= term.effect.placed(study.session, values).get("stations_in_base_link", {})
    stated = {s.name: s.xyz for s in study.session.stations if s.known and s.name in placed}
    off = {name: float(np.linalg.norm(np.subtract(placed[name]["xyz"], xyz))) for name, xyz in stated.items()}
    return [
        f"Station {name} stands {length(d)} from where the session states it: measure its pose anew."
        for name, d in off.items()
        if d > SETTINGS.misplaced_m
    ]


def _doubt(assessment: Assessment, effect_id: str) -> str:
    """Why an effect of the improved model is no diagnosis."""
    if effect_id in assessment.parts and assessment.parts[effect_id].proven:
        return "readings wander by more than it explains"
    loaded = assessment.study.ready.kind == "loaded"
    beside = "structure that has no name is left beside it" if loaded else "without it other poses are predicted as well"
    return f"no part of it is proven, and {beside}"


def _form(shown: Shown) -> list[str]:
    """What completes the form of the model's springs: no cause, but a better model."""
    labels = " and ".join(find_effect(i).label for i in shown.form)
    matter = "matter" if len(shown.form) > 1 else "matters"
    if not shown.form_matters:
        has = shown.completed is not None or shown.without_form is not None
        return [f"The model has the springs' {labels} as every robot has; this session says little of it."] if has else []
    if shown.without_form is not None:
        error = length(shown.without_form.held_out.rms_m)
        return [f"Beside that the springs' {labels} {matter}: without it that error would be {error}."]
    if shown.completed is None:
        return []
    before, after = shown.asked.held_out.rms_m, shown.completed.held_out.rms_m
    return [f"The springs' {labels} {matter} too: with it the error on held-out poses is {length(after)} for {length(before)}."]


def _stands_in(shown: Shown) -> list[str]:
    """What an improved model has that is no diagnosis."""
    if not shown.stand_ins:
        return []
    before, after = shown.after.held_out.rms_m, shown.best.held_out.rms_m
    which = " and ".join(in_words(s.effect) for s in shown.stand_ins)
    return [
        f"The improved model has {which} to predict what has no name, which is no diagnosis: the error on"
        f" held-out poses is {length(after)} for {length(before)}."
    ]


def _bad_rows(assessment: Assessment) -> list[str]:
    """Rows that stand out from all others; they count for nothing in the assessment."""
    left_out = [b.sentence for b in assessment.asked.observation.bad if b.is_left_out]
    beside = [p.structure.words for p in assessment.stand_out]
    anew = [m.anew for m in assessment.asked.session.markers if m.anew]
    out = []
    for begin, bad in (
        ("Left out as plainly wrong", left_out),
        ("Taken as another reflector", anew),
        ("Readings that stand out and count for nothing here", beside),
    ):
        if bad:
            more = f" and {len(bad) - ROWS_SHOWN} more" if len(bad) > ROWS_SHOWN else ""
            out.append(f"{begin}: {'; '.join(bad[:ROWS_SHOWN])}{more}.")
    return out


def _could_hide(assessment: Assessment) -> list[str]:
    out = [f"A cause without structure of up to {length(assessment.hidden_m)} could hide in it."]
    if "repeats" not in assessment.noise.source:
        out.append(
            f"A few repeats would tell: {SETTINGS.proposed.poses_to_tell} poses that are far from each other, all load cases"
            " measured twice, each with its own reference."
        )
    return out


def _why_either(assessment: Assessment) -> list[str]:
    """Why two effects that are one by their values (`Effect.also_called`) are not told apart."""
    ready = assessment.study.ready
    out: list[str] = []
    for term in assessment.built.final.added:
        also = also_called(term, ready)
        if not also or not any({term.effect.id, also} <= set(s) for s in assessment.one_of):
            continue
        if term.effect.turns_by_angle and term.effect.by_angle:
            out.append("What a balancer carries of the weight turns its axis by its own angle, as an eccentric encoder does.")
        elif term.effect.turns_by_angle:
            out.append(
                "On which side of its play an axis lies that no weight turns goes with its angle, as an encoder's error does."
            )
        elif term.effect.family is not Alike.TORQUE_LAW:
            out.append("A station turned about the first axis and an error of that axis' zero do the same to all that is seen.")
        elif rating_known(ready.robot).all():
            out.append("The gear is soft over just the range of torque at which play ends and a soft gear begins.")
        else:
            out.append(
                "What is soft over so little torque is play by one torque limit of the drive and a soft gear by another, and the"
                " robot description states none (effort)."
            )
    return list(dict.fromkeys(out))


def _rest(assessment: Assessment) -> list[str]:
    """What has structure and no name."""
    if assessment.usual_m > 0.0:
        return [
            f"{length(assessment.usual_m)} of structure is left, no more than gears of every robot leave by friction, creep and a"
            " soft range about zero torque: no cause to look for."
        ]
    if not assessment.evidence:
        return []
    more = "A further" if assessment.names else "The residual has"
    about = f"{length(assessment.remaining_m)}"
    has = f"{more} {about} {'has' if assessment.names else 'of'} structure that no effect of the catalogue explains"
    out = [f"{has}: {'; '.join(SHOWN_BY[e] for e in assessment.evidence)}."]
    if assessment.depends_on:
        out.append(f"It depends on {', '.join(assessment.depends_on)}.")
    ripples: dict[int, float] = {}
    for p in assessment.remainder.structures:
        if p.structure.ripple is not None:
            ripples.setdefault(*p.structure.ripple)  # the strongest of each axis
    if ripples:
        often = " and ".join(f"{n:.3g} times per turn of axis {k + 1}" for k, n in sorted(ripples.items()))
        out.append(f"Some of it repeats about {often}, as errors of a gear or an encoder do.")
    closest = assessment.built.closest
    if closest is not None and closest.ids and assessment.reason and closest.ids[-1] not in _named(assessment):
        out.append(f"The closest try, {_label(closest.ids[-1])}, is not named as a cause: {assessment.reason}.")
    return out


def _missing(assessment: Assessment, shown: Shown, candidates: Sequence[Candidate], where: Mapping[str, str]) -> list[str]:
    labels = " and ".join(_label(i) + _in_brackets(assessment.parts.get(i)) for i in assessment.names)
    out = [f"Missing: {labels}. {how_the_error_falls(assessment, shown)}"]
    for i in assessment.names:
        one = next((c for c in candidates if c.effect == i), None)
        if one is not None and not one.plausible:
            why = implausible(assessment.built.final, i)
            out.append(f"Check {_label(i)} before using it{': ' + why if why else ''}.")
        out += [where[i]] if i in where else []
        out += _parts_in_words(_label(i), assessment.parts.get(i), alone=len(assessment.names) == 1)
    return out


def _where(assessment: Assessment, shown: Shown) -> dict[str, str]:
    """Of each named effect whose values say so, where to look for it: a sentence."""
    out = {}
    for term in shown.after.study.terms:
        effect, parts = term.effect, assessment.parts.get(term.effect.id)
        if effect.id not in assessment.names or parts is None:
            continue
        known = {n: e.value for n, e in term.estimates.items() if e.lower < e.value < e.upper}
        where = effect.where_to_look(known, parts.proven)
        if where:
            label = _label(effect.id)
            out[effect.id] = f"{label[0].upper()}{label[1:]}: {where}."
    return out


def _in_brackets(parts: Parts | None) -> str:
    return f" ({', '.join(parts.proven)})" if parts is not None and parts.proven else ""


def _parts_in_words(label: str, parts: Parts | None, alone: bool = True) -> list[str]:
    """What these data can't tell about the axes (or directions) of an effect.

    Args:
        alone: no other effect is named that they could be taken for those of.
    """
    out: list[str] = []
    if parts is None:
        return out
    if parts.one_of:
        begin = f"{label[0].upper()}{label[1:]}: " + (f"besides {' and '.join(parts.proven)}, " if parts.proven else "")
        sets = " or ".join(" with ".join(s) for s in parts.one_of)
        many = len(parts.one_of) > SETS_SHOWN
        out.append(
            f"{begin}{'which axis it is, ' if many else f'{sets}: '}these data do not tell{'' if many else ' them apart'}."
        )
    if parts.perhaps:
        of = "Perhaps also" if alone else f"{label[0].upper()}{label[1:]}: perhaps also"
        if not parts.proven and not parts.one_of:
            of = f"{label[0].upper()}{label[1:]}: not sure where; perhaps"
        out.append(f"{of} {', '.join(parts.perhaps)}: too small a part to be sure of.")
    return out


def _apart(assessment: Assessment, planned: Sequence[Measurement]) -> list[str]:
    """Which sample would tell the sets of axes apart."""
    m = next((m for m in planned if assessment.other is not None and m.separates == assessment.other[1]), None)
    if m is None:
        return []
    if not m.repeats:
        return ["No load case at these poses or near them separates these axes."]
    return [f"Measuring load case {m.load_case} at {_at(m)}{_often(m)} separates these axes ({length(m.difference_m)} there)."]


def _rivals_apart(assessment: Assessment, planned: Sequence[Measurement]) -> list[str]:
    """Which sample would tell an effect from the likeliest other one that would do in its place, and how often to take it."""
    rivals = assessment.built.rivals
    pairs = [(i, others[0][0]) for i, others in rivals.items() if others and i not in assessment.usual]
    m = next((m for m in planned if m.separates in pairs), None)
    if m is None:
        return []
    one, other = map(_label, m.separates)
    if m.repeats:
        return [
            f"Measuring load case {m.load_case} at {_at(m)}{_often(m)} separates {one} and {other}"
            f" ({length(m.difference_m)} there)."
        ]
    where = "; irec plan --to-tell looks for poses on the whole tooling" if assessment.study.ready.kind == "loaded" else ""
    return [
        f"No single load case at these poses or near them tells {one} from {other}: once both are fitted to it, even"
        f" {SETTINGS.proposed.most_repeats} repeats at this noise leave them alike{where}."
    ]


def _often(m: Measurement) -> str:
    return f" {m.repeats} times" if m.repeats > 1 else ""
