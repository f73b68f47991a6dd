# SPDX-License-Identifier: Apache-2.0
"""The elastic arm of the simulated cell in equilibrium with tooling or process, step by step.

Quasi-static: the arm has no mass to accelerate. Arm and contact are solved together; the solution of the step before is so near
that one pass brings it to below a nanometre once the robot stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .cellfile import CellFile
from .contact import Contact, Disc, solve_contact
from .kinematics import Array
from .plant import Conditions, Frames, Plant

STILL = 1e-9  # rad, below which a free arm keeps the equilibrium it has
FORCE_TOLERANCE = 0.5  # N, change of the contact force in a pass that calls for another; 1 N is a micrometre
MAX_PASSES = 6
REUSE = 5e-5  # rad and m by which the configuration may change before lever arms are computed again


class Equilibrium:
    """Where the arm is under what acts on it.

    Attributes:
        surface, disc: what the tool meets, and with what; may be exchanged between two steps, as a fault does.
        force: on the robot at the TCP, (3,), N in base_link.
        frames: the deflected configuration; conditions: under which it was found.
    """

    def __init__(self, cell: CellFile, plant: Plant, motor: Array, conditions: Conditions) -> None:
        """Free, at motor angles (1, n), rad."""
        self._plant, self.surface, self.disc = plant, cell.surface, Disc(friction=cell.friction)
        self._contact = Contact()
        self._base: tuple[Array, Array, Frames] | None = None
        self._found_at = np.full(motor.shape, np.inf)
        self._frees = bool(np.isfinite(plant.parameters.release))
        self._state, self.frames = plant.equilibrium(motor, conditions, plant.relaxed(motor, conditions))
        self.conditions, self.force = conditions, np.zeros(3)

    def step(
        self, motor: Array, moving: bool, process: Array | None, carriage: Array, under: Callable[[Array], Conditions], dt: float
    ) -> None:
        """Equilibrium at new motor angles.

        Lever arms are taken from a configuration at most REUSE away, which leaves nanometres. A free arm that moves winds up
        no friction: its gears turn. Where the plant says how far a joint turns until its friction is freed, a loaded arm that
        moves loses friction by that.

        Args:
            motor: (1, n), rad. process: force at the TCP in tool0 in place of contact, (3,), N; None: contact with the tooling.
            carriage: where the base is in the cell frame, (3,), m.
            under: conditions for a force on the robot, (3,), N in base_link.
        """
        plant = self._plant
        free = process is None and not self._contact.touching
        if free and not plant.creeps and float(np.abs(motor - self._found_at).max()) < STILL:
            return  # nothing pushes and nothing moves
        moved, self._found_at = motor - self._found_at, motor
        begin, force = self._state, self.force
        frames = self._frames_near(motor, begin.e)
        after = Contact()
        conditions = under(force)
        if free and moving:
            begin = plant.released(frames, motor, conditions, begin)
        elif self._frees and np.isfinite(moved).all():
            begin = plant.released(frames, motor, conditions, begin, moved)
        c = plant.compliance(motor, conditions)
        if process is None:
            compliance = plant.tcp_compliance(frames, c)[0]
            for _ in range(MAX_PASSES):
                trial, _ = plant.respond(frames, motor, conditions, begin, c, dt)
                p = frames.p_tcp[0] + (trial.e - begin.e)[0] @ frames.lever[0] + carriage
                answer, after = solve_contact(
                    self.disc, self.surface.gap, p - compliance @ force, compliance, self._contact, force
                )
                change = float(np.abs(answer - force).max())
                force = answer
                if change < FORCE_TOLERANCE:
                    break
                conditions = under(force)
        else:
            force = frames.R_tool[0] @ process
            conditions = under(force)
        self._state, _ = plant.respond(frames, motor, conditions, begin, c, dt)
        self._contact, self.force, self.conditions = after, force, conditions
        self.frames = replace(frames, p_tcp=frames.p_tcp + (self._state.e - begin.e) @ frames.lever[0])

    def _frames_near(self, q: Array, e: Array) -> Frames:
        """Configuration at q and e; after small changes the last one computed, with the TCP moved along its lever arms."""
        if self._base is not None:
            q_base, e_base, frames = self._base
            dq, de = q - q_base, e - e_base
            if max(float(np.abs(dq).max()), float(np.abs(de).max())) < REUSE:
                de[:, self._plant.axial] += dq
                return replace(frames, p_tcp=frames.p_tcp + de @ frames.lever[0])
        frames = self._plant.frames(q, e)
        self._base = q, e, frames
        return frames

    def idle(self, motor: Array) -> Frames:
        """The configuration at these motor angles, (1, n), without any process force, now."""
        nothing = replace(self.conditions, force=np.zeros((1, 3)), process_on=np.zeros(1, dtype=bool))
        return self._plant.equilibrium(motor, nothing, self._plant.relaxed(motor, nothing))[1]
