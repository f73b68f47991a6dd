# SPDX-License-Identifier: Apache-2.0
"""Formulas for what has no name: short laws in the variables that the remainder depends on, each tried like an effect of a user.

A proposal describes, it names no cause: it says with which few coefficients the error on held-out poses falls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from ..effects.formula import FormulaEffect
from ..effects.scene import Scene
from ..errors import SolveError
from ..model import Term
from ..typing import Array
from .candidates import Trial, options, try_option
from .evidence import Block
from .ground import Ground
from .held_out import held_out
from .law_forms import likeliest
from .remainder import Remainder
from .ripples import ripples
from .settings import SETTINGS, Settings
from .study import Study, study_of

MOST = 3
MOST_TERMS = 3  # of a formula that people are to make something of
HARMONICS = (1, 2, 3)
OWN_HARMONICS = range(1, 13)  # of a gear's compliance with its own angle: some teeth carry worse than others
XYZ = "xyz"


@dataclass(frozen=True)
class Proposal:
    """One formula, as `irec add` takes it.

    Attributes:
        cv_rms_m, cv_rms_se_m: held-out error with it, everything refitted, and its standard error over poses.
        log_evidence: natural log of the odds against the model without it, the number of formulas tried taken off.
    """

    formula: str
    cv_rms_m: float
    cv_rms_se_m: float
    log_evidence: float


def proposals(
    study: Study,
    remainder: Remainder,
    depends_on: Sequence[str],
    check: Callable[[], None] = lambda: None,
    settings: Settings = SETTINGS,
) -> tuple[Proposal, ...]:
    """The best formulas on top of a model, at most three; only such as help on held-out poses.

    Args:
        study: the model with everything that is named.
        remainder: what is left beside it.
        depends_on: session columns and `tau_k`, strongest first.
    """
    could = weighed(study, remainder, depends_on, check, settings)
    likely = [one for one in could if _is_readable(one[0], study.ready)]
    before = held_out(study).rms_m if likely else 0.0
    out: list[Proposal] = []
    for effect, _, odds in likely:
        if len(out) == MOST:
            break
        check()
        try:
            after = held_out(study_of(study.observation, (*study.terms, Term(effect))))
        except SolveError:
            continue
        if after.rms_m < before:
            out.append(Proposal(effect.formula, after.rms_m, after.rms_se_m, odds))
    return tuple(out)


def _is_readable(law: FormulaEffect, scene: Scene) -> bool:
    """Whether people can make something of a law: it is short, and no law of an axis' whole torque that was written for another
    size of force, which is among the others as it is."""
    twice = law.formula.startswith("axis") and "load" in law.formula and "tau_g" in law.formula
    return len(law.parameters(scene)) <= MOST_TERMS and not twice


def weighed(
    study: Study, remainder: Remainder, depends_on: Sequence[str], check: Callable[[], None], settings: Settings = SETTINGS
) -> list[tuple[FormulaEffect, Block, float]]:
    """Formulas with the evidence that a name needs on top of a model, their columns, and that evidence in nats (the number of
    formulas tried taken off), the likeliest first: laws in the variables that are asked about, and of a loaded session all that
    are in proportion to the force. Arguments as of `proposals`."""
    found = _in_variables(study, remainder, depends_on, check, settings)
    if study.ready.kind == "loaded" and remainder.structures:
        known = {effect.formula for effect, _, _ in found}
        found += [one for one in likeliest(study, check, settings) if one[0].formula not in known]
    return sorted(found, key=lambda one: -one[2])


def _in_variables(
    study: Study, remainder: Remainder, depends_on: Sequence[str], check: Callable[[], None], settings: Settings
) -> list[tuple[FormulaEffect, Block, float]]:
    """As `weighed`, of laws in the variables that are asked about, in any order."""
    turned = {p.structure.axis for p in remainder.structures if p.structure.axis is not None}
    written = list(dict.fromkeys([*_ripples(study, remainder), *_formulas(study.ready, depends_on, sorted(turned))]))
    if not written:
        return []
    effects = {e.id: e for e in (FormulaEffect(f"formula_{i + 1}", text) for i, text in enumerate(written))}
    found, _ = options(study, list(effects.values()), check)
    ground = Ground(study.bench, study.base)
    trials: list[Trial] = []
    for option in found:
        check()
        trials.append(try_option(ground, option, study.ready))
    odds = [(effects[t.effect.id], t.best.block, t.log_evidence - log(len(written))) for t in trials]
    return [one for one in odds if one[2] >= settings.nats_to_name]


def _ripples(study: Study, remainder: Remainder) -> Iterator[str]:
    """What repeats many times per turn of a joint, as found while the model was built and as it shows in what that leaves."""
    found = [p.structure.ripple for p in remainder.structures if p.structure.ripple is not None]
    if found:
        found += [(k, n) for k, n, *_ in ripples(study, [study.fit.residual])]
    for k, n in found:
        for often in (f"{n:.4f}", f"{n:.0f}"):  # gears and encoders mostly repeat a whole number of times
            yield f"axis {k + 1}: a * cos({often} * q_{k + 1}) + b * sin({often} * q_{k + 1})"


def _formulas(scene: Scene, depends_on: Sequence[str], turned: Sequence[int]) -> Iterator[str]:
    """Laws in some variables; turned: axes that the structures turn, from 0."""
    named = [int(v[4:]) - 1 for v in depends_on if v.startswith("tau_")]
    axes = list(dict.fromkeys([*named, *turned])) or [int(k) for k in np.flatnonzero(scene.driven)]
    tau = "tau" if scene.kind == "loaded" else "tau_g"
    for variable in depends_on:
        kind, _, name = variable.partition("_")
        if kind == "tau":
            yield from _of_torque(scene, int(name) - 1, tau)
            others = [k for k in axes if k != int(name) - 1]  # that give way to the torque of this one: gears on one shaft
            yield from (f"axis {k + 1}: a * {law}" for k in others for law in (f"{tau}_{name}", f"abs({tau}_{name})"))
        elif kind == "joint":
            yield from _of_angle(scene, int(name), axes, tau)
        elif kind == "force":
            yield from _of_force(scene, name)
        elif variable == "load_case":
            for component in XYZ:
                yield from _of_force(scene, component)
        elif variable == "stamp":
            yield from (f"base {d}: a * t + b * t**2" for d in XYZ)
            middle = _from_middle("t", scene.stamp)  # a gear that softens while it is measured, whichever it is
            yield from (f"axis {k + 1}: {tau} * a * {middle}" for k in np.flatnonzero(scene.driven))
        elif kind in ("temp", "ext"):
            yield from (f"base {d}: a * {variable} + b * {variable}**2" for d in XYZ)
            # about the middle, where the axis has its own spring, which would have no room for less than nothing at 0
            middle = _from_middle(variable, scene.temperature[name] if kind == "temp" else scene.ext[name])
            yield from (f"axis {k + 1}: {tau} * a * {middle}" for k in axes)
            if scene.kind == "loaded":
                yield from (f"tool {d}: f_{d} * a * {middle}" for d in XYZ)
            yield from (f"axis {k + 1}: {tau} * (a * {variable} + b * {variable}**2)" for k in axes)


def _from_middle(variable: str, values: Array) -> str:
    """A variable less the mean of its values."""
    mean = float(np.nanmean(values))
    return f"({variable} {'-' if mean >= 0.0 else '+'} {abs(mean):.3g})"


def _of_torque(scene: Scene, axis: int, tau: str) -> Iterator[str]:
    for law in (f"a * {tau}**2", f"a * {tau}**3", f"a * abs({tau})", f"a * {tau} * abs({tau}) + b * {tau}**3"):
        yield f"axis {axis + 1}: {law}"
    typical = float(np.sqrt(np.mean(scene.load_torque()[:, axis] ** 2)))
    for share in (0.1, 0.3, 1.0):
        bend = f"{max(share * typical, 1e-3):.3g}"
        yield f"axis {axis + 1}: a * tanh({tau} / {bend})"
        if tau == "tau":
            yield f"axis {axis + 1}: a * (tanh((tau + tau_g) / {bend}) - tanh(tau_g / {bend}))"


def _of_angle(scene: Scene, joint: int, axes: Sequence[int], tau: str) -> Iterator[str]:
    for m in OWN_HARMONICS:
        angle = f"q_{joint}" if m == 1 else f"{m} * q_{joint}"
        wave = f"a * cos({angle}) + b * sin({angle})"
        for k in axes:
            if m in HARMONICS or k == joint - 1:
                yield f"axis {k + 1}: {tau} * ({wave})"
        if m not in HARMONICS:
            continue
        if scene.kind == "loaded":
            yield from (f"tool {d}: f_{d} * ({wave})" for d in XYZ)
        else:
            yield from (f"axis {k + 1}: {wave}" for k in dict.fromkeys([joint - 1, *axes]))


def _of_force(scene: Scene, component: str) -> Iterator[str]:
    f = f"f_{component}"
    typical = float(np.sqrt(np.mean(scene.force_in_tool[:, XYZ.index(component)] ** 2)))
    for d in XYZ:
        yield f"tool {d}: a * abs({f})"
        yield f"tool {d}: a * {f}**2"
        yield f"tool {d}: a * {f} * abs({f}) + b * {f}**3"
        yield from (f"tool {d}: a * tanh({f} / {max(share * typical, 1e-2):.3g})" for share in (0.3, 1.0))
