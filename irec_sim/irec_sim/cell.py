# SPDX-License-Identifier: Apache-2.0
"""The simulated cell in steps, usually of 4 ms: the controller, what it commands, and when it switches off.

The arm and what it presses on are in `equilibrium`, what is read of it in `readings`, temperatures in `heat`.
"""

from __future__ import annotations

import math

import numpy as np

from .cellfile import CellFile
from .equilibrium import Equilibrium
from .errors import SimError
from .heat import Heat
from .instruments import InstrumentSettings
from .kinematics import Array, Pose, forward
from .plant import Conditions, Plant
from .readings import Readings
from .sensing import drift_at, motor_angles
from .servo import ForceController, OffsetChannel, Servo
from .truth import Truth

POSITION, FORCE, FAULT = 0, 1, 2  # MODE_ constants of irec_msgs/RobotState
PERIOD = 0.004  # s
_STANDING = 3e-4  # rad/s, below which the arm counts as standing
_LIGHT = 1.5e5  # N/m at the TCP, below which an arm is a light one
_COLLISION = 8000.0  # N, at which the drives switch off
_POSE_REUSE = 5e-4  # rad by which joints may turn before the Jacobian is computed again


def _tuned(cell: CellFile, axial: Array) -> ForceController:
    """The force controller as somebody sets it up for this robot: slower on stiff arms, lateral forces from 5 % of the load on.

    axial: compliances (n,), rad/(N m). The values of the heavy robots are those of the controller's defaults.
    """
    usual = ForceController()
    J = forward(cell.chain, cell.home[None]).jacobian()[0, :3]
    stiffness = 1.0 / float(np.linalg.eigvalsh((J * axial) @ J.T)[-1])
    onset = min(usual.lateral_onset, 0.055 * float(np.abs(cell.load_cases[:, 2]).max()))
    return ForceController(stiffness=usual.stiffness if stiffness > _LIGHT else stiffness, lateral_onset=onset)


