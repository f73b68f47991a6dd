# SPDX-License-Identifier: Apache-2.0
"""The parts of a scene: rows, arm, observed point, load, gravity, instruments. Each derives what follows from it, once.

All are frozen; what is derived belongs to one object and is computed anew for another, so that nothing can be out of date.
Positions and vectors in base_link unless named otherwise, SI units; n rows, k joints.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ..robot import Kinematics, Payload, Robot
from ..typing import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Rows:
    """Which row is what, and when.

    Attributes:
        kind: `loaded` (an effect's change against the reference row is observed) or `absolute`.
        stamp: s; load_since: the stamp from which the row's load has acted (previous row's stamp), s.
        reference: index of the row's reference row, -1 in absolute sessions; previous: of the row before in the same pose
            and repeat (loaded) or of the pose before (absolute), -1 for the first.
        clock: `time`, `order` or `none`: what `stamp` can be trusted for.
    """

    kind: str
    pose: IntArray
    repeat: IntArray
    load_case: IntArray
    stamp: Array
    load_since: Array
    reference: IntArray
    previous: IntArray
    clock: str = "time"

    @cached_property
    def in_turn(self) -> tuple[IntArray, ...]:
        """Rows with no row before them, those that come right after one of these, and so on."""
        out = [np.flatnonzero(self.previous < 0)]
        while len(out[-1]):
            out.append(np.flatnonzero(np.isin(self.previous, out[-1])))
        return tuple(out[:-1])

    @cached_property
    def in_time(self) -> IntArray:
        """Rows as they were read one after the other, those of one moment by load case."""
        return np.lexsort((self.load_case, self.stamp))

    @cached_property
    def stands(self) -> tuple[IntArray, IntArray]:
        """The first row of each time that the robot stands, one after the other, and in which of these each row was read: several
        markers are read while it stands."""
        order = self.in_time
        where = np.stack([self.pose, self.repeat, self.load_case], axis=1)[order]
        begins = np.concatenate([np.ones(min(len(order), 1), dtype=bool), (where[1:] != where[:-1]).any(axis=1)])
        which = np.empty(len(order), dtype=np.int64)
        which[order] = np.cumsum(begins) - 1
        return order[begins], which

    @cached_property
    def short_dwell(self) -> float:
        """Time under the load that all rows but one in twenty exceed, of those that were read some time after it came, s; 0 where
        there are none."""
        dwell = (self.stamp - self.load_since)[self.stamp > self.load_since]
        return float(np.quantile(dwell, 0.05)) if len(dwell) else 0.0

    @property
    def under_load(self) -> BoolArray:
        """Rows in which a load acts: all of an absolute session, those with a load case of a loaded one, (n,)."""
        loaded: BoolArray = self.load_case > 0 if self.kind == "loaded" else np.ones(len(self.stamp), dtype=bool)
        return loaded


@dataclass(frozen=True)
class Arm:
    """Where the robot is in each row.

    Attributes:
        q, step: joint angles, and their change since the previous row (0 where there is none), (n, k), rad.
        p_tcp: TCP by the controller, (n, 3), m.
        driven: False for passive joints, (k,).
        coupling: how passive joints follow the driven ones, dq = coupling dq_driven, (n, k, k); None where all are driven.
        repeatability: of the TCP as the session states it, one standard deviation per coordinate, m; 0: not stated.
    """

    robot: Robot
    kin: Kinematics
    q: Array
    step: Array
    p_tcp: Array
    driven: BoolArray
    coupling: Array | None = None
    repeatability: float = 0.0

    @property
    def axis_in_joint(self) -> Array:
        """Unit vector of each actuated axis in the joint's own frame, (k, 3)."""
        return np.einsum("kji,kj->ki", self.kin.R_joint[0], self.kin.axis[0])

    @cached_property
    def J_tcp(self) -> Array:
        """Translational Jacobian of the actuated axes at the TCP, Eq. (2)-(3), (n, 3, k)."""
        return _fixed(self.kin.jacobian(self.p_tcp))

    @cached_property
    def V_tcp(self) -> Array:
        """The same for the virtual axes, (n, 3, 2k), ordered 1a, 1b, 2a, ..."""
        return _fixed(self.kin.virtual_jacobian(self.p_tcp))

    def followed(self, per_joint: Array) -> Array:
        """Quantities per joint that act on coordinates, (n, ..., k), carried over to the driven joints that passive ones
        follow."""
        return per_joint if self.coupling is None else np.einsum("n...k,nkl->n...l", per_joint, self.coupling)


