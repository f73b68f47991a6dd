# SPDX-License-Identifier: Apache-2.0
"""The oracle of absolute sessions: fit of the true structure, geometry and places of station and markers included.

As in `oracle`: one step of weighted least squares from the truth with weak priors, judged on noise-free rows of other poses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .absolute import AbsoluteMade, at_rest, free_of_gauge, in_station, markers_of, spoiled
from .absolute_truth import AbsoluteTruth
from .kinematics import Array, forward, rotation
from .oracle import NATS_VISIBLE, Oracle, Seen
from .plant import Plant

_STEP = 1e-3
_LENGTH, _TURN = 2e-3, 4e-3  # widths of priors on where links are and how they are turned, m and rad
_EFFECT_WIDTH = 3.0


class _Half:
    """One session: what a truth says the markers are in base_link (as the stated truth of the station puts them there)."""

    def __init__(self, made: AbsoluteMade) -> None:
        self.made = made
        self.q, self.setup = made.q, made.setup
        error = np.where(spoiled(made)[..., None], 0.0, made.seen - made.clean)
        self.error = error @ made.setup.R_station.T
        sigma = np.hypot(made.noise.sigma(made.distance), made.robot_m)
        self.weight = np.where(spoiled(made), 1e-6, 1.0) / sigma
        physics = made.truth.physics()
        self._near = at_rest(Plant(made.truth.arm.chain, physics.plant, whole=True), physics, made.q)

    def __call__(self, truth: AbsoluteTruth) -> tuple[Array, Array]:
        """Markers and TCP in base_link."""
        physics = truth.physics()
        plant = Plant(truth.arm.chain, physics.plant, whole=True)
        rest = at_rest(plant, physics, self.q, self._near)
        measured = in_station(physics, self.setup, markers_of(physics, self.setup, rest, self.made.stamp, self.made.ambient))
        return measured @ self.setup.R_station.T + self.setup.p_station, rest.frames.p_tcp

    def white(self, x: Array) -> Array:
        return (x * self.weight[..., None]).ravel()


def _geometric(half: _Half, chain_rows: tuple[Array, Array, Array, list[Array]]) -> tuple[list[Array], list[Array]]:
    """Columns of station, markers, joint zeros and frames: of the markers (N, k, 3) and the TCP (N, 3), in widths."""
    p, R, origins, links = chain_rows
    k = half.error.shape[1]
    on_tool = np.arange(k) < len(half.setup.markers)
    places = p[:, None] + np.einsum("nij,kj->nki", R, half.setup.markers)
    if half.setup.base_marker is not None:
        places = np.concatenate([places, np.broadcast_to(half.setup.base_marker, (len(p), 1, 3))], axis=1)
    markers, tcp = [], []

    def add(m: Array, t: Array, width: float) -> None:
        markers.append(m * width)
        tcp.append(t * width)

    zero = np.zeros_like(p)
    for a in np.eye(3):
        add(np.broadcast_to(a, places.shape), zero, 0.1)  # the station: the TCP in base_link does not move with it
        add(np.cross(a, places), zero, 0.05)
        for m in range(len(half.setup.markers)):
            one = np.zeros(places.shape)
            one[:, m] = R @ a
            add(one, zero, 0.02)
    for j in range(origins.shape[1]):
        for a in np.eye(3):
            direction = links[j] @ a
            shift = np.broadcast_to(direction[:, None], places.shape) * on_tool[None, :, None]
            add(shift, direction, _LENGTH)
            lever = (places - origins[:, j, None]) * on_tool[None, :, None]
            add(np.cross(direction[:, None], lever), np.cross(direction, p - origins[:, j]), _TURN)
    return markers, tcp


def _rows(half: _Half) -> tuple[Array, Array, Array, list[Array]]:
    """Nominal TCP, its orientation, origins of the joints, orientation of the link before each joint."""
    chain = half.made.truth.arm.chain
    pose = forward(chain, half.q)
    links = [np.broadcast_to(np.eye(3), (len(half.q), 3, 3))]
    for i in range(chain.n - 1):
        links.append(links[-1] @ chain.R_fixed[i] @ rotation(chain.axis[i], half.q[:, i]))
    return pose.p_tcp, pose.R_tool, pose.origin, links


def _nudged(truth: AbsoluteTruth, effect: str) -> list[AbsoluteTruth]:
    out = []
    p = dict(truth.hidden)[effect]
    for name, value in p.items():
        x = np.array(value)
        if x.dtype.kind != "f" or not np.all(np.isfinite(x)) or (effect == "station_shift" and name in ("share", "time")):
            continue
        width = _EFFECT_WIDTH * np.sqrt((x**2).mean())
        for at in np.argwhere(x) if x.ndim else [()]:
            moved = x.copy()
            moved[tuple(at)] += _STEP * width
            changed = {**p, name: moved.tolist()}
            out.append(replace(truth, hidden=tuple((e, changed if e == effect else v) for e, v in truth.hidden)))
    return out


Columns = tuple[list[Array], list[Array], list[Array]]


def _of_effects(truth: AbsoluteTruth, session: _Half, check: _Half) -> dict[str, Columns]:
    """Per effect: markers of the session, markers and TCP of the validation session by each parameter, in widths."""
    ours, (markers, tcp) = session(truth)[0], check(truth)
    out: dict[str, Columns] = {}
    for effect, _ in truth.hidden:
        out[effect] = ([], [], [])
        for changed in _nudged(truth, effect):
            m, t = check(changed)
            for part, x in zip(out[effect], (session(changed)[0] - ours, m - markers, t - tcp), strict=True):
                part.append(x / _STEP)
    return out


def consult_absolute(made: AbsoluteMade, validation: AbsoluteMade) -> Oracle:
    """Ask the oracle about an absolute session and its validation session."""
    truth = made.truth
    session, check = _Half(made), _Half(validation)
    clean, _ = session(truth)
    seen = clean + session.error
    check_clean, check_tcp = check(truth)
    ours, theirs = _geometric(session, _rows(session)), _geometric(check, _rows(check))
    p, R, *_ = _rows(check)
    at_truth = _of_effects(truth, session, check)

    def fitted(gone: tuple[str, ...]) -> tuple[float, float]:
        less = truth.without(*gone)
        start = session(less)[0]
        m, t = check(less)
        # without its spring nothing is left of a gear's friction, so its columns are not those at the truth
        columns = _of_effects(less, session, check) if "joint_torsion" in gone else at_truth
        kept = [columns[e] for e, _ in less.hidden]
        a = ours[0] + [x for c in kept for x in c[0]]
        b = theirs[0] + [x for c in kept for x in c[1]]
        c = theirs[1] + [x for k in kept for x in k[2]]
        J = np.vstack([np.column_stack([session.white(x) for x in a]), np.eye(len(a))])
        delta = np.linalg.lstsq(J, np.r_[session.white(seen - start), np.zeros(len(a))], rcond=None)[0]
        miss = check.white(m + sum(d * x for d, x in zip(delta, b, strict=True)) - check_clean)
        wrong = free_of_gauge(t + sum(d * x for d, x in zip(delta, c, strict=True)) - check_tcp, p, R)
        return float(np.sqrt((wrong**2).sum(1).mean())), float((miss**2).mean())

    error, mean_square = fitted(())
    asked = [e for e, _ in truth.hidden]
    base = fitted(tuple(asked))[0] if asked else error
    samples = session.error.size
    result = []
    for effect in asked:
        nats = 0.5 * samples * (fitted((effect,))[1] - mean_square)
        result.append(Seen(effect, float(nats), bool(nats > NATS_VISIBLE)))
    return Oracle(base, error, tuple(result))
