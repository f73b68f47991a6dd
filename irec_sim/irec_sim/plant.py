# SPDX-License-Identifier: Apache-2.0
"""The elastic robot: nonlinear static equilibrium of its springs, its weight and the process force.

Each joint is three springs in series, one about the actuated axis and two orthogonal to it, each a real rotation of
everything beyond it; there may be six more under base_link and six at the tool's mount. Equilibrium is sought at the
deflected configuration: e = phi(tau(q, e)), where tau are the torques that weight and process force exert about the
deflected axes and phi the laws of the springs (flexibility form, so that play, friction and creep are explicit). The
torques change by about 3e-3 of the elastic angle's own torque, so the iteration contracts by that factor per step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .errors import SimError
from .kinematics import Array, Chain, rotation_of_vector, skew
from .parameters import PlantParameters

GRAVITY = 9.81
_PLAY_LEVELS = np.array([0.25, 0.6, 1.0, 1.6])  # slip torques of the friction elements, shares of friction_torque


def _cross(a: Array, b: Array) -> Array:
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = ay * bz - az * by
    out[..., 1] = az * bx - ax * bz
    out[..., 2] = ax * by - ay * bx
    return out


@dataclass(frozen=True)
class State:
    """Memory of the plant over n rows: elastic coordinates e (n, dof), torque held by each friction element
    (n, joints, 4) in N m, delayed strain (n, joints) in rad."""

    e: Array
    held: Array
    delayed: Array


@dataclass(frozen=True)
class Conditions:
    """What acts on the plant in n rows.

    Attributes:
        force: process force on the robot at the TCP, in base_link, (n, 3), N.
        rail: position of base_link along the rail, (n,), m.
        gear_temperature: (n, joints), degC.
        process_on: (n,) bool; hoses pull only then.
    """

    force: Array
    rail: Array
    gear_temperature: Array
    process_on: Array

    @classmethod
    def idle(cls, n: int, joints: int = 6) -> Conditions:
        return cls(np.zeros((n, 3)), np.zeros(n), np.full((n, joints), 25.0), np.zeros(n, dtype=bool))


@dataclass(frozen=True)
class Frames:
    """Deflected configuration of n rows, in base_link.

    Attributes:
        p_tcp, R_tool: physical TCP, (n, 3) m and (n, 3, 3).
        axis: of each degree of freedom, (n, dof, 3); lever: its translational Jacobian at the TCP, (n, dof, 3).
        weight_torque: torque of the weights about each degree of freedom, (n, dof), N m (N for translations).
    """

    p_tcp: Array
    R_tool: Array
    axis: Array
    lever: Array
    weight_torque: Array


class Plant:
    """An elastic robot of n joints; degrees of freedom in order: base (6 if any), 3 per joint, tool (6 if any)."""

    def __init__(self, chain: Chain, parameters: PlantParameters, gravity: float = GRAVITY) -> None:
        """gravity: m/s^2, along -z of base_link."""
        self.chain, self.parameters = chain, parameters
        par, n = parameters, chain.n
        self.has_base = bool(np.any(par.base) or np.any(par.rail))
        self.has_tool = bool(np.any(par.tool) or par.taper or np.any(par.flange_gap))
        b = 3 if self.has_base else 0
        eye = np.eye(3)
        fixed = [eye] * b
        local_axis = list(eye) if self.has_base else []
        R_fixed = chain.R_fixed @ rotation_of_vector(par.turn_error)
        for k in range(n):
            first = np.cross(chain.axis[k], eye[int(np.argmin(np.abs(chain.axis[k])))])
            first /= np.linalg.norm(first)
            fixed += [R_fixed[k], eye, eye]
            local_axis += [chain.axis[k], first, np.cross(chain.axis[k], first)]
        if self.has_tool:
            fixed += [chain.R_mount, eye, eye]
            local_axis += list(eye)
        self._local = np.array(local_axis)
        K = skew(self._local)
        self._A = np.array(fixed)
        self._B, self._C = self._A @ K, self._A @ K @ K
        self._p_fixed = chain.p_fixed + par.p_error
        self._b = b
        self._last = b + 2 + 3 * np.arange(n)  # rotation after which each link is reached
        self._axial_rotation = b + 3 * np.arange(n)
        # degrees of freedom: [base t, base r], joints, [tool t, tool r]
        j0 = 6 if self.has_base else 0
        self.dof = j0 + 3 * n + (6 if self.has_tool else 0)
        self.axial = j0 + 3 * np.arange(n)
        self._rotations = np.r_[np.arange(3, j0) if self.has_base else [], j0 + np.arange(3 * n)].astype(int)
        if self.has_tool:
            self._rotations = np.r_[self._rotations, self.dof - 3 + np.arange(3)]
        masses = np.r_[chain.mass, chain.tool_mass]
        self._weight = masses[:, None] * np.array([0.0, 0.0, -gravity])  # (n + 1, 3)
        self._weight_beyond = self._weight[::-1].cumsum(axis=0)[::-1]
        owner = np.r_[np.zeros(j0), np.repeat(np.arange(n), 3), np.full(6 if self.has_tool else 0, n)].astype(int)
        self._owner = owner
        self._weight_owned = self._weight_beyond[owner]
        c = np.concatenate([np.zeros(j0), np.column_stack([par.axial, par.transverse]).ravel(), np.zeros(self.dof - j0 - 3 * n)])
        if self.has_tool:
            c[-6:] = par.tool
        self._compliance = c
        self._varies = bool(self.has_base or par.balancer.stiffness or np.any(par.gear_heat) or np.any(par.neighbour))
        self._play = par.friction[:, None] * par.axial[:, None] / len(_PLAY_LEVELS) * np.ones(len(_PLAY_LEVELS))
        self._slip = par.friction_torque[:, None] * _PLAY_LEVELS
        self._has = {
            "friction": bool(np.any(par.friction)),
            "creep": bool(np.any(par.creep)),
            "backlash": bool(np.any(par.backlash)),
            "soft": bool(np.any(par.soft_zone)),
            "coupling": bool(np.any(par.coupling)),
            "product": bool(np.any(par.torque_product)),
            "cable": bool(np.any(par.cable_in_base) or np.any(par.cable_in_tool) or np.any(par.cable_wrist)),
        }

    @property
    def creeps(self) -> bool:
        """Whether the arm goes on deforming under a constant load."""
        return self._has["creep"]

    # -- geometry and statics ---------------------------------------------------------------------------------------

    def frames(self, q: Array, e: Array) -> Frames:
        """Deflected configuration at motor angles q (n, joints) and elastic coordinates e (n, dof)."""
        chain, n = self.chain, len(q)
        angle = e[:, self._rotations]
        angle[:, self._axial_rotation] += q + self.parameters.joint_zero
        local = np.sin(angle)[..., None, None] * self._B
        local += (1.0 - np.cos(angle))[..., None, None] * self._C
        local += self._A
        G = np.empty_like(local)
        R = local[:, 0]
        G[:, 0] = R
        for i in range(1, local.shape[1]):
            R = np.matmul(R, local[:, i], out=G[:, i])
        axis_of_rotation = (G @ self._local[:, :, None])[..., 0]
        R_link = G[:, self._last]
        R_before = np.empty_like(R_link)
        R_before[:, 0] = G[:, 2] if self._b else np.eye(3)
        R_before[:, 1:] = R_link[:, :-1]
        origin = (R_before @ self._p_fixed[:, :, None])[..., 0]
        if self.has_base:
            origin[:, 0] += e[:, :3]
        origin = origin.cumsum(axis=1)
        com = np.empty((n, chain.n + 1, 3))
        com[:, :-1] = origin + (R_link @ chain.com[:, :, None])[..., 0]
        p_mount = origin[:, -1] + R_link[:, -1] @ chain.p_mount
        R_mount0 = R_link[:, -1] @ chain.R_mount
        if self.has_tool:
            p_mount = p_mount + (R_mount0 @ e[:, -6:-3, None])[..., 0]
            R_mount = G[:, -1]
        else:
            R_mount = R_mount0
        com[:, -1] = p_mount + R_mount @ chain.tool_com
        p_tcp = p_mount + R_mount @ chain.p_tcp
        moment = _cross(com, self._weight)
        moment_beyond = moment[:, ::-1].cumsum(axis=1)[:, ::-1]
        axis = np.empty((n, self.dof, 3))
        center = np.empty((n, self.dof, 3))
        axis[:, self._rotations] = axis_of_rotation
        j0 = 6 if self.has_base else 0
        center[:, j0 : j0 + 3 * chain.n] = np.repeat(origin, 3, axis=1)
        if self.has_base:
            axis[:, :3] = np.eye(3)
            center[:, :6] = e[:, None, :3]
        if self.has_tool:
            axis[:, -6:-3] = R_mount0.swapaxes(1, 2)
            center[:, -6:] = p_mount[:, None]
        about_base = _cross(axis, center)
        lever = axis @ skew(p_tcp) - about_base
        torque = (axis * moment_beyond[:, self._owner]).sum(axis=2) - (about_base * self._weight_owned).sum(axis=2)
        if self.has_base:
            lever[:, :3] = axis[:, :3]
            torque[:, :3] = axis[:, :3] @ self._weight_beyond[0]
        if self.has_tool:
            lever[:, -6:-3] = axis[:, -6:-3]
            torque[:, -6:-3] = axis[:, -6:-3] @ self._weight_beyond[-1]
        return Frames(p_tcp, R_mount @ chain.R_tcp, axis, lever, torque)

    def load_torque(self, frames: Frames, conditions: Conditions, q: Array) -> Array:
        """Torque of process force and hoses about each degree of freedom, (n, dof), N m (N for translations)."""
        force = conditions.force
        par = self.parameters
        torque = (frames.lever @ force[:, :, None])[..., 0]
        if np.any(par.contact_offset):
            moment = _cross(frames.R_tool @ par.contact_offset, force)
            turning = np.ones(self.dof, dtype=bool)
            turning[[*range(3 if self.has_base else 0), *(range(self.dof - 6, self.dof - 3) if self.has_tool else ())]] = False
            torque += (frames.axis @ moment[:, :, None])[..., 0] * turning
        if self._has["cable"]:
            in_tool = par.cable_in_tool + np.sin(q[:, [3, -1]]) @ par.cable_wrist
            hose = (par.cable_in_base + (frames.R_tool @ in_tool[:, :, None])[..., 0]) * conditions.process_on[:, None]
            torque += (frames.lever @ hose[:, :, None])[..., 0]
        return torque

    # -- laws of the springs ----------------------------------------------------------------------------------------

    def compliance(self, q: Array, conditions: Conditions) -> Array:
        """Linear compliance of each degree of freedom in n rows, (n, dof) or (dof,)."""
        if not self._varies:
            return self._compliance
        par = self.parameters
        c = np.tile(self._compliance, (len(q), 1))
        if self.has_base:
            travel = np.clip(conditions.rail / par.rail_half, -1.0, 1.0) ** 2
            c[:, :6] = par.base + par.rail * (par.rail_middle + (1.0 - par.rail_middle) * travel)[:, None]
        factor = 1.0 + par.gear_heat * (conditions.gear_temperature - 25.0) + np.sin(2.0 * q) @ par.neighbour.T
        c[:, self.axial] *= np.maximum(factor, 0.1)
        if par.balancer.stiffness:
            parallel = par.balancer.stiffness * par.balancer.lever(q[:, 1]) ** 2
            c[:, self.axial[1]] = 1.0 / (1.0 / c[:, self.axial[1]] + parallel)
        return c

    def _strain(self, torque: Array, c: Array, held: Array, delayed: Array) -> Array:
        """phi: elastic coordinates (n, dof) under the torques (n, dof)."""
        par, has = self.parameters, self._has
        e = c * torque
        axial = torque[:, self.axial]
        extra = None
        if has["backlash"]:
            extra = par.backlash * np.clip(axial / par.backlash_torque, -1.0, 1.0)
        if has["soft"]:
            soft = par.soft_zone * par.axial * par.soft_torque * np.tanh(axial / par.soft_torque)
            extra = soft if extra is None else extra + soft
        if has["friction"]:
            wound = (self._play * held).sum(axis=2)
            extra = wound if extra is None else extra + wound
        if has["coupling"]:
            coupled = axial @ par.coupling
            extra = coupled if extra is None else extra + coupled
        if has["product"]:
            product = axial * (axial @ par.torque_product.T)
            extra = product if extra is None else extra + product
        if has["creep"]:
            extra = delayed if extra is None else extra + delayed
        if extra is not None:
            e[:, self.axial] += extra
        if self.has_tool:
            side = torque[:, -6:-4]
            e[:, -4] += par.taper * (side * side).sum(axis=1)
            e[:, -3:-1] += par.flange_gap * np.maximum(torque[:, -3:-1], 0.0)
        return e

    # -- equilibrium ------------------------------------------------------------------------------------------------

    def relaxed(self, q: Array, conditions: Conditions | None = None) -> State:
        """Equilibrium under the weights alone with no friction torque held and all creep done."""
        n = len(q)
        conditions = conditions or Conditions.idle(n, self.chain.n)
        state = State(np.zeros((n, self.dof)), np.zeros((n, self.chain.n, len(_PLAY_LEVELS))), np.zeros((n, self.chain.n)))
        for _ in range(4):
            f = self.frames(q, state.e)
            axial = (f.weight_torque + self.load_torque(f, conditions, q))[:, self.axial]
            held = np.repeat(axial[..., None], len(_PLAY_LEVELS), axis=2)
            state = replace(state, held=held, delayed=self.parameters.creep * self.parameters.axial * axial)
            state, _ = self.equilibrium(q, conditions, state)
        return replace(state, held=held)

    def equilibrium(
        self, q: Array, conditions: Conditions, state: State, dt: float | Array = 0.0, tolerance: float = 1e-13
    ) -> tuple[State, Frames]:
        """Static equilibrium at motor angles q (n, joints); friction and creep start from `state`.

        Args:
            dt: time that passes under this load before the answer holds, s; scalar or (n,).
            tolerance: largest change of an elastic coordinate in the last iteration, rad and m.

        Returns:
            the new state and the deflected configuration.

        Raises:
            SimError: no equilibrium within 80 iterations (a spring so soft that the arm buckles).
        """
        c = self.compliance(q, conditions)
        e = state.e
        for _ in range(80):
            f = self.frames(q, e)
            after, torque = self.respond(f, q, conditions, state, c, dt)
            change = np.abs(after.e - e).max()
            e = after.e
            if change < tolerance:
                return after, f
        raise SimError(f"no static equilibrium: elastic coordinates still change by {change:.1e} after 80 iterations")

    def released(self, frames: Frames, q: Array, conditions: Conditions, state: State) -> State:
        """The same state with no friction torque held in the gears, as after some motion."""
        if not self._has["friction"]:
            return state
        axial = (frames.weight_torque + self.load_torque(frames, conditions, q))[:, self.axial]
        return replace(state, held=np.repeat(axial[..., None], len(_PLAY_LEVELS), axis=2))

    def respond(
        self, frames: Frames, q: Array, conditions: Conditions, state: State, c: Array, dt: float | Array
    ) -> tuple[State, Array]:
        """phi(tau) with tau taken at a given configuration: one iteration of `equilibrium`.

        Args:
            state: memory at the beginning; c: from `compliance`; dt: s under this load.

        Returns:
            the state that follows and the torques, (n, dof).
        """
        torque = frames.weight_torque + self.load_torque(frames, conditions, q)
        axial = torque[:, self.axial]
        delayed, held = state.delayed, state.held
        if self._has["creep"]:
            decay = np.exp(-np.broadcast_to(np.asarray(dt, dtype=float), (len(q),)) / self.parameters.creep_time)[:, None]
            final = self.parameters.creep * self.parameters.axial * axial
            delayed = final + (delayed - final) * decay
        if self._has["friction"]:
            held = np.clip(held, axial[..., None] - self._slip, axial[..., None] + self._slip)
        return State(self._strain(torque, c, held, delayed), held, delayed), torque

    def deflection(self, q: Array, force_in_base: Array) -> Array:
        """Change of the TCP from the relaxed arm to the one under the force, (n, 3) m in base_link: the basic experiment."""
        idle = Conditions.idle(len(q), self.chain.n)
        start = self.relaxed(q, idle)
        _, before = self.equilibrium(q, idle, start)
        _, after = self.equilibrium(q, replace(idle, force=force_in_base, process_on=np.ones(len(q), dtype=bool)), start)
        return after.p_tcp - before.p_tcp

    def tcp_compliance(self, frames: Frames, c: Array) -> Array:
        """Tangent translational compliance at the TCP of the linear springs, (n, 3, 3), m/N."""
        weighted = frames.lever * np.broadcast_to(c, frames.lever.shape[:2])[..., None]
        return weighted.swapaxes(1, 2) @ frames.lever
