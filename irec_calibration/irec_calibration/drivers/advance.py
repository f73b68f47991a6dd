# SPDX-License-Identifier: Apache-2.0
"""Whether the force follows where force control advances: a sensor that does not measure any more leaves the tool pressing on.

What is looked at is the way along tool z, as joint states say it, and the force against it. On the way to the contact nothing is
expected of the force; from its first change on it has to rise with the way, and fall with the way back only.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ..typing import Array
from .settings import Settings

SOFTEST = 0.1  # of contact_stiffness: less is no contact (the true one is at most 4 times softer)
PRESSES = 0.2  # of the set point: a force from which on force control began in contact; less may be bias that was not removed
OF = 3  # readings, of which the middle one counts: a single one that is wrong says nothing
SMOOTHED = 0.05  # s, time constant of the force that is judged
STEP = 0.25  # of `advance`: what is looked at for a rise
FELL_WITHIN = 0.3  # s
FELL_SHARE = 0.5  # of the force


class AdvanceWatch:
    """Of one robot; forces are N, of the environment on the robot in tool0, (3,)."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._least = SOFTEST * settings.contact_stiffness  # N/m
        self._newest: deque[Array] = deque(maxlen=OF)
        self._force: Array | None = None  # smoothed
        self._way: float | None = None  # along tool z, m, smoothed as the force is
        self._share = 1.0  # of what is new in this tick
        self._in_air = np.zeros(3)
        self._from: Array | None = None  # TCP at the begin, or where the contact was lost, (3,), m
        # way, m, and force, N, from which on a rise is expected; None: no contact
        self._anchor: tuple[float, float] | None = None
        self._late: deque[tuple[float, float, float]] = deque()  # time, way, force

    def read(self, dt: float, force: Array) -> None:
        """A tick of dt s with this force, in any control mode."""
        self._newest.append(force)
        usual = np.median(self._newest, axis=0)
        if self._force is None:
            self._force = usual
        self._share = 1.0 - math.exp(-dt / SMOOTHED)
        self._force = self._force + self._share * (usual - self._force)

    def begin(self, asked: Array) -> None:
        """Force control begins; asked: its set point."""
        self._from, self._way, self._anchor = None, None, None
        self._late.clear()
        force = self._force if self._force is not None else np.zeros(3)
        self._in_air = np.zeros(3) if float(np.linalg.norm(force)) >= self._presses(asked) else force.copy()

    def _presses(self, asked: Array) -> float:
        return max(self._settings.touch, PRESSES * float(np.linalg.norm(asked)))

    def problem(self, now: float, p: Array, z: Array, asked: Array) -> str:
        """Why the robot has to leave; empty where the force follows. p: TCP (3,), m; z: tool z, both in base_link."""
        if self._force is None:
            return ""
        if self._from is None or self._way is None:
            self._from, self._way = p.copy(), float(p @ z)
        way, force = float(p @ z), -float(self._force[2])
        self._way += self._share * (way - self._way)
        change = float(np.linalg.norm(self._force - self._in_air))
        if fell := self._fell(now, self._way, force):
            return fell
        if change >= self._settings.first_touch * (1.0 if self._anchor is None else 0.5):
            return self._not_followed(way, force)
        if self._anchor is not None:
            self._anchor, self._from = None, p.copy()
        return self._too_far(float(np.linalg.norm(p - self._from)))

    def _too_far(self, way: float) -> str:
        if way <= self._settings.approach:
            return ""
        return (
            f"force control has moved the tool by {1e3 * way:.0f} mm without contact, limit {1e3 * self._settings.approach:g} mm"
            " (approach_limit): is the surface where it should be, and does the force sensor measure?"
        )

    def _not_followed(self, way: float, force: float) -> str:
        """way along tool z, m; force against it, N."""
        if self._anchor is None or way < self._anchor[0]:
            self._anchor = way, force
            return ""
        advanced, rise = way - self._anchor[0], force - self._anchor[1]
        expected = self._least * advanced
        if advanced >= STEP * self._settings.advance and rise >= expected:
            self._anchor = way, force
            return ""
        if advanced <= self._settings.advance:
            return ""
        return (
            f"the tool has advanced {1e3 * advanced:.1f} mm in contact and the force has risen by {rise:.0f} N, at least"
            f" {expected:.0f} N were to be expected (a tenth of contact_stiffness): does the force sensor still measure?"
        )

    def _fell(self, now: float, way: float, force: float) -> str:
        while self._late and self._late[0][0] < now - FELL_WITHIN:
            self._late.popleft()
        self._late.append((now, way, force))
        _, way_then, then = max(self._late, key=lambda one: one[2])
        fall = then - force
        drawn_back = SOFTEST * fall / self._settings.contact_stiffness  # m, at least, where it fell by that
        if fall < max(2.0 * self._settings.touch, FELL_SHARE * then) or way_then - way >= drawn_back:
            return ""
        return (
            f"the force has fallen from {then:.0f} to {force:.0f} N within {FELL_WITHIN:g} s while the tool stood: has it slid"
            " off, or was the force sensor zeroed?"
        )
