# SPDX-License-Identifier: Apache-2.0
"""Which parts of an effect (axes, directions) a session proves, and which it can't tell apart.

Somebody opens a gearbox on the strength of an axis' name. So an axis is named only where every explanation within reach has
it: the best set of axes without it, with any other in its place and everything refitted, must explain the session clearly
worse. Parts that earn nothing of their own are taken out of the model.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..effects import Family as Alike
from ..effects import known_effects
from ..errors import SolveError
from ..identification.validation import gain
from ..model import Term
from ..typing import Json
from .candidates import SMALLEST_COLUMN
from .columns import block_columns
from .evidence import Block
from .family import Family
from .ground import Ground
from .held_out import held_out
from .part_sets import Names, Parts, PartSets
from .priors import FACTORS
from .remainder import grow
from .settings import SETTINGS
from .study import Study, study_of


@dataclass(frozen=True)
class Pruned:
    """A fitted model after its added effects were cut down to the parts that they need.

    Attributes:
        parts: effect id -> what is known of its parts; effects without parts are not in it.
        other: terms of a model with the likeliest other set of parts, and the two sets in words; None where all is told apart.
    """

    study: Study
    parts: dict[str, Parts]
    other: tuple[tuple[Term, ...], tuple[str, str]] | None = None


def parts_in(term: Term, study: Study) -> Names:
    """The parts of an effect that a term of a fitted model has."""
    groups = (p.group for p in term.effect.parameters(study.ready) if p.name in term.estimates and p.group)
    return tuple(dict.fromkeys(groups))


def prune(study: Study, added: Iterable[str], beside: Block | None = None, family: Family | None = None) -> Pruned:
    """Cut the added effects of a fitted model down to the parts that the session asks for, and say which of them it proves.

    Args:
        study: the model with the added effects.
        added: their ids; effects that have no parts are left alone.
        beside: columns of a nonparametric remainder; family: structures that may stand in for a part.
    """
    known: dict[str, Parts] = {}
    other = None
    for effect_id in added:
        term = next((t for t in study.terms if t.effect.id == effect_id), None)
        present = parts_in(term, study) if term else ()
        if term is None or not present:
            continue
        try:
            rest = without_columns(study, effect_id)
            fitted = {n: e.value for n, e in term.estimates.items()}
            sets = PartSets(rest, term.effect, fitted, beside)
            if len(sets.names) < 2:
                known[effect_id] = Parts(proven=present)
                continue
            starts = dict.fromkeys((sets.ordered(present) or sets.names, sets.names))
            names, near = sets.best(max((sets.cut_down(s) for s in starts), key=sets.score))
            known[effect_id] = sets.parts(names, near)
            if family is not None:
                known[effect_id] = _beyond_structures(known[effect_id], sets, names, beside, family)
            if term.effect.compliance_of:  # every axis gives way: none is taken out for want of evidence
                said = known[effect_id]
                known[effect_id] = replace(said, perhaps=tuple(n for n in present if n not in said.proven), one_of=())
                continue
            used = sets.in_use(names)
            cut = study if used == present else _with(study, sets.term(used))
            if beside is not None and beside.A.shape[1]:
                used, cut = _with_needless(cut, used, PartSets(rest, term.effect, fitted, None))
            if cut is not study and _missed(study, cut, beside):
                known[effect_id] = Parts(perhaps=present, log_evidence=known[effect_id].log_evidence)
                continue
            known[effect_id] = _with_more(known[effect_id], sets, used)
            study = cut
            rival = next((n for n in near if not set(n) < set(names)), None)
            if known[effect_id].one_of and rival is not None and other is None:
                other = (_with(study, sets.term(rival)).terms, (_label(effect_id, names), _label(effect_id, rival)))
        except SolveError:
            known[effect_id] = Parts(perhaps=present)
    return Pruned(study, known, other)


def _missed(study: Study, cut: Study, beside: Block | None) -> bool:
    """Whether a model lacks the parts that were taken out of it, once it is fitted.

    Sets are scored on the linear problem about the model with all parts. Without some of them springs may be far softer, and what
    pulls at these moves far more than there.

    Args:
        beside: columns of a remainder that both have.
    """
    blocks = (s.base if beside is None else s.base + beside for s in (study, cut))
    whole, less = (s.bench.posterior(block).log_evidence for s, block in zip((study, cut), blocks, strict=True))
    return bool(whole - less > SETTINGS.nats_to_prove_part)


def _with_needless(cut: Study, used: Names, alone: PartSets) -> tuple[Names, Study]:
    """A model and its parts, with those too that only a remainder made needless, where held-out poses ask for them.

    A remainder describes; without a name it predicts nothing, and what it takes from a named effect the model would lack.

    Args:
        cut: the model with the parts that are asked for beside a remainder; used: these parts; alone: sets without a remainder.
    """
    also, _ = alone.best(alone.names)
    more = alone.ordered((*used, *also))
    if more == used:
        return used, cut
    whole = _with(cut, alone.term(more))
    mean, se, _ = gain(held_out(cut), held_out(whole))
    return (more, whole) if mean > SETTINGS.held_out_sigmas * se else (used, cut)


def _with_more(parts: Parts, sets: PartSets, used: Names) -> Parts:
    """What is known of parts, and that the model has others too, of which none is sure."""
    spoken = {*parts.proven, *parts.perhaps, *(n for s in parts.one_of for n in s)}
    own = {n: sets.cost(used, n) for n in used if n not in parts.log_evidence}
    return replace(parts, perhaps=(*parts.perhaps, *(n for n in used if n not in spoken)), log_evidence=parts.log_evidence | own)


def _beyond_structures(parts: Parts, sets: PartSets, names: Names, beside: Block | None, family: Family) -> Parts:
    """Parts of which some are no longer proven, because a nonparametric structure explains the session as well in their place;
    or, of several axes with one law of torque, another law in one of them."""
    doubtful = []
    axes = {p.group: p.axis for p in sets.effect.parameters(sets.rest.ready)}
    for n in parts.proven:
        less = tuple(m for m in names if m != n)
        base = sets.rest.base if beside is None else sets.rest.base + beside
        if less:
            _, found, i = sets.fit(less)
            base = base + sets.tables[i][1].take(sets.columns(less, i)).widened(found.factor)
        instead = grow(sets.rest.bench, family, base, most=2, beside_axis=axes.get(n)).gained
        if less and sets.effect.family is Alike.TORQUE_LAW:
            instead = max(instead, _by_another_law(sets, base, axes.get(n)))
        if sets.cost(names, n) - instead < SETTINGS.nats_to_prove_part:
            doubtful.append(n)
    if not doubtful:
        return parts
    return replace(parts, proven=tuple(n for n in parts.proven if n not in doubtful), perhaps=(*parts.perhaps, *doubtful))


def _by_another_law(sets: PartSets, base: Block, axis: int | None) -> float:
    """Log evidence that another effect which is a law of torque gains in one axis only, on top of a model."""
    rest = sets.rest
    ground = Ground(rest.bench, base)
    best = 0.0
    for effect in known_effects().values():
        if effect.family is not Alike.TORQUE_LAW or effect.id == sets.effect.id or rest.why_not(effect):
            continue
        shaped = [p for p in effect.parameters(rest.ready) if p.grid]
        for values in product(*(p.grid for p in shaped)):
            shape = {p.name: v for p, v in zip(shaped, values, strict=True)}
            block, parameters = block_columns(rest, effect, shape)
            length = np.linalg.norm(block.A, axis=0)
            mine = [i for i, p in enumerate(parameters) if p.axis == axis and length[i] > SMALLEST_COLUMN]
            if mine:
                found = ground.posterior(block.take(mine), FACTORS)
                best = max(best, found.log_evidence - ground.log_evidence)
    return best


def parts_json(parts: dict[str, Parts]) -> Json:
    """What is known of the parts of effects, for a result file."""
    return {
        effect: {
            "proven": list(p.proven),
            "one_of": [list(s) for s in p.one_of],
            "perhaps": list(p.perhaps),
            "log_evidence": p.log_evidence,
        }
        for effect, p in parts.items()
    }


def without_columns(study: Study, effect_id: str) -> Study:
    """The linear problem about a fitted model without the columns of one effect.

    Not that about the model fitted without it: other effects would be bent to make up for what is missing, and linearised there
    they lend evidence to parts that are not there.
    """
    rest = [i for i, owner in enumerate(study.owners) if owner != effect_id]
    return replace(study, base=study.base.take(rest), owners=tuple(study.owners[i] for i in rest),
                   parameters=tuple(study.parameters[i] for i in rest), scale=study.scale[rest])  # fmt: skip


def _with(study: Study, term: Term) -> Study:
    """A model with the term of the same effect replaced, refitted."""
    return study_of(study.observation, tuple(term if t.effect.id == term.effect.id else t for t in study.terms))


def _label(effect_id: str, names: Names) -> str:
    return f"{effect_id}:{'+'.join(names)}"
