# SPDX-License-Identifier: Apache-2.0
"""A robot for the tests of the state machine: moves take a second, forces follow, the marker moves with the TCP.

The surface is at z = 0 of base_link, and tool0 z points to it along z.
"""

from __future__ import annotations

import numpy as np
from irec_calibration.procedure.checks import Target
from irec_calibration.procedure.commands import CancelMove, Event, ForceSetpoint, MoveJoint, MoveLinear, Row, SwitchMode
from irec_calibration.procedure.machine import Procedure
from irec_calibration.procedure.settings import Settings, Settling
from irec_calibration.procedure.standstill import Streams
from irec_calibration.procedure.table import STATES

FORCES = np.array([[0, 0, -1100.0], [280, 0, -1100], [-280, 0, -1100]])
HOME_TCP = np.array([1.0, 0.0, -0.5])
LEAVES_S = 2.0  # s
NAMES = tuple(f"joint_{i + 1}" for i in range(6))


def settings(**changed: object) -> Settings:
    values: dict = dict(
        home_speed=0.25, linear_speed=0.1, window_s=0.4, settling=Settling(15.0, 5.0, 6e-6, 6e-5, 1e-3), min_samples=20,
        force_abort_n=1600.0, sensor_range_n=2500.0, friction=0.333, repeats=1,
        timeouts={s.name: 10.0 for s in STATES.values() if s.otherwise}, skip_limit=0.5, workspace=np.zeros((2, 3)),
    )  # fmt: skip
    return Settings(**{**values, **changed})


def targets(n: int, bad: dict[int, str] | None = None) -> list[Target]:
    return [
        Target(i, np.full(6, 0.1 * i), None, np.eye(3), np.array([1, 0, -0.15]), np.array([1, 0, -0.003]), (bad or {}).get(i, ""))
        for i in range(1, n + 1)
    ]


