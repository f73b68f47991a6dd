# SPDX-License-Identifier: Apache-2.0
"""Streams of readings, windows cut out of them, and whether the robot stands still in a window.

Times are the stamps of the readings, s; forces N, torques N m, positions m, joints rad.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from ..typing import Array
from .settings import Checks, Settling

STAND_TIME = 0.05  # s
STAND_MOVE = 2e-4  # rad or m in that time
LEAST_SAMPLES = 4  # of which two halves can be compared
LOOK_BACK = 4  # newest readings of which two have to be beyond a limit: no single one ends anything, and zeros between hide none
DISORDER = 0.5  # s by which the stamp of a reading may be older than that of one before it


@dataclass(frozen=True)
class Window:
    """Readings with begin < stamp <= end.

    Attributes:
        force_in_tool, torque_in_tool: environment on robot at the TCP, (n, 3).
        p_marker_in_station: (m, 3), all from one station; without a tracker (0, 3), and no station.
        q: joints and then external axes as reported, (k, joints). p_tcp_in_base: (l, 3). quat_tcp: (l, 4).
    """

    begin: float
    end: float
    force_in_tool: Array
    torque_in_tool: Array
    p_marker_in_station: Array
    station: str
    q: Array
    p_tcp_in_base: Array
    quat_tcp: Array | None = None

    @property
    def marker_std(self) -> float:
        """Standard deviation of the marker, worst axis, m; NaN without a tracker."""
        return float(self.p_marker_in_station.std(axis=0).max()) if len(self.p_marker_in_station) else float("nan")

    @property
    def force_std(self) -> float:
        """Standard deviation of the force, worst axis, N."""
        return float(self.force_in_tool.std(axis=0).max())


class Streams:
    """The newest readings of every instrument.

    Args:
        horizon_s: how long they are kept, s.
        tracker: whether there is one; without it windows hold no marker.
    """

    def __init__(self, horizon_s: float, tracker: bool = True) -> None:
        self.horizon_s = horizon_s
        self.needed = ("force", "marker", "joints", "TCP") if tracker else ("force", "joints", "TCP")
        self.names: tuple[str, ...] = ()
        self.temperature: dict[str, float] = {}
        self.counts = {"force": 0, "joints": 0, "TCP": 0, "marker": 0}  # readings so far
        self._force: deque[tuple[float, ...]] = deque()
        self._marker: deque[tuple[float, float, float, float, str]] = deque()
        self._joints: deque[tuple[float, ...]] = deque()
        self._tcp: deque[tuple[float, ...]] = deque()

    def clear(self) -> None:
        """Forget every reading; the counts go on."""
        for stream in (self._force, self._marker, self._joints, self._tcp):
            stream.clear()
        self.temperature.clear()

    def _add(self, stream: deque, item: tuple) -> None:  # type: ignore[type-arg]
        if stream and item[0] < stream[-1][0] - self.horizon_s:
            stream.clear()  # the clock was set back: what is there belongs to another run
        stream.append(item)
        while stream[0][0] < item[0] - self.horizon_s:
            stream.popleft()

    def add_wrench(self, t: float, wrench: tuple[float, ...]) -> None:
        """wrench: force (3) and torque (3) of the environment on the robot at the TCP, in tool0."""
        self._add(self._force, (t, *wrench))
        self.counts["force"] += 1

    def add_marker(self, t: float, x: float, y: float, z: float, station: str) -> None:
        """Marker in the frame of its station."""
        self._add(self._marker, (t, x, y, z, station))
        self.counts["marker"] += 1

    def add_joints(self, t: float, names: tuple[str, ...], position: tuple[float, ...]) -> None:
        """Joints and external axes in the order of `names`."""
        if names != self.names:
            self._joints.clear()
            self.names = names
        self._add(self._joints, (t, *position))
        self.counts["joints"] += 1

    def add_tcp(
        self, t: float, x: float, y: float, z: float, qx: float = 0.0, qy: float = 0.0, qz: float = 0.0, qw: float = 1.0
    ) -> None:
        """TCP by the controller, in base_link: position and quaternion of tool0."""
        self._add(self._tcp, (t, x, y, z, qx, qy, qz, qw))
        self.counts["TCP"] += 1

    @property
    def newest_force(self) -> Array | None:
        """Latest force, (3,), N."""
        return np.array(self._force[-1][1:4]) if self._force else None

    def last_forces(self, n: int) -> Array:
        """The newest n forces, oldest first, (n, 3) or fewer, N."""
        return np.array([item[1:4] for item in islice(reversed(self._force), n)][::-1]).reshape(-1, 3)

    def forces_of(self, length_s: float) -> Array:
        """The forces of the newest length_s, at least the newest one, (n, 3), N."""
        return _rows(self._force, self._force[-1][0] - length_s)[:, 1:4]

    def force_before(self, n: int, length_s: float) -> Array | None:
        """Mean force, (3,), N, over length_s before the newest n readings; None where there are fewer than LEAST_SAMPLES."""
        if len(self._force) <= n:
            return None
        end = self._force[-n - 1][0]
        rows = _rows(self._force, end - length_s, end)
        return rows[:, 1:4].mean(axis=0) if len(rows) >= LEAST_SAMPLES else None

    @property
    def newest_tcp(self) -> tuple[Array, Array] | None:
        """Latest TCP, (3,), m, and quaternion of tool0, (4,), in base_link."""
        return (np.array(self._tcp[-1][1:4]), np.array(self._tcp[-1][4:8])) if self._tcp else None

    def tcp_speed(self, length_s: float) -> float:
        """Of the TCP over the newest length_s, m/s: the median of its steps, which one wrong pose does not change; 0 where
        there are fewer than LEAST_SAMPLES."""
        rows = _rows(self._tcp, self._tcp[-1][0] - length_s) if self._tcp else np.empty((0, 8))
        if len(rows) < LEAST_SAMPLES:
            return 0.0
        return float(np.median(np.linalg.norm(np.diff(rows[:, 1:4], axis=0), axis=1) / np.maximum(np.diff(rows[:, 0]), 1e-6)))

    @property
    def newest_joints(self) -> Array | None:
        """Latest joints and external axes in the order of `names`."""
        return np.array(self._joints[-1][1:]) if self._joints else None

    @property
    def stands(self) -> bool:
        """No joint has moved in the last STAND_TIME, nor the TCP."""
        return _stands(self._joints, len(self.names)) and _stands(self._tcp, 3)

    @property
    def newest_marker(self) -> tuple[float, Array, str] | None:
        """Stamp, s, latest marker in the frame of its station, (3,), m, and the station."""
        return (self._marker[-1][0], np.array(self._marker[-1][1:4]), self._marker[-1][4]) if self._marker else None

    def newest(self) -> dict[str, float]:
        """Stamp of the newest reading of each stream that has any."""
        streams: dict[str, Any] = {"force": self._force, "marker": self._marker, "joints": self._joints, "TCP": self._tcp}
        return {name: stream[-1][0] for name, stream in streams.items() if stream}

    def mean_force(self, begin: float, length_s: float) -> Array | None:
        """Mean force over the newest length_s; None while they do not lie after begin."""
        if not self._force or self._force[-1][0] - length_s < begin:
            return None
        return _rows(self._force, self._force[-1][0] - length_s)[:, 1:4].mean(axis=0)

    def window(self, begin: float, length_s: float) -> Window | None:
        """The newest window that every stream which is needed covers; None while there is none that starts after `begin`."""
        newest = self.newest()
        if any(name not in newest for name in self.needed):
            return None
        end = min(newest[name] for name in self.needed)
        start = end - length_s
        if start < begin:
            return None
        force, joints, tcp = (_rows(s, start, end) for s in (self._force, self._joints, self._tcp))
        if not (len(force) and len(joints) and len(tcp)):
            return None
        if "marker" not in self.needed:
            none = np.empty((0, 3))
            return Window(start, end, force[:, 1:4], force[:, 4:7], none, "", joints[:, 1:], tcp[:, 1:4], tcp[:, 4:8])
        marker = [m for m in self._marker if start < m[0] <= end]
        if not marker:
            return None
        station = max({m[4] for m in marker}, key=[m[4] for m in marker].count)
        points = np.array([m[1:4] for m in marker if m[4] == station])
        return Window(start, end, force[:, 1:4], force[:, 4:7], points, station, joints[:, 1:], tcp[:, 1:4], tcp[:, 4:8])


def second_largest(sizes: Array) -> float:
    """What two of these sizes reach, (n,); 0 where there are fewer than two."""
    return float(np.sort(sizes)[-2]) if len(sizes) > 1 else 0.0


def _stands(stream: deque, values: int) -> bool:  # type: ignore[type-arg]
    if not stream:
        return False
    newest = stream[-1]
    before = next((item for item in reversed(stream) if item[0] <= newest[0] - STAND_TIME), None)
    return before is not None and all(abs(newest[k] - before[k]) < STAND_MOVE for k in range(1, values + 1))


def _rows(stream: deque, begin: float, end: float = np.inf) -> Array:  # type: ignore[type-arg]
    rows = []
    for item in reversed(stream):  # several times a cycle: not through all that is kept
        if item[0] <= begin - DISORDER:
            break
        if begin < item[0] <= end:
            rows.append(item)
    return np.array(rows[::-1], dtype=float)


def drift(samples: Array) -> Array:
    """Difference of the means of the two halves of samples (n, k) that three standard deviations of it do not explain, (k,).

    Infinite for fewer than LEAST_SAMPLES samples, of which nothing is known.
    """
    if len(samples) < LEAST_SAMPLES:
        return np.full(samples.shape[1], np.inf)
    half = len(samples) // 2
    a, b = samples[:half], samples[half:]
    expected = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
    return np.maximum(np.abs(b.mean(axis=0) - a.mean(axis=0)) - 3.0 * expected, 0.0)


def too_few(window: Window, checks: Checks) -> str:
    """Which stream sends too little for a window to say that the robot stands; empty where none does."""
    length = window.end - window.begin
    for topic, n, least in (
        ("wrench", len(window.force_in_tool), checks.least_wrench_hz),
        ("joint_states", len(window.q), checks.least_states_hz),
        ("tcp_pose", len(window.p_tcp_in_base), checks.least_states_hz),
    ):
        if n < max(LEAST_SAMPLES, round(least * length)):
            return (
                f"{topic} has sent {n} readings in {length:g} s, at least {max(LEAST_SAMPLES, round(least * length))} are needed"
                f" ({least:g} Hz, procedure.checks): is the driver slow, or the network?"
            )
    return ""


def unsettled(window: Window, s: Settling, min_samples: int, force_target: Array | None) -> str:
    """Why the robot does not stand still in a window, empty if it does.

    Args:
        force_target: set point in tool0, (3,), N; None for a reference, where no force is controlled.
    """
    n = len(window.p_marker_in_station)
    if n < min_samples:
        return f"tracker delivers {n} samples per window, {min_samples} are needed (line of sight?)"
    if not window.marker_std <= s.marker_std_m:
        return f"marker moves: standard deviation {window.marker_std * 1e6:.0f} um, limit {s.marker_std_m * 1e6:.0f} um"
    moving = float(drift(window.p_marker_in_station).max())
    if not moving <= s.marker_drift_m:
        return f"marker drifts {moving * 1e6:.1f} um per half window, limit {s.marker_drift_m * 1e6:.1f} um"
    return force_unsettled(window, s, force_target)


def force_unsettled(window: Window, s: Settling, force_target: Array | None) -> str:
    """What of the force does not stand still in a window, or is not at its set point; empty if it is. Arguments as above."""
    changing = float(drift(window.force_in_tool).max())
    if not changing <= s.force_drift_n:
        return f"force drifts {changing:.1f} N per half window, limit {s.force_drift_n:.1f} N"
    if force_target is not None:
        off = float(np.abs(window.force_in_tool.mean(axis=0) - force_target).max())
        if not off <= s.force_n:
            return f"force is {off:.1f} N off its set point, limit {s.force_n:.1f} N"
    return ""
