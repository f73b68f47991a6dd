# SPDX-License-Identifier: Apache-2.0
"""What the terms of a model do to the observed point of each row, and by how much for each of their parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..effects import Effect, Family, Parameter, follows_springs, parameters_of
from ..effects.scene import Scene
from ..effects.state import ElasticResponse, Load
from ..typing import Array
from .springs import answer_of, by_geometry, by_parameters, displacement_at, is_kept, response_of
from .term import Estimate, Term

TORQUE_STEP = 0.005  # N m at most, of what pulls at the arm, for derivatives
WRENCH_STEP = 1e-3  # of the scale of a parameter that changes the wrench


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
    sag = _whole_sag(term, scene)
    return sag - sag[scene.reference]


def _whole_sag(term: Term, scene: Scene) -> Array:
    weighs = scene.by_weight()
    return _moved(term, weighs) if parameters_of(term.effect, weighs) else np.zeros((len(scene), 3))


def sag_of(terms: Sequence[Term], scene: Scene) -> Array | None:
    """What the springs of a model give way more under the weight of the arm than at the reference of each row, all of it,
    (n, 3), m; None where a session of this kind does not see it."""
    springs = [t for t in terms if _bends(t, scene)]
    if scene.kind != "loaded" or scene.instruments.by_contact or not springs:
        return None
    return sum((_sag(t, scene) for t in springs), np.zeros((len(scene), 3)))


def whole_sag_of(terms: Sequence[Term], scene: Scene) -> Array:
    """What the springs of a model give way under the weight of the arm from no weight on, (n, 3), m: not in differences, but in
    what is read at each row."""
    return sum((_whole_sag(t, scene) for t in terms if _bends(t, scene)), np.zeros((len(scene), 3)))


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


def elastic_response(
    terms: Sequence[Term], scene: Scene, mover: Effect | None = None, which: Sequence[int] | None = None
) -> ElasticResponse:
    """How the springs among the terms answer (they are linear in the wrench, and in where they are seen), those of loaded axes:
    what creeps or gives way to a hose is a gear whose teeth carry.

    Args:
        mover: an effect that `moves_joints`, if it is asked what springs do by its parameters.
        which: by which of these; None: by all.
    """
    n = len(scene)
    u, rotation, compliance = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 6))
    of_wrist = np.zeros((n, 3, 6))
    turned = []
    for term in loaded(terms, scene):
        if not term.effect.elastic:
            continue
        theta = term.theta(parameters_of(term.effect, scene))
        one = response_of(term.effect, theta, scene)
        u, rotation, compliance = u + one.displacement, rotation + one.rotation, compliance + one.compliance
        if one.of_wrist is not None:
            of_wrist = of_wrist + one.of_wrist
        more = None if mover is None else by_geometry(term.effect, theta, scene, mover, which)
        turned += [] if more is None else [more]
    return ElasticResponse(u, rotation, compliance, np.sum(turned, axis=0) if turned else None, of_wrist)


def mover_of(effects: Iterable[Effect], scene: Scene) -> Effect | None:
    """The effect that moves the joints of a loaded session, if there is one."""
    return next((e for e in effects if e.moves_joints), None) if scene.kind == "loaded" else None


def prepared(terms: Sequence[Term], scene: Scene) -> Scene:
    """The scene as the effects of a model see it: wrench corrected, what pulls unseen and elastic response attached."""
    scene = apply_wrench_effects(terms, scene)
    if any(follows_springs(t.effect, scene) for t in terms):
        mover = mover_of((t.effect for t in terms), scene)
        which = _known_of(mover, terms, scene)
        scene = scene.loaded_otherwise(elastic=elastic_response(terms, scene, mover, which))
    return with_pull(terms, scene)


def _known_of(mover: Effect | None, terms: Sequence[Term], scene: Scene) -> list[int] | None:
    """Which parameters of an effect that moves the joints a model has; None: all, as before a first fit."""
    known = next((t.estimates for t in terms if t.effect is mover), {})
    return [i for i, p in enumerate(parameters_of(mover, scene)) if p.name in known] if mover and known else None


def with_pull(terms: Sequence[Term], scene: Scene) -> Scene:
    """The scene with the torque of what pulls at the arm and no sensor reads: laws of gears answer to that too."""
    pulls = [t for t in terms if t.effect.loads_arm and any(e.value for e in t.estimates.values())]
    if not pulls:
        return scene if scene.tau_unseen is None else scene.loaded_otherwise(tau_unseen=None)
    torques = [t.effect.torque_of_pull(scene, t.theta(parameters_of(t.effect, scene))) for t in pulls]
    return scene.loaded_otherwise(tau_unseen=np.sum(torques, axis=0))


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
            out.append(_wrench_regressor(terms, i, scene, ready, parameters))
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
                change[i] = by_parameters(terms[i].effect, at, ready, plain[i], mover, _known_of(mover, terms, scene))
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
    found = []
    for term, plain in zip(terms, out, strict=True):
        free = term.free(parameters_of(term.effect, ready)) if term.effect.loads_arm else []
        more = plain.copy() if free else plain
        for law in laws if free else ():
            change = _torque_of_pull(term, ready)[:, :, free]
            said = law.effect.by_torque(ready, law.theta(parameters_of(law.effect, ready)), change, read=False)
            more[:, :, free] += _by_step(law, ready, change) if said is None else said
        found.append(more)
    return found


def _by_step(law: Term, ready: Scene, change: Array) -> Array:
    """Derivative of the displacement by a law of gears by a change of the torque that is not read, (n, 3, p), by a small step."""
    unseen = np.zeros_like(ready.tau) if ready.tau_unseen is None else ready.tau_unseen
    at, out = _moved(law, ready), np.empty((len(ready), 3, change.shape[2]))
    for p in range(change.shape[2]):
        h = TORQUE_STEP / max(float(np.abs(change[:, :, p]).max()), 1e-300)
        out[:, :, p] = (_moved(law, ready.loaded_otherwise(tau_unseen=unseen + h * change[:, :, p])) - at) / h
    return out


def _torque_of_pull(term: Term, scene: Scene) -> Array:
    """Torque about the actuated axes by one of each parameter of what pulls at the arm, at its shape values, (n, k, p); kept with
    the view for the next step of a fit."""
    effect, own = term.effect, parameters_of(term.effect, scene)
    shape = np.where([bool(p.grid) for p in own], term.theta(own), 0.0)
    name, key = f"torque of {effect.id}", (effect, shape.tobytes())
    rows, of, known = scene.view.kept.get(name, (None,) * 3)
    if rows is not scene.rows or of != key:
        unit = np.diag([0.0 if p.grid else 1.0 for p in own])
        known = np.stack([effect.torque_of_pull(scene, shape + one) for one in unit], axis=2)
        scene.view.kept[name] = scene.rows, key, known
    return np.asarray(known)


def _takers(terms: Sequence[Term], springs: Sequence[int], scene: Scene) -> dict[int, list[tuple[int, int, int]]]:
    """Of each spring the parameters that take from it: number of the term, of the parameter there, of that of the spring."""
    own = [parameters_of(term.effect, scene) for term in terms]
    takes = [(j, p, one.takes_from) for j, all_of in enumerate(own) for p, one in enumerate(all_of) if one.takes_from]
    return {i: [(j, p, c) for j, p, name in takes for c, one in enumerate(own[i]) if one.name == name] for i in springs}


def _wrench_regressor(terms: Sequence[Term], i: int, scene: Scene, ready: Scene, parameters: Sequence[Parameter]) -> Array:
    """Of an effect that changes the wrench: springs that are kept are linear in it, laws of gears say what they make of it, other
    terms are asked a small step beside each value (at these steps a step to either side gives the same to four digits, at twice
    the cost)."""
    theta, none = terms[i].theta(parameters), np.zeros((len(scene), 3))
    wrench, out = np.empty((len(scene), 6, len(parameters))), np.zeros((len(scene), 3, len(parameters)))
    shifted = []
    for p, parameter in enumerate(parameters):
        step = WRENCH_STEP * parameter.scale * np.eye(len(parameters))[p]
        values = {q.name: Estimate(float(v)) for q, v in zip(parameters, theta + step, strict=True)}
        shifted.append([*terms[:i], replace(terms[i], estimates=values), *terms[i + 1 :]])
        there = apply_wrench_effects(shifted[-1], scene)
        wrench[:, :3, p] = (there.force_in_tool - ready.force_in_tool) / step[p]
        wrench[:, 3:, p] = (there.torque_in_tool - ready.torque_in_tool) / step[p]
    change = np.stack([Load(scene.arm, w[:, :3], w[:, 3:]).tau for w in np.moveaxis(wrench, 2, 0)], axis=2)
    others = []
    for term in terms:
        at = term.theta(parameters_of(term.effect, scene))
        if is_kept(term.effect, scene):
            out += answer_of(term.effect, at, scene).by_wrench[:, :, 0] @ wrench
        elif term.effect.acts_on != "wrench":
            said = term.effect.by_torque(ready, at, change, read=True)
            others += [term] if said is None else []
            out += 0.0 if said is None else said
    here = sum((_moved(t, ready) for t in others), none)
    for p, parameter in enumerate(parameters if others else ()):
        there = prepared(shifted[p], scene)
        out[:, :, p] += (sum((_moved(t, there) for t in others), none) - here) / (WRENCH_STEP * parameter.scale)
    return out
