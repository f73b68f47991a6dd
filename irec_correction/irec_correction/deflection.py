# SPDX-License-Identifier: Apache-2.0
"""Deflection of the TCP by the process wrench at every tick: the real-time forms of a model's effects, put together.

What counts is the change against the same pose without process force. Which form an effect has, it says itself (`Effect.live`,
effects/live.py); this file only sorts and evaluates forms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from irec_calibration.effects.live import (
    ByDisplacement,
    ColumnLaw,
    ElasticLaw,
    LeftOut,
    LiveForm,
    Pull,
    Refused,
    SensorMap,
    Springs,
    Tick,
    drives,
)
from irec_calibration.effects.production import LOADED, POINTS, production_scene
from irec_calibration.effects.scene import Scene
from irec_calibration.effects.state import ElasticResponse
from irec_calibration.model import Model, Term
from irec_calibration.robot import Payload, Robot, parent_joint
from irec_calibration.typing import Array

from .errors import ActivationError
from .spring_chain import build_chain, springs_with
from .user_terms import UserTerms


class Deflection:
    """Predicted deflection of the TCP; keeps the history that hysteresis and creep need.

    One instance belongs to one thread. A call allocates nothing that lasts.

    Attributes:
        left_out: effect id -> why it has no part in the correction.
    """

    def __init__(
        self,
        model: Model,
        robot: Robot,
        gravity_in_base: tuple[float, float, float] = (0.0, 0.0, -9.81),
        payload: Payload | None = None,
        rail_name: str = "rail",
    ) -> None:
        """Put the forms together.

        Args:
            gravity_in_base: m/s^2; preload of effects that depend on the total torque.
            payload: mass on tool0 beyond the robot description; where it is none, that which the model counts on.
            rail_name: of the external axis, as sessions name it (`ext_<name>`).

        Raises:
            ActivationError: an effect can't act in real time; says which, why, and what to do.
        """
        self._gravity = np.asarray(gravity_in_base, dtype=float)
        if payload is None or payload.mass == 0.0:  # a cell file that says nothing of the tool
            payload = model.carried
        scene = production_scene(robot, self._gravity, payload, rail_name)
        self.left_out: dict[str, str] = {}
        springs: list[Springs] = []
        laws: list[ColumnLaw] = []
        user = []
        sensor: SensorMap | None = None
        self._follow: list[ElasticLaw] = []
        pulls: list[Pull] = []
        for term in model.terms:
            theta, form = _form(term, scene)
            match form:
                case Springs():
                    springs.append(form)
                case SensorMap():
                    sensor = form if sensor is None else form.after(sensor)
                case ColumnLaw():
                    laws.append(form)
                    springs.append(form.springs)
                case ElasticLaw():
                    self._follow.append(form)
                case Pull():
                    pulls.append(form)
                case ByDisplacement():
                    user.append((term.effect, theta))
                case LeftOut(why):
                    self.left_out[term.effect.id] = why
                case Refused(why):
                    raise ActivationError(
                        f"effect '{term.effect.id}' {why}; use a model without it, or give the effect a method 'live'"
                        " (docs/adding-an-effect.md)"
                    )
        self._user = UserTerms(user, scene, model) if user else None
        self._chain = chain = build_chain(robot, _springs_needed(springs, laws), model.standing(scene).kin)
        # an offset is turned into the tool as the controller believes it: a chain of its own only beside a geometry error
        self._described = build_chain(robot) if any(t.effect.moves_joints for t in model.terms) else chain
        self.n_joints = robot.n_joints
        n = chain.n_columns
        C = np.zeros((n, n))
        for spring in springs:
            for moves, by, compliance in spring.entries:
                C[chain.index[moves], chain.index[by]] += compliance
        self._C = np.asfortranarray(C)
        bound = [(law, np.array([chain.index[c] for c in law.columns])) for law in laws]
        self._elastic_laws = [pair for pair in bound if pair[0].elastic]
        self._laws = [pair for pair in bound if not pair[0].elastic]
        self._pulls = [
            (pull, np.array([chain.index[c] for c in pull.columns], dtype=int), _columns_of(pull.beyond, chain.index))
            for pull in pulls
        ]
        self._refuse_hidden_springs(user)
        self._sensor = sensor
        self._weight = _Weight(robot, self._gravity, payload) if any(law.needs_gravity for law in laws) else None
        self._tick = Tick(robot.n_joints)
        self._tick.drives = np.array([chain.index[c] for c in drives(robot.n_joints)])
        self._wrench_at_base = np.zeros(6)
        self.reset()

    def _refuse_hidden_springs(self, user: list) -> None:
        """A spring that only its `displacement` describes is unknown to effects that build on the springs' answer."""
        hidden = [effect.id for effect, _ in user if effect.elastic]
        if hidden and (self._follow or self._pulls or any(effect.needs_elastic for effect, _ in user)):
            raise ActivationError(
                f"effect '{hidden[0]}' is a spring without a real-time form, and other effects of the model build on its springs;"
                " give it a method 'live' that returns Springs or a ColumnLaw (docs/adding-an-effect.md)"
            )

    @property
    def R_tool(self) -> Array:
        """tool0 in base_link at the last call, by the controller, (3, 3); overwritten by the next one."""
        return self._described.R_tool

    def reset(self) -> None:
        """Forget history: the robot stands relaxed, without process force."""
        for law, _ in (*self._laws, *self._elastic_laws):
            law.reset()
        for form in self._follow:
            form.reset()

    def __call__(
        self, q: Array, force_in_tool: Array, torque_in_tool: Array, dt: float, rail_position: float = 0.0
    ) -> tuple[Array, Array]:
        """Deflection of the TCP now.

        Args:
            q: joint angles, (k,), rad.
            force_in_tool, torque_in_tool: environment on robot at the TCP as the sensor reads it, (3,), N and N m.
            dt: time since the call before, s.
            rail_position: of the external axis, m.

        Returns:
            translation (3,), m, and rotation (3,), rad, of the physical tool0 relative to the controller's, in base_link;
            Eq. (11).
        """
        chain, tick = self._chain, self._tick
        chain.update(q)
        if self._described is not chain:
            self._described.update(q)
        tick.q, tick.dt, tick.rail_position = q, dt, rail_position
        R, J = chain.R_tool, chain.J_at_base
        if self._sensor is not None:
            force_in_tool = self._sensor.force @ force_in_tool + self._sensor.weight @ (R.T @ self._gravity)
            torque_in_tool = self._sensor.torque @ torque_in_tool
        tick.force, tick.torque = force_in_tool, torque_in_tool
        px, py, pz = chain.p_tcp.tolist()
        tau = J.T @ self._at_base(R @ force_in_tool, R @ torque_in_tool)
        dq = self._answer(tau)
        if self._follow or self._pulls or (self._user is not None and self._user.needs_elastic):
            elastic = dq.copy()
            tick.tau = tau[tick.drives]
            for form in self._follow:
                dq += form.displacement(tick, elastic, self._at_tcp(J @ elastic)[0])
            tick.tau_unseen[:] = 0.0
            for pull, columns, beyond in self._pulls:
                tick.directions, tick.moments = J[3:, columns], J[:3, columns]
                unseen = J.T @ self._at_base(pull.force(tick, chain.p_tcp, R), pull.torque(tick, chain.p_tcp, R))
                if pull.beyond:
                    unseen += beyond * (J.T @ self._at_base(*pull.between(tick, chain.p_tcp, R)))
                tick.tau_unseen += unseen[tick.drives]
                dq += self._answer(unseen)
        else:
            elastic = dq
        if self._laws:
            if self._weight is not None:
                tick.tau_gravity = self._weight.torque(q)
            for law, columns in self._laws:
                dq[columns] += law.displacement(tick, tau[columns])
        vx, vy, vz, wx, wy, wz = (J @ dq).tolist()
        translation = np.array([vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px])
        rotation = np.array([wx, wy, wz])
        if self._user is not None:
            response = self._response(elastic) if self._user.needs_elastic else None
            moved, turned = self._user.displacement(
                q, force_in_tool, torque_in_tool, rail_position, response, tick.tau_unseen
            )
            translation += moved
            rotation += turned
        return translation, rotation

    def _at_base(self, f: Array, m: Array) -> Array:
        """Wrench (6,) about the origin of base_link of a force and torque (3,) at the TCP; overwritten by the next call."""
        px, py, pz = self._chain.p_tcp.tolist()
        fx, fy, fz = f.tolist()
        mx, my, mz = m.tolist()
        w = self._wrench_at_base
        w[0], w[1], w[2] = fx, fy, fz
        w[3], w[4], w[5] = mx + py * fz - pz * fy, my + pz * fx - px * fz, mz + px * fy - py * fx
        return w

    def _answer(self, tau: Array) -> Array:
        """Displacement of all columns by their springs, (n_columns,)."""
        dq: Array = self._C @ tau
        for law, columns in self._elastic_laws:
            dq[columns] += law.displacement(self._tick, tau[columns])
        return dq

    def _at_tcp(self, twist: Array) -> tuple[Array, Array]:
        """Translation of the TCP and rotation by a twist (6,) about the origin of base_link."""
        return twist[:3] + np.cross(twist[3:], self._chain.p_tcp), twist[3:]

    def _response(self, elastic: Array) -> ElasticResponse:
        """The springs' answer in the rows of a production scene, as effects with `needs_elastic` read it."""
        J, R, p = self._chain.J_at_base, self._chain.R_tool, self._chain.p_tcp
        points = p + np.tile(POINTS, (2, 1))
        twist = J @ elastic
        by_unit = np.stack([J @ self._answer(J.T @ self._at_base(R @ e[:3], R @ e[3:])) for e in np.eye(6)], axis=1)
        compliance = by_unit[:3] + np.cross(by_unit[3:].T[None], points[:, None, :]).transpose(0, 2, 1)
        displacement = LOADED[:, None] * (twist[:3] + np.cross(twist[3:], points))
        return ElasticResponse(displacement, np.outer(LOADED, twist[3:]), compliance)


