# SPDX-License-Identifier: Apache-2.0
"""An elastic model of one robot: a list of effects with parameter values, and what it predicts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import Axes, Effect, Family, Parameter, find_effect, follows_springs, is_predicted, parameters_of
from ..effects.scene import Scene
from ..effects.state import ElasticResponse, Load
from ..errors import ModelError
from ..typing import Array, Json
from .springs import answer_of, by_geometry, by_parameters, displacement_at, is_kept, response_of

SIX_DOF = ("joint_torsion",)
EIGHTEEN_DOF = ("joint_torsion", "link_bending")
GEOMETRIC = ("station_pose", "marker_position", "geometry_error")  # where absolute sessions start from


NO_UNIT = ("1", "0 or 1", "0, 1/2 or 1")
PULL_STEP = 1e-3  # of the scale of a pull, for derivatives
MOST_SAG = 1.5  # times what the masses of a robot description say


@dataclass(frozen=True)
class Estimate:
    """One parameter's value.

    Attributes:
        se: standard error, in the parameter's unit; NaN where only a combination with others is known or none was computed.
        identified: the single value is known, not only a combination.
    """

    value: float
    se: float = math.nan
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    identified: bool = True

    def __str__(self) -> str:
        error = f" +- {self.se:.2g}" if math.isfinite(self.se) else ""
        unit = self.unit if self.unit not in NO_UNIT else ""
        return f"{as_known(self.value, self.se)}{error} {unit}".rstrip()


@dataclass(frozen=True)
class Term:
    """One effect of a model with its parameters by name.

    Raises:
        ModelError: a parameter is of an earlier form of the effect, whose values mean something else now.
    """

    effect: Effect
    estimates: dict[str, Estimate] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.estimates:
            if any(re.fullmatch(pattern, name) for pattern in self.effect.obsolete):
                raise ModelError(
                    f"effect '{self.effect.id}': parameter '{name}' is of an earlier form of this effect;"
                    " identify the model again"
                )

    def theta(self, parameters: Iterable[Parameter]) -> Array:
        """Values in the order of `parameters`; the start value where the model does not name one, (p,)."""
        return np.array([self.estimates[p.name].value if p.name in self.estimates else p.start for p in parameters])

    def whole(self, parameters: Iterable[Parameter]) -> Term:
        """The same with all parameters, those that it does not name at their start; as it is where it names none (all then)."""
        if not self.estimates:
            return self
        named = {p.name: self.estimates.get(p.name, Estimate(p.start, unit=p.unit)) for p in parameters}
        return replace(self, estimates=named)

    def free(self, parameters: Sequence[Parameter]) -> list[int]:
        """Indices of the parameters that a fit may change: those that the term names (all where it names none), without a
        grid."""
        named = {p.name for p in parameters} & set(self.estimates)
        return [i for i, p in enumerate(parameters) if not p.grid and (not named or p.name in named)]


def as_known(value: float, se: float) -> str:
    """A value to the second digit of its standard error; four digits where there is none."""
    if not (math.isfinite(se) and se > 0.0 and math.isfinite(value)):
        return f"{value:.4g}"
    place = math.floor(math.log10(se)) - 1
    whole = round(value / 10.0**place)
    return f"{whole * 10.0**place:.{min(max(len(str(abs(whole))), 1), 7)}g}" if whole else "0"


@dataclass(frozen=True)
class Envelope:
    """The range that a model was identified in.

    Attributes:
        q_lower, q_upper: joint angles, (k,), rad.
        force, torque: largest magnitude at the TCP, N and N m.
    """

    q_lower: tuple[float, ...]
    q_upper: tuple[float, ...]
    force: float
    torque: float = 0.0


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that is known although its members are not.

    Attributes:
        weights: parameter (effect.parameter) -> weight in the sum.
        value, se: of the sum, in the members' unit.
    """

    weights: dict[str, float]
    value: float
    se: float

    def __str__(self) -> str:
        parts = [
            f"{'-' if w < 0 else '+'} {'' if abs(abs(w) - 1) < 1e-6 else f'{abs(w):.3g} '}{n}" for n, w in self.weights.items()
        ]
        return " ".join(parts).removeprefix("+ ") + f" = {self.value:.4g} (std. error {self.se:.2g})"


