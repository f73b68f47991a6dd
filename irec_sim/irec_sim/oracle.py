# SPDX-License-Identifier: Apache-2.0
"""What somebody could do with a session who knows which causes there are, but not how large they are.

The oracle fits the true structure (the plant's own compliances and the parameters of the hidden effects, with the plant's own
laws) to the noisy rows of the session, by one step of weighted least squares from the true values; rows that a mishap spoiled
are left out. It is judged on noise-free rows at other poses. The same without one effect tells whether that effect is
visible at all. Nothing of the analysis is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .kinematics import Array, forward
from .mishaps import spoiled_rows
from .observe import arrived, conditions_at
from .plant import Conditions, Frames, Plant, State
from .sensing import SensingParameters, beyond_reported, drift_at, motor_angles, tracker_reading, true_force
from .session import Generated
from .truth import EFFECTS, Hidden, Truth
from .truth_catalogue import Physics

NATS_VISIBLE = 12.0  # log odds that a name needs (6.5) after choosing among some 300 alternatives (5.7)
_FIXED = {"station_shift": ("share", "time", "station"), "thermal_drift": ("kind",)}
_COMPLIANCE_WIDTH = 1.0  # of the weak prior on each compliance, relative
_STEP = 1e-3  # of a finite difference, in widths
_EFFECT_WIDTH = 3.0  # on each parameter of an effect, times the RMS of its group


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


class Replay:
    """The rows of one pass again under other physics, at the joint angles and force readings that were recorded.

    Lever arms are taken from the true equilibrium; the change by other parameters is of first order in the deflection.
    """

    def __init__(self, made: Generated, repeat: int, physics: Physics, readings: Array) -> None:
        """readings: of the force sensor, (N, M + 1, 3), N."""
        self.cell, self.schedule, self.rows = made.cell, made.schedules[repeat], made.rows[repeat]
        self.readings, self._true = readings, physics
        self._frames: list[Frames] = []
        self._e: list[Array] = []
        self._motor = self._motor_angles(physics.sensing)
        plant = Plant(self.cell.chain, physics.plant, whole=True)
        state: State | None = None
        frames = before = None
        for j in range(self.rows.q.shape[1]):
            R = self._frames[-1].R_tool if self._frames else forward(self.cell.chain, self.rows.q[:, 0]).R_tool
            conditions = self._conditions(j, self.schedule.force[:, j], R)
            if state is None:
                state = plant.relaxed(self._motor[0], conditions, arrived(self.rows.q[:, 0]))
            elif frames is not None and before is not None and np.isfinite(physics.plant.release):
                state = plant.released(frames, self._motor[j - 1], before, state, self._motor[j] - self._motor[j - 1])
            before = conditions
            state, frames = plant.equilibrium(self._motor[j], conditions, state, self._dt(j), tolerance=1e-11)
            self._frames.append(frames)
            self._e.append(state.e)
        self._plant = plant

    def _dt(self, j: int) -> Array:
        stamp = self.schedule.stamp
        return stamp[:, j] - stamp[:, j - 1] if j else np.zeros(len(stamp))

    def _step(self, j: int) -> Array:
        q = self.rows.q
        return np.asarray(q[:, j] - (q[:, j - 1] if j else self.rows.q_before))

    def _motor_angles(self, sensing: SensingParameters) -> list[Array]:
        return [motor_angles(sensing, self.rows.q[:, j], self._step(j)) for j in range(self.rows.q.shape[1])]

    def _conditions(self, j: int, force: Array, R_tool: Array) -> Conditions:
        axis = self.cell.rail[0] if self.cell.rail is not None else np.zeros(3)
        conditions = conditions_at(self.schedule, j, self.schedule.poses.rail[:, None] * axis, force)
        return replace(conditions, force=(R_tool @ force[:, :, None])[..., 0]) if j else conditions

    def _strains(self, physics: Physics) -> list[tuple[Frames, Array]]:
        """Configuration from which lever arms are taken, and change of the elastic coordinates against it, row by row."""
        sensing = physics.sensing
        plant = Plant(self.cell.chain, physics.plant, whole=True)
        motor = self._motor_angles(sensing)
        moved = any(np.any(a != b) for a, b in zip(motor, self._motor, strict=True))
        moved = moved or _geometry(physics) != _geometry(self._true)
        state: State | None = None
        last = before = None
        force, out = np.zeros((len(self.rows.q), 3)), []
        for j, (frames, e_true) in enumerate(zip(self._frames, self._e, strict=True)):
            if moved:
                frames = plant.frames(motor[j], e_true)
            force = true_force(
                sensing, self.cell.sensor_axis, self.readings[:, j], frames.R_tool, force, self.schedule.ambient[:, j]
            )
            conditions = self._conditions(j, force, frames.R_tool)
            if state is None:
                state = plant.at_rest(frames, motor[j], conditions, arrived(self.rows.q[:, 0]))
            elif last is not None and before is not None and np.isfinite(physics.plant.release):
                state = plant.released(last, motor[j - 1], before, state, motor[j] - motor[j - 1])
            last, before = frames, conditions
            state, _ = plant.respond(frames, motor[j], conditions, state, plant.compliance(motor[j], conditions), self._dt(j))
            out.append((frames, state.e - e_true))
        return out

    def __call__(self, physics: Physics) -> tuple[Array, Array]:
        """Displacement of the marker, seen with the stated stations, and of the TCP against the controller's, since the
        reference, (N, M, 3) each, m."""
        sensing, tcp, seen = physics.sensing, [], []
        for j, (frames, de) in enumerate(self._strains(physics)):
            p = frames.p_tcp + (de[:, None] @ frames.lever)[:, 0]
            turn = (de[:, None] @ self._plant.turns(frames))[:, 0]
            arm = (frames.R_tool @ (self.cell.marker_in_tool0 + sensing.marker_error)[:, None])[..., 0]
            jacobian = forward(self.cell.chain, self.rows.q[:, j]).jacobian()
            tcp.append(p - beyond_reported(sensing, jacobian, self._step(j)) - self.rows.p_controller[:, j])
            drifted = p + drift_at(sensing, self.schedule.stamp[:, j], self.schedule.ambient[:, j])
            seen.append(self._measured(sensing, drifted + arm + np.cross(turn, arm), j))
        return _since_reference(np.stack(seen, axis=1)), _since_reference(np.stack(tcp, axis=1))

    def compliance_columns(self, truth: Truth) -> tuple[Array, Array]:
        """Derivative of both displacements by the logarithm of each compliance of the joints, (3 n, N, M, 3) each, m.

        All are changed at once: a spring's own angle answers to its own compliance only.
        """
        softer = replace(truth, axial=truth.axial * (1.0 + _STEP), transverse=truth.transverse * (1.0 + _STEP))
        seen, tcp = [], []
        for (frames, a), (_, b) in zip(self._strains(truth.physics()), self._strains(softer.physics()), strict=True):
            joints = slice(6, 6 + 3 * self.cell.chain.n)
            by_spring = ((b - a) / _STEP)[:, joints, None]
            arm = (frames.R_tool @ self.cell.marker_in_tool0[:, None])[..., 0]
            tcp.append(by_spring * frames.lever[:, joints])
            seen.append(tcp[-1] + np.cross(by_spring * frames.axis[:, joints], arm[:, None]))
        return (_since_reference(np.stack(seen, axis=1).transpose(2, 0, 1, 3), 2),
                _since_reference(np.stack(tcp, axis=1).transpose(2, 0, 1, 3), 2))  # fmt: skip

    def _measured(self, sensing: SensingParameters, p_marker: Array, j: int) -> Array:
        """In base_link with the stated pose of the station."""
        out = np.empty_like(p_marker)
        axis = self.cell.rail[0] if self.cell.rail is not None else np.zeros(3)
        in_cell = p_marker + self.schedule.poses.rail[:, None] * axis
        for s, (_, p_station, R_station) in enumerate(self.cell.stations):
            by = self.schedule.station == s
            shifted = self.rows.shifted[by, j]
            out[by] = tracker_reading(sensing, in_cell[by], s, p_station, R_station, shifted) @ R_station.T
        return out


def _since_reference(x: Array, axis: int = 1) -> Array:
    reference = x.take([0], axis)
    return np.delete(x, 0, axis) - reference


def _geometry(physics: Physics) -> bytes:
    plant = physics.plant
    ends = (plant.hose.attach, plant.hose.anchor) if plant.hose is not None else ()
    return b"".join(np.asarray(x).tobytes() for x in (plant.joint_zero, plant.p_error, plant.turn_error, *ends))


# -- parameters ---------------------------------------------------------------------------------------------------------


def _nudged(truth: Truth, of: Hidden) -> Iterator[Truth]:
    """The truth with one free number of an effect after the other changed by a small step of its prior's width."""
    for name in _free(of.effect, of.parameters):
        x = np.array(of.parameters[name], dtype=float)
        width = _EFFECT_WIDTH * np.sqrt((x**2).mean())
        for at in np.argwhere(x) if x.ndim else [()]:  # a zero says that this part doesn't exist
            moved = x.copy()
            moved[tuple(at)] += _STEP * width
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
        out.seen.append(clean + _since_reference(error))
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


