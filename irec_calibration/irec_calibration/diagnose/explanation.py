# SPDX-License-Identifier: Apache-2.0
"""A model with effects added and what is left beside it; how one is made by adding an effect, or by taking one out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, log, sqrt

import numpy as np

from ..effects import Axes, Evidence, parameters_of
from ..effects.scales import SURELY
from ..effects.scene import Scene
from ..model import Term, displacements, prepared
from ..model.springs import ROWS_KEPT
from ..typing import Array
from .candidates import Trial, supported
from .family import Family
from .forms import NO_FORMS, Forms, bends, forms_of, steps
from .ground import Ground
from .priors import FACTORS
from .readings import against, carried
from .remainder import Part, Remainder, grow
from .settings import SETTINGS
from .shape import refit, reshaped
from .study import Study, study_of


@dataclass(frozen=True)
class Explanation:
    """A model with effects added, fitted exactly, and what is left beside it.

    Attributes:
        added: the terms added to the start, in order.
        named: log evidence of the added terms alone, relative to the start alone.
        log_evidence: the same together with the remainder.
        less: the same without one of the added terms, as far as it was asked for (`without`).
    """

    added: tuple[Term, ...]
    study: Study
    named: float
    remainder: Remainder
    less: dict[str, Explanation] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(t.effect.id for t in self.added)

    @property
    def log_evidence(self) -> float:
        return self.named + self.remainder.gained

    @property
    def chi2(self) -> float:
        """Squared residual of the linear problem about the model, without the remainder, in standard deviations."""
        return self.study.bench.posterior(self.study.base).chi2

    def term(self, effect_id: str) -> Term:
        """The added term of an effect."""
        return next(t for t in self.added if t.effect.id == effect_id)


def explain(start: Explanation, current: Explanation, trial: Trial, family: Family) -> Explanation | None:
    """A model with a tried effect added, fitted exactly, and its remainder; None where the fit fails."""
    fitted = refit(current.study, trial)
    if fitted is None:
        return None
    gained = _evidence(fitted) - _evidence(current.study) - log(len(FACTORS))
    saved = _saved(current.study, fitted, fitted.true_chi2)
    named = supported(gained, saved) + trial.best.log_prior
    if not current.added:  # the trial tried more prior widths, but there no spring gives way to an effect
        named = max(named, supported(trial.log_evidence, saved))
    added = fitted.terms[len(start.study.terms) :]
    rest = remainder_of(fitted, family, current.remainder.parts)
    return Explanation(added, fitted, current.named + named, rest)


def reshaped_again(start: Explanation, one: Explanation, family: Family) -> Explanation:
    """A model of several added effects with their shapes found again beside each other."""
    study = reshaped(one.study, one.ids) if len(one.added) > 1 else one.study
    if study is one.study:
        return one
    named = one.named + borne_out(one.study, study)
    return Explanation(study.terms[len(start.study.terms) :], study, named, remainder_of(study, family, one.remainder.parts))


def remainder_of(study: Study, family: Family, known: Sequence[Part], forms: Forms = NO_FORMS) -> Remainder:
    """The better of a remainder from nothing and of one that starts from known structures.

    Args:
        forms: structures that are left out.
    """
    fresh = _grown(study, family, (), forms)
    return max(fresh, _grown(study, family, known, forms), key=lambda r: r.gained) if known else fresh


def _grown(study: Study, family: Family, known: Sequence[Part], forms: Forms) -> Remainder:
    """As `grow`; the same is asked of a model several times, and kept with it where the session is not too large for that."""
    structures = tuple(p.structure for p in known)
    key = (id(family), forms, *map(id, structures))
    if key in study.kept:
        return study.kept[key][1]
    grown = grow(study.bench, family, study.base, known, without=forms.has if forms else None)
    if len(study.ready) <= ROWS_KEPT:
        study.kept[key] = (family, structures), grown  # what the ids stand for is kept alive with it
    return grown


def without(start: Explanation, one: Explanation, effect_id: str, family: Family) -> Explanation:
    """A model without one of its added effects, refitted, with a remainder that may take its place."""
    if effect_id in one.less:
        return one.less[effect_id]
    bare = _without(start, one, effect_id, family)
    if len(one.study.ready) <= ROWS_KEPT:
        one.less[effect_id] = bare
    return bare


def _without(start: Explanation, one: Explanation, effect_id: str, family: Family) -> Explanation:
    if len(one.added) == 1:
        rest = remainder_of(start.study, family, one.remainder.parts)
        return replace(start, remainder=max(rest, start.remainder, key=lambda r: r.gained))
    terms = tuple(t for t in one.study.terms if t.effect.id != effect_id)
    rest_study = study_of(one.study.observation, terms)
    bent = bends(one.term(effect_id), one.study.ready)
    # what bends the same curve was shaped beside the one taken out
    rest_study = reshaped(rest_study, [t.effect.id for t in terms if bends(t, one.study.ready) & bent])
    lost = _evidence(one.study) - log(len(FACTORS)) - _evidence(rest_study)
    added = tuple(t for t in rest_study.terms if t.effect.id in one.ids)
    rest = remainder_of(rest_study, family, one.remainder.parts)
    return Explanation(added, rest_study, one.named - min(lost, _saved(rest_study, one.study)), rest)


def borne_out(before: Study, after: Study) -> float:
    """Log evidence of a model over the same before its effects were changed, as far as the data bear it out (`supported`)."""
    chi2 = [s.bench.posterior(s.base).chi2 for s in (before, after)]
    return supported(_evidence(after) - _evidence(before), before.bench.saved(*chi2))


def _evidence(study: Study) -> float:
    """Log evidence of a model, with the odds of how large what completes the form of its springs has to be for it."""
    return study.bench.posterior(study.base).log_evidence + study.log_odds_of_form


def _saved(without: Study, with_it: Study, at_least: float = 0.0) -> float:
    """Evidence by the fall of the residual between models without and with an effect, what completes the form of springs being as
    large in both: without the effect it may be large enough to stand for it.

    Args:
        at_least: squared residual, in standard deviations, that the model with it leaves.
    """
    bench = without.bench
    before = bench.posterior(without.with_form(with_it.form)).chi2
    after = with_it.bench.posterior(with_it.base).chi2
    return bench.saved(before, max(after, at_least))


def own_forms(one: Explanation, effect_id: str) -> Forms:
    """Structures that an added effect is a special form of, less the laws of axes that another one bends, or turns by the step
    just made, too: it may only mend the other's form."""
    scene, term = one.study.ready, one.term(effect_id)
    others = [t for t in one.added if t.effect.id != effect_id]
    bent = bends(term, scene).intersection(frozenset().union(*(bends(t, scene) for t in others)))
    stepped = frozenset[int]().union(*(steps(t, scene) for t in others))
    forms = forms_of(term, scene)
    return replace(forms, axes=forms.axes - bent, steps=forms.steps - stepped)


