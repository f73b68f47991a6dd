# SPDX-License-Identifier: Apache-2.0
"""The elastic robot: nonlinear static equilibrium of its springs, its weight and the process force.

Each joint is three springs in series, one about the actuated axis and two orthogonal to it, each a real rotation of
everything beyond it; there may be six more under base_link and six at the tool's mount. Equilibrium is sought at the
deflected configuration: e = phi(tau(q, e)), where tau are the torques that weight and process force exert about the
deflected axes and phi the laws of the springs (flexibility form, so that play, friction and creep are explicit). The
torques change by about 3e-3 of the elastic angle's own torque, so the iteration contracts by that factor per step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .errors import SimError
from .kinematics import Array, Chain
from .laws import SLIDER_LEVELS, Maxwell, play, presliding
from .parameters import PlantParameters
from .skeleton import GRAVITY, Frames, Skeleton, cross
from .terms import Term, factor_of


@dataclass(frozen=True)
class State:
    """Memory of the plant over n rows: elastic coordinates e (n, dof), and what the gears remember, by name:

    held: torque on each slider (n, joints, 4) in N m, or friction torque (n, joints); wound: angle of the part that friction
    holds (n, joints); strain (n, joints) and branches (n, joints, b) of gears that creep, rad.
    """

    e: Array
    memory: dict[str, Array]


@dataclass(frozen=True)
class Conditions:
    """What acts on the plant in n rows.

    Attributes:
        force: process force on the robot at the TCP, in base_link, (n, 3), N.
        rail: position of base_link along the rail, (n,), m.
        gear_temperature: (n, joints), degC.
        process_on: (n,) bool; hoses pull only then.
        base_in_cell: of base_link, (n, 3), m; None: at the origin.
        known: further variables of the rows by name, (n,) each, for causes outside the catalogue.
    """

    force: Array
    rail: Array
    gear_temperature: Array
    process_on: Array
    base_in_cell: Array | None = None
    known: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def idle(cls, n: int, joints: int = 6) -> Conditions:
        return cls(np.zeros((n, 3)), np.zeros(n), np.full((n, joints), 25.0), np.zeros(n, dtype=bool))


class Plant:
    """An elastic robot of n joints; degrees of freedom in order: base (6 if any), 3 per joint, tool (6 if any)."""

    def __init__(self, chain: Chain, parameters: PlantParameters, gravity: float = GRAVITY, whole: bool = False) -> None:
        """gravity: m/s^2, along -z of base_link; whole: with the springs of base and tool even where they are rigid."""
        self.chain, self.parameters = chain, parameters
        par, n = parameters, chain.n
        skeleton = self._skeleton = Skeleton(chain, parameters, gravity, whole)
        self.dof, self.axial, self._across, self._turning = skeleton.dof, skeleton.axial, skeleton.across, skeleton.turning
        self.has_base, self.has_tool = skeleton.has_base, skeleton.has_tool
        j0 = 6 if self.has_base else 0
        c = np.concatenate([np.zeros(j0), np.column_stack([par.axial, par.transverse]).ravel(), np.zeros(self.dof - j0 - 3 * n)])
        if self.has_tool:
            c[-6:] = par.tool
        self._compliance = c
        self._varies = bool(
            self.has_base or par.balancer.stiffness or np.any(par.gear_heat) or np.any(par.neighbour)
            or any(t.softens for t in par.terms)
        )  # fmt: skip
        self._rubs = np.flatnonzero(par.friction)
        self._play = par.friction[:, None] * par.axial[:, None] / len(SLIDER_LEVELS) * np.ones(len(SLIDER_LEVELS))
        self._slip = par.friction_torque[:, None] * SLIDER_LEVELS
        self._maxwell = Maxwell(par.creep, par.creep_weights, par.creep_times) if np.any(par.creep) else None
        self._has = {
            "sliders": par.friction_form == "sliders" and len(self._rubs) > 0,
            "presliding": par.friction_form == "presliding" and len(self._rubs) > 0,
            "backlash": bool(np.any(par.backlash)),
            "bearing": bool(np.any(par.bearing_gap)),
            "coupling": bool(np.any(par.coupling)),
            "product": bool(np.any(par.torque_product)),
        }

    @property
    def creeps(self) -> bool:
        """Whether the arm goes on deforming under a constant load."""
        return self._maxwell is not None

    # -- geometry and statics ---------------------------------------------------------------------------------------

    def frames(self, q: Array, e: Array) -> Frames:
        """Deflected configuration at motor angles q (n, joints) and elastic coordinates e (n, dof)."""
        return self._skeleton.frames(q, e)

    def turns(self, frames: Frames) -> Array:
        """Rotation of the tool per degree of freedom, (n, dof, 3): its axis, nothing for translations."""
        return self._skeleton.turns(frames)

    def load_torque(self, frames: Frames, conditions: Conditions, q: Array) -> Array:
        """Torque of process force and hoses about each degree of freedom, (n, dof), N m (N for translations)."""
        force = conditions.force
        par = self.parameters
        torque = (frames.lever @ force[:, :, None])[..., 0]
        if np.any(par.contact_offset):
            moment = cross(frames.R_tool @ par.contact_offset, force)
            torque += (frames.axis @ moment[:, :, None])[..., 0] * self._turning
        if par.hose is not None:
            torque += self._skeleton.hose_torque(par.hose, frames, conditions.process_on, conditions.base_in_cell, q)
        return torque

    # -- laws of the springs ----------------------------------------------------------------------------------------

    def compliance(self, q: Array, conditions: Conditions) -> Array:
        """Linear compliance of each degree of freedom in n rows, (n, dof) or (dof,)."""
        if not self._varies:
            return self._compliance
        par = self.parameters
        c = np.tile(self._compliance, (len(q), 1))
        if self.has_base:
            near = np.exp(-(((conditions.rail - par.rail_place) / par.rail_width) ** 2))
            c[:, :6] = par.base + par.rail * (par.rail_floor + (1.0 - par.rail_floor) * near)[:, None]
        factor = 1.0 + par.gear_heat * (conditions.gear_temperature - 25.0) + np.sin(2.0 * q) @ par.neighbour.T
        c[:, self.axial] *= np.maximum(factor, 0.1)
        if par.balancer.stiffness:
            parallel = par.balancer.stiffness * par.balancer.lever(q[:, 1]) ** 2
            c[:, self.axial[1]] = 1.0 / (1.0 / c[:, self.axial[1]] + parallel)
        for term in par.terms:
            if term.softens:
                c[:, self._dof_of(term)] *= factor_of(term.value(lambda v: self._variable(v, q, conditions)))
        return c

    def _dof_of(self, term: Term) -> int:
        if term.place == "axial":
            return int(self.axial[term.joint - 1])
        if term.place == "across":
            return int(self._across[term.joint - 1, term.index])
        return term.index if term.place == "base" else self.dof - 6 + term.index

    def _variable(self, name: str, q: Array, conditions: Conditions, axial: Array | None = None) -> Array:
        """A variable of the rows by name; 0 where it is not known."""
        if name.startswith("joint_"):
            return q[:, int(name[6:]) - 1]
        if name.startswith("tau_") and axial is not None:
            return axial[:, int(name[4:]) - 1]
        return conditions.known.get(name, np.zeros(len(q)))

    def _strain(self, torque: Array, c: Array, q: Array, conditions: Conditions, extra: Array | None) -> Array:
        """phi: elastic coordinates (n, dof) under the torques (n, dof); extra: angles of the gears that remember."""
        par, has = self.parameters, self._has
        e = c * torque
        axial = torque[:, self.axial]
        angle = np.zeros_like(axial) if extra is None else extra
        if has["backlash"]:
            angle = angle + par.backlash * play(axial / par.backlash_torque, par.backlash_sharpness)
        if has["coupling"]:
            angle = angle + axial @ par.coupling
        if has["product"]:
            angle = angle + axial * (axial @ par.torque_product.T)
        e[:, self.axial] += angle
        for curve in par.curves:
            e[:, self.axial[curve.joint - 1]] += curve.angle(axial[:, curve.joint - 1])
        if has["bearing"]:
            across = torque[:, self._across]
            e[:, self._across] += par.bearing_gap * play(across / par.bearing_torque[:, None], 6.0)
        for term in par.terms:
            if not term.softens:
                e[:, self._dof_of(term)] += term.value(lambda v: self._variable(v, q, conditions, axial))
        if self.has_tool:
            side = torque[:, -6:-4]
            e[:, -4] += par.taper * (side * side).sum(axis=1)
            e[:, -3:-1] += par.flange_gap * np.maximum(torque[:, -3:-1], 0.0)
        return e

    # -- equilibrium ------------------------------------------------------------------------------------------------

    def relaxed(self, q: Array, conditions: Conditions | None = None, arrived: Array | None = None) -> State:
        """Equilibrium under the weights alone with all creep done.

        Args:
            arrived: direction from which each joint came, -1 .. 1, (n, joints): friction that is not relaxed points there.
                None: no friction torque is held.
        """
        n = len(q)
        conditions = conditions or Conditions.idle(n, self.chain.n)
        state = State(np.zeros((n, self.dof)), {})
        for _ in range(4):
            f = self.frames(q, state.e)
            rest = self.at_rest(f, q, conditions, arrived)
            state, _ = self.equilibrium(q, conditions, replace(rest, e=state.e))
        return replace(rest, e=state.e)

    def at_rest(self, frames: Frames, q: Array, conditions: Conditions, arrived: Array | None = None) -> State:
        """Memory of an arm that rests in a given configuration with all creep done; arrived as in `relaxed`."""
        par, axial = self.parameters, self._axial_torque(frames, q, conditions)
        memory = self._freed(axial, 0.0 if arrived is None else par.unrelaxed * arrived)
        if self._maxwell is not None:
            memory["strain"], memory["branches"] = self._maxwell.at_rest(par.axial * axial)
        return State(np.zeros((len(q), self.dof)), memory)

    def _axial_torque(self, frames: Frames, q: Array, conditions: Conditions) -> Array:
        return (frames.weight_torque + self.load_torque(frames, conditions, q))[:, self.axial]

    def _freed(self, axial: Array, share: float | Array) -> dict[str, Array]:
        """Friction of gears that hold a share of the largest friction, -1 .. 1."""
        if self._has["sliders"]:
            return {"held": axial[..., None] + (share * np.ones_like(axial))[..., None] * self._slip}
        if self._has["presliding"]:
            held = share * self.parameters.friction_torque * np.ones_like(axial)
            return {"held": held, "wound": self.parameters.friction * self.parameters.axial * (axial - held)}
        return {}

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

    def released(self, frames: Frames, q: Array, conditions: Conditions, state: State, moved: Array | None = None) -> State:
        """The same state with friction freed by motion.

        Args:
            moved: by how much each joint turned, (n, joints), rad; None: so far that no friction torque is left.
        """
        if not (self._has["sliders"] or self._has["presliding"]):
            return state
        axial = self._axial_torque(frames, q, conditions)
        if moved is None:
            return replace(state, memory={**state.memory, **self._freed(axial, 0.0)})
        keep = np.exp(-np.abs(moved) / self.parameters.release)
        held = state.memory["held"]
        if self._has["sliders"]:
            return replace(state, memory={**state.memory, "held": axial[..., None] + keep[..., None] * (held - axial[..., None])})
        wound = self.parameters.friction * self.parameters.axial * (axial - keep * held)
        return replace(state, memory={**state.memory, "held": keep * held, "wound": wound})

    def respond(
        self, frames: Frames, q: Array, conditions: Conditions, state: State, c: Array, dt: float | Array
    ) -> tuple[State, Array]:
        """phi(tau) with tau taken at a given configuration: one iteration of `equilibrium`.

        Args:
            state: memory at the beginning; c: from `compliance`; dt: s under this load.

        Returns:
            the state that follows and the torques, (n, dof).
        """
        par = self.parameters
        torque = frames.weight_torque + self.load_torque(frames, conditions, q)
        axial = torque[:, self.axial]
        memory, extra = {}, None
        if self._has["sliders"]:
            held = state.memory["held"]
            memory["held"] = held = np.clip(held, axial[..., None] - self._slip, axial[..., None] + self._slip)
            extra = (self._play * held).sum(axis=2)
        elif self._has["presliding"]:
            k = self._rubs
            compliance = (par.friction * par.axial)[k]
            wound, held = state.memory["wound"].copy(), state.memory["held"].copy()
            wound[:, k], held[:, k] = presliding(
                axial[:, k], compliance, par.friction_torque[k], par.presliding / compliance, wound[:, k], held[:, k]
            )
            memory["wound"], memory["held"], extra = wound, held, wound
        if self._maxwell is not None:
            x = par.axial * axial
            passed = np.broadcast_to(np.asarray(dt, dtype=float), (len(q),))
            strain, memory["branches"] = self._maxwell.after(x, state.memory["strain"], state.memory["branches"], passed)
            memory["strain"] = strain
            extra = strain - x if extra is None else extra + strain - x
        return State(self._strain(torque, c, q, conditions, extra), memory), torque

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