@dataclass(frozen=True)
class Model:
    """Effects with values, and whose robot they belong to.

    Attributes:
        urdf_sha256: SHA-256 of the robot description.
        tool: name or note of the tool that was mounted.
        made: how it was made: session, solver, version, date, parent.
        figures: what it earned: fit_rms_m, cv_rms_m, noise_floor_m, rank, ...
        combinations: sums that are known of parameters which are not known singly.
    """

    terms: tuple[Term, ...]
    serial: str = ""
    urdf: str = ""
    urdf_sha256: str = ""
    tool: str = ""
    envelope: Envelope | None = None
    made: Json = field(default_factory=dict)
    figures: Json = field(default_factory=dict)
    combinations: tuple[Combination, ...] = ()
    history: tuple[Json, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Effect ids in order."""
        return tuple(t.effect.id for t in self.terms)

    @property
    def sag_share(self) -> float:
        """Share of what the arm sags more on the way from the reference, by its springs and the masses of its description, that
        its loaded sessions show; 0 where the controller corrects for all of it."""
        share = self.made.get("sag_share", 1.0) if isinstance(self.made, dict) else 1.0
        return float(share) if isinstance(share, (int, float)) and 0.0 <= share <= MOST_SAG else 1.0

    def standing(self, scene: Scene) -> Scene:
        """A loaded scene with the arm as it stands by a geometry error of the model: springs turn about other lines."""
        for term in self.terms:
            if term.effect.moves_joints and scene.kind == "loaded":
                scene = term.effect.standing(scene, term.theta(parameters_of(term.effect, scene)))
        return scene

    def predict(self, scene: Scene) -> Array:
        """Deflection of the TCP in each row, (n, 3), m, in base_link.

        In `loaded` sessions what the process force causes since the row's reference, evaluated at the force that really acts
        (sensor effects) on the arm as it stands: what a geometry error makes of the commanded displacement, what is left of a
        motion, what passes with time and what only instruments see is no part of it, as in the live correction. In `absolute`
        sessions where the physical TCP is relative to the controller's, without what passes with time and what only instruments
        see.

        Args:
            scene: rows that observe the TCP (`scene_of(session, observe="tcp")`).
        """
        moving = [t for t in self.terms if is_predicted(t.effect.cause, scene.kind)]
        return scene.change(total_displacement(moving, self.standing(scene)))


def blank_model(effects: Sequence[str]) -> tuple[Term, ...]:
    """Terms without values, for a first fit. Raises EffectError for an unknown id."""
    return tuple(Term(find_effect(e)) for e in effects)


def axis_compliances(terms: Sequence[Term], scene: Scene) -> dict[int, Estimate]:
    """Compliances of actuated axes that are known singly, with their standard errors: joint (from 0) -> estimate."""
    return {
        p.axis: term.estimates[p.name]
        for term in terms
        if term.effect.compliance_of is Axes.ACTUATED
        for p in parameters_of(term.effect, scene)
        if p.axis is not None and p.name in term.estimates
        if term.estimates[p.name].identified and math.isfinite(term.estimates[p.name].se)
    }


def apply_wrench_effects(terms: Sequence[Term], scene: Scene) -> Scene:
    """The scene under the wrench that really acts, by the model's sensor effects."""
    for term in terms:
        if term.effect.acts_on == "wrench":
            scene = scene.with_wrench(*term.effect.wrench(scene, term.theta(parameters_of(term.effect, scene))))
    return scene


def displacement_of(term: Term, scene: Scene) -> Array:
    """Displacement of the observed point by one term, (n, 3), m."""
    moved = _moved(term, scene)
    return moved + scene.view.sags * _sag(term, scene) if scene.view.sags and _bends(term, scene) else moved


def _moved(term: Term, scene: Scene) -> Array:
    theta = term.theta(parameters_of(term.effect, scene))
    return displacement_at(term.effect, theta, scene) if is_kept(term.effect, scene) else term.effect.displacement(scene, theta)


def _bends(term: Term, scene: Scene) -> bool:
    """Whether a term is a spring, or the part that the spring of a gear has less where teeth carry."""
    return term.effect.elastic or any(p.takes_from for p in parameters_of(term.effect, scene))


def _sag(term: Term, scene: Scene) -> Array:
    """What a spring gives way more under the weight of the arm than at the reference of each row, (n, 3), m.

    A few millimetres further, where it presses, the arm sags by micrometres to some ten of them more, which a geometry error
    would pass for. It follows from the springs that the process shows; nothing is read off it (`regressors` have no part of it):
    masses are known but roughly, and balancers are not known at all.
    """
    weighs = scene.by_weight()
    if not parameters_of(term.effect, weighs):
        return np.zeros((len(scene), 3))
    sag = _moved(term, weighs)
    return sag - sag[scene.reference]


def sag_of(terms: Sequence[Term], scene: Scene) -> Array | None:
    """What the springs of a model give way more under the weight of the arm than at the reference of each row, all of it,
    (n, 3), m; None where a session of this kind does not see it."""
    springs = [t for t in terms if _bends(t, scene)]
    if scene.kind != "loaded" or scene.instruments.by_contact or not springs:
        return None
    return sum((_sag(t, scene) for t in springs), np.zeros((len(scene), 3)))


def loaded(terms: Sequence[Term], scene: Scene) -> list[Term]:
    """The terms with the compliances of loaded axes: less what other terms take from them (`Parameter.takes_from`)."""
    taken: dict[str, float] = {}
    for term in terms:
        for p in parameters_of(term.effect, scene):
            if p.takes_from and p.name in term.estimates:
                taken[p.takes_from] = taken.get(p.takes_from, 0.0) + term.estimates[p.name].value

    def less(term: Term) -> Term:
        changed = {n: replace(e, value=e.value + taken[n]) for n, e in term.estimates.items() if n in taken}
        return replace(term, estimates={**term.estimates, **changed}) if changed else term

    return [less(term) if term.effect.elastic else term for term in terms]


def elastic_response(terms: Sequence[Term], scene: Scene, mover: Effect | None = None) -> ElasticResponse:
    """How the springs among the terms answer (they are linear in the wrench, and in where they are seen), those of loaded axes:
    what creeps or gives way to a hose is a gear whose teeth carry.

    Args:
        mover: an effect that `moves_joints`, if it is asked what springs do by its parameters.
    """
    n = len(scene)
    u, rotation, compliance = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 6))
    turned = []
    for term in loaded(terms, scene):
        if not term.effect.elastic:
            continue
        theta = term.theta(parameters_of(term.effect, scene))
        one = response_of(term.effect, theta, scene)
        u, rotation, compliance = u + one.displacement, rotation + one.rotation, compliance + one.compliance
        more = None if mover is None else by_geometry(term.effect, theta, scene, mover)
        turned += [] if more is None else [more]
    return ElasticResponse(u, rotation, compliance, np.sum(turned, axis=0) if turned else None)


