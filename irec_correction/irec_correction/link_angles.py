# SPDX-License-Identifier: Apache-2.0
"""From the angles behind the gears to their windup: beside the motor-side angles of the same moment, less what a dry drive shows.

An arm that moves at 1 rad/s turns ten times further within 4 ms than its gears wind up under the process, so that angles are
compared at one stamp only: motor-side angles are remembered, and told between two samples. Gravity winds gears up too, and
encoders are eccentric; both are the same on the same course without process, which the table of a dry drive holds.
"""

from __future__ import annotations

import io
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.files.regular import TABLE_LIMIT, read_text
from irec_calibration.sensors.dry_drive import LINK
from irec_calibration.typing import Array

from .errors import SettingsError
from .figures import fixed, signed
from .watchdog import Fault, Finding

REMEMBERED = 100  # samples of the motor-side angles
GAP = 0.05  # s between two of them, over which nothing is told
OFF_WAY = 0.01  # rad, any joint, beyond which the robot is not where the dry drive went
_NEAR = 200  # rows of the dry drive about the last one, among which the robot is looked for first


@dataclass(frozen=True)
class DryDrive:
    """Motor-side angles q (k, n) along a drive without process, and windup, link-side minus motor-side, there (k, n), rad."""

    q: Array
    windup: Array

    def __post_init__(self) -> None:
        if self.q.ndim != 2 or len(self.q) < 1 or self.windup.shape != self.q.shape:
            raise SettingsError(
                f"a dry drive needs joint angles (k, n) and as many windups, not {self.q.shape}, {self.windup.shape}"
            )
        if not (np.isfinite(self.q).all() and np.isfinite(self.windup).all()):
            raise SettingsError("a dry drive holds values that are not finite")


def read_dry_drive(path: str | Path, joint_names: Sequence[str]) -> DryDrive:
    """A table (CSV) with a column for each joint, motor-side, and `link_` before its name, link-side, rad (`irec links`).

    Raises:
        SettingsError: not such a table; says which column is missing.
    """
    columns = [*joint_names, *(LINK + n for n in joint_names)]
    try:
        text = read_text(path, "dry drive", SettingsError, TABLE_LIMIT)
        if not text.strip():
            raise ValueError("it is empty")
        table = np.atleast_1d(np.genfromtxt(io.StringIO(text), delimiter=",", names=True, dtype=float))
    except (ValueError, IndexError) as error:  # IndexError: nothing but comments
        raise SettingsError(f"{path}: not a dry drive that can be read: {error}") from error
    missing = [c for c in columns if c not in (table.dtype.names or ())]
    if missing or table.size < 1:
        raise SettingsError(f"{path}: a dry drive has columns {', '.join(columns)} and a row or more; missing: {missing}")
    q, link = (np.stack([table[c] for c in part], axis=1) for part in (columns[: len(joint_names)], columns[len(joint_names) :]))
    try:
        return DryDrive(q, link - q)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


class LinkAngles:
    """Pairs both sides of the gears. Times are seconds on one clock, given by the caller."""

    def __init__(self, joints: int, clock_tolerance: float, dry: DryDrive | None = None) -> None:
        """Args: joints: how many; clock_tolerance: largest distance of a stamp from now, s; dry: None: nothing is taken off.

        Raises:
            SettingsError: the dry drive is one of a robot with other joints.
        """
        if dry is not None and dry.q.shape[1] != joints:
            raise SettingsError(f"the dry drive is of {dry.q.shape[1]} joints, the robot has {joints}")
        self._n, self._tolerance, self._dry = joints, clock_tolerance, dry
        self._motor: deque[tuple[float, Array]] = deque(maxlen=REMEMBERED)
        self._waiting: tuple[float, Array] | None = None
        self._last, self._row = -math.inf, -1

    def take_motor(self, stamp: float, q: Array) -> tuple[float, Array | Finding] | None:
        """Motor-side angles (n,), rad, that are believed; what a sample that waited for them gives, as `take_link`."""
        if self._motor and stamp <= self._motor[-1][0]:
            if stamp == self._motor[-1][0]:
                return None
            self._motor.clear()  # the clock was set back
        self._motor.append((stamp, np.array(q, dtype=float)))
        if self._waiting is None or self._waiting[0] > stamp:
            return None
        (at, link), self._waiting = self._waiting, None
        return at, self._windup(at, link)

    def take_link(self, stamp: float, now: float, link: Array) -> tuple[float, Array | Finding] | None:
        """Link-side angles (n,), rad.

        Returns:
            their stamp and windup (n,), rad, less that of the dry drive, or what is wrong with them; None while the motor-side
            angles of that moment have not come.
        """
        if np.shape(link) != (self._n,):
            return stamp, Finding(Fault.JOINTS_NAMES, f"link angles of {np.size(link)} joints came, the robot has {self._n}")
        if not np.isfinite(link).all():
            return stamp, Finding(Fault.JOINTS_NOT_FINITE, "link angles hold NaN or infinity")
        if not abs(stamp - now) <= self._tolerance:
            return stamp, Finding(
                Fault.JOINTS_CLOCK,
                f"stamp of the link angles is {signed(stamp - now, 3)} s from now, limit {self._tolerance:g} s",
            )
        if stamp <= self._last:
            newer, self._last = signed(stamp - self._last, 3), stamp
            return stamp, Finding(Fault.JOINTS_CLOCK, f"stamp of the link angles is not newer than the last one ({newer} s)")
        self._last = stamp
        if not self._motor or self._motor[-1][0] < stamp:
            self._waiting = stamp, np.array(link, dtype=float)
            return None
        return stamp, self._windup(stamp, np.asarray(link, dtype=float))

    def _windup(self, stamp: float, link: Array) -> Array | Finding:
        after = next((k for k, (t, _) in enumerate(self._motor) if t >= stamp), 0)
        at, q = self._motor[after]
        if at != stamp:
            before, q_before = self._motor[after - 1] if after > 0 else (-math.inf, q)
            if at - before > GAP:
                return Finding(
                    Fault.JOINTS_CLOCK, f"no joint angles within {GAP:g} s before and after the stamp of the link angles"
                )
            q = q_before + (stamp - before) / (at - before) * (q - q_before)
        windup = link - q
        if self._dry is None:
            return np.asarray(windup)
        away, row = self._nearest(self._dry.q, q)
        if away > OFF_WAY:
            return Finding(
                Fault.OUTSIDE_JOINTS, f"the robot is {fixed(away, 3)} rad from the dry drive of links.file, limit {OFF_WAY:g} rad"
            )
        return np.asarray(windup - self._dry.windup[row])

    def _nearest(self, way: Array, q: Array) -> tuple[float, int]:
        """Distance, rad, of the nearest row of the way and its number; the whole way is searched only where it is not near."""
        if self._row >= 0:
            begin = max(0, self._row - _NEAR // 4)
            away = np.abs(way[begin : begin + _NEAR] - q).max(axis=1)
            best = int(np.argmin(away))
            if away[best] <= OFF_WAY:
                self._row = begin + best
                return float(away[best]), self._row
        away = np.abs(way - q).max(axis=1)
        self._row = int(np.argmin(away))
        return float(away[self._row]), self._row
