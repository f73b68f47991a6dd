# SPDX-License-Identifier: Apache-2.0
"""How wrong a model's predictions of the TCP are to be expected, from its own session.

A loaded session sees the translation of a reflector, a correction needs that of the TCP. Between them lies how the tool turns,
and a model may describe every reading and still not know it. Three parts are told apart: what readings and priors leave open of
the parameters, at the reflector and at the TCP (samples of the posterior, cut at its bounds: two compliances whose sum is small
are both small), what held-out poses show beyond noise and that, and what gears of every robot leave, which noise hides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np

from ..effects import is_predicted
from ..effects.of_session import scene_of
from ..effects.scene import Scene
from ..identification.cut_normal import samples
from ..identification.identify import rms
from ..identification.validation import HeldOut, floored
from ..lengths import length
from ..model import Estimate, Model, Term, total_displacement
from ..typing import Array, Json
from .bad_readings import rows_as_a_whole
from .settings import SETTINGS
from .study import Study

SAMPLES = 3000  # they tell the error to 5 %
SEED = 0
STEP = 0.1  # standard deviations, by which parameters are moved for a derivative
# of the deflection, RMS: what friction, creep and a soft range of sound gears leave of any model; with 1 % the median error on
# two outside simulators whose gears have these was 1.5 times the expected one, with 1.5 % it is 1.2 times
GEARS = 0.015
EVENT = 10.0  # times the median over poses of the mean square: what is more may have come over one pose only
FAR_WORSE, WORTH_TELLING = 2.0, 0.3  # times the error at the reflector, and the noise: the TCP is not known then


@dataclass(frozen=True)
class ExpectedError:
    """RMS over a session's loaded rows of the norm of the error of predictions, m.

    Attributes:
        tcp_m, reflector_m: what readings leave open of the parameters, at the TCP and at the reflector.
        beyond_m: what held-out poses show beyond noise and that; gears_m: what gears of every robot leave.
        noise_m: of a reading; away_m: of the reflector nearest to the TCP, from it.
    """

    tcp_m: float
    reflector_m: float
    beyond_m: float
    gears_m: float
    noise_m: float
    away_m: float

    @property
    def at_tcp_m(self) -> float:
        """For poses and forces as those of the session."""
        return hypot(self.tcp_m, self.beyond_m, self.gears_m)

    @property
    def at_reflector_m(self) -> float:
        """As `at_tcp_m`, of a point that the session shows."""
        return hypot(self.reflector_m, self.beyond_m, self.gears_m)

    @property
    def figures(self) -> Json:
        """As the file of a model has it."""
        return {"expected_error_m": self.at_tcp_m, "expected_error_reflector_m": self.at_reflector_m}

    @property
    def turning_unknown(self) -> bool:
        """Whether the TCP is known far worse than the reflector, by more than the noise hides."""
        at_tcp, at_reflector = (hypot(m, self.beyond_m) for m in (self.tcp_m, self.reflector_m))
        return at_tcp > max(FAR_WORSE * at_reflector, WORTH_TELLING * self.noise_m)

    @property
    def caution(self) -> str:
        """What to think of before a correction trusts the model, or an empty string."""
        if not self.turning_unknown:
            return ""
        return (
            f"the deflection is predicted to {length(self.at_reflector_m)} where the reflector is, but only to"
            f" {length(self.at_tcp_m)} at the TCP, {length(self.away_m)} from it: one place does not show how the tool turns;"
            " measure with a second reflector on the tool, far from the first, or with one at the TCP"
        )


def with_error(model: Model, expected: ExpectedError | None) -> Model:
    """A model that says how wrong its predictions are to be expected."""
    if expected is None:
        return model
    cautions = [c for c in (model.made.get("caution", ""), expected.caution) if c]
    made = {**model.made, **({"caution": "; ".join(cautions)} if cautions else {})}
    return replace(model, made=made, figures={**model.figures, **expected.figures})


def expected_error(study: Study, held_out: HeldOut) -> ExpectedError | None:
    """The error to be expected of a model's predictions; None for a session that loads nothing but by gravity.

    Args:
        study: the model fitted to its session; held_out: its error on held-out poses.
    """
    session = study.session
    if session.kind != "loaded" or not np.isfinite(held_out.rms_m):
        return None
    # a row that is left out, as one with another pose's joint angles, is no place at which something is predicted
    read = np.isin(np.arange(len(session.load_case)), study.observation.rows)
    loaded = read & (session.load_case != 0) & session.on_tool
    base, bench = study.base, study.bench
    G = base.A.T @ base.A
    precision = G + np.diag(floored(base.width**-2.0, G, bench.rounding))
    mode = np.clip(bench.posterior(base).x, base.lower, base.upper)
    mean = np.asarray(np.linalg.solve(precision, base.A.T @ bench.b), dtype=np.float64)
    off = samples(mean, precision, base.lower, base.upper, mode, SAMPLES, np.random.default_rng(SEED)) - mode
    spread = off.T @ off / len(off)  # about what the model has
    sd = np.sqrt(np.maximum(spread.diagonal(), 1e-30))
    at_tcp, at_reflector = (
        _rms(_derivatives(study, scene_of(session, observe=point), STEP * sd)[loaded], spread) for point in ("tcp", "marker")
    )
    gears = GEARS * rms(study.observation.of(total_displacement(study.terms, study.observation.scene)))
    square, floor = _usual_square(study, held_out)
    beyond = max(square - floor**2 - at_reflector**2, 0.0)
    away = min(float(np.linalg.norm(m.xyz)) for m in session.markers if m.link == "tool0") if session.contact is None else 0.0
    return ExpectedError(at_tcp, at_reflector, sqrt(beyond), gears, floor, away)


def _usual_square(study: Study, held_out: HeldOut) -> tuple[float, float]:
    """Mean square of the error on held-out poses, m^2, and what noise alone leaves, m, without readings that stand out; of a pose
    that does no more than EVENT times the usual: what came over it alone, as a bump of the station, production does not have.
    Poses that stand out as a whole, where several do, are as production has them."""
    observation = study.observation
    no_accident = rows_as_a_whole(study, study.apart, SETTINGS)
    aside = [r for p in study.apart for r in p.structure.rows]
    usual = ~np.isin(observation.rows, aside)
    good = usual | np.isin(observation.rows, no_accident)
    square = (held_out.residual**2).sum(axis=1)
    _, pose = np.unique(study.session.pose[observation.rows[good]], return_inverse=True)
    if not len(pose):
        return held_out.rms_m**2, observation.whiten.floor
    count = np.bincount(pose)
    mean = np.bincount(pose, square[good]) / count
    kept = np.bincount(pose, np.isin(observation.rows[good], no_accident)) > 0
    mean = np.where(kept, mean, np.minimum(mean, EVENT * np.median(mean)))
    return float((mean * count).sum() / count.sum()), observation.whiten.only(usual).floor


def _rms(derivatives: Array, spread: Array) -> float:
    """sqrt of the mean over rows of the trace of A S A'; derivatives (n, 3, p), spread (p, p)."""
    return float(np.sqrt(np.einsum("nip,pq,niq->n", derivatives, spread, derivatives).mean()))