def mover_of(effects: Iterable[Effect], scene: Scene) -> Effect | None:
    """The effect that moves the joints of a loaded session, if there is one."""
    return next((e for e in effects if e.moves_joints), None) if scene.kind == "loaded" else None


def prepared(terms: Sequence[Term], scene: Scene) -> Scene:
    """The scene as the effects of a model see it: wrench corrected, what pulls unseen and elastic response attached."""
    scene = apply_wrench_effects(terms, scene)
    if any(follows_springs(t.effect, scene) for t in terms):
        scene = replace(scene, elastic=elastic_response(terms, scene, mover_of((t.effect for t in terms), scene)))
    return with_pull(terms, scene)


def with_pull(terms: Sequence[Term], scene: Scene) -> Scene:
    """The scene with the torque of what pulls at the arm and no sensor reads: laws of gears answer to that too."""
    pulls = [t for t in terms if t.effect.loads_arm and any(e.value for e in t.estimates.values())]
    if not pulls:
        return scene
    wrenches = [t.effect.pull(scene, t.theta(parameters_of(t.effect, scene))) for t in pulls]
    return replace(scene, tau_unseen=np.sum([Load(scene.arm, *wrench).tau for wrench in wrenches], axis=0))


def displacements(terms: Sequence[Term], scene: Scene, ready: Scene | None = None) -> dict[str, Array]:
    """Displacement of the observed point by each term that moves it, effect id -> (n, 3), m.

    Args:
        ready: `prepared(terms, scene)`, where it is known already.
    """
    ready = prepared(terms, scene) if ready is None else ready
    return {t.effect.id: displacement_of(t, ready) for t in terms if t.effect.acts_on != "wrench"}


def total_displacement(terms: Sequence[Term], scene: Scene, ready: Scene | None = None) -> Array:
    """Sum over the terms, (n, 3), m. Arguments as of `displacements`."""
    return sum(displacements(terms, scene, ready).values(), np.zeros((len(scene), 3)))