def implausible(one: Explanation, effect_id: str) -> str:
    """The first value of an effect that can't be, with its limit, in words; empty where there is none.

    A value that the session knows by itself has to lie beyond the limit for certain: by two standard errors. What moves each
    reading by itself can't be where the readings at the references do not have it.
    """
    term = one.term(effect_id)
    for p in term.effect.parameters(one.study.ready):
        low, high = p.plausible_range
        if p.name not in term.estimates:
            continue
        value, se = term.estimates[p.name].value, term.estimates[p.name].se
        beyond = SURELY * se if term.estimates[p.name].identified and isfinite(se) else 0.0
        if not low - beyond - 1e-12 <= value <= high + beyond + 1e-12:
            limit = low if value < low else high
            unit = "" if p.unit == "1" else f" {p.unit}"
            return f"{p.name} = {value:.3g}{unit} is beyond what is physically likely ({limit:.3g}{unit})"
    not_read = against(one.study, term)
    if not_read:
        return not_read
    axial = (t for t in one.study.terms if t.effect.compliance_of is Axes.ACTUATED)
    compliance = {name: e.value for t in axial for name, e in t.estimates.items()}
    values = {name: (e.value, e.se) for name, e in term.estimates.items()}
    return term.effect.why_impossible(values, compliance, one.study.ready)


def usual(one: Explanation, effect_id: str) -> bool:
    """Whether an added effect is not surely larger, by one standard error, than in every robot: it is part of the model and no
    cause."""
    study, term = one.study, one.term(effect_id)
    effect = term.effect
    if study.ready.kind not in effect.usual_in:
        return False
    moved, whole = _moved(one)
    own = moved.get(effect_id, np.zeros_like(study.observation.y))
    # a share that few readings show is known roughly: by one in as many as its displacement has standard deviations of noise
    surely = max(1.0 - 1.0 / sqrt(max(float((study.observation.whiten(own) ** 2).sum()), 1e-300)), 0.0)
    values = {n: e.value for n, e in term.estimates.items() if SURELY * e.se <= abs(e.value) or not effect.usual_by_known}
    share = sqrt(float((own**2).sum())) / whole
    if effect.is_usual(values, surely * share, study.ready):
        return True
    if study.ready.kind != "loaded" or share * _known(one, effect_id, own) > effect.usual_at_most:
        return False
    # two of them that do what one cause does take it up from each other, and are seen together only
    most = {t.effect.id: t.effect.usual_visible * whole for t in one.added if t.effect.usual_visible > 0.0}
    small = [i for i, largest in most.items() if i in moved and _visible(one, [i], moved) <= largest]
    return effect_id in small and _visible(one, small, moved) <= sum(most[i] for i in small)