class Cell:
    """A cell with one robot. SI units; forces on the robot by the environment, in tool0; positions in base_link.

    Attributes:
        time: simulated time, s; period: s; mode: POSITION, FORCE or FAULT.
        rail_names: names of external axes; rail_range: m.
        offset: translation of the correction that is applied now, in base_link, (3,), m.
        arm: the elastic arm on what it presses on.
    """

    def __init__(
        self, cell: CellFile, truth: Truth, seed: int = 0, settings: InstrumentSettings | None = None, period: float = PERIOD
    ) -> None:
        """Stand at HOME in position control, rail at 0.

        Args:
            period: of a step, s. Force control of a heavy robot bears 0.02, that of a light one PERIOD only.
        """
        self.cell, self.chain = cell, cell.chain
        self.settings = settings or InstrumentSettings()
        self.period, self.time, self.mode = period, 0.0, POSITION
        self.rail_names: tuple[str, ...] = ("ext_rail",) if cell.rail is not None else ()
        self.rail_range: tuple[float, float] = cell.rail[1] if cell.rail is not None else (0.0, 0.0)
        self._rail_axis = cell.rail[0] if cell.rail is not None else np.zeros(3)
        physics = truth.physics()
        self._sensing = physics.sensing
        self._servo = Servo(0.015, cell.chain.velocity)
        self._force_control = _tuned(cell, physics.plant.axial)
        self._channel = OffsetChannel()
        self._readings = Readings(cell, self._sensing, self.settings, seed)
        self._heat = Heat(seed, cell.chain.n)
        self._q_command, self._rail = cell.home.copy(), 0.0
        self._rail_command = 0.0
        self._q = cell.home.copy()  # as the controller reports it
        self._q_plain = cell.home.copy()  # as it would be without the offset
        self._stood = self._leaving = self._q.copy()
        self.offset = np.zeros(3)
        self._setpoint = np.zeros(3)
        self._freed = False
        self._process: Array | None = None
        self._pose: tuple[Array, Pose] | None = None
        self._near: tuple[Array, Array, Array] | None = None
        idle = self._make_conditions(np.zeros(3))
        self.arm = Equilibrium(cell, Plant(cell.chain, physics.plant), self._motor()[None], idle)
        self._read_force()

    # -- commands ---------------------------------------------------------------------------------------------------

    @property
    def commanded(self) -> tuple[Array, float]:
        """Joint angles (n,), rad, and rail position, m, that the servo goes to, without the correction."""
        return self._q_command, self._rail_command

    @property
    def force_setpoint(self) -> Array:
        """What force control seeks, (3,), N, environment on robot in tool0."""
        return self._setpoint.copy()

    @property
    def late_offsets(self) -> int:
        """Times at which an offset was missing for longer than the robot waits without counting."""
        return self._channel.late

    def command(self, q: Array, rail: float) -> None:
        """Set point of the position servo; ignored in fault."""
        if self.mode == FAULT:
            return
        self._q_command, self._rail_command = np.array(q, dtype=float), float(rail)

    def control_force(self, force: Array) -> None:
        """Switch to force control along x, y, z of tool0 with this set point, N.

        Raises:
            SimError: the robot is in fault.
        """
        self._refuse_in_fault()
        self.freeze()
        self._setpoint = np.array(force, dtype=float)
        self.mode = FORCE

    def control_position(self) -> None:
        """Switch to position control where the robot is.

        Raises:
            SimError: the robot is in fault.
        """
        self._refuse_in_fault()
        self.freeze()
        self.mode = POSITION

    def clear_fault(self) -> None:
        """What an operator does after a collision: drives on again, in position control."""
        self.mode = POSITION
        self._freed = True

    def _refuse_in_fault(self) -> None:
        if self.mode == FAULT:
            raise SimError(
                f"the robot is in fault: it met the tooling with more than {_COLLISION:.0f} N; the operator has to clear it"
            )

    def set_force(self, force: Array) -> None:
        """New set point of the force controller, N.

        Raises:
            SimError: the robot is not in force control.
        """
        if self.mode != FORCE:
            raise SimError("the robot is in position control; switch to force control first")
        self._setpoint = np.array(force, dtype=float)

    def set_offset(self, translation: Array, turn: Array, stamp: float) -> None:
        """Correction of the commanded TCP, m and rotation vector in base_link, computed at `stamp` s; stale ones are ignored."""
        if self.time - stamp <= self._channel.fade_after:
            self._channel.take(translation, turn, self.time)

    def fade_offset(self) -> None:
        """Two nodes send offsets: fade the last one out, follow nobody before it is at zero."""
        self._channel.fade()

    def set_process(self, force_in_tool: Array | None) -> None:
        """Process force at the TCP in place of contact with the tooling, N; None: contact again."""
        self._process = None if force_in_tool is None else np.array(force_in_tool, dtype=float)

    def freeze(self) -> None:
        """Stand where the joints are now, with no offset."""
        self._q_command = self._q_plain = self._q.copy()
        self._rail_command = self._rail
        self._channel = OffsetChannel(late=self._channel.late)
        self.offset = np.zeros(3)

    # -- stepping ---------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Advance by one period."""
        self.time += self.period
        before = self._q
        self._q = self._servo.follow(self._q, self._target(), self.period)
        self._q_plain = self._servo.follow(self._q_plain, self._q_command, self.period) if self.mode == POSITION else self._q
        rail_step = (self._rail_command - self._rail) * (1.0 - math.exp(-self.period / self._servo.time_constant))
        self._rail += rail_step
        moving = self._notice_standing(before)
        carriage = self._rail * self._rail_axis
        self.arm.step(self._motor()[None], moving, self._process, carriage, self._make_conditions, self.period)
        self._switch_off_where_crushed()
        self._read_force()

    def _target(self) -> Array:
        if self.mode == FORCE:
            move = self._force_control.displacement(self._setpoint, self._readings.wrench[:3], self.period)
            R, J_inverse = self._nearby()
            self._q_command = self._q_command + J_inverse[:, :3] @ (R @ move)
            return self._q_command
        applied = self._channel.applied(self.time, self.period, self.mode == POSITION)
        self.offset = applied[:3]
        if not applied.any():
            return self._q_command
        return self._q_command + self._nearby()[1] @ applied

    def _nearby(self) -> tuple[Array, Array]:
        """Rotation of tool0 and inverse Jacobian (damped near singularities) at joint angles near the commanded ones."""
        if self._near is None or float(np.abs(self._near[0] - self._q_command).max()) > _POSE_REUSE:
            pose = forward(self.chain, self._q_command[None])
            J = pose.jacobian()[0]
            self._near = self._q_command, pose.R_tool[0], J.T @ np.linalg.inv(J @ J.T + 1e-8 * np.eye(6))
        return self._near[1], self._near[2]

    def _notice_standing(self, before: Array) -> bool:
        """Keep the angles at which the arm stood last and before that; whether it moves now."""
        standing = float(np.abs(self._q - before).max()) < _STANDING * self.period
        if not standing and np.abs(self._q - self._stood).max() > 1e-5 and self._stood is not self._leaving:
            self._leaving = self._stood
        if standing:
            self._stood = self._q if np.abs(self._q - self._stood).max() > 1e-5 else self._stood
        return not standing

    def _motor(self) -> Array:
        return motor_angles(self._sensing, self._q, self._q - self._leaving)

    def _make_conditions(self, force: Array) -> Conditions:
        on = self._process is not None or bool(force.any())
        base_in_cell = (self._rail * self._rail_axis)[None]
        return Conditions(force[None], np.array([self._rail]), self._heat.gears(self.time)[None], np.array([on]), base_in_cell)

    def _switch_off_where_crushed(self) -> None:
        crushed = math.sqrt(float(self.arm.force @ self.arm.force)) > _COLLISION
        if crushed and not self._freed and self.mode != FAULT:
            self.freeze()
            self.mode = FAULT
        self._freed = self._freed and crushed  # a cleared robot may move out of the tooling

    # -- what is measured -------------------------------------------------------------------------------------------

    def _read_force(self) -> None:
        self._readings.read_force(self.time, self.arm.force, self.arm.frames.R_tool[0])

    def joints(self) -> tuple[Array, float]:
        """Joint angles reported by the controller, (n,), rad, and rail position, m."""
        return self._q + self._readings.encoders(), self._rail

    def tcp(self) -> tuple[Array, Array]:
        """tool0 in base_link by the controller: position (3,), m, rotation (3, 3)."""
        if self._pose is None or self._pose[0] is not self._q:
            self._pose = self._q, forward(self.chain, self._q[None])
        pose = self._pose[1]
        return pose.p_tcp[0], pose.R_tool[0]

    def wrench_raw(self) -> Array:
        """Reading of the sensor in its own frame with bias and tool weight, (6,), N and N m."""
        return self._readings.wrench_raw

    def wrench(self) -> Array:
        """Process wrench at the TCP in tool0, bias and weight removed, (6,), N and N m."""
        return self._readings.wrench

    def tracker(self) -> tuple[str, Array] | None:
        """Station that sees the marker and the marker in its frame, (3,), m; None without line of sight or in a drop-out.

        With a delay in the settings this is the reading of that time ago.
        """
        arm = self.arm.frames.R_tool[0] @ (self.cell.marker_in_tool0 + self._sensing.marker_error)
        marker = self._drifted() + arm + self._rail * self._rail_axis
        return self._readings.tracker(self.time, marker, self._q, self._rail)

    def temperatures(self) -> dict[str, float]:
        """degC: ambient, gear_1 .. gear_n."""
        return self._readings.thermometers(self._heat.ambient(self.time), self._heat.gears(self.time))

    # -- the truth, for judging only --------------------------------------------------------------------------------

    def _drifted(self) -> Array:
        ambient = np.array([self._heat.ambient(self.time)])
        return self.arm.frames.p_tcp[0] + drift_at(self._sensing, np.array([self.time]), ambient)[0]

    def true_tcp(self) -> Array:
        """Physical TCP in base_link, (3,), m. For judging a correction, never for making one."""
        return self._drifted()

    def true_force(self) -> Array:
        """Force on the robot at the TCP in tool0, (3,), N."""
        return self.arm.frames.R_tool[0].T @ self.arm.force

    def true_deviation(self) -> Array:
        """Physical TCP against where it would be now without process force and correction, (3,), m in base_link."""
        q = motor_angles(self._sensing, self._q_plain, np.zeros(self.chain.n))[None]
        return self.arm.frames.p_tcp[0] - self.arm.idle(q).p_tcp[0]