@dataclass(frozen=True)
class View:
    """The point whose displacement is asked for.

    Attributes:
        p_observed: marker (identification) or TCP (prediction), (n, 3), m.
        moves_with_arm: False for a marker on base_link, (n,).
        sags: share of what its own weight bends the arm by on the way from the reference that is seen too: by who measures a
            loaded session, not in what the process force causes.
        measured: all that differs between a row and its reference is asked for, as who measures sees it; False: only what forces
            cause that are others than at the reference, on the arm as it stands.
    """

    arm: Arm
    p_observed: Array
    moves_with_arm: BoolArray
    sags: float = 0.0
    measured: bool = False

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What functions of this place keep for the next call, by a name of their own."""
        return {}

    @cached_property
    def J(self) -> Array:
        """Translational Jacobian of the actuated axes at the observed point, Eq. (2)-(3), (n, 3, k); 0 where it does not move."""
        return _fixed(self.arm.followed(self.arm.kin.jacobian(self.p_observed) * self.moves_with_arm[:, None, None]))

    @cached_property
    def lever(self) -> Array:
        """How far the point moves when an axis turns by 1 rad, RMS over rows, (k,), m."""
        return _fixed(np.sqrt((self.J**2).sum(axis=1).mean(axis=0)))

    @cached_property
    def V(self) -> Array:
        """The same for the virtual axes, (n, 3, 2k), ordered 1a, 1b, 2a, ..."""
        return _fixed(self.arm.kin.virtual_jacobian(self.p_observed) * self.moves_with_arm[:, None, None])


@dataclass(frozen=True)
class Load:
    """The process wrench: environment on robot at the TCP, (n, 3) each, N and N m in tool0."""

    arm: Arm
    force_in_tool: Array
    torque_in_tool: Array

    @cached_property
    def force(self) -> Array:
        """The force in base_link, (n, 3), N."""
        return _fixed(np.einsum("nij,nj->ni", self.arm.kin.R_tool, self.force_in_tool))

    @cached_property
    def torque(self) -> Array:
        """The torque about the TCP in base_link, (n, 3), N m."""
        return _fixed(np.einsum("nij,nj->ni", self.arm.kin.R_tool, self.torque_in_tool))

    @cached_property
    def tau(self) -> Array:
        """Torque about each actuated axis, Eq. (9), (n, k), N m."""
        kin = self.arm.kin
        from_force = np.einsum("nik,ni->nk", self.arm.J_tcp, self.force)
        from_torque = np.einsum("nki,ni->nk", kin.axis, self.torque)
        return _fixed(self.arm.followed(from_force + np.where(kin.is_prismatic, 0.0, from_torque)))

    @cached_property
    def tau_virtual(self) -> Array:
        """Torque about each virtual axis, Eq. (9), (n, 2k), N m."""
        kin = self.arm.kin
        from_force = np.einsum("nik,ni->nk", self.arm.V_tcp, self.force)
        from_torque = np.einsum("nkvi,ni->nkv", kin.virtual_axis, self.torque)
        return _fixed(from_force + from_torque.reshape(from_force.shape))


@dataclass(frozen=True)
class Gravity:
    """What the weight of links and payload does.

    Attributes:
        in_base: gravity, (3,), m/s^2.
        tau: torque about each axis, (n, k), N m.
        branches: position of joints off the path to tool0, by name, (n,), rad or m; they move masses only.
    """

    arm: Arm
    in_base: Array
    tau: Array
    payload: Payload | None = None
    branches: dict[str, Array] = field(default_factory=dict)

    @cached_property
    def _by_joint(self) -> tuple[Array, Array]:
        """Weight carried by each joint, (n, k, 3), N, and its moment about the joint's origin, (n, k, 3), N m."""
        return self.arm.robot.gravity_wrench(self.arm.q, self.in_base, self.payload, self.branches)

    @cached_property
    def wrench_at_base(self) -> tuple[Array, Array]:
        """Weight of the moving links and its moment about base_link, (n, 3) each, N and N m."""
        force, moment = self._by_joint
        return _fixed(force[:, 0].copy()), _fixed(moment[:, 0] + np.cross(self.arm.kin.origin[:, 0], force[:, 0]))

    @cached_property
    def payload_in_tool(self) -> tuple[Array, Array]:
        """Weight of the payload and its moment about tool0, in tool0, (n, 3) each, N and N m."""
        if self.payload is None:
            nothing = np.zeros((len(self.arm.q), 3))
            return _fixed(nothing), _fixed(nothing)
        weight = self.payload.mass * np.einsum("nji,j->ni", self.arm.kin.R_tool, self.in_base)
        return _fixed(weight), _fixed(np.cross(self.payload.com, weight))

    @cached_property
    def largest(self) -> Array:
        """The largest torque about each axis, (k,), N m."""
        return _fixed(np.abs(self.tau).max(axis=0, initial=0.0))

    @cached_property
    def largest_virtual(self) -> Array:
        """The largest torque about each virtual axis, (2k,), N m."""
        return _fixed(np.abs(self.tau_virtual).max(axis=0, initial=0.0))

    @cached_property
    def largest_at_base(self) -> float:
        """The largest moment about base_link, N m."""
        return float(np.linalg.norm(self.wrench_at_base[1], axis=1).max(initial=0.0))

    @cached_property
    def tau_virtual(self) -> Array:
        """Torque about each virtual axis, (n, 2k), N m."""
        _, moment = self._by_joint
        n, k = self.arm.q.shape
        return _fixed(np.einsum("nkvi,nki->nkv", self.arm.kin.virtual_axis, moment).reshape(n, 2 * k))