def cause_though_usual(one: Explanation, effect_id: str, noise: float, *, beside: bool = False) -> bool:
    """Whether an effect that is as large as in every robot is a cause of a loaded session all the same: so much of it is seen
    that the session shows more than noise.

    Args:
        noise: of a sample, as inferred, m. beside: it has others, whose forms this one may mend.
    """
    moved, whole = _moved(one)
    if one.study.ready.kind != "loaded" or effect_id not in moved:
        return False
    seen = _visible(one, [effect_id], moved)
    least = SETTINGS.usual_beside_noise * noise * sqrt(len(one.study.observation.y))
    effect = one.term(effect_id).effect
    return seen > max((effect.usual_beside if beside else effect.usual_alone) * whole, least)


def _moved(one: Explanation) -> tuple[Mapping[str, Array], float]:
    """What each effect moves, (m, 3), m, by id, and the root of the sum over readings of the square of what springs do, m.

    As differences show it: a station that is turned moves what is read at a reference by centimetres.
    """
    study = one.study
    observation, scene = study.observation, study.observation.scene
    moved = {i: observation.of(d) for i, d in displacements(study.terms, scene, prepared(study.terms, scene)).items()}
    springs = {t.effect.id for t in study.terms if t.effect.elastic or scene.kind == "loaded"}
    whole = float((sum((u for i, u in moved.items() if i in springs), np.zeros_like(observation.y)) ** 2).sum())
    return moved, max(sqrt(whole), 1e-150)


def rather(one: Explanation, effect_id: str) -> str:
    """Id of another effect that an added one is rather, where both explain alike (`Effect.rather`), or an empty string."""
    axial = (t for t in one.study.terms if t.effect.compliance_of is Axes.ACTUATED)
    compliance = {name: e.value for t in axial for name, e in t.estimates.items()}
    term = one.term(effect_id)
    return term.effect.rather({n: e.value for n, e in term.estimates.items()}, compliance, one.study.ready)


def ends_at(one: Explanation, effect_id: str) -> str:
    """Id of another effect that begins where the values of an added one end (`Effect.ends_at`), or an empty string."""
    term = one.term(effect_id)
    return term.effect.ends_at({n: e.value for n, e in term.estimates.items()}, one.study.ready)


def is_simpler(term: Term) -> bool:
    """Whether the values of a special form of another effect are likelier than that one (`Effect.simpler`)."""
    return term.effect.simpler({n: e.value for n, e in term.estimates.items()})


def also_called(term: Term, scene: Scene) -> str:
    """Id of another effect that a fitted one may as well be called (`Effect.also_called`), or an empty string."""
    own = parameters_of(term.effect, scene)
    errors = [term.estimates[p.name].se if p.name in term.estimates else None for p in own]
    se = np.array([e if e is not None and isfinite(e) else 0.0 for e in errors])
    return term.effect.also_called(scene, term.theta(own), se)


def _visible(one: Explanation, ids: Sequence[str], moved: Mapping[str, Array]) -> float:
    """Root of the sum over readings of the square of what effects move, m, that the rest of the model does not take up: most of
    friction and of creep looks like softer gears.

    Args:
        moved: displacement that is observed of each effect, (m, 3), m.
    """
    observation = one.study.observation
    left = _beside_the_rest(one, ids, sum((moved[i] for i in ids), np.zeros_like(observation.y)))
    return sqrt(float((observation.whiten.undo(left.reshape(-1, 3)) ** 2).sum()))


def _known(one: Explanation, effect_id: str, own: Array) -> float:
    """Share of what an effect moves, (m, 3), m, that is certain: less two standard errors of its size beside the rest."""
    return max(1.0 - SURELY / max(float(np.linalg.norm(_beside_the_rest(one, [effect_id], own))), 1e-150), 0.0)


def _beside_the_rest(one: Explanation, ids: Sequence[str], moved: Array) -> Array:
    """What is left of a displacement of some effects, (m, 3), m, beside the rest of a model, whitened, (3m,)."""
    study = one.study
    rest = study.base.take([i for i, owner in enumerate(study.owners) if owner not in ids])
    return Ground(study.bench, rest).beside(study.observation.whiten(moved).ravel())


def everywhere(one: Explanation, effect_id: str) -> bool:
    """Whether every robot shows an effect in such a session: it is preferred to a structure that explains no more."""
    return one.study.ready.kind in one.term(effect_id).effect.everywhere


def of_axes(one: Explanation, effect_id: str) -> bool:
    """Whether an effect is the springs of the axes: no arm is without, so that they are there needs no proof."""
    return one.term(effect_id).effect.compliance_of is not None


def in_one_pose(one: Explanation, effect_id: str) -> bool:
    """Whether an effect shows in the differences of one pose only."""
    return one.term(effect_id).effect.evidence is Evidence.ONE_POSE and one.study.ready.kind == "loaded"


def shown_by_readings(one: Explanation, effect_id: str) -> float:
    """Log odds that the readings at the references carry an effect, where they tell; else 0.

    No spring, no law of torque and no structure of the remainder moves them, so nothing of that kind passes for it then.
    """
    odds = carried(one.study, one.term(effect_id))
    return odds if odds > SETTINGS.nats_to_name else 0.0
