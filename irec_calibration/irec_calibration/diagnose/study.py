# SPDX-License-Identifier: Apache-2.0
"""One session and one model, prepared so that thousands of alternatives can be tried in seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import log
from typing import TYPE_CHECKING

import numpy as np

from ..effects import Effect, Parameter, absent, known_effects
from ..effects.scene import Scene
from ..identification.absolute import completed, thinned
from ..identification.gauss_newton import fitted
from ..identification.identify import Fit, fit, keep_seated_anew, observe_with_force_noise
from ..identification.noise import FARTHEST_CLAIM
from ..identification.observe import Observation
from ..identification.validation import RIDGE, ROUNDING, floored
from ..model import Term, apply_wrench_effects, elastic_response, mover_of, with_pull
from ..session.data import Session
from ..typing import Array
from .evidence import Bench, Block, NoisePrior
from .priors import FORM_LEVELS, choices, level_key, level_of_form, log_odds_of_form
from .settings import SETTINGS

if TYPE_CHECKING:
    from .candidates import Option
    from .remainder import Part, Remainder

ROUGHLY = 1e-4  # relative fall of the loss at which springs are known well enough to set widths by them
NEARLY = 1e-6  # relative fall of the loss at which evidence is known: by a thousandth of a nat
MOST_REFLECTORS = 20  # that are told apart, those that were seated anew counted each time
ROUNDS = 2  # in which widths of priors follow the springs; a third changes them by less than a per cent


@dataclass(frozen=True)
class Study:
    """A model fitted to a session with weak priors, as a linear problem.

    A term that names some of its effect's parameters has only those; the others are held at zero.

    Attributes:
        fit: the model's terms with fitted values, their residual and what is identifiable.
        ready: scene under the model's wrench corrections, with the elastic response of its springs attached.
        base: columns of the model's own parameters; owners: effect id of each; parameters.
        scale: physical value of one scaled unit, (p,).
        apart: rows that stand out and have noise of their own in it (`apart.py`); as_stated: the same with that for
            accidents only (`accidents.py`), None where no row stands out.
        form: level of the priors of what completes the form of springs, by `level_key`.
        kept: remainders beside it that were asked for (`explanation.remainder_of`); tables: of effects on top of it, by id
            (`candidates.Option.on`).
    """

    fit: Fit
    ready: Scene
    base: Block
    owners: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    scale: Array
    bench: Bench
    apart: tuple[Part, ...] = ()
    as_stated: Study | None = None
    form: dict[str, float] = field(default_factory=dict)
    kept: dict[object, tuple[object, Remainder]] = field(default_factory=dict, init=False, repr=False, compare=False)
    tables: dict[str, Option] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def to_weigh(self) -> Study:
        """What alternatives are weighed on: there a row that stands out may yet be shown to have a cause, but for accidents."""
        return self.as_stated or self

    @property
    def log_odds_of_form(self) -> float:
        """Log odds of the levels of what completes the form of springs, against their usual ones."""
        return float(log_odds_of_form(np.array(list(self.form.values()))).sum())

    def with_form(self, form: Mapping[str, float]) -> Block:
        """The columns with other levels of what completes the form of springs; levels that are not given are left as they are."""
        keys = [level_key(o, p.level) for o, p in zip(self.owners, self.parameters, strict=True)]
        share = np.array([form.get(k, self.form[k]) / self.form[k] if k in self.form else 1.0 for k in keys])
        return replace(self.base, width=self.base.width * share)

    @property
    def observation(self) -> Observation:
        return self.fit.observation

    @property
    def session(self) -> Session:
        return self.fit.observation.session

    @property
    def terms(self) -> tuple[Term, ...]:
        return self.fit.terms

    @property
    def true_chi2(self) -> float:
        """Squared residual of the fit in standard deviations, without any linearisation."""
        return float((self.observation.whiten(self.fit.residual) ** 2).sum())

    def errors_of(self, effect_id: str) -> dict[str, float]:
        """Posterior standard deviation of each parameter of an effect of the model, everything else as likely as it is."""
        own = [i for i, owner in enumerate(self.owners) if owner == effect_id]
        if not own:
            return {}
        G = self.base.A.T @ self.base.A
        H = G + np.diag(floored(self.base.width**-2.0, G, self.bench.rounding))
        sd = np.sqrt(np.linalg.inv(H).diagonal()) * self.scale
        return {self.parameters[i].name: float(sd[i]) for i in own}

    def columns(self, displacement: Array) -> Array:
        """Whitened equations of displacements per session row: (n, 3, p) -> (3m, p)."""
        seen = self.observation.whiten(self.observation.of(displacement))
        return seen.reshape(-1, displacement.shape[2])

    def regressor(self, effect: Effect, theta: Array) -> Array:
        """Derivative of the displacement by an effect's parameters about theta, on top of the model, (n, 3, p)."""
        if effect.acts_on != "wrench":
            return effect.regressor(self.ready, theta)
        parameters = effect.parameters(self.ready)
        out = np.empty((len(self.ready), 3, len(parameters)))
        for p, parameter in enumerate(parameters):
            h = 1e-2 * parameter.scale
            ahead, behind = theta.copy(), theta.copy()
            ahead[p] += h
            behind[p] -= h
            change = [np.concatenate(effect.wrench(self.ready, t), axis=1) for t in (ahead, behind)]
            out[:, :, p] = np.einsum("nij,nj->ni", self.ready.response.compliance, (change[0] - change[1]) / (2 * h))
        return out

    def why_not(self, effect: Effect) -> str:
        """Why an effect can't show in this session at all, or an empty string."""
        why = absent(self.ready, effect.needs)
        if not why and not effect.parameters(self.ready):
            why = "it has no parameter that this robot or session could show"
        return why


