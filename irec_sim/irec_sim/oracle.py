# SPDX-License-Identifier: Apache-2.0
"""What somebody could do with a session who knows which causes there are, but not how large they are.

The oracle fits the true structure (the plant's own compliances, where its springs sit, and the parameters of the hidden effects,
with the plant's own laws) to the noisy rows of the session, by one step of weighted least squares from the true values; rows
that a mishap spoiled are left out. Where springs sit is no cause that anybody could be told: of that it knows no more than that
it is some centimetres about the joints' origins. It is judged on noise-free rows at other poses. The same without one effect
tells whether that effect is visible at all. Nothing of the analysis is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .kinematics import Array
from .mishaps import spoiled_rows
from .replay import STEP, Replay, since_reference
from .session import Generated
from .truth import EFFECTS, Hidden, Truth
from .truth_catalogue import Physics

NATS_VISIBLE = 12.0  # log odds that a name needs (6.5) after choosing among some 300 alternatives (5.7)
_FIXED = {"station_shift": ("share", "time", "station"), "thermal_drift": ("kind",)}
_COMPLIANCE_WIDTH = 1.0  # of the weak prior on each compliance, relative
_EFFECT_WIDTH = 3.0  # on each parameter of an effect, times the RMS of its group
_PLACE_WIDTH = 0.03  # m, of the prior on each coordinate of where springs sit, about the joint's origin


@dataclass(frozen=True)
class Seen:
    """What one effect means in a session.

    Attributes:
        effect: id; nats: log score that the model without it loses on noise-free held-out rows of as many samples as the
            session has; visible: whether that is beyond NATS_VISIBLE.
    """

    effect: str
    nats: float
    visible: bool


@dataclass(frozen=True)
class Oracle:
    """Validation errors in m (RMS over samples of the norm, TCP deflection): base model, true structure; what is seen."""

    base_m: float
    oracle_m: float
    seen: tuple[Seen, ...]

    def as_data(self) -> dict[str, Any]:
        return {
            "base_m": self.base_m, "oracle_m": self.oracle_m,
            "effects": [{"effect": s.effect, "nats": round(s.nats, 2), "visible": s.visible} for s in self.seen],
        }  # fmt: skip


# -- parameters ---------------------------------------------------------------------------------------------------------


def _nudged(truth: Truth, of: Hidden) -> Iterator[Truth]:
    """The truth with one free number of an effect after the other changed by a small step of its prior's width."""
    for name in _free(of.effect, of.parameters):
        x = np.array(of.parameters[name], dtype=float)
        width = _EFFECT_WIDTH * np.sqrt((x**2).mean())
        for at in np.argwhere(x) if x.ndim else [()]:  # a zero says that this part doesn't exist
            moved = x.copy()
            moved[tuple(at)] += STEP * width
            changed = replace(of, parameters={**of.parameters, name: moved.tolist()})
            yield replace(truth, hidden=tuple(changed if h is of else h for h in truth.hidden))


def _free(effect: str, parameters: dict[str, Any]) -> list[str]:
    fixed = (*_FIXED.get(effect, ()), *EFFECTS[effect].fixed)
    return [n for n, v in parameters.items() if n not in fixed and np.asarray(v).dtype.kind == "f"]


# -- fit ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Half:
    """One session as the fit needs it: replays of its passes, what was seen, weights (1 / standard deviation, reference)."""

    replays: list[Replay]
    seen: list[Array]
    clean: list[Array]
    tcp: list[Array]
    whiten: list[Array]


def _half(made: Generated, truth: Truth) -> _Half:
    physics = truth.physics()
    out = _Half([], [], [], [], [])
    for r, run in enumerate(made.passes):
        rows = made.rows[r]
        sigma = made.noise.sigma(rows.distance)
        spoiled = spoiled_rows(made.schedules[r].case, run.pose, r, tuple(made.mishaps))
        replay = Replay(made, r, physics, rows.force_reading)
        clean, _ = replay(physics)
        R = np.stack([made.cell.stations[k][2] for k in rows.station])
        error = (R[:, None] @ (run.marker - rows.p_marker)[..., None])[..., 0]
        error = np.where(spoiled[..., None], 0.0, error)
        replay.readings = np.where(spoiled[..., None], rows.force_reading, run.force)
        out.replays.append(replay)
        out.clean.append(clean)
        out.seen.append(clean + since_reference(error))
        out.tcp.append(rows.deflection)
        own = np.where(spoiled, 1e3, sigma)
        covariance = own[:, 1:, None] ** 2 * np.eye(own.shape[1] - 1) + (sigma[:, 0] ** 2)[:, None, None]
        out.whiten.append(np.linalg.inv(np.linalg.cholesky(covariance)))
    return out


def _white(half: _Half, parts: list[Array]) -> Array:
    """Rows of all passes in standard deviations, (k, ...) with the coordinate beside the row."""
    return np.concatenate([(w @ x.reshape(*x.shape[:2], -1)).reshape(-1, *x.shape[3:]) for w, x in zip(half.whiten, parts)])


def _evaluate(half: _Half, physics: Physics) -> tuple[list[Array], list[Array]]:
    both = [replay(physics) for replay in half.replays]
    return [b[0] for b in both], [b[1] for b in both]


