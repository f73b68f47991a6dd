# SPDX-License-Identifier: Apache-2.0
"""The verdict in one plain paragraph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..absolute import REPEATS
from ..effects import find_effect
from .judge import Judgement
from .parts import Parts
from .result import Candidate, Comparison, Measurement, Verdict
from .search import NATS_TO_NAME, Search
from .study import Study

FEW_POSES = 5
SETS_SHOWN = 3  # sets of axes in a sentence
REPEATS_AT_MOST = 20  # that anybody would take of one sample
SIGMAS_TO_TELL = 3.0  # standard deviations by which samples must differ to tell two explanations apart


def um(metres: float) -> str:
    """A length in um for a sentence."""
    return f"{1e6 * metres:.1f} um" if np.isfinite(metres) else "unknown"


def put_in_words(
    study: Study,
    found: Search,
    verdict: Judgement,
    candidates: Sequence[Candidate],
    comparison: Comparison,
    flexible: float,
    planned: Sequence[Measurement],
) -> Verdict:
    """The verdict with its text."""
    poses = len(study.bench.poses)
    weight = verdict.readings is not None and verdict.readings.log_evidence > NATS_TO_NAME
    ids = list(verdict.chosen.ids) if verdict.chosen and verdict.status == "missing_effect" else []
    if weight and verdict.status != "unexplained":
        ids.append("tool_weight")
    rivals = ["+".join(h.ids) for h in verdict.rivals]
    opening = (
        f"The model leaves {um(comparison.rms_m)} ({um(verdict.held_out_base.rms_m)} on held-out poses);"
        f" the instruments' noise explains {um(comparison.noise_floor_m)}."
    )
    parts = [opening]
    if verdict.status == "adequate":
        parts.append("No effect and no structure without a name is significant: the residual is what the noise explains.")
    elif verdict.status == "missing_effect":
        parts += _missing(verdict, candidates, ids)
    else:
        parts += _unexplained(verdict)
    if verdict.status != "adequate":
        parts += [f"{n[0].upper()}{n[1:]}." for n in study.session.notes if n.startswith(REPEATS)]
    if weight and verdict.readings is not None:
        parts.append(
            f"The force sensor reads {verdict.readings.rms_before:.1f} N where nothing touches the tool, turning with the flange:"
            f" a tool mass wrong by {verdict.readings.mass:.2f} +- {verdict.readings.mass_se:.2f} kg in the weight removal."
        )
    if rivals and verdict.status == "missing_effect":
        parts.append(f"On this session it can't be told from {', '.join(rivals)}.")
        if planned:
            m = planned[0]
            at = f"pose {m.pose}" if m.pose else "a new pose (see next_measurements)"
            parts.append(f"Measuring load case {m.load_case} at {at} would part them by {um(m.difference_m)}.")
    if verdict.status == "missing_effect":
        parts += _apart(verdict, planned)
    if np.isfinite(flexible) and verdict.status != "adequate" and flexible > 0.0:
        parts.append(f"A flexible regression could remove another {um(flexible)} at most on held-out poses.")
    if not np.any(np.abs(study.base.A) > 1e-6):
        parts.insert(1, "Nothing in this session loads the model: it can't identify anything.")
    if poses < FEW_POSES or study.fit.dof < study.fit.rank:
        cases = len(np.unique(study.session.load_case[study.observation.rows]))
        parts.append(
            f"{poses} pose(s) with {cases} load case(s) determine {study.fit.rank} combinations of parameters with"
            f" {study.fit.dof} equations to spare: too little to find a missing effect. Measure more poses."
        )
    return Verdict(
        status=verdict.status,
        text=" ".join(parts),
        effects=tuple(ids),
        depends_on=verdict.depends_on if verdict.status == "unexplained" else (),
        size_m=verdict.size_m,
        explained=verdict.explained,
        confident=not rivals,
        parts=verdict.parts if verdict.status == "missing_effect" else {},
    )


def _missing(verdict: Judgement, candidates: Sequence[Candidate], ids: Sequence[str]) -> list[str]:
    out = []
    if verdict.chosen is not None and verdict.held_out_chosen is not None:
        best = next((c for c in candidates if c.effect == verdict.chosen.ids[0]), None)
        labels = " and ".join(find_effect(i).label + _in_brackets(verdict.parts.get(i)) for i in verdict.chosen.ids)
        out.append(
            f"Missing: {labels}. Added, the error on held-out poses falls from {um(verdict.held_out_base.rms_m)} to"
            f" {um(verdict.held_out_chosen.rms_m)}; it explains {100 * verdict.explained:.0f} % of what noise does not."
        )
        if best is not None and not best.plausible:
            out.append("Its value lies outside what is physically likely: check it before using it.")
        for i in verdict.chosen.ids:
            out += _parts_in_words(find_effect(i).label, verdict.parts.get(i))
    return out


def _in_brackets(parts: Parts | None) -> str:
    return f" ({', '.join(parts.proven)})" if parts is not None and parts.proven else ""


def _parts_in_words(label: str, parts: Parts | None) -> list[str]:
    """What these data can't tell about the axes (or directions) of an effect."""
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
        of = "Perhaps also" if parts.proven or parts.one_of else f"{label[0].upper()}{label[1:]}: not sure where; perhaps"
        out.append(f"{of} {', '.join(parts.perhaps)}: too small a part to be sure of.")
    return out


def _apart(verdict: Judgement, planned: Sequence[Measurement]) -> list[str]:
    """Which sample would tell the sets of axes apart."""
    m = next((m for m in planned if verdict.other is not None and m.separates == verdict.other[1]), None)
    if m is None:
        return []
    at = f"pose {m.pose}" if m.pose else "a new pose (see next_measurements)"
    repeats = int(np.ceil(0.5 * SIGMAS_TO_TELL**2 / max(m.gain, 1e-9)))
    if repeats > REPEATS_AT_MOST:
        return ["No load case at these poses or near them would tell these axes apart."]
    often = f", so take at least {repeats} repeats" if repeats > 1 else ""
    sample = f"Measuring load case {m.load_case} at {at}"
    return [f"{sample} would tell these axes apart: they differ there by {um(m.difference_m)}{often}."]


def _unexplained(verdict: Judgement) -> list[str]:
    out = [f"There is structure of about {um(verdict.size_m)} in the residual that no effect of the catalogue explains."]
    if verdict.depends_on:
        out.append(f"It depends on {', '.join(verdict.depends_on)}.")
    if verdict.chosen is not None:
        tried = " and ".join(find_effect(i).label for i in verdict.chosen.ids)
        out.append(
            f"The closest try, {tried}, removes {100 * verdict.explained:.0f} % of it ({verdict.reason}) and is not named "
            "as the cause."
        )
    return out