def prepare(session: Session, terms: Sequence[Term]) -> Study:
    """Fit a model to a session with weak priors whose level the session sets, and lay out the linear problem.

    Rows that stand out beside the model and whatever else has structure count as little as they deserve. A reflector that was
    seated anew, by evidence beyond an accident's, is another one from there on.

    Raises:
        SolveError: the session can't be used with this model.
    """
    from .accidents import steps_left_out
    from .apart import set_apart
    from .level import with_inferred_level

    observation = thinned(observe_with_force_noise(session, terms))
    found, bad, sure = with_inferred_level(observation, terms)
    seated = [(p.log_evidence, p.structure.seated, p.structure.words) for p in bad if p.structure.seated]
    surest, where, words = max(seated, default=(0.0, None, ""))
    if where is not None and surest > SETTINGS.nats_of_accident and len(found.session.markers) < MOST_REFLECTORS:
        keep_seated_anew(session, *where, words)
        return prepare(session, terms)
    lasting = steps_left_out(found)
    if lasting:
        found, bad, sure = with_inferred_level(thinned(observe_with_force_noise(session, terms, lasting)), terms)
    if not bad:
        return found
    weighed = replace(study_of(set_apart(found.observation, sure), found.terms), apart=sure) if sure else found
    if len(sure) == len(bad):
        return weighed
    return replace(study_of(set_apart(found.observation, bad), found.terms), apart=bad, as_stated=weighed)


def completed_study(study: Study) -> Study:
    """The same with the effects that complete the form of those it has (`Effect.completes`), each where it can show."""
    present = {t.effect.id for t in study.terms}
    more = [e for e in known_effects().values() if e.completes in present and e.id not in present and not study.why_not(e)]
    return study_of(study.observation, (*study.terms, *(Term(e) for e in more))) if more else study


def form_evidence(asked: Study, completed: Study) -> float:
    """Log evidence for what completes the form of a model's springs; the widths that were tried are taken off."""
    if len(asked.terms) == len(completed.terms):
        return 0.0
    plain, whole = (s.bench.posterior(s.base).log_evidence for s in (asked, completed))
    every = log(np.exp(log_odds_of_form(np.array(FORM_LEVELS))).sum()) * max(len(completed.form), 1)
    return float(whole + completed.log_odds_of_form - plain - asked.log_odds_of_form - every)


