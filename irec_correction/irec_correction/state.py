# SPDX-License-Identifier: Apache-2.0
"""The state machine of the correction: when the offset follows the model, is held, faded out, or stays at zero.

             start                 ramped
INACTIVE ------------> RAMP_IN ------------> ACTIVE
    ^  ^                 |  ^  ^               |
    |  |       lost      |  |  |  back   lost  |         stop or outside leads from each of RAMP_IN, ACTIVE and HOLD to FADE;
    |  |                 v  |  |               |         back leads from FADE to RAMP_IN where the model was outside
    |  |                HOLD --+ <-------------+         its envelope, not where an input was lost, and RETURNS times at most.
    |  | faded           | expired
    |  +----------- FADE <
    | stop           | faded after a loss
    +------------- FAULT
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
from irec_calibration.typing import Array

from .errors import SettingsError
from .watchdog import Finding

RETURNS, WITHIN = 3, 10.0  # times that the correction comes back by itself within so many s: one more waits for the operator


class State(IntEnum):
    """Values of irec_msgs/CorrectionState."""

    INACTIVE = 0
    RAMP_IN = 1
    ACTIVE = 2
    HOLD = 3
    FADE = 4
    FAULT = 5


class Event(Enum):
    """What can happen to the correction."""

    START = "start"
    STOP = "stop"
    RAMPED = "ramped"
    LOST = "lost"
    OUTSIDE = "outside"
    BACK = "back"
    EXPIRED = "expired"
    FADED = "faded"


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.INACTIVE, Event.START): State.RAMP_IN,
    (State.RAMP_IN, Event.RAMPED): State.ACTIVE,
    (State.RAMP_IN, Event.LOST): State.HOLD,
    (State.RAMP_IN, Event.OUTSIDE): State.FADE,
    (State.RAMP_IN, Event.STOP): State.FADE,
    (State.ACTIVE, Event.LOST): State.HOLD,
    (State.ACTIVE, Event.OUTSIDE): State.FADE,
    (State.ACTIVE, Event.STOP): State.FADE,
    (State.HOLD, Event.BACK): State.RAMP_IN,
    (State.HOLD, Event.EXPIRED): State.FADE,
    (State.HOLD, Event.OUTSIDE): State.FADE,
    (State.HOLD, Event.STOP): State.FADE,
    (State.FADE, Event.BACK): State.RAMP_IN,
    (State.FADE, Event.FADED): State.FAULT,  # after a loss; after a stop INACTIVE, see Supervisor
    (State.FAULT, Event.STOP): State.INACTIVE,
}


@dataclass(frozen=True)
class StateTimes:
    """Times of the state machine, s.

    Attributes:
        ramp_in: from the present offset to the model's.
        hold: at most this long the last offset is held while an input is missing.
        fade: from the held offset to zero.
        recover: an input must have been sound for this long before the correction comes back.
    """

    ramp_in: float = 0.5
    hold: float = 0.25
    fade: float = 1.0
    recover: float = 0.05

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value < 3600.0:
                raise SettingsError(f"time '{name}' of the correction is {value} s, 0 .. 3600 s is possible")


class Supervisor:
    """Turns what the model wants and what the watchdog found into the target of the offset, tick by tick."""

    def __init__(self, times: StateTimes) -> None:
        self.times = times
        self.state = State.INACTIVE
        self.reason = "not started"
        self._since = 0.0
        self._after = 0.0  # s before the ramp begins
        self._sound_since: float | None = None
        self._held = np.zeros(6)
        self._stopped = True
        self._lost = False
        self._returned: deque[float] = deque()  # when it came back to where the model holds, s
        self._outside = ""  # why it was faded out before that

    def start(self, now: float, present: Array, after: float = 0.0) -> None:
        """Ask for an offset, which begins to change `after` s from now. In FAULT: acknowledge first by `stop`."""
        self._stopped = False
        self._returned.clear()
        if self._go(Event.START, now, present, "ramping in"):
            self._after = after

    def stop(self, now: float, present: Array, reason: str = "stopped") -> None:
        """Ask for no offset: fades out, then INACTIVE. Acknowledges a FAULT."""
        self._stopped = True
        if not self._go(Event.STOP, now, present, reason) and self.state is State.FADE:
            self.reason = reason

    def restart_ramp(self, now: float, present: Array, reason: str) -> None:
        """Another model has been put in force, or the robot begins anew: go on from the present offset."""
        self._held = present.copy()
        if self.state in (State.RAMP_IN, State.ACTIVE):
            self._enter(State.RAMP_IN, now, present, reason)

    def tick(self, now: float, finding: Finding | None, wanted: Array, present: Array) -> Array:
        """Target of the offset.

        Args:
            finding: what is wrong now, or None.
            wanted: offset that the model asks for, (6,), m and rad; read only where nothing is wrong.
            present: offset that is being sent, (6,).
        """
        if now < self._since:  # the clock was set back: what was begun begins again, nothing jumps
            self._since, self._sound_since = now, None
        sound = self._sound_for(now, finding)
        if self.state in (State.RAMP_IN, State.ACTIVE) and finding is not None:
            self._go(Event.OUTSIDE if finding.outside else Event.LOST, now, present, finding.text)
        elif self.state is State.HOLD:
            if finding is not None and finding.outside:
                self._go(Event.OUTSIDE, now, present, finding.text)
            elif sound:
                self._go(Event.BACK, now, present, "input is back")
            elif now - self._since >= self.times.hold:
                self._go(Event.EXPIRED, now, present, self.reason)
                self._lost = True
        elif self.state is State.FADE:
            self._while_fading(now, finding, present, sound)
        elif self.state is State.RAMP_IN and now - self._since >= self._after + self.times.ramp_in:
            self._go(Event.RAMPED, now, present, "")
        return self._target(now, wanted)

    def _while_fading(self, now: float, finding: Finding | None, present: Array, sound: bool) -> None:
        if self._stopped or self._lost:
            faded = now - self._since >= self.times.fade and not np.any(np.abs(present) > ZERO_OFFSET)
            if faded and self._stopped:
                self._enter(State.INACTIVE, now, present, self.reason)
            elif faded:
                self._go(Event.FADED, now, present, self.reason)
        elif sound and self._returns_too_often(now):
            self._lost = True
            self.reason = (
                f"faded out {RETURNS + 1} times within {WITHIN:g} s, {RETURNS} are possible: {self._outside}; does the offset"
                " press the tool into what it touches, or is this load too much for the model? Activate again without it"
            )
        elif sound:
            self._returned.append(now)
            self._go(Event.BACK, now, present, "back where the model holds")
        elif finding is not None and not finding.outside:
            self._lost, self.reason = True, finding.text  # sound input ended while outside: now the operator is needed
        elif finding is not None:
            self.reason = self._outside = finding.text

    def _returns_too_often(self, now: float) -> bool:
        """Where what the offset itself does ends it, it would come and go without end."""
        while self._returned and not 0.0 <= now - self._returned[0] <= WITHIN:
            self._returned.popleft()
        return len(self._returned) >= RETURNS

    def _sound_for(self, now: float, finding: Finding | None) -> bool:
        if finding is not None:
            self._sound_since = None
            return False
        if self._sound_since is None:
            self._sound_since = now
        return now - self._sound_since >= self.times.recover

    def _go(self, event: Event, now: float, present: Array, reason: str) -> bool:
        new = TRANSITIONS.get((self.state, event))
        if new is not None:
            self._enter(new, now, present, reason)
            self._outside = reason if event is Event.OUTSIDE else self._outside
        return new is not None

    def _enter(self, state: State, now: float, present: Array, reason: str) -> None:
        self.state, self.reason, self._since, self._after = state, reason, now, 0.0
        self._held = present.copy()
        if state is State.FADE:
            self._lost = False

    def _target(self, now: float, wanted: Array) -> Array:
        if self.state is State.ACTIVE:
            return wanted
        if self.state is State.RAMP_IN:
            return self._held + _share(now - self._since - self._after, self.times.ramp_in) * (wanted - self._held)
        if self.state is State.HOLD:
            return self._held
        if self.state is State.FADE:
            return self._held * (1.0 - _share(now - self._since, self.times.fade))
        return np.zeros(6)


ZERO_OFFSET = 1e-8  # m or rad: an offset below this counts as zero


def _share(elapsed: float, duration: float) -> float:
    """0 at the start, 1 at the end, without a step in speed."""
    x = float(elapsed >= 0.0) if duration <= 0.0 else min(max(elapsed / duration, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)
