# SPDX-License-Identifier: Apache-2.0
"""The state machine of Procedure 1. It is told the time and the answers of the robot and returns commands and rows.

Nothing here waits or sends: `step` is called often, and whoever calls it carries the commands out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..typing import Array
from .checks import Target, contact_problem
from .commands import CancelMove, Command, Event, ForceSetpoint, MoveJoint, MoveLinear, Row, SwitchMode
from .settings import Settings
from .settle import Streams, Window, unsettled
from .table import NEAR_CONTACT, STATES

SILENCE_S = 3.0  # s of the machine's clock; an instrument that says nothing for longer has stopped


@dataclass
class Counts:
    """What has happened so far."""

    complete: int = 0
    skipped: int = 0
    rejected: int = 0
    seconds: list[float] = field(default_factory=list)


class Procedure:
    """Procedure 1 over a list of poses.

    Args:
        targets: poses in the order of the run; those with a problem are skipped and reported.
        forces: load cases f_j, (M, 3), N, environment on robot in tool0.
        home: joint angles, (k,), rad.
        station_rotation: station name -> rotation of its frame into base_link, (3, 3).
        done: (pose, repeat) that an earlier part of the run has completed.
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
    ) -> None:
        self.forces, self.home, self.settings, self.streams = forces, home, settings, streams
        self.station_rotation = station_rotation
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
        self.state = "idle"
        self.case = 0
        self.message = ""
        self.stopped_because = ""
        self._index = 0
        self._since = self._pose_since = self._window_from = 0.0
        self._out: list[Command] = []
        self._started = self._moved = self._switched = self._moving = False
        self._pause = False
        self._outcome = ""  # of the pose under way: empty, skipped or broken off
        self._now = 0.0
        self._clock_moved = 0.0  # machine's clock when the cell's clock last moved
        self._heard = {name: (-1, 0.0) for name in streams.counts}  # readings so far, machine's clock when they last grew
        self._window: Window | None = None
        self._reference: Window | None = None
        self._recorded = 0

    # --- what the world reports -------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin the run: poses that the robot must not go to are reported, the others measured."""
        for target in self.refused:
            self._out.append(Event("skipped", target.pose, 0, 0, target.problem))
        self.counts.skipped = len(self.refused)
        if self.refused:
            self._check_skip_limit(self.refused[-1].problem)
        self._started = True

    def move_finished(self, success: bool, message: str = "") -> None:
        """Answer to MoveJoint or MoveLinear."""
        self._moving = False
        if success:
            self._moved = True
        elif self.state in ("home", "approach", "advance", "retract"):
            self._fail(f"the move was not carried out: {message}")

    def mode_switched(self, success: bool, message: str = "") -> None:
        """Answer to SwitchMode."""
        if success:
            self._switched = True
        elif self.state in ("force_mode", "position_mode"):
            self._fail(f"the control mode was not switched: {message}")

    def fault(self, message: str) -> None:
        """The robot reports a fault: nothing more can be asked of it."""
        if self.state not in ("finished", "failed"):
            self._add_reason(f"robot fault: {message}")
            self._go("failed")

    def pause(self) -> None:
        """Leave the contact now and wait; the pose under way is measured again from its reference."""
        self._pause = True
        self._break_off()

    def resume(self) -> None:
        """Go on after a pause."""
        self._pause = False

    def stop(self, reason: str) -> None:
        """Cancel or abort: leave the contact, retract, end."""
        if not self.stopped_because:
            self.stopped_because = reason
            self._break_off()

    # --- what is asked about the run --------------------------------------------------------------------------------

    @property
    def target(self) -> Target | None:
        return self.work[self._index][0] if self._index < len(self.work) else None

    @property
    def repeat(self) -> int:
        return self.work[self._index][1] if self._index < len(self.work) else 0

    @property
    def place(self) -> int:
        """Which of the poses of the run is worked on, from 1; pose numbers of a file need not be consecutive."""
        return self._place[self.target.pose] if self.target else self.total

    @property
    def finished(self) -> bool:
        return self.state == "finished"

    def remaining_s(self, now: float) -> float:
        """Estimate of the time to the end, s of the cell's clock."""
        per_pose = float(np.median(self.counts.seconds)) if self.counts.seconds else 6.0 + 2.0 * len(self.forces)
        spent = min(now - self._pose_since, 0.9 * per_pose) if self._index < len(self.work) and self._started else 0.0
        return max(0.0, per_pose * (len(self.work) - self._index) - spent)

    # --- the machine ------------------------------------------------------------------------------------------------

    def step(self, now: float, steady: float) -> list[Command]:
        """Advance as far as the readings allow and return what is to be done, in order.

        Args:
            now: the cell's clock, s; the same clock as the stamps of the readings.
            steady: the machine's clock, s, which also runs when the cell is dead.
        """
        if now != self._now:
            self._now, self._clock_moved = now, steady
        self._watch(steady)
        for _ in range(len(STATES)):
            state = STATES[self.state]
            for guard, following in state.leave:
                if getattr(self, f"when_{guard}")():
                    self._go(following)
                    break
            else:
                timeout = self.settings.timeouts.get(state.name) if state.otherwise else None
                if timeout is None or now - self._since <= timeout:
                    break
                waited_for = f" ({self.message})" if self.message else ""
                self._fail(f"timeout of {timeout:g} s in state {state.name}{waited_for}")
        commands, self._out = self._out, []
        return commands

    def _go(self, name: str) -> None:
        self.state = name
        self._since = getattr(self, "_now", 0.0)
        self.message = ""
        enter: Callable[[], None] = getattr(self, f"enter_{STATES[name].enter}")
        enter()

    def _fail(self, reason: str) -> None:
        """Take the way out that the table names for the present state."""
        way = STATES[self.state].otherwise
        if way == "next_case":
            self._event("rejected", reason)
            self.counts.rejected += 1
            self._go("next_case")
        elif way == "skip_pose":
            self._skip(reason)
            self._cancel_move()
            self._go("position_mode")
        elif way == "next_pose":
            self._skip(reason)
            self._cancel_move()
            self._go("next_pose")
        elif way == "failed":
            self._add_reason(reason)
            self._go("failed")
        else:
            self.stop(reason)

    def _add_reason(self, reason: str) -> None:
        self.stopped_because = f"{self.stopped_because}; {reason}" if self.stopped_because else reason

    def _skip(self, reason: str) -> None:
        self._event("skipped", reason)
        self.counts.skipped += 1
        self._outcome = "skipped"
        self._check_skip_limit(reason)

    def _check_skip_limit(self, reason: str) -> None:
        if self.counts.skipped > self.settings.skip_limit * self.total and not self.stopped_because:
            self.stopped_because = (
                f"{self.counts.skipped} of {self.total} poses could not be measured,"
                f" limit {self.settings.skip_limit:.0%}; the last because: {reason}"
            )

    def _break_off(self) -> None:
        """Leave what is being done: out of contact if there may be contact, else just stop."""
        if self.state in ("idle", "position_mode", "retract", "next_pose", "paused", "finished", "failed"):
            return
        self._outcome = "broken off"
        self._cancel_move()
        self._go("position_mode" if self.state in NEAR_CONTACT else "next_pose")

    def _watch(self, steady: float) -> None:
        """Conditions that end the run in any state that moves the robot or presses."""
        for name, count in self.streams.counts.items():
            if count != self._heard[name][0]:
                self._heard[name] = count, steady
        if self.state in ("idle", "paused", "finished", "failed"):
            return
        if steady - self._clock_moved > 2 * SILENCE_S:
            self.fault("the cell's clock stands still")
        if self.stopped_because:
            return
        for name, (_, heard) in self._heard.items():
            if steady - heard > SILENCE_S:
                self.stop(f"no {name} readings for {SILENCE_S:g} s")
                return
        force = self.streams.newest_force
        if force is not None:
            if np.linalg.norm(force) > self.settings.force_abort_n:
                self.stop(f"force is {np.linalg.norm(force):.0f} N, limit {self.settings.force_abort_n:.0f} N")
            elif np.abs(force).max() > self.settings.sensor_range_n:
                self.stop(f"force sensor reads {np.abs(force).max():.0f} N, its range is {self.settings.sensor_range_n:.0f} N")

    def _event(self, kind: str, text: str) -> None:
        target = self.target
        case = min(self.case, len(self.forces))  # past the last one the pose is complete
        self._out.append(Event(kind, target.pose if target else 0, self.repeat, case, text))

    def _cancel_move(self) -> None:
        if self._moving:
            self._out.append(CancelMove())
            self._moving = False

    def _move(self, command: MoveJoint | MoveLinear) -> None:
        self._moved, self._moving = False, True
        self._out.append(command)

    # --- on entry ---------------------------------------------------------------------------------------------------

    def enter_nothing(self) -> None:
        """Wait for the operator, or be done."""
        if self.state == "paused":
            self._event("paused", "")
        elif self.state == "finished":
            self._event("stopped" if self.stopped_because else "finished", self.stopped_because)

    def enter_move_home(self) -> None:
        """Line 4; the rail stays where it is, since the arm may still be close to the tooling."""
        self._pose_since, self._recorded, self.case, self._outcome = self._since, 0, 0, ""
        self._move(MoveJoint(self.home, None, self.settings.home_speed))

    def enter_move_to_approach(self) -> None:
        """Line 5."""
        target = self.work[self._index][0]
        self._move(MoveJoint(target.q_approach, target.rail, self.settings.home_speed))

    def enter_move_to_reference(self) -> None:
        """Lines 6 and 7."""
        target = self.work[self._index][0]
        self._move(MoveLinear(target.p_reference, target.R_tool_in_base, self.settings.linear_speed))

    def enter_begin_window(self) -> None:
        """Only readings from now on may count."""
        self._window_from = self._since

    def enter_record_and_switch(self) -> None:
        """Lines 8 to 11: the window that stood still is the reference."""
        self._reference = self._window
        self._record(0)
        self._switched, self.case = False, 1
        self._out.append(SwitchMode(True, self.forces[0]))

    def enter_ask_for_force(self) -> None:
        """Line 13."""
        self._window_from = self._since
        self._out.append(ForceSetpoint(self.forces[self.case - 1]))

    def enter_record_row(self) -> None:
        """Lines 14 to 21, unless the contact slips."""
        if self._window is None or self._reference is None:
            raise RuntimeError("record was entered before a window stood still")
        station = self.station_rotation.get(self._reference.station)
        if station is None:
            problem = f"the tracker reports as '{self._reference.station}', which the cell file does not name"
        else:
            R_tool_in_station = station.T @ self.work[self._index][0].R_tool_in_base
            problem = contact_problem(self._window, self._reference, R_tool_in_station, self.settings)
        if problem:
            self._event("rejected", problem)
            self.counts.rejected += 1
            return
        self._record(self.case)
        self._recorded += 1

    def _record(self, load_case: int) -> None:
        if self._window is None:
            raise RuntimeError("nothing stood still that could be recorded")
        pose = self.work[self._index][0].pose
        names, temperature = self.streams.names, dict(self.streams.temperature)
        self._out.append(Row(pose, load_case, self.repeat, self._window, names, temperature))

    def enter_count_case(self) -> None:
        """Line 22."""
        self.case += 1

    def enter_switch_to_position(self) -> None:
        """Line 24."""
        self._switched = False
        self._out.append(SwitchMode(False, np.zeros(3)))

    def enter_move_to_retract(self) -> None:
        """Line 25."""
        target = self.work[self._index][0]
        self._move(MoveLinear(target.p_approach, target.R_tool_in_base, self.settings.linear_speed))

    def enter_count_pose(self) -> None:
        """Line 26; a pose that was broken off is not counted, it is measured again."""
        if self._outcome == "broken off":
            return
        if not self._outcome:
            if self._recorded:
                self._event("complete", f"{self._recorded} of {len(self.forces)} load cases")
                self.counts.complete += 1
                self.counts.seconds.append(self._since - self._pose_since)
            else:
                self._skip("no load case could be recorded")
        self._index += 1

    def enter_give_up(self) -> None:
        """The robot does not obey: stop asking."""
        self._cancel_move()

    # --- guards -----------------------------------------------------------------------------------------------------

    def when_always(self) -> bool:
        """Left at once."""
        return True

    def when_started(self) -> bool:
        """The run may begin, and there is something to do."""
        return self._started

    def when_nothing_to_do(self) -> bool:
        """All poses are measured or refused, or the run was stopped before it began."""
        return bool(self.stopped_because) or (self._started and not self.work)

    def when_moved(self) -> bool:
        """The move asked for has arrived."""
        return self._moved

    def when_switched(self) -> bool:
        """The control mode asked for is active."""
        return self._switched

    def when_force_is_near(self) -> bool:
        """The force has come within twice the settling tolerance of the set point."""
        mean = self.streams.mean_force(self._window_from, 0.25 * self.settings.window_s)
        if mean is None:
            self.message = "waits for force readings"
            return False
        off = float(np.abs(mean - self.forces[self.case - 1]).max())
        self.message = f"force is {off:.0f} N off its set point"
        return off <= 2.0 * self.settings.settling.force_n

    def when_stands_still(self) -> bool:
        """One whole window since entry in which force and marker stand still."""
        window = self.streams.window(self._window_from, self.settings.window_s)
        if window is None:
            newest = self.streams.newest()
            silent = [n for n in ("force", "marker", "joints", "TCP") if newest.get(n, -1.0) < self._now - 0.5]
            self.message = f"no readings of {', '.join(silent)}" if silent else "fills the averaging window"
            self.message += " (tracker: line of sight?)" if "marker" in silent else ""
            return False
        target = None if self.state == "reference" else self.forces[self.case - 1]
        self.message = unsettled(window, self.settings.settling, self.settings.min_samples, target)
        self._window = window
        return not self.message

    def when_cases_left(self) -> bool:
        """Line 12."""
        return self.case <= len(self.forces)

    def when_ending(self) -> bool:
        """Cancelled or aborted."""
        return bool(self.stopped_because)

    def when_pausing(self) -> bool:
        """The operator wants a pause."""
        return self._pause

    def when_resumed(self) -> bool:
        """The operator wants to go on."""
        return not self._pause

    def when_no_pose_left(self) -> bool:
        """Line 3."""
        return self._index >= len(self.work)