def _of_effects(truth: Truth, session: _Half, validation: _Half) -> dict[str, _Columns]:
    """Of the parameters of each hidden effect, by differences about the truth."""
    physics = truth.physics()
    seen, _ = _evaluate(session, physics)
    check, tcp = _evaluate(validation, physics)
    out = {}
    for h in truth.hidden:
        if h.background:
            continue
        columns = out[h.effect] = _Columns([], [], [])
        for changed in _nudged(truth, h):
            a, _ = _evaluate(session, changed.physics())
            b, c = _evaluate(validation, changed.physics())
            columns.seen.append(_white(session, [x - y for x, y in zip(a, seen)]).ravel() / _STEP)
            columns.check.append([(x - y) / _STEP for x, y in zip(b, check)])
            columns.tcp.append([(x - y) / _STEP for x, y in zip(c, tcp)])
    return out


def _fitted(truth: Truth, columns: dict[str, _Columns], session: _Half, validation: _Half) -> tuple[float, float]:
    """Fit the structure of a truth.

    Args:
        columns: of the parameters of effects.

    Returns:
        validation error of the TCP, m, and mean square error of the noise-free marker there in standard deviations.
    """
    physics = truth.physics()
    seen, _ = _evaluate(session, physics)
    check, tcp = _evaluate(validation, physics)
    free = _of_compliances(truth, session, validation)
    for h in truth.hidden:
        if not h.background:
            free = free + columns[h.effect]
    residual = _white(session, [x - y for x, y in zip(session.seen, seen)]).ravel()
    J = np.vstack([np.column_stack(free.seen), np.eye(len(free.seen))])
    delta = np.linalg.lstsq(J, np.r_[residual, np.zeros(len(free.seen))], rcond=None)[0]

    def after(parts: list[Array], derivative: list[list[Array]]) -> list[Array]:
        return [p + sum(d * column[i] for d, column in zip(delta, derivative)) for i, p in enumerate(parts)]

    wrong = [x - y for x, y in zip(validation.tcp, after(tcp, free.tcp))]
    error = float(np.sqrt(np.mean(np.concatenate([(w**2).sum(-1).ravel() for w in wrong]))))
    missed = _white(validation, [x - y for x, y in zip(validation.clean, after(check, free.check))])
    return error, float((missed**2).mean())


def consult(made: Generated, validation: Generated, truth: Truth) -> Oracle:
    """Ask the oracle about a session and its validation session: the same robot at other poses, without mishaps."""
    session, check = _half(made, truth), _half(validation, truth)
    columns = _of_effects(truth, session, check)
    samples = 3 * sum(r.distance.shape[0] * (r.distance.shape[1] - 1) for r in made.rows)
    error, mean_square = _fitted(truth, columns, session, check)
    asked = [h.effect for h in truth.hidden]
    if not asked:
        return Oracle(error, error, ())
    base, _ = _fitted(truth.without(*(h.effect for h in truth.hidden if not h.background)), columns, session, check)
    seen = []
    for effect in asked:
        _, without = _fitted(truth.without(effect), columns, session, check)
        nats = 0.5 * samples * (without - mean_square)
        seen.append(Seen(effect, float(nats), bool(nats > NATS_VISIBLE)))
    return Oracle(base, error, tuple(seen))