def study_of(observation: Observation, terms: Sequence[Term]) -> Study:
    """As `prepare`, for an observation that exists already."""
    scene, terms = observation.scene, completed(terms, observation)
    own = _widths(terms, scene)
    first = fitted(terms, observation, prior_width=own, settled=ROUGHLY)
    system = first.linearised(observation)
    owners = [terms[i].effect.id for i in system.owner]
    believed = NoisePrior(scale=min(1.0 / observation.whiten.level, FARTHEST_CLAIM))
    rounding = ROUNDING if scene.kind == "absolute" else RIDGE
    bench = Bench(system.b, system.pose.astype(np.int64), believed, rounding)
    block = Block(system.A, system.lower, system.upper, _beside_softening(own, system.parameters, system.scale))
    follows = _going_with(system.parameters)
    form: dict[str, float] = {}
    times = np.ones(len(own))
    for choice in choices([terms[i].effect for i in system.owner], [p.level for p in system.parameters]):
        soft = _softness(bench, block, follows)
        tried = np.where(choice.of, choice.times, times)
        widths = np.array([_beside_softening(soft * own * t, system.parameters, system.scale) for t in tried])
        log_evidence = bench.evidence_over_widths(block, widths) + choice.log_odds
        best = int(np.argmax(log_evidence))
        times, block = tried[best], replace(block, width=widths[best])
        if choice.completing:
            level = form[choice.completing] = level_of_form(log_evidence)
            times = np.where(choice.of, level, times)
            block = replace(block, width=np.where(choice.of, level / FORM_LEVELS[best], 1.0) * block.width)
    own = own * times
    for _ in range(ROUNDS if follows else 0):  # the springs depend a little on what goes with them
        soft = _softness(bench, block, follows)
        block = replace(block, width=_beside_softening(soft * own, system.parameters, system.scale))
    width = block.width
    result = fit(first.terms, observation, prior_width=width, settled=NEARLY, start=replace(first, system=system))
    system = result.system
    ready = apply_wrench_effects(result.terms, scene)
    mover = mover_of(known_effects().values(), ready)
    ready = with_pull(result.terms, replace(ready, elastic=elastic_response(result.terms, ready, mover)))
    return Study(
        result,
        ready,
        Block(system.A, system.lower, system.upper, width),
        tuple(owners),
        tuple(system.parameters),
        system.scale,
        Bench(system.b, system.pose.astype(np.int64), believed, rounding),
        form=form,
    )


def _beside_softening(width: Array, parameters: Sequence[Parameter], scale: Array) -> Array:
    """Prior widths with those of compliances from which other parameters take something away (`Parameter.takes_from`).

    What is known beforehand is about how soft a loaded axis is, c + a with a <= 0. So c has the width of both.
    """
    if not any(p.takes_from for p in parameters):
        return width
    out = width.copy()
    at = {p.name: i for i, p in enumerate(parameters)}
    for i, p in enumerate(parameters):
        if p.takes_from in at:
            j = at[p.takes_from]
            out[j] = np.hypot(out[j], width[i] * scale[i] / scale[j])
    return out


def _going_with(parameters: Sequence[Parameter]) -> dict[int, int]:
    """Parameters whose size follows from a compliance (`Parameter.goes_with`), and that one: places in the list."""
    at = {p.name: i for i, p in enumerate(parameters)}
    return {i: at[p.goes_with] for i, p in enumerate(parameters) if p.goes_with in at}


def _softness(bench: Bench, block: Block, follows: dict[int, int]) -> Array:
    """Multiples of prior widths by how soft the springs are that parameters go with, (p,): the RMS of what the session says.

    A width that goes with c and holds for c = 1 (scaled) has the mean square c^2 + its variance.
    """
    out = np.ones(len(block.width))
    if follows:
        x = bench.posterior(block).x
        G = block.A.T @ block.A
        precision = floored(block.width**-2.0, G, bench.rounding)
        variance = np.linalg.inv(G + np.diag(precision)).diagonal()
        for i, j in follows.items():
            out[i] = np.sqrt(x[j] ** 2 + variance[j])
    return out


def _widths(terms: Sequence[Term], scene: Scene) -> Array:
    """Prior width of each free parameter."""
    out = []
    for term in terms:
        own = term.effect.parameters(scene)
        out += [own[i].prior_width for i in term.free(own)]
    return np.array(out)
