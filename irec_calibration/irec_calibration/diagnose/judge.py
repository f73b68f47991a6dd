# SPDX-License-Identifier: Apache-2.0
"""From the evidence to a verdict: adequate, missing effect, or unexplained.

A name is given only where the effect is significant, helps on held-out poses, leaves no structure of size behind, and is
told apart from its rivals or named together with them. A wrong name given with confidence is the worst outcome.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import log

import numpy as np

from ..model import Term
from .candidates import Trial
from .held_out import HeldOut, gain, held_out
from .parts import Parts, Settled, settle
from .priors import FACTORS
from .search import NATS_TO_NAME, NATS_TO_SEPARATE, Hypothesis, Search, chi2_and_expectation
from .study import Study, study_of
from .tool_weight import Readings
from .unnamed import Unnamed, depends_on
from .unnamed import search as search_unnamed

NATS_FOR_STRUCTURE = 9.0  # evidence of a structure without a name that makes it significant (some 300 are tried)
SHARE_TO_NAME = 0.75  # of the explainable excess that the named effects must explain
SHARE_OF_SECOND = 0.08  # of the excess that a second effect must bring to be named beside the first
CHI2_SIGMAS = 5.0  # by which chi2 must exceed its expectation to say that noise does not explain the residual
NATS_TO_BEAT = 4.0  # by which a structure without a name must beat the best effect to deny it the name
FEWEST_POSES = 3  # with fewer nothing can be tested on other poses, and nothing is named
HELD_OUT_SIGMAS = 1.5  # by which the held-out loss must fall, over poses


@dataclass(frozen=True)
class Judgement:
    """What the evidence says, before it is put in words.

    Attributes:
        chosen: the hypothesis that is named or came closest; None where no effect is significant.
        rivals: other hypotheses with as many effects that can't be told from it.
        left: structures without a name on top of the chosen model, best first; unnamed: on top of the model alone.
        explained: share of the excess over noise that the chosen model explains.
        parts: of each named effect, which axes or directions are proven; other: the likeliest other set of them, with the names
            of the two, where they are not told apart.
    """

    status: str
    chosen: Hypothesis | None
    rivals: tuple[Hypothesis, ...]
    left: tuple[Unnamed, ...]
    depends_on: tuple[str, ...]
    explained: float
    readings: Readings | None
    held_out_base: HeldOut
    held_out_chosen: HeldOut | None
    size_m: float
    reason: str
    unnamed: tuple[Unnamed, ...] = ()
    parts: dict[str, Parts] = field(default_factory=dict)
    other: tuple[tuple[Term, ...], tuple[str, str]] | None = None


def judge(found: Search, readings: Readings | None, check: Callable[[], None] = lambda: None) -> Judgement:
    """Weigh the outcome of a search."""
    study = found.study
    base_cv = held_out(study)
    weight_wrong = readings is not None and readings.log_evidence > NATS_TO_NAME
    chosen = _choose(found)
    left = tuple(search_unnamed(chosen.study if chosen else study, check))
    best_left = left[0] if left and left[0].log_evidence > NATS_FOR_STRUCTURE else None
    final = chosen.study if chosen else study
    chi2, dof = chi2_and_expectation(final)
    white = max(chi2 - dof - 2.0 * np.sqrt(2.0 * dof), 0.0)
    structured = 0.0 if best_left is None else max(chi2 - best_left.posterior.chi2 - best_left.block.A.shape[1], 0.0)
    remaining = max(white, structured)
    size = float(np.sqrt(max(remaining, 0.0) / max(len(study.bench.b), 1))) * study.observation.whiten.floor
    variables = tuple(depends_on(list(left), NATS_FOR_STRUCTURE)) if best_left else ()
    too_noisy = chi2 - dof > CHI2_SIGMAS * np.sqrt(2.0 * dof)

    if chosen is None:
        if best_left or too_noisy:
            reason = "no effect is significant"
            return Judgement("unexplained", None, (), left, variables, 0.0, readings, base_cv, None, size, reason)
        status = "missing_effect" if weight_wrong else "adequate"
        return Judgement(status, None, (), left, (), float(weight_wrong), readings, base_cv, None, 0.0, "")

    chosen_cv = held_out(chosen.study)
    won = max(chi2_and_expectation(study)[0] - chi2, 1e-9)
    explained = float(won / (won + remaining))
    rivals = _rivals(found, chosen)
    mean, se, _ = gain(base_cv, chosen_cv)
    enough = len(study.bench.poses) >= FEWEST_POSES
    helps = enough and np.isfinite(mean) and ("station_shift" in chosen.ids or mean > HELD_OUT_SIGMAS * se)
    unnamed = tuple(search_unnamed(study, check))
    better = max(unnamed, key=_odds, default=None)
    beaten = better is not None and _odds(better) > chosen.log_evidence + NATS_TO_BEAT and not _in_family(chosen, better)
    named = helps and explained >= SHARE_TO_NAME and not beaten
    reason = "" if named else _why_not(enough, helps, better if beaten else None)
    status = "missing_effect" if named else "unexplained"
    if status == "unexplained" and (beaten or not variables):
        variables = tuple(depends_on(list(unnamed), NATS_FOR_STRUCTURE)) if unnamed else ()
    judged = Judgement(status, chosen, rivals, left, variables, explained, readings, base_cv, chosen_cv, size, reason, unnamed)
    return _with_proven_parts(judged, settle(chosen.study, chosen.ids)) if named else judged


def _with_proven_parts(judged: Judgement, settled: Settled) -> Judgement:
    """A judgement that names an effect, with the model cut down to the parts that the session asks for."""
    if judged.chosen is None:
        return judged
    chosen, study = cut_down(judged.chosen, settled), settled.study
    cv = judged.held_out_chosen if study is judged.chosen.study else held_out(study)
    return replace(judged, chosen=chosen, held_out_chosen=cv, parts=settled.parts, other=settled.other)


def cut_down(hypothesis: Hypothesis, settled: Settled) -> Hypothesis:
    """A hypothesis with its effects as they were settled."""
    terms = {t.effect.id: t for t in settled.study.terms}
    return replace(hypothesis, added=tuple(terms[i] for i in hypothesis.ids), study=settled.study)


def _odds(structure: Unnamed) -> float:
    """Log evidence of a structure, less what trying so many of its kind gives by chance."""
    return structure.log_evidence - float(np.log(structure.tried))


def _why_not(enough: bool, helps: bool, better: Unnamed | None) -> str:
    if not enough:
        return "there are too few poses to test it on others"
    if not helps:
        return "it does not help on held-out poses"
    return f"a structure without a name fits better: {better.frame}" if better else "it explains only a part"


def _in_family(chosen: Hypothesis, other: Unnamed) -> bool:
    """Whether a structure without a name is a coarse picture of an effect that is named."""
    torque_effects = {"joint_stiffening", "joint_backlash", "joint_hysteresis", "counterbalance"}
    return bool(torque_effects & set(chosen.ids)) and "ax" in other.frame and other.variables[0][:4] in ("tau_", "load")


def _choose(found: Search) -> Hypothesis | None:
    """The single effect with the best evidence, or the best pair where it is justified."""
    if not found.singles or found.singles[0].log_evidence < NATS_TO_NAME:
        return None
    best = found.singles[0]
    if not found.pairs:
        return best
    pair = found.pairs[0]
    before, one, two = (chi2_and_expectation(s)[0] for s in (found.study, best.study, pair.study))
    needed = pair.log_evidence - best.log_evidence > NATS_TO_NAME and one - two > SHARE_OF_SECOND * (before - two)
    return _by_importance(found, _needed_of(pair)) if needed else best


def _needed_of(pair: Hypothesis) -> Hypothesis:
    """A pair, or one of its effects where the other adds nothing to it: what was tried first may have been in its place."""
    for term in pair.added:
        rest = study_of(pair.study.observation, tuple(t for t in pair.study.terms if t.effect.id != term.effect.id))
        with_it, without = (s.bench.posterior(s.base) for s in (pair.study, rest))
        lost = with_it.log_evidence - log(len(FACTORS)) - without.log_evidence
        if min(lost, without.chi2 - with_it.chi2) < NATS_TO_NAME:
            ids = [t.effect.id for t in pair.added if t is not term]
            return Hypothesis(tuple(t for t in rest.terms if t.effect.id in ids), rest, pair.log_evidence - max(lost, 0.0))
    return pair


def _by_importance(found: Search, pair: Hypothesis) -> Hypothesis:
    """The pair with the effect first that explains more by itself."""
    alone = {t.effect.id: t.log_evidence for t in found.trials}
    return Hypothesis(tuple(sorted(pair.added, key=lambda t: -alone.get(t.effect.id, 0.0))), pair.study, pair.log_evidence)


def _rivals(found: Search, chosen: Hypothesis) -> tuple[Hypothesis, ...]:
    others = found.singles if len(chosen.added) == 1 else found.pairs
    near = [h for h in others if h.log_evidence > chosen.log_evidence - NATS_TO_SEPARATE]
    return tuple(h for h in near if set(h.ids) != set(chosen.ids))


def p_value(trial: Trial, study: Study, tried: int) -> float:
    """Probability that noise alone gives an effect this evidence, corrected for the number of effects tried (Markov's bound)."""
    return float(min(1.0, tried * np.exp(-max(trial.log_evidence, 0.0))))