def _derivatives(study: Study, scene: Scene, step: Array) -> Array:
    """Derivatives of the predicted displacement by scaled parameters, (n, 3, p); step: (p,), scaled.

    How the arm stands by what is not predicted itself, as errors of its geometry, is taken as it is.
    """
    scene = Model(study.terms).standing(scene)
    here = _predicted(study.terms, scene)
    out = np.zeros((*here.shape, len(step)))
    i = 0
    for at, term in enumerate(study.terms):
        own = term.effect.parameters(study.ready)
        for j in term.free(own):
            if is_predicted(term.effect.cause, scene.kind):
                moved = _moved(study.terms, at, own[j].name, own[j].unit, float(step[i] * study.scale[i]))
                out[:, :, i] = (_predicted(moved, scene) - here) / step[i]
            i += 1
    return out


def _predicted(terms: Sequence[Term], standing: Scene) -> Array:
    """As `Model.predict`, of an arm as it stands already."""
    return Model(tuple(t for t in terms if is_predicted(t.effect.cause, standing.kind))).predict(standing)


def _moved(terms: Sequence[Term], at: int, name: str, unit: str, by: float) -> tuple[Term, ...]:
    """The terms with one value moved."""
    term = terms[at]
    old = term.estimates.get(name, Estimate(0.0, unit=unit))
    new = replace(term, estimates={**term.estimates, name: replace(old, value=old.value + by)})
    return (*terms[:at], new, *terms[at + 1 :])
