# SPDX-License-Identifier: Apache-2.0
"""The simulated cell in steps of 4 ms: controller, elastic robot in equilibrium with tooling or process, instruments.

Each step solves the static equilibrium of arm and contact together (quasi-static: the arm has no mass to accelerate). The
solution of the step before is so near that one pass settles it to below a nanometre once the robot stands.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .cellfile import CellFile
from .contact import Contact, Disc, solve_contact
from .errors import SimError
from .instruments import Delay, InstrumentSettings, Noise
from .kinematics import Array, Pose, forward, skew
from .plant import Conditions, Frames, Plant
from .sensing import AMBIENT, drift_at, force_reading, motor_angles, tracker_reading
from .servo import ForceController, OffsetChannel, Servo
from .sight import visible
from .truth import Truth

POSITION, FORCE, FAULT = 0, 1, 2  # MODE_ constants of irec_msgs/RobotState
PERIOD = 0.004  # s
_STANDING = 3e-4  # rad/s, below which the arm counts as standing
_STILL = 1e-9  # rad, below which a free arm keeps the equilibrium it has
_FORCE_TOLERANCE = 0.5  # N, change of the contact force in a pass that calls for another; 1 N is a micrometre
_MAX_PASSES = 6
_LIGHT = 1.5e5  # N/m at the TCP, below which an arm is a light one
_COLLISION = 8000.0  # N, at which the drives switch off
_REUSE = 5e-5  # rad and m by which the configuration may change before lever arms are computed again
_POSE_REUSE = 5e-4  # rad by which joints may turn before Jacobian and line of sight are computed again


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
    """

    def __init__(self, cell: CellFile, truth: Truth, seed: int = 0, settings: InstrumentSettings | None = None) -> None:
        """Stand at HOME in position control, rail at 0."""
        self.cell, self.chain = cell, cell.chain
        self.settings = settings or InstrumentSettings()
        self.period, self.time, self.mode = PERIOD, 0.0, POSITION
        self.rail_names: tuple[str, ...] = ("ext_rail",) if cell.rail is not None else ()
        self.rail_range: tuple[float, float] = cell.rail[1] if cell.rail is not None else (0.0, 0.0)
        self._rail_axis = cell.rail[0] if cell.rail is not None else np.zeros(3)
        physics = truth.physics()
        self._plant, self._sensing = Plant(cell.chain, physics.plant), physics.sensing
        self._disc = Disc(friction=cell.friction)
        self._servo = Servo(0.015, cell.chain.velocity)
        self._force_control = _tuned(cell, physics.plant.axial)
        self._channel = OffsetChannel()
        self._noise = Noise(seed, self.settings, cell.chain.n, len(cell.stations))
        self._force_delay: Delay[Array] = Delay(self.settings.force_delay)
        self._tracker_delay: Delay[tuple[str, Array] | None] = Delay(self.settings.tracker_delay)
        self._heat = np.random.default_rng([seed, 99])
        self._rise, self._warm_time = (
            self._heat.uniform(6.0, 18.0, cell.chain.n),
            self._heat.uniform(1200.0, 3600.0, cell.chain.n),
        )
        self._swing = self._heat.uniform(0.3, 1.0), self._heat.uniform(1500.0, 3500.0), self._heat.uniform(0.0, 2.0 * math.pi)
        self._q_command, self._rail = cell.home.copy(), 0.0
        self._rail_command = 0.0
        self._q = cell.home.copy()  # as the controller reports it
        self._q_plain = cell.home.copy()  # as it would be without the offset
        self._stood = self._leaving = self._q.copy()
        self.offset = np.zeros(3)
        self._setpoint = np.zeros(3)
        self._freed = False
        self._process: Array | None = None
        self._contact = Contact()
        self._base: tuple[Array, Array, Frames] | None = None
        self._settled_at = np.full((1, cell.chain.n), np.inf)
        self._pose: tuple[Array, Pose] | None = None
        self._near: tuple[Array, Array, Array] | None = None
        self._sight: tuple[Array, float, int | None] | None = None
        self._gear_cache: tuple[float, Array] = (-math.inf, np.zeros(cell.chain.n))
        self._cross_tcp, self._cross_com = skew(cell.chain.p_tcp), skew(cell.chain.tool_com)
        self._conditions = self._make_conditions(np.zeros(3))
        self._state = self._plant.relaxed(self._motor()[None], self._conditions)
        self._state, self._frames = self._plant.equilibrium(self._motor()[None], self._conditions, self._state)
        self._force = np.zeros(3)  # on the robot, in base_link
        self._raw = np.zeros(6)
        self._wrench = np.zeros(6)
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
        self._freeze()
        self._setpoint = np.array(force, dtype=float)
        self.mode = FORCE

    def control_position(self) -> None:
        """Switch to position control where the robot is.

        Raises:
            SimError: the robot is in fault.
        """
        self._refuse_in_fault()
        self._freeze()
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

    def set_process(self, force_in_tool: Array | None) -> None:
        """Process force at the TCP in place of contact with the tooling, N; None: contact again."""
        self._process = None if force_in_tool is None else np.array(force_in_tool, dtype=float)

    def _freeze(self) -> None:
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
        self._settle(moving)
        self._read_force()

    def _target(self) -> Array:
        if self.mode == FORCE:
            move = self._force_control.displacement(self._setpoint, self._wrench[:3], self.period)
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

    def _ambient(self, t: float) -> float:
        size, period, phase = self._swing
        return AMBIENT + size * math.sin(2.0 * math.pi * t / period + phase) + 2e-4 * t

    def _gears(self, t: float) -> Array:
        if t - self._gear_cache[0] > 1.0:
            self._gear_cache = t, self._ambient(t) + 3.0 + self._rise * (1.0 - np.exp(-t / self._warm_time))
        return self._gear_cache[1]

    def _make_conditions(self, force: Array) -> Conditions:
        on = self._process is not None or bool(force.any())
        return Conditions(force[None], np.array([self._rail]), self._gears(self.time)[None], np.array([on]))

    def _settle(self, moving: bool) -> None:
        """Equilibrium of arm and contact at the new motor angles.

        Lever arms are taken from a configuration at most _REUSE away, which leaves nanometres. A free arm that moves winds up
        no friction: its gears turn.
        """
        plant, q = self._plant, self._motor()[None]
        free = self._process is None and not self._contact.touching
        if free and not plant.creeps and float(np.abs(q - self._settled_at).max()) < _STILL:
            return  # nothing pushes and nothing moves
        self._settled_at = q
        begin, force = self._state, self._force
        frames = self._frames_near(q, begin.e)
        in_cell = self._rail * self._rail_axis
        after = Contact()
        conditions = self._make_conditions(force)
        if free and moving:
            begin = plant.released(frames, q, conditions, begin)
        c = plant.compliance(q, conditions)
        if self._process is None:
            compliance = plant.tcp_compliance(frames, c)[0]
            for _ in range(_MAX_PASSES):
                trial, _ = plant.respond(frames, q, conditions, begin, c, self.period)
                p = frames.p_tcp[0] + (trial.e - begin.e)[0] @ frames.lever[0] + in_cell
                answer, after = solve_contact(
                    self._disc, self.cell.surface.gap, p - compliance @ force, compliance, self._contact, force
                )
                change = float(np.abs(answer - force).max())
                force = answer
                if change < _FORCE_TOLERANCE:
                    break
                conditions = self._make_conditions(force)
        else:
            force = frames.R_tool[0] @ self._process
            conditions = self._make_conditions(force)
        self._state, _ = plant.respond(frames, q, conditions, begin, c, self.period)
        self._contact, self._force, self._conditions = after, force, conditions
        crushed = math.sqrt(float(force @ force)) > _COLLISION
        if crushed and not self._freed and self.mode != FAULT:
            self._freeze()
            self.mode = FAULT
        self._freed = self._freed and crushed  # a cleared robot may move out of the tooling
        p_tcp = frames.p_tcp + (self._state.e - begin.e) @ frames.lever[0]
        self._frames = replace(frames, p_tcp=p_tcp)

    def _frames_near(self, q: Array, e: Array) -> Frames:
        """Configuration at q and e; after small changes the last one computed, with the TCP moved along its lever arms."""
        if self._base is not None:
            q_base, e_base, frames = self._base
            dq, de = q - q_base, e - e_base
            if max(float(np.abs(dq).max()), float(np.abs(de).max())) < _REUSE:
                de[:, self._plant.axial] += dq
                return replace(frames, p_tcp=frames.p_tcp + de @ frames.lever[0])
        frames = self._plant.frames(q, e)
        self._base = q, e, frames
        return frames

    # -- what is measured -------------------------------------------------------------------------------------------

    def _read_force(self) -> None:
        R = self._frames.R_tool
        clean = force_reading(self._sensing, self.cell.sensor_axis, (R[0].T @ self._force)[None], R)[0]
        noise = self._noise.force(self.time)
        chain = self.chain
        R_sensor = R[0] @ chain.R_tcp.T
        weight = R_sensor.T @ np.array([0.0, 0.0, -9.81 * chain.tool_mass])
        at_sensor = chain.R_tcp @ clean
        raw = np.concatenate([at_sensor + weight, self._cross_tcp @ at_sensor + self._cross_com @ weight])
        raw += noise + np.array(self.settings.force_bias)
        wrench = np.concatenate([clean, np.zeros(3)])
        wrench[:3] += chain.R_tcp.T @ noise[:3]
        wrench[3:] += chain.R_tcp.T @ (noise[3:] - self._cross_tcp @ noise[:3])
        both = self._force_delay.pass_through(self.time, np.concatenate([raw, wrench]))
        self._raw, self._wrench = both[:6], both[6:]

    def joints(self) -> tuple[Array, float]:
        """Joint angles reported by the controller, (n,), rad, and rail position, m."""
        return self._q + self._noise.encoder(), self._rail

    def tcp(self) -> tuple[Array, Array]:
        """tool0 in base_link by the controller: position (3,), m, rotation (3, 3)."""
        if self._pose is None or self._pose[0] is not self._q:
            self._pose = self._q, forward(self.chain, self._q[None])
        pose = self._pose[1]
        return pose.p_tcp[0], pose.R_tool[0]

    def wrench_raw(self) -> Array:
        """Reading of the sensor in its own frame with bias and tool weight, (6,), N and N m."""
        return self._raw

    def wrench(self) -> Array:
        """Process wrench at the TCP in tool0, bias and weight removed, (6,), N and N m."""
        return self._wrench

    def tracker(self) -> tuple[str, Array] | None:
        """Station that sees the marker and the marker in its frame, (3,), m; None without line of sight or in a drop-out.

        With a delay in the settings this is the reading of that time ago.
        """
        R = self._frames.R_tool[0]
        marker = self._drifted() + R @ (self.cell.marker_in_tool0 + self._sensing.marker_error) + self._rail * self._rail_axis
        moved = (
            self._sight is None
            or np.abs(self._sight[0] - self._q).max() > _POSE_REUSE
            or abs(self._sight[1] - self._rail) > _POSE_REUSE
        )
        if moved:
            self._sight = self._q, self._rail, visible(self.cell, self._q, self._rail, marker)
        index = self._sight[2] if self._sight is not None else None
        reading: tuple[str, Array] | None = None
        if index is not None and not self._noise.drop_outs[index].silent(self.time):
            name, p_station, R_station = self.cell.stations[index]
            shifted = np.array([self.time >= self._sensing.shift_time])
            clean = tracker_reading(self._sensing, marker[None], index, p_station, R_station, shifted)[0]
            noise = self.cell.noise
            sigma = math.hypot(noise["tracker_m"], noise["tracker_m_per_m"] * float(np.linalg.norm(clean)))
            reading = name, clean + self._noise.tracker(index, self.time, sigma)
        return self._tracker_delay.pass_through(self.time, reading)

    def temperatures(self) -> dict[str, float]:
        """degC: ambient, gear_1 .. gear_n."""
        values = np.concatenate([[self._ambient(self.time)], self._gears(self.time)])
        values = np.round(values + self._noise.temperature.normal(0.0, 0.02, values.shape), 2)
        return dict(zip(["ambient", *(f"gear_{k + 1}" for k in range(self.chain.n))], values.tolist(), strict=True))

    # -- the truth, for judging only --------------------------------------------------------------------------------

    def _drifted(self) -> Array:
        return self._frames.p_tcp[0] + drift_at(self._sensing, np.array([self.time]), np.array([self._ambient(self.time)]))[0]

    def true_tcp(self) -> Array:
        """Physical TCP in base_link, (3,), m. For judging a correction, never for making one."""
        return self._drifted()

    def true_force(self) -> Array:
        """Force on the robot at the TCP in tool0, (3,), N."""
        return self._frames.R_tool[0].T @ self._force

    def true_deviation(self) -> Array:
        """Physical TCP against where it would be now without process force and correction, (3,), m in base_link."""
        q = motor_angles(self._sensing, self._q_plain, np.zeros(self.chain.n))[None]
        idle = replace(self._conditions, force=np.zeros((1, 3)), process_on=np.zeros(1, dtype=bool))
        _, frames = self._plant.equilibrium(q, idle, self._plant.relaxed(q, idle))
        return self._frames.p_tcp[0] - frames.p_tcp[0]
