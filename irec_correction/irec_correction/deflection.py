# SPDX-License-Identifier: Apache-2.0
"""Deflection of the TCP by the process wrench, as a compiled form of a model that is fast enough for every tick.

What counts is the change against the same pose without process force: effects that do not depend on the wrench cancel and are
left out, with a reason. Effects of users that the compiled form does not know go through their own `displacement`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from irec_calibration.effects.scales import rated_torque
from irec_calibration.effects.sensor_gain import NAMES as GAIN_NAMES
from irec_calibration.effects.sensor_gain import crosstalk
from irec_calibration.model import Model, Term
from irec_calibration.robot import Payload, Robot
from irec_calibration.typing import Array
from scipy.spatial.transform import Rotation

from .spring_chain import BASE_SPRING, TOOL_SPRING, build_chain

if TYPE_CHECKING:
    from .user_terms import UserTerms

DOF = ("t_x", "t_y", "t_z", "r_x", "r_y", "r_z")
UNTIL_SIDE_SURE = 3.0  # backlash: the side changes beyond this many widths of the zone where the model leaves it undefined
UNDEFINED_SHARE_OF_RATED = 1e-3  # of the rated torque, as in effects/joint_backlash.py
LEFT_OUT = {
    "geometry_error": "does not depend on the process force",
    "encoder_harmonics": "does not depend on the process force",
    "thermal_drift": "describes the time between reference and load of a session",
    "joint_settling": "describes when the joint angles of a session were read",
    "external_force": "is a force that no sensor sees; what it does to the tool is not known in production",
}


@dataclass(frozen=True)
class Compiled:
    """Springs of a model on the columns of a chain with c columns and k drives; all in rad, m, N, N m.

    Attributes:
        C: compliance, symmetric except for joint_coupling, (c, c); torque or force of a column -> its displacement.
        sensor_matrix: force that acts = sensor_matrix @ force read, (3, 3); sensor_turn: the same for the torque.
        tool_mass_error: kg, of `tool_weight`.
        balancer: a, b of `counterbalance`, rad/(N m).
        rail: coefficients of each base spring over the rail position, (6, 3).
        stiffening: a_k, (k,) rad/(N m), beyond stiffening_from (k,), N m.
        backlash: b_k (k,), rad.
        hysteresis: h_k (k,) rad/(N m), play half-width hysteresis_play (k,), N m.
        creep_share: 1, creep_time: s.
        left_out: effect id -> why it has no part in the correction.
    """

    C: Array
    sensor_matrix: Array
    sensor_turn: Array
    tool_mass_error: float
    balancer: tuple[float, float]
    rail: Array
    stiffening: Array
    stiffening_from: Array
    backlash: Array
    hysteresis: Array
    hysteresis_play: Array
    creep_share: float
    creep_time: float
    left_out: dict[str, str]


class Deflection:
    """Predicted deflection of the TCP; keeps the history that hysteresis, backlash and creep need.

    One instance belongs to one thread. A call allocates nothing that lasts.
    """

    def __init__(
        self,
        model: Model,
        robot: Robot,
        gravity_in_base: tuple[float, float, float] = (0.0, 0.0, -9.81),
        payload: Payload | None = None,
    ) -> None:
        """Compile a model.

        Args:
            gravity_in_base: m/s^2; preload of effects that depend on the total torque.
            payload: mass on tool0 beyond the robot description.

        Raises:
            ActivationError: an effect needs what is not known in production (time since a reference, order of load cases).
        """
        ids = set(model.effects)
        springs = set()
        if ids & {"base_compliance", "rail_compliance"}:
            springs.add(BASE_SPRING)
        if "tool_compliance" in ids:
            springs.add(TOOL_SPRING)
        self._chain = chain = build_chain(robot, frozenset(springs))
        self._user, known = _split(model, robot)
        self.compiled = c = _compile(known, robot, chain.index, chain.n_columns)
        self.left_out = c.left_out
        self.n_joints = robot.n_joints
        self._C = np.asfortranarray(c.C)
        self._drives = np.array([chain.index[f"joint_{k + 1}"] for k in range(robot.n_joints)])
        self._base = np.array([chain.index[f"base_{d}"] for d in DOF]) if BASE_SPRING in springs else None
        self._has_rail = bool(np.any(c.rail))
        self._corrects_sensor = bool(np.any(c.sensor_matrix != np.eye(3))) or c.tool_mass_error != 0.0
        self._needs_gravity = bool(np.any(c.stiffening) or np.any(c.backlash))
        self._needs_drives = self._needs_gravity or bool(np.any(c.hysteresis))
        self._gravity = np.asarray(gravity_in_base, dtype=float)
        self._weight = _Weight(robot, self._gravity, payload) if self._needs_gravity else None
        self._until_sure = UNTIL_SIDE_SURE * UNDEFINED_SHARE_OF_RATED * rated_torque(robot)
        self._wrench_at_base = np.zeros(6)
        self.reset()

    @property
    def R_tool(self) -> Array:
        """tool0 in base_link at the last call, (3, 3); overwritten by the next one."""
        return self._chain.R_tool

    def reset(self) -> None:
        """Forget history: the robot stands relaxed, without process force."""
        self._played = np.zeros(self.n_joints)
        self._crept = np.zeros(self._chain.n_columns)
        self._side: Array | None = None

    def __call__(
        self, q: Array, force_in_tool: Array, torque_in_tool: Array, dt: float, rail_position: float = 0.0
    ) -> tuple[Array, Array]:
        """Deflection of the TCP now.

        Args:
            q: joint angles, (k,), rad.
            force_in_tool, torque_in_tool: environment on robot at the TCP, (3,), N and N m.
            dt: time since the call before, s.
            rail_position: of the external axis, m.

        Returns:
            translation (3,), m, and rotation (3,), rad, of the physical tool0 relative to the controller's, in base_link;
            Eq. (11).
        """
        c, chain = self.compiled, self._chain
        chain.update(q)
        R, J = chain.R_tool, chain.J_at_base
        if self._corrects_sensor:
            force_in_tool = c.sensor_matrix @ force_in_tool - c.tool_mass_error * (R.T @ self._gravity)
            torque_in_tool = c.sensor_turn @ torque_in_tool
        px, py, pz = chain.p_tcp.tolist()
        fx, fy, fz = (R @ force_in_tool).tolist()
        mx, my, mz = (R @ torque_in_tool).tolist()
        w = self._wrench_at_base
        w[0], w[1], w[2] = fx, fy, fz
        w[3], w[4], w[5] = mx + py * fz - pz * fy, my + pz * fx - px * fz, mz + px * fy - py * fx
        tau = J.T @ w
        dq = self._C @ tau
        if c.creep_share:
            self._crept += (1.0 - math.exp(-dt / c.creep_time)) * (tau - self._crept)
            dq += c.creep_share * (self._C @ self._crept)
        a, b = c.balancer
        if a or b:
            second = self._drives[1]
            dq[second] += (a * math.sin(q[1]) + b * math.cos(q[1])) * tau[second]
        if self._has_rail:
            dq[self._base] += (c.rail @ (1.0, rail_position, rail_position**2)) * tau[self._base]
        if self._needs_drives:
            dq[self._drives] += self._of_drives(q, tau[self._drives])
        vx, vy, vz, wx, wy, wz = (J @ dq).tolist()
        translation = np.array([vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px])
        if self._user is not None:
            translation += self._user.displacement(q, force_in_tool, torque_in_tool)
        return translation, np.array([wx, wy, wz])

    def _of_drives(self, q: Array, tau: Array) -> Array:
        c = self.compiled
        self._played = np.clip(self._played, tau - c.hysteresis_play, tau + c.hysteresis_play)
        turn = c.hysteresis * self._played
        if self._weight is None:
            return turn
        preload = self._weight.torque(q)
        total, x = tau + preload, c.stiffening_from
        turn += c.stiffening * (tau - x * (np.tanh(total / x) - np.tanh(preload / x)))
        if np.any(c.backlash):
            unloaded = np.sign(preload)
            side = unloaded if self._side is None else self._side
            self._side = np.where(np.abs(total) > self._until_sure, np.sign(total), side)
            turn += 0.5 * c.backlash * (self._side - unloaded)
        return turn


class _Weight:
    """Torque of gravity about each drive, on preallocated data."""

    def __init__(self, robot: Robot, gravity_in_base: Array, payload: Payload | None) -> None:
        self._model = m = pin.buildModelFromXML(robot.urdf_text)
        tcp, base = m.frames[m.getFrameId("tool0")], m.getFrameId("base_link")
        if payload is not None and payload.mass > 0.0:
            m.appendBodyToJoint(
                tcp.parentJoint, pin.Inertia(payload.mass, np.asarray(payload.com, dtype=float), np.zeros((3, 3))), tcp.placement
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


def _split(model: Model, robot: Robot) -> tuple[UserTerms | None, list[Term]]:
    """Terms of users, to be evaluated by their own code, and the terms that can be compiled."""
    known: list[Term] = []
    foreign: list[Term] = []
    for term in model.terms:
        compiled = term.effect.id in COMPILED or term.effect.id in LEFT_OUT or term.effect.acts_on == "instrument"
        (known if compiled else foreign).append(term)
    if not foreign:
        return None, known
    from .user_terms import UserTerms  # a model of the catalogue alone does not pay for it

    return UserTerms(foreign, robot), known


def _compile(terms: list[Term], robot: Robot, index: dict[str, int], n: int) -> Compiled:
    k = robot.n_joints
    C, rail = np.zeros((n, n)), np.zeros((6, 3))
    sensor, turn, dm = np.eye(3), np.eye(3), 0.0
    stiffening, backlash, hysteresis = np.zeros(k), np.zeros(k), np.zeros(k)
    rated = rated_torque(robot)
    stiffening_from, play = rated, np.full(k, np.inf)
    balancer, creep = (0.0, 0.0), (0.0, 1.0)
    left_out: dict[str, str] = {}
    for term in terms:

        def value(name: str, otherwise: float = 0.0, term: Term = term) -> float:
            return term.estimates[name].value if name in term.estimates else otherwise

        def per_joint(letter: str) -> Array:
            return np.array([value(f"{letter}_{i + 1}") for i in range(k)])

        def add(a: str, b: str, compliance: float) -> None:
            C[index[a], index[b]] += compliance

        match term.effect.id:
            case "joint_torsion":
                for i, x in enumerate(per_joint("c")):
                    add(f"joint_{i + 1}", f"joint_{i + 1}", x)
            case "link_bending":
                for name in (f"{i + 1}{v}" for i in range(k) for v in "ab"):
                    add(f"joint_{name}", f"joint_{name}", value(f"c_{name}"))
            case "joint_coupling":
                for name in term.estimates:
                    a, b = name[2:] if k < 10 else (name[2 : 2 + (len(name) - 2) // 2], name[2 + (len(name) - 2) // 2 :])
                    add(f"joint_{a}", f"joint_{b}", value(name))
            case "tool_compliance":
                for a in "xyz":
                    add(f"tool_{a}", f"tool_{a}", value(f"c_{a}"))
                for a, b in (("x", "y"), ("x", "z"), ("y", "z")):
                    add(f"tool_{a}", f"tool_{b}", value(f"c_{a}{b}"))
                    add(f"tool_{b}", f"tool_{a}", value(f"c_{a}{b}"))
            case "base_compliance":
                for d in DOF:
                    add(f"base_{d}", f"base_{d}", value(d))
            case "rail_compliance":
                rail += np.array([[value(f"{d}_s{p}") for p in range(3)] for d in DOF])
            case "counterbalance":
                balancer = (value("a"), value("b"))
            case "joint_stiffening":
                stiffening, stiffening_from = per_joint("a"), value("x_0", 0.15) * rated
            case "joint_backlash":
                backlash = per_joint("b")
            case "joint_hysteresis":
                hysteresis, play = per_joint("h"), value("r", 0.03) * rated
            case "creep":
                creep = (value("share"), value("T", 10.0))
            case "sensor_gain":
                sensor = (np.eye(3) + crosstalk(np.array([value(g) for g in GAIN_NAMES]))) @ sensor
            case "sensor_alignment":
                R = Rotation.from_rotvec([value(f"w_{a}") for a in "xyz"]).as_matrix()
                sensor, turn = R @ sensor, R @ turn
            case "tool_weight":
                dm += value("dm")
            case other:
                left_out[other] = LEFT_OUT.get(other, "is seen by the measuring instrument only and moves no tool")
    return Compiled(
        C, sensor, turn, dm, balancer, rail, stiffening, stiffening_from, backlash, hysteresis, play, *creep, left_out
    )  # fmt: skip


COMPILED = frozenset({
    "joint_torsion", "link_bending", "joint_coupling", "tool_compliance", "base_compliance", "rail_compliance", "counterbalance",
    "joint_stiffening", "joint_backlash", "joint_hysteresis", "creep", "sensor_gain", "sensor_alignment", "tool_weight",
})  # fmt: skip