@dataclass(frozen=True)
class Instruments:
    """What measures: stations, markers, the force sensor.

    Attributes:
        station, marker: index into `stations` and `markers`, (n,).
        station_known, marker_known: False where the pose is an unknown of the session; all known where not given.
        measured_from_station: vector from the station to the measured marker, (n, 3), m; None in predictions and without a
            tracker.
        modelled_from_station: vector from the station to where the controller believes the marker, (n, 3), m; None in
            predictions.
        sensor_axis_in_tool: mounting axis of the force sensor, (3,).
        by_contact: the observed point is the disc on the tooling; there is no tracker.
    """

    station: IntArray
    stations: tuple[str, ...]
    marker: IntArray
    markers: tuple[str, ...]
    station_known: tuple[bool, ...] = ()
    marker_known: tuple[bool, ...] = ()
    measured_from_station: Array | None = None
    modelled_from_station: Array | None = None
    sensor_axis_in_tool: tuple[float, float, float] = (0.0, 0.0, 1.0)
    by_contact: bool = False

    def __post_init__(self) -> None:
        if len(self.station_known) != len(self.stations):
            object.__setattr__(self, "station_known", (True,) * len(self.stations))
        if len(self.marker_known) != len(self.markers):
            object.__setattr__(self, "marker_known", (True,) * len(self.markers))


@dataclass(frozen=True)
class ElasticResponse:
    """How the elastic effects of a model respond in each row, at the observed point.

    Attributes:
        displacement: (n, 3), m, in base_link.
        rotation: small rotation of the tool, (n, 3), rad, in base_link.
        compliance: displacement by force and torque in tool0, (n, 3, 6), m/N and m/(N m).
        by_geometry: derivative of the displacement by the parameters of `geometry_error`, (n, 3, g); None where it was not asked
            for.
        of_wrist: as compliance, of the springs of wrist axes alone, (n, 3, 6): what a wrench between forearm and flange moves;
            None where there is none.
    """

    displacement: Array
    rotation: Array
    compliance: Array
    by_geometry: Array | None = None
    of_wrist: Array | None = None


NOT_PER_ROW = ("driven", "in_base", "is_prismatic", "virtual_in_joint")  # arrays of parts and kinematics that are not per row
Part = TypeVar("Part", Rows, Arm, Kinematics, View, Load, Gravity, Instruments, ElasticResponse)


def cut(part: Part, rows: IntArray, **changed: Any) -> Part:
    """Some rows of a part, with what is named instead."""
    per_row = {
        f.name: getattr(part, f.name)[rows]
        for f in fields(part)
        if f.name not in NOT_PER_ROW and isinstance(getattr(part, f.name), np.ndarray)
    }
    return replace(part, **{**per_row, **changed})


def _fixed(array: Array) -> Array:
    array.setflags(write=False)
    return array