class FakeRobot:
    """Runs a Procedure to its end in simulated time; what it answers and reads can be changed at any time."""

    def __init__(
        self,
        n_poses: int = 2,
        bad: dict[int, str] | None = None,
        seed: int = 1,
        order_seed: int | None = None,
        **arguments: object,
    ) -> None:
        asked = settings(**arguments.pop("settings", {}))  # type: ignore[arg-type]
        self.streams = Streams(5.0, tracker=not asked.without_tracker)
        self.procedure = Procedure(
            targets(n_poses, bad), FORCES, np.zeros(6), asked, self.streams,
            {"A": np.eye(3)}, seed=order_seed, **arguments,  # type: ignore[arg-type]
        )  # fmt: skip
        self.rng = np.random.default_rng(seed)
        self.now = 0.0
        self.force_control = False
        self.near_surface = False
        self.presses_in = 0.0  # m/s by which the TCP goes on into the surface in force control
        self.marker_follows = True  # the TCP
        self.wanted = np.zeros(3)
        self.force = np.zeros(3)
        self.marker = np.array([2.0, 0.0, 0.0])
        self.sees_marker = True
        self.delivers_force = True
        self.force_every, self._force_at = 0.0, 0.0  # s between two wrenches; 0: one each tick
        self.delivers_joints = True  # and tcp_pose
        self.torque_lever = np.zeros(3)  # m, of the force, about which the torque is told; and torque that is always there, N m
        self.torque_bias = np.zeros(3)
        self.force_share = np.ones(3)  # what the contact can hold of the wanted force
        self.extra_force = np.zeros(3)
        self.obeys_moves = self.obeys_modes = True
        self.speaks = True  # on robot/state
        self.force_noise = 1.0  # N
        self.lease = 0.5  # s
        self.set_points = 0
        self.says = ""  # in robot/state
        self.retreating = False
        self.tcp = HOME_TCP.copy()
        self.arrives = 1.0  # share of the way that moves go
        self.retracts = True  # False: moves away from the surface are answered and not made
        self.drives_in = 0.0  # N/s by which the force grows on the way out
        self.holds = False  # what was pressed stays in position control until a move leads away
        self.leaves_by_itself = True  # after LEAVES_S in position control with a force that stays, and after a lease
        self.clock = 0.0  # s by which somebody has set the cell's clock
        self.sliding = np.zeros(3)  # m/s
        self.yields = np.zeros(3)  # m/N by which the controller's TCP follows the force
        self.joint_noise = 0.0  # rad
        self.creeping = np.zeros(6)  # rad/s of the joints under load
        self.q = np.zeros(6)
        self.rows: list[Row] = []
        self.events: list[Event] = []
        self.commands: list[object] = []
        self.states: list[str] = []
        self._move: tuple[float, MoveJoint | MoveLinear] | None = None
        self._stood = self._set = 0.0  # when force control was left; when a set point came last
        self._marker_at = self.tcp.copy()

    def run(self, until_s: float = 600.0, stop_when: str = "finished") -> FakeRobot:
        """Advance until the state is reached; raises if it takes longer than until_s of its own time."""
        end = self.now + until_s
        while self.procedure.state != stop_when:
            if self.now > end:
                raise TimeoutError(f"still in {self.procedure.state} after {until_s} s: {self.procedure.message}")
            self.tick()
        return self

    def start(self) -> FakeRobot:
        self.procedure.watch.robot_said(int(self.force_control))
        self.procedure.start()
        return self

    def tick(self, dt: float = 0.01) -> None:
        self.now += dt
        self._read(dt)
        if self._move and self.now >= self._move[0]:
            move, self._move = self._move[1], None
            self._arrive(move)
            self.procedure.move_finished(True)
        self._leave_by_itself()
        if self.speaks:
            self.procedure.watch.robot_said(int(self.force_control), self.retreating, self.says)
        for command in self.procedure.step(self.now + self.clock, self.now):
            self.commands.append(command)
            self._carry_out(command)
        if not self.states or self.states[-1] != self.procedure.state:
            self.states.append(self.procedure.state)

    def _arrive(self, move: MoveJoint | MoveLinear) -> None:
        if isinstance(move, MoveJoint):
            self.q = self.q + self.arrives * (move.q - self.q)
            at = [t.p_approach for t in targets(9) if np.array_equal(t.q_approach, move.q)]
            self.tcp, self.near_surface = (at[0] if at else HOME_TCP).copy(), False
        elif self.retracts or move.p_in_base[2] > self.tcp[2]:
            self.tcp = self.tcp + self.arrives * (move.p_in_base - self.tcp)
            self.near_surface = bool(self.tcp[2] > -0.005)
        else:
            return
        if self.holds and not self.near_surface:
            self.force[:] = 0.0
            self.holds = False

    def _leave_by_itself(self) -> None:
        """The dead man's switch of the contract, in one step."""
        if not self.leaves_by_itself:
            return
        late = self.force_control and self.lease > 0.0 and self.now - self._set > self.lease + 0.3
        stands = self.holds and not self.force_control and self._move is None and self.now - self._stood > LEAVES_S
        if late or stands:
            self.force_control, self.holds, self.near_surface = False, False, False
            self.force[:] = 0.0
            self.tcp = self.tcp - [0.0, 0.0, 0.02]

    def _read(self, dt: float) -> None:
        goal = self.wanted * self.force_share if self.force_control else np.zeros(3)
        if self.holds and not self.force_control:
            goal = self.force
            if self._move and isinstance(self._move[1], MoveLinear) and self.drives_in:
                self.force[2] -= self.drives_in * dt
        self.force += (goal - self.force) * min(1.0, dt / 0.1)
        self.marker = self.marker + self.sliding * dt * self.force_control + (self.tcp - self._marker_at) * self.marker_follows
        self.q = self.q + self.creeping * dt * self.force_control
        self.tcp = self.tcp + self.sliding * dt * self.force_control
        self.tcp = self.tcp + [0.0, 0.0, self.presses_in * dt * self.force_control]
        self._marker_at = self.tcp.copy()  # where the arm gives way the marker stands
        if self.delivers_force and self.now >= self._force_at:
            self._force_at = self.now + self.force_every
            noisy = self.force + self.extra_force + self.rng.normal(0, self.force_noise, 3)
            self.streams.add_wrench(self.now, (*noisy, *(np.cross(self.torque_lever, noisy) + self.torque_bias)))
        if self.sees_marker:
            self.streams.add_marker(self.now, *(self.marker + self.rng.normal(0, 1e-5, 3)), "A")
        if self.delivers_joints:
            q = self.q + (self.rng.normal(0.0, self.joint_noise, 6) if self.joint_noise else 0.0)
            self.streams.add_joints(self.now, NAMES, tuple(q.tolist()))
            self.streams.add_tcp(self.now, *(self.tcp + self.yields * self.force))

    def _carry_out(self, command: object) -> None:
        if isinstance(command, MoveJoint | MoveLinear):
            if self.force_control:
                raise AssertionError("a move was asked for in force control")
            if self.obeys_moves:
                self._move = (self.now + 1.0, command)
        elif isinstance(command, CancelMove):
            self._move = None
        elif isinstance(command, SwitchMode):
            if self.obeys_modes:
                self._stood = self._set = self.now
                self.force_control, self.wanted = command.force, command.force_in_tool
                self.procedure.mode_switched(True, "", self.lease)
            else:
                self.procedure.mode_switched(False, "the robot does not want to")
        elif isinstance(command, ForceSetpoint):
            if not self.force_control:
                raise AssertionError("a force was asked for in position control")
            self.wanted = command.force_in_tool
            self._set = self.now
            self.set_points += 1
        elif isinstance(command, Row):
            self.rows.append(command)
        elif isinstance(command, Event):
            self.events.append(command)

    @property
    def is_safe(self) -> bool:
        """Retracted and in position control."""
        return not self.force_control and not self.near_surface and self._move is None


def keys(robot: FakeRobot) -> list[tuple[int, int, int]]:
    """Pose, repeat and load case of each row that was recorded."""
    return [(r.pose, r.repeat, r.load_case) for r in robot.rows]