def regressors(terms: Sequence[Term], scene: Scene, ready: Scene | None = None) -> list[Array]:
    """Derivative of the total displacement by the parameters of each term at their values, list of (n, 3, p). Arguments as of
    `displacements`."""
    ready = prepared(terms, scene) if ready is None else ready
    out = []
    for i, term in enumerate(terms):
        parameters = parameters_of(term.effect, scene)
        theta = term.theta(parameters)
        if term.effect.acts_on == "wrench":
            out.append(_wrench_regressor(terms, i, scene, parameters, theta))
        else:
            out.append(term.effect.regressor(ready, theta))
    springs = [i for i, t in enumerate(terms) if t.effect.elastic and t.effect.acts_on != "wrench"]
    plain = {i: out[i] for i in springs}
    change: dict[int, ElasticResponse] = {}
    takers = _takers(terms, springs, scene)
    mover = mover_of((t.effect for t in terms if any(e.value for e in t.estimates.values())), scene)
    for term in terms:
        if not follows_springs(term.effect, scene):
            continue
        theta = term.theta(parameters_of(term.effect, scene))
        for i in springs if theta.any() and type(term.effect).by_elastic is not Effect.by_elastic else ():
            if i not in change:
                at = terms[i].theta(parameters_of(terms[i].effect, scene))
                change[i] = by_parameters(terms[i].effect, at, ready, plain[i], mover)
            more = term.effect.by_elastic(ready, theta, change[i])
            if more is None:
                continue
            out[i] = out[i] + more
            for j, p, c in takers[i]:
                out[j] = out[j].copy()
                out[j][:, :, p] += more[:, :, c]
    return _with_laws(terms, ready, out)


def _with_laws(terms: Sequence[Term], ready: Scene, out: list[Array]) -> list[Array]:
    """Derivatives by the parameters of each term, with what laws of gears make of the torque of what pulls unseen."""
    unseen = ready.tau_unseen
    laws = [t for t in terms if t.effect.family is Family.TORQUE_LAW and any(e.value for e in t.estimates.values())]
    if unseen is None or not laws:
        return out
    at = sum((_moved(t, ready) for t in laws), np.zeros((len(ready), 3)))
    found = []
    for term, plain in zip(terms, out, strict=True):
        parameters = parameters_of(term.effect, ready) if term.effect.loads_arm else ()
        more = plain.copy() if parameters else plain
        for i in term.free(parameters):
            step = np.zeros(len(parameters))
            step[i] = PULL_STEP * parameters[i].scale
            there = replace(ready, tau_unseen=unseen + Load(ready.arm, *term.effect.pull(ready, step)).tau)
            more[:, :, i] += (sum(_moved(t, there) for t in laws) - at) / step[i]
        found.append(more)
    return found


def _takers(terms: Sequence[Term], springs: Sequence[int], scene: Scene) -> dict[int, list[tuple[int, int, int]]]:
    """Of each spring the parameters that take from it: number of the term, of the parameter there, of that of the spring."""
    own = [parameters_of(term.effect, scene) for term in terms]
    takes = [(j, p, one.takes_from) for j, all_of in enumerate(own) for p, one in enumerate(all_of) if one.takes_from]
    return {i: [(j, p, c) for j, p, name in takes for c, one in enumerate(own[i]) if one.name == name] for i in springs}


def _wrench_regressor(terms: Sequence[Term], i: int, scene: Scene, parameters: Sequence[Parameter], theta: Array) -> Array:
    """Of an effect that changes the wrench: springs that are kept are linear in it, what other terms make of it is asked on both
    sides of each value."""
    moving = [t for t in terms if t.effect.acts_on != "wrench"]
    kept = [t for t in moving if is_kept(t.effect, scene)]
    by_wrench = sum(
        (answer_of(t.effect, t.theta(parameters_of(t.effect, scene)), scene).by_wrench[:, :, 0] for t in kept),
        np.zeros((len(scene), 3, 6)),
    )
    others = [t for t in moving if not is_kept(t.effect, scene)]
    out = np.empty((len(scene), 3, len(parameters)))
    for p, parameter in enumerate(parameters):
        h = 1e-2 * parameter.scale
        sides, wrench = [], []
        for step in (h, -h):
            shifted = theta.copy()
            shifted[p] += step
            values = {q.name: Estimate(float(v)) for q, v in zip(parameters, shifted, strict=True)}
            there = prepared([*terms[:i], replace(terms[i], estimates=values), *terms[i + 1 :]], scene)
            sides.append(sum((_moved(t, there) for t in others), np.zeros((len(scene), 3))))
            wrench.append(np.concatenate([there.force_in_tool, there.torque_in_tool], axis=1))
        moved = sides[0] - sides[1] + np.einsum("nik,nk->ni", by_wrench, wrench[0] - wrench[1])
        out[:, :, p] = moved / (2 * h)
    return out
