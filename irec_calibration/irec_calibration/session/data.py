# SPDX-License-Identifier: Apache-2.0
"""What one run of Procedure 1, or one plain tracker calibration, measured (irec-session/1)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..robot import Payload, Robot
from ..typing import Array, BoolArray, IntArray, Json


@dataclass(frozen=True)
class Station:
    """A tracker station: pose of its frame in base_link.

    Attributes:
        xyz: m.
        quat_xyzw: rotation of the station frame into base_link.
        known: False where the pose is a starting value only (`absolute` sessions).
        stated: False where the file gave no pose at all.
        level: z of the station is up.
    """

    name: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    known: bool = False
    stated: bool = True
    level: bool = False

    @property
    def R_in_base(self) -> Array:
        """Rotation matrix of the station frame into base_link, shape (3, 3)."""
        x, y, z, w = np.asarray(self.quat_xyzw) / np.linalg.norm(self.quat_xyzw)
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )


@dataclass(frozen=True)
class Marker:
    """A tracker target fixed to a link (`tool0` or `base_link`); xyz in that link's frame, m.

    Attributes:
        anew: of one that was seated anew in mid-session and counts as another one from there on: what happened, in words.
    """

    name: str
    link: str = "tool0"
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    known: bool = True
    anew: str = ""


@dataclass(frozen=True)
class Noise:
    """One standard deviation per coordinate, from the instruments' data sheets.

    Attributes:
        tracker_m: constant part, m.
        tracker_m_per_m: part proportional to the distance from the station.
        force_n: force sensor, N.
        settling_m: repeatability of standing still, m.
        robot_m, robot_rad: repeatability of the robot, m and rad.
    """

    tracker_m: float
    tracker_m_per_m: float = 0.0
    force_n: float = 0.0
    settling_m: float = 0.0
    robot_m: float = 0.0
    robot_rad: float = 0.0


@dataclass(frozen=True)
class ExternalAxis:
    """An axis that carries base_link: its pose in the cell is the axis value along (or about) `axis`."""

    name: str
    kind: str
    axis: tuple[float, float, float]


@dataclass(frozen=True)
class Contact:
    """What takes the tracker's place in a session whose measured point is the disc on the tooling (`without_tracker`).

    Attributes:
        normal_m: how far the disc comes or goes along tool0 z although it is believed to stay, one standard deviation, m.
        slip_m: the same across tool0 z, m; much larger, since a disc creeps and slips along the surface.
        disc_known: what the disc gives way is in the positions already, by its stated stiffness.
    """

    normal_m: float
    slip_m: float
    disc_known: bool = False


@dataclass(frozen=True)
class Session:
    """One session; n rows, k joints. Row order is the order of the file. Arrays are read-only.

    Attributes:
        kind: `loaded` (rows are read as differences to row 0 of their pose) or `absolute`.
        pose, load_case, repeat: shape (n,).
        stamp: s since the session began, shape (n,).
        q: joint angles reported by the controller, shape (n, k), rad or m.
        q_target: commanded joint angles, shape (n, k), or None.
        ext: external axes, name without `ext_` -> shape (n,), m or rad.
        p_tcp_in_base: TCP by the controller, shape (n, 3), m; from the URDF where absent.
        p_marker_in_station: shape (n, 3), m; NaN where the marker was not seen.
        station, marker: index into `stations` / `markers`, shape (n,).
        force_in_tool, torque_in_tool: environment on robot at the TCP, in tool0, shape (n, 3), N and N m; 0 where not measured.
        temperature: name without `temp_` -> shape (n,), degC; NaN where not measured.
        passive: joint name -> expression of a coupled joint without a drive.
        clock: `time`, `order` or `none`: what `stamp` can be trusted for.
        meta: the content of session.yaml, for what the attributes do not name.
        is_whole: nothing of a recording is missing; False while it is still being written.
        notes: what the reader wants the user to know (ignored columns and the like).
        contact: positions are those of the disc on the tooling, not of a tracker's marker; None: a tracker measured.
    """

    name: str
    kind: str
    robot: Robot
    serial: str
    pose: IntArray
    load_case: IntArray
    repeat: IntArray
    stamp: Array
    q: Array
    p_tcp_in_base: Array
    p_marker_in_station: Array
    station: IntArray
    stations: tuple[Station, ...]
    marker: IntArray
    markers: tuple[Marker, ...]
    force_in_tool: Array
    torque_in_tool: Array
    noise: Noise
    q_target: Array | None = None
    ext: dict[str, Array] = field(default_factory=dict)
    ext_axes: tuple[ExternalAxis, ...] = ()
    temperature: dict[str, Array] = field(default_factory=dict)
    load_case_names: dict[int, str] = field(default_factory=dict)
    load_cases: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    gravity_in_base: tuple[float, float, float] = (0.0, 0.0, -9.81)
    payload: Payload | None = None
    passive: dict[str, str] = field(default_factory=dict)
    clock: str = "time"
    inertials: str = "cad"
    has_torque: bool = False
    has_tcp: bool = True
    meta: Json = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    is_whole: bool = True
    contact: Contact | None = None
    path: Path | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            for array in value.values() if isinstance(value, dict) else (value,):
                if isinstance(array, np.ndarray):
                    array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.pose)

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What functions of this session keep for the next call, by a name of their own."""
        return {}

    @property
    def marker_seen(self) -> BoolArray:
        """Rows in which the marker was measured, shape (n,)."""
        return np.logical_not(np.isnan(self.p_marker_in_station).any(axis=1))

    @property
    def on_tool(self) -> BoolArray:
        """Rows whose marker is on the tool, shape (n,); the others' is on base_link."""
        return np.array([m.link == "tool0" for m in self.markers])[self.marker]

    @property
    def poses(self) -> IntArray:
        """Distinct pose numbers, ascending."""
        return np.unique(self.pose)

    def reference_row(self) -> IntArray:
        """Index of the reference row of each row (its own pose, repeat and marker), -1 in `absolute` sessions; shape (n,)."""
        if self.kind == "absolute":
            return np.full(len(self), -1)
        keys = list(zip(self.pose.tolist(), self.repeat.tolist(), self.marker.tolist(), strict=True))
        zero = {key: i for i, key in enumerate(keys) if self.load_case[i] == 0}
        return np.array([zero[key] for key in keys], dtype=np.int64)

    def case_name(self, j: int) -> str:
        """Readable name of a load case."""
        return self.load_case_names.get(int(j), "reference" if j == 0 else str(int(j)))

    def select(self, rows: BoolArray | IntArray) -> Session:
        """The same session with some rows only (a mask or indices)."""

        def take(a: Any) -> Any:
            return None if a is None else a[rows]

        per_row = "pose load_case repeat stamp q p_tcp_in_base p_marker_in_station station marker force_in_tool torque_in_tool"
        changed = {name: take(getattr(self, name)) for name in per_row.split()}
        return replace(
            self,
            **changed,
            q_target=take(self.q_target),
            ext={k: v[rows] for k, v in self.ext.items()},
            temperature={k: v[rows] for k, v in self.temperature.items()},
        )

    def select_poses(self, poses: IntArray | list[int]) -> Session:
        """The same session with whole poses only."""
        return self.select(np.isin(self.pose, poses))
