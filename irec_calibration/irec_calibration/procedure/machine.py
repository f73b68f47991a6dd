# SPDX-License-Identifier: Apache-2.0
"""The state machine of Procedure 1. It is told the time and the answers of the robot and returns commands and rows.

Nothing here waits or sends: `step` is called often, and whoever calls it carries the commands out. What a state does on entry is
in entries.py, when it is left in guards.py, what ends a run in any state in watch.py; table.py ties them together.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..typing import Array
from . import entries, guards
from .arrival import found_in_contact
from .checks import Target, lease_problem
from .commands import CancelMove, Command, Event, ForceSetpoint, MoveJoint, MoveLinear, SwitchMode
from .elapsed import CellTime
from .plausible import Plausibility
from .settings import Settings
from .standstill import Streams, Window
from .table import NEAR_CONTACT, PRESSING, STATES, WAY_IN
from .watch import Watch

RENEWALS = 5  # force set points per lease
NO_LEASE_PERIOD = 0.1  # s between force set points where the driver has no lease
ASK_AGAIN = 0.5  # s after which leaving force control is asked for again where it was refused
NOT_BROKEN_OFF = (
    "idle", "position_first", "withdraw", "position_mode", "lift", "retract", "next_pose", "again", "paused", "finished",
    "failed", "stand_off", "let_go", "position_last",
)  # fmt: skip


@dataclass
class Counts:
    """What has happened so far."""

    complete: int = 0
    skipped: int = 0
    rejected: int = 0
    cases: int = 0  # load cases that were tried
    seconds: list[float] = field(default_factory=list)


class Procedure:
    """Procedure 1 over a list of poses.

    Args:
        targets: poses in the order of the run; those with a problem are skipped and reported.
        forces: load cases f_j, (M, 3), N, environment on robot in tool0.
        home: joint angles, (k,), rad.
        station_rotation: station name -> rotation of its frame into base_link, (3, 3).
        done: (pose, repeat) that an earlier part of the run has completed.
        seed: draws the order of the load cases of each pose and repeat; None: as they are numbered.
        plausibility: judges the readings of the standing robot; None: nobody does.
        simulated: the cell's clock is a simulated one.
    """

    def __init__(
        self,
        targets: list[Target],
        forces: Array,
        home: Array,
        settings: Settings,
        streams: Streams,
        station_rotation: dict[str, Array],
        repeats: int = 0,
        done: frozenset[tuple[int, int]] = frozenset(),
        seed: int | None = None,
        plausibility: Plausibility | None = None,
        simulated: bool = True,
    ) -> None:
        self.forces, self.home, self.settings, self.streams = forces, home, settings, streams
        self.station_rotation, self.plausibility, self.seed = station_rotation, plausibility, seed
        self.refused = [target for target in targets if target.problem]
        self.work = [
            (target, repeat)
            for target in targets
            for repeat in range(repeats or settings.repeats)
            if not target.problem and (target.pose, repeat) not in done
        ]
        self.total = len(targets)
        self._place = {target.pose: i for i, target in enumerate(targets, 1)}
        self.counts = Counts()
        self.markers_before = 0  # readings of the tracker when the run began
        self.state = "idle"
        self.message = self.stopped_because = ""
        self.scale_doubt = ""  # why the scale of the force is not known; empty where it is, or may yet be verified
        self.index = 0  # in work
        self.order = tuple(range(1, len(forces) + 1))
        self.case = 0  # which of `order` is under way, from 1
        self.setpoint = np.zeros(3)
        self.force_before: Array | None = None  # mean force when the set point was changed
        self.force_in_air = np.zeros(3)  # read at the approach of the pose under way, (3,), N
        self.force_unloaded = np.zeros(3)  # read at the approach of the pose under way, then at its reference, (3,), N
        self.force_at_move = np.zeros(3)  # when the move under way was asked for, (3,), N; NaN: not known
        self.forces_at_move = 0  # readings of the force until then
        self.p_contact: Array | None = None  # TCP by the controller when contact was made at it, m in base_link
        self.p_touch: Array | None = None  # likewise when the tool touched
        self.p_pressed: list[Array] = []  # mean of it in each load case that was recorded at the pose
        self.lease_s = 0.0
        self.time = CellTime(simulated)
        self.watch = Watch(self)
        self.now = 0.0  # the cell's clock
        self.since = self.window_from = 0.0  # the cell's clock: readings after it count
        self.since_elapsed = self.pose_since = 0.0  # for time-outs
        self.out: list[Command] = []
        self.started = self.moved = self.moving = self.switched = False
        self.moved_from: Array | None = None  # TCP when the move under way was asked for, m in base_link
        self.goal: MoveJoint | MoveLinear | None = None  # of the move that was asked for last
        self.answered_at, self.counts_at_answer = 0.0, dict(streams.counts)  # elapsed time, readings so far
        self.stood_at = np.nan  # cell's clock when the robot stood after it
        self.is_out = False  # nothing has moved since the robot was seen out of contact
        self.found_pressing = self.pause_wanted = False
        self.set_out: set[int] = set()  # poses whose reference was set further out
        self.outcome = ""  # of the pose under way: empty, skipped or broken off
        self.window: Window | None = None
        self.reference: Window | None = None
        self.recorded = 0
        self.last_rejection = ""
        self.switched_at = self._set_at = self._refused_at = 0.0
        self._refusal = ""

    # --- what the world reports -------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin the run: poses that the robot must not go to are reported, the others measured."""
        for target in self.refused:
            self.out.append(Event("skipped", target.pose, 0, 0, target.problem))
        self.counts.skipped = len(self.refused)
        if self.refused:
            self.check_skip_limit(self.refused[-1].problem)
        found, problem = found_in_contact(self)
        self.found_pressing = self.watch.robot_presses or found
        if problem and not self.watch.robot_presses and not self.stopped_because:
            self.stopped_because = problem
        self.markers_before = self.streams.counts["marker"]
        self._doubt_scale()
        self.started = True

    def _doubt_scale(self) -> None:
        """Where the places of the run can't tell the scale of the force, that is said before anything is pressed."""
        if self.plausibility is None or not self.work:
            return
        self.scale_doubt = self.plausibility.scale_doubt_before(np.array([target.R_tool_in_base for target, _ in self.work]))
        if not self.scale_doubt:
            return
        self.out.append(Event("unverified", 0, 0, 0, self.scale_doubt))
        most, limit = float(np.linalg.norm(self.forces, axis=1).max()), self.settings.checks.unverified_n
        if most > limit > 0.0 and not self.stopped_because:
            self.stopped_because = (
                f"{self.scale_doubt}. Asked for are up to {most:.0f} N, and more than {limit:g} N (procedure.checks.unverified_n)"
                " is not pressed with a scale that nobody knows"
            )

    def move_finished(self, success: bool, message: str = "") -> None:
        """Answer to MoveJoint or MoveLinear."""
        self.moving = False
        if success:
            self.moved = True
            self.answered_at, self.counts_at_answer = self.time.elapsed, dict(self.streams.counts)
        elif self.state in ("withdraw", "home", "approach", *WAY_IN, "lift", "retract"):
            self.fail(f"the move was not carried out: {message}")

    def mode_switched(self, success: bool, message: str = "", force_lease: float = 0.0) -> None:
        """Answer to SwitchMode; force_lease: s for which the driver takes a force set point to hold, 0: for ever."""
        if success:
            self.switched, self.lease_s, self.switched_at = True, force_lease, self.time.elapsed
            if (self.state == "position_first" or force_lease != 0.0) and (
                problem := lease_problem(force_lease, self.settings.operator_at_robot)
            ):
                self.stop(problem)
        elif self.state == "force_mode":
            self.fail(f"the control mode was not switched: {message}")
        elif self.state == "let_go":
            self.message = f"the control mode was not switched: {message}"
        elif self.state in ("position_first", "position_mode", "position_last"):  # the robot may be leaving by itself
            self._refused_at, self._refusal = self.time.elapsed, f"the control mode was not switched: {message}"

    def fault(self, message: str) -> None:
        """The robot reports a fault: nothing more can be asked of it."""
        if self.state not in ("finished", "failed"):
            self.add_reason(f"robot fault: {message}")
            self.go("failed")

    def pause(self) -> None:
        """Leave the contact now and wait; the pose under way is measured again from its reference."""
        self.pause_wanted = True
        self.break_off()

    def resume(self) -> None:
        """Go on after a pause."""
        self.pause_wanted = False

    def stop(self, reason: str) -> None:
        """Cancel or abort: leave the contact, retract, end."""
        if not self.stopped_because:
            self.stopped_because = reason
            self.break_off()

    # --- what is asked about the run --------------------------------------------------------------------------------

    @property
    def target(self) -> Target | None:
        return self.work[self.index][0] if self.index < len(self.work) else None

    @property
    def repeat(self) -> int:
        return self.work[self.index][1] if self.index < len(self.work) else 0

    @property
    def load_case(self) -> int:
        """Number j of the load case under way: 0 before the first and after the last."""
        return self.order[self.case - 1] if 1 <= self.case <= len(self.order) else 0

    @property
    def place(self) -> int:
        """Which of the poses of the run is worked on, from 1; pose numbers of a file need not be consecutive."""
        return self._place[self.target.pose] if self.target else self.total

    @property
    def pausing(self) -> bool:
        """The operator wants a pause."""
        return self.pause_wanted

    @property
    def finished(self) -> bool:
        return self.state == "finished"

    def remaining_s(self) -> float:
        """Estimate of the time to the end, s of the cell's clock."""
        per_pose = float(np.median(self.counts.seconds)) if self.counts.seconds else 6.0 + 2.0 * len(self.forces)
        spent = min(self.time.elapsed - self.pose_since, 0.9 * per_pose) if self.index < len(self.work) and self.started else 0.0
        return max(0.0, per_pose * (len(self.work) - self.index) - spent)

    # --- the machine ------------------------------------------------------------------------------------------------

    def step(self, now: float, steady: float) -> list[Command]:
        """Advance as far as the readings allow and return what is to be done, in order.

        Args:
            now: the cell's clock, s; the same clock as the stamps of the readings.
            steady: the machine's clock, s, which nobody can set and which also runs when the cell is dead.
        """
        self.now = now
        self.time.look(now, steady)
        self.watch.look(steady)
        for _ in range(len(STATES)):
            state = STATES[self.state]
            for guard, following in state.leave:
                leaves = guards.GUARDS[guard](self)
                if self.state != state.name:  # what was found has ended the state
                    break
                if leaves:
                    self.go(following)
                    break
            else:
                timeout = self.settings.timeouts.get(state.timeout or state.name) if state.otherwise else None
                if timeout is None or self.in_state_s <= timeout:
                    break
                waited_for = f" ({self._refusal or self.message})" if self._refusal or self.message else ""
                self.fail(f"timeout of {timeout:g} s in state {state.name}{waited_for}")
        self._renew()
        commands, self.out = self.out, []
        return commands

    @property
    def in_state_s(self) -> float:
        """Time in the present state, s of the cell's clock."""
        return self.time.elapsed - self.since_elapsed

    def _renew(self) -> None:
        """Send the force set point again before its lease ends; ask again to leave force control where that was refused."""
        if self.state in PRESSING:
            period = self.lease_s / RENEWALS if self.lease_s > 0.0 else NO_LEASE_PERIOD
            if self.time.elapsed - self._set_at >= period:
                self.set_force(self.setpoint)
        elif self._refusal and not self.switched and self.time.elapsed - self._refused_at >= ASK_AGAIN:
            self._refused_at = self.time.elapsed
            self.out.append(SwitchMode(False, np.zeros(3)))

    def go(self, name: str) -> None:
        """Enter a state."""
        self.state, self.since, self.since_elapsed = name, self.now, self.time.elapsed
        self.message = self._refusal = ""
        entries.ENTRIES[STATES[name].enter](self)

    def fail(self, reason: str) -> None:
        """Take the way out that the table names for the present state."""
        way = STATES[self.state].otherwise
        if way == "next_case":
            self.reject(reason)
            self.go("next_case")
        elif self.state == "contact" and not self.counts.complete:
            self.stop(f"no contact could be made at the first pose: {reason}")  # it will be so at each
        elif way in ("skip_pose", "next_pose"):
            self.skip(reason)
            self.cancel_move()
            self.go("position_mode" if way == "skip_pose" else "next_pose")
        elif way in ("failed", "stand_off", "let_go"):
            self.add_reason(reason)
            self.go(way)
        else:
            self.stop(reason)

    def add_reason(self, reason: str) -> None:
        """One more reason for the end of the run."""
        self.stopped_because = f"{self.stopped_because}; {reason}" if self.stopped_because else reason

    def reject(self, reason: str) -> None:
        """The load case under way is not recorded."""
        self.event("rejected", reason)
        self.counts.rejected += 1
        self.last_rejection = reason

    def skip(self, reason: str) -> None:
        """The pose under way is given up."""
        self.event("skipped", reason)
        self.counts.skipped += 1
        self.outcome = "skipped"
        self.check_skip_limit(reason)

    def discard(self, reason: str) -> None:
        """What was recorded of the pose under way does not count; it is measured again by a run that goes on with this one."""
        if self.recorded:
            self.event("discarded", reason)
            self.recorded = 0
        if not self.outcome:
            self.skip(reason)

    def check_skip_limit(self, reason: str) -> None:
        """End the run where too many poses could not be measured."""
        if self.counts.skipped > self.settings.skip_limit * self.total and not self.stopped_because:
            self.stopped_because = (
                f"{self.counts.skipped} of {self.total} poses could not be measured,"
                f" limit {self.settings.skip_limit:.0%}; the last because: {reason}"
            )

    def break_off(self) -> None:
        """Leave what is being done: out of contact if there may be contact, else just stop."""
        if self.state in NOT_BROKEN_OFF:
            return
        self.outcome = "broken off"
        self.cancel_move()
        self.go("position_mode" if self.state in NEAR_CONTACT else "next_pose")

    def event(self, kind: str, text: str) -> None:
        """For the record."""
        target = self.target
        case = self.load_case if self.case <= len(self.forces) else len(self.forces)  # past the last one the pose is complete
        self.out.append(Event(kind, target.pose if target else 0, self.repeat, case, text))

    def cancel_move(self) -> None:
        """Stop on the path."""
        if self.moving:
            self.out.append(CancelMove())
            self.moving = False

    def move(self, command: MoveJoint | MoveLinear) -> None:
        """Ask for a move."""
        self.moved, self.moving, self.goal, self.is_out, self.stood_at = False, True, command, False, np.nan
        tcp, force = self.streams.newest_tcp, self.streams.newest_force
        self.moved_from = None if tcp is None else tcp[0]
        self.force_at_move = np.full(3, np.nan) if force is None else force
        self.forces_at_move = self.streams.counts["force"]
        self.out.append(command)

    def switch(self, force: bool, force_in_tool: Array) -> None:
        """Ask for a control mode."""
        self.switched, self.setpoint = False, force_in_tool
        self.out.append(SwitchMode(force, force_in_tool))

    def set_force(self, force_in_tool: Array) -> None:
        """Set point and renewal of its lease."""
        self.setpoint, self._set_at = force_in_tool, self.time.elapsed
        self.out.append(ForceSetpoint(force_in_tool))
