# SPDX-License-Identifier: Apache-2.0
"""Feed-forward of a force that is known from earlier courses: touch-down, ramps, cuts, at the place where they come.

The wrench that the model gets is that of the sensor, passed through the filters F, plus what the known profile P says will change
until the offset acts: y = F w + P(now + lead) - F P(now). A sensor that reads what was expected is thus answered without delay;
what was not expected is answered as without a profile.

A touch-down does not come at the same place each time. Within `slack` the profile is moved in time to where the readings have it:
r = w - P(now) is about -P' shift, so the shift is the least-squares one over the last readings, drawn to zero where the profile
is not steep.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.files.regular import TABLE_LIMIT, read_text
from irec_calibration.typing import Array

from .errors import SettingsError
from .filters import Filter
from .fir import Fir

_AHEAD = 25  # samples of the profile among which the robot is looked for, in each tick
_MOST = 200_000  # rows of a table
_FASTER = 3  # times the profile's speed that the robot may be followed at
_REMEMBERED = 0.25  # s of readings by which the profile is moved in time
_STEEP = 4.0  # samples with the steepest slope of the profile that halve the draw to zero


@dataclass(frozen=True)
class ForceProfile:
    """Expected wrench along a course.

    Attributes:
        q: joint angles, (k, n), rad, at equal steps of time; period: s; wrench: at the TCP in tool0, (k, 6), N and N m.
    """

    q: Array
    wrench: Array
    period: float = 0.004

    def __post_init__(self) -> None:
        if self.q.ndim != 2 or len(self.q) < 2 or self.wrench.shape != (len(self.q), 6):
            raise SettingsError(
                f"a force profile needs joint angles (k, n) and wrenches (k, 6), not {self.q.shape}, {self.wrench.shape}"
            )
        if not (np.isfinite(self.q).all() and np.isfinite(self.wrench).all()):
            raise SettingsError("a force profile holds values that are not finite")
        if not (math.isfinite(self.period) and 0.0 < self.period <= 0.1):
            raise SettingsError(f"period of the force profile is {self.period} s; 0 .. 0.1 s is possible")


def read_profile(path: str | Path, joint_names: Sequence[str]) -> ForceProfile:
    """A profile from a table (CSV): stamp [s], a column for each joint [rad], force_x, force_y, force_z in tool0 [N].

    Raises:
        SettingsError: not such a table; says which column is missing.
    """
    columns = ["stamp", *joint_names, "force_x", "force_y", "force_z"]
    try:
        text = read_text(path, "force profile", SettingsError, TABLE_LIMIT)
        if not text.strip():
            raise ValueError("it is empty")
        table = np.genfromtxt(io.StringIO(text), delimiter=",", names=True, dtype=float, max_rows=_MOST)
    except (ValueError, IndexError) as error:  # IndexError: nothing but comments
        raise SettingsError(f"{path}: not a force profile that can be read: {error}") from error
    missing = [c for c in columns if c not in (table.dtype.names or ())]
    if missing or table.size < 2:
        raise SettingsError(f"{path}: a force profile has columns {', '.join(columns)} and two rows or more; missing: {missing}")
    wrench = np.zeros((table.size, 6))
    wrench[:, :3] = np.stack([table[f"force_{axis}"] for axis in "xyz"], axis=1)
    steps = np.diff(table["stamp"])
    if not (np.isfinite(steps).all() and float(np.ptp(steps)) < 0.1 * float(steps.mean())):
        raise SettingsError(f"{path}: the stamps of a force profile go on in equal steps")
    try:
        return ForceProfile(np.stack([table[n] for n in joint_names], axis=1), wrench, float(steps.mean()))
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


class Preview:
    """Follows the robot along a profile, tick by tick; silent where the robot is elsewhere.

    Attributes:
        at: sample of the profile at which the robot is, or -1; shift: samples by which the force comes later than there.
    """

    def __init__(
        self, profile: ForceProfile, lead: float, filters: Sequence[Filter] = (), largest: float = 400.0, off_way: float = 0.01,
        slack: float = 0.0,
    ) -> None:  # fmt: skip
        """Args:
        lead: s from a reading to the motion it causes; filters: as the wrench passes, of its own (they keep state).
        largest: N and N m, that may be added, any axis; off_way: rad, any joint, beyond which the robot is not on this course.
        slack: s, by which the force may come sooner or later than the profile has it.

        Raises:
            SettingsError: lead or slack out of range.
        """
        if not 0.0 <= lead <= 0.2:
            raise SettingsError(f"lead of the force profile is {lead} s; 0 .. 0.2 s is possible")
        if not 0.0 <= slack <= 0.2:
            raise SettingsError(f"slack of the force profile is {slack} s; 0 .. 0.2 s is possible")
        self._profile, self._filters, self._largest, self._off = profile, list(filters), largest, off_way
        self._ahead, self._slack = lead / profile.period, slack / profile.period
        self._slope = np.gradient(profile.wrench, axis=0)  # N and N m per sample
        self._keep = math.exp(-profile.period / _REMEMBERED)
        self._draw = _STEEP * float((self._slope[:, :3] ** 2).sum(axis=1).max())
        self.reset()

    def reset(self) -> None:
        """The robot may be anywhere."""
        self.at, self.shift = -1, 0.0
        self._steep, self._early = 0.0, 0.0
        for f in self._filters:
            f.reset()

    def step(self, q: Array, reading: Array | None = None) -> Array:
        """What is to be added to the filtered wrench at joint angles q (n,), (6,), N and N m; once per tick.

        Args:
            reading: wrench as it goes into the filters, (6,); None: the profile is not moved.
        """
        profile = self._profile
        if self.at < 0:
            self.at = int(np.argmin(np.abs(profile.q - q).max(axis=1)))
        else:
            near = profile.q[self.at : self.at + _AHEAD]
            away = np.abs(near - q).max(axis=1)
            # a robot that stands is nowhere in particular: time goes on with it as it did when the profile was made
            self.at += max(min(int(np.argmin(away)), _FASTER), int(away[min(1, len(away) - 1)] <= away[0]))
        if float(np.abs(profile.q[self.at] - q).max()) > self._off or self.at >= len(profile.q) - 1:
            self.reset()
            return np.zeros(6)
        if reading is not None and self._slack > 0.0:
            self._move(reading)
        now, ahead = self.expected()
        seen = now
        for f in self._filters:
            if isinstance(f, Fir):
                f.place(q)
            seen = f.step(seen)
        return np.clip(ahead - seen, -self._largest, self._largest)

    def expected(self) -> tuple[Array, Array]:
        """Wrench of the profile where the robot is and `lead` later, (6,), N and N m; zeros where it is on no way."""
        if self.at < 0:
            return np.zeros(6), np.zeros(6)
        return self._expected(self.at - self.shift), self._expected(self.at - self.shift + self._ahead)

    def _expected(self, x: float) -> Array:
        """The profile at a sample, between samples linear, (6,)."""
        wrench = self._profile.wrench
        x = min(max(x, 0.0), len(wrench) - 1.0)
        i = min(int(x), len(wrench) - 2)
        return np.asarray(wrench[i] + (x - i) * (wrench[i + 1] - wrench[i]))

    def _move(self, reading: Array) -> None:
        """Least squares about the present shift, which moves slowly against what is remembered."""
        i = min(max(round(self.at - self.shift), 0), len(self._slope) - 1)
        slope = self._slope[i, :3]
        missed = reading[:3] - self._expected(self.at - self.shift)[:3]
        self._steep = self._keep * self._steep + float(slope @ slope)
        self._early = self._keep * self._early + float(slope @ missed) - float(slope @ slope) * self.shift
        wanted = -self._early / (self._steep + self._draw) if self._draw > 0.0 else 0.0
        wanted = min(max(wanted, -self._slack), self._slack)
        self.shift += min(max(wanted - self.shift, -0.5), 0.5)  # time never runs backwards in the profile