@dataclass(frozen=True)
class _Columns:
    """Derivatives of what is seen and of where the TCP is by some free numbers, in widths of their priors.

    seen: whitened, of the session, one flat array each; check, tcp: at the validation poses, one list of passes each.
    """

    seen: list[Array]
    check: list[list[Array]]
    tcp: list[list[Array]]

    def __add__(self, other: _Columns) -> _Columns:
        return _Columns(self.seen + other.seen, self.check + other.check, self.tcp + other.tcp)


def _of_compliances(truth: Truth, session: _Half, validation: _Half) -> _Columns:
    ours = [replay.compliance_columns(truth) for replay in session.replays]
    theirs = [replay.compliance_columns(truth) for replay in validation.replays]
    count = 3 * truth.axial.size
    return _Columns(
        [_COMPLIANCE_WIDTH * _white(session, [x[0][k] for x in ours]).ravel() for k in range(count)],
        [[_COMPLIANCE_WIDTH * x[0][k] for x in theirs] for k in range(count)],
        [[_COMPLIANCE_WIDTH * x[1][k] for x in theirs] for k in range(count)],
    )


def _of_places(truth: Truth, session: _Half, validation: _Half) -> tuple[_Columns, Array]:
    """Of where the springs across the joints sit, and the coordinates in widths of their prior; none where all sit at origins."""
    at = truth.centre / _PLACE_WIDTH
    if not at.any():
        return _Columns([], [], []), np.zeros(0)
    moved = []
    for k, axis in np.argwhere(np.isfinite(at)):
        centre = truth.centre.copy()
        centre[k, axis] += STEP * _PLACE_WIDTH
        moved.append(replace(truth, centre=centre))
    return _by_differences(truth, moved, session, validation), at.ravel()


def _of_effects(truth: Truth, session: _Half, validation: _Half) -> dict[str, _Columns]:
    """Of the parameters of each hidden effect, by differences about the truth."""
    return {h.effect: _by_differences(truth, _nudged(truth, h), session, validation) for h in truth.hidden if not h.background}


def _by_differences(truth: Truth, changed: Iterable[Truth], session: _Half, validation: _Half) -> _Columns:
    """From truths of which each has one number changed by STEP of its prior's width."""
    physics = truth.physics()
    seen, _ = _evaluate(session, physics)
    check, tcp = _evaluate(validation, physics)
    columns = _Columns([], [], [])
    for other in changed:
        a, _ = _evaluate(session, other.physics())
        b, c = _evaluate(validation, other.physics())
        columns.seen.append(_white(session, [x - y for x, y in zip(a, seen)]).ravel() / STEP)
        columns.check.append([(x - y) / STEP for x, y in zip(b, check)])
        columns.tcp.append([(x - y) / STEP for x, y in zip(c, tcp)])
    return columns


def _fitted(
    truth: Truth, places: tuple[_Columns, Array], columns: dict[str, _Columns], session: _Half, validation: _Half
) -> tuple[float, float]:
    """Fit the structure of a truth.

    Args:
        places: of where springs sit, with the true coordinates in widths of their prior; columns: of the parameters of effects.

    Returns:
        validation error of the TCP, m, and mean square error of the noise-free marker there in standard deviations.
    """
    physics = truth.physics()
    seen, _ = _evaluate(session, physics)
    check, tcp = _evaluate(validation, physics)
    free = _of_compliances(truth, session, validation)
    known = np.r_[np.zeros(len(free.seen)), -places[1]]
    free = free + places[0]
    for h in truth.hidden:
        if not h.background:
            free = free + columns[h.effect]
    residual = _white(session, [x - y for x, y in zip(session.seen, seen)]).ravel()
    J = np.vstack([np.column_stack(free.seen), np.eye(len(free.seen))])
    delta = np.linalg.lstsq(J, np.r_[residual, known, np.zeros(len(free.seen) - len(known))], rcond=None)[0]

    def after(parts: list[Array], derivative: list[list[Array]]) -> list[Array]:
        return [p + sum(d * column[i] for d, column in zip(delta, derivative)) for i, p in enumerate(parts)]

    wrong = [x - y for x, y in zip(validation.tcp, after(tcp, free.tcp))]
    error = float(np.sqrt(np.mean(np.concatenate([(w**2).sum(-1).ravel() for w in wrong]))))
    missed = _white(validation, [x - y for x, y in zip(validation.clean, after(check, free.check))])
    return error, float((missed**2).mean())


def consult(made: Generated, validation: Generated, truth: Truth) -> Oracle:
    """Ask the oracle about a session and its validation session: the same robot at other poses, without mishaps."""
    session, check = _half(made, truth), _half(validation, truth)
    places, columns = _of_places(truth, session, check), _of_effects(truth, session, check)
    samples = 3 * sum(r.distance.shape[0] * (r.distance.shape[1] - 1) for r in made.rows)
    error, mean_square = _fitted(truth, places, columns, session, check)
    asked = [h.effect for h in truth.hidden]
    if not asked:
        return Oracle(error, error, ())
    base, _ = _fitted(truth.without(*(h.effect for h in truth.hidden if not h.background)), places, columns, session, check)
    seen = []
    for effect in asked:
        _, without = _fitted(truth.without(effect), places, columns, session, check)
        nats = 0.5 * samples * (without - mean_square)
        seen.append(Seen(effect, float(nats), bool(nats > NATS_VISIBLE)))
    return Oracle(base, error, tuple(seen))