def _form(term: Term, scene: Scene) -> tuple[Array, LiveForm]:
    """Parameter values of a term and its form in real time."""
    none = term.effect.no_live_form()
    if none is not None:
        return np.zeros(0), none
    theta = term.theta(term.effect.parameters(scene))
    return theta, term.effect.live(scene, theta)


def _columns_of(drives: Sequence[str], index: Mapping[str, int]) -> Array:
    """1 of each column that belongs to some drives (`joint_4`, `joint_4a`, `joint_4ta`), else 0, (n_columns,)."""
    out = np.zeros(len(index))
    for name, i in index.items():
        out[i] = any(name == drive or (name.startswith(drive) and not name[len(drive)].isdigit()) for drive in drives)
    return out


def _springs_needed(springs: list[Springs], laws: list[ColumnLaw]) -> frozenset[str]:
    columns = {c for s in springs for entry in s.entries for c in entry[:2]} | {c for law in laws for c in law.columns}
    return springs_with(columns)


class _Weight:
    """Torque of gravity about each drive, on preallocated data."""

    def __init__(self, robot: Robot, gravity_in_base: Array, payload: Payload | None) -> None:
        self._model = m = pin.buildModelFromXML(robot.completed_urdf)
        tcp, base = m.frames[m.getFrameId("tool0")], m.getFrameId("base_link")
        if payload is not None and payload.mass > 0.0:
            m.appendBodyToJoint(
                parent_joint(tcp),
                pin.Inertia(payload.mass, np.asarray(payload.com, dtype=float), np.zeros((3, 3))),
                tcp.placement,
            )
        self._data = m.createData()
        pin.framesForwardKinematics(m, self._data, pin.neutral(m))
        m.gravity.linear = self._data.oMf[base].rotation @ gravity_in_base
        joints = [m.joints[m.getJointId(name)] for name in robot.joint_names]
        self._q = pin.neutral(m)
        self._iv = np.array([j.idx_v for j in joints])
        self._iq = [(j.idx_q, j.nq == 2) for j in joints]

    def torque(self, q: Array) -> Array:
        for value, (i, continuous) in zip(q.tolist(), self._iq, strict=True):
            if continuous:
                self._q[i], self._q[i + 1] = math.cos(value), math.sin(value)
            else:
                self._q[i] = value
        return -pin.computeGeneralizedGravity(self._model, self._data, self._q)[self._iv]
