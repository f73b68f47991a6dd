# SPDX-License-Identifier: Apache-2.0
"""What an effect may read about the rows of a session (or of a production course): state, load, history.

A scene never holds the model's parameters, and an effect never sees more than a scene. For predictions the scene observes the
TCP and has no measured positions at all, so a prediction can't read marker columns by mistake.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from .coupled import coupling
from .registration import level_gravity, registered
from .robot import Kinematics, Payload, Robot
from .session.data import Session
from .typing import Array, BoolArray, IntArray


@dataclass(frozen=True)
class ElasticResponse:
    """How the elastic effects of a model respond in each row, at the observed point.

    Attributes:
        displacement: (n, 3), m, in base_link.
        rotation: small rotation of the tool, (n, 3), rad, in base_link.
        compliance: displacement by force and torque in tool0, (n, 3, 6), m/N and m/(N m).
    """

    displacement: Array
    rotation: Array
    compliance: Array


@dataclass(frozen=True)
class Scene:
    """n rows of a robot with k joints. Positions and vectors in base_link unless named otherwise; SI units.

    Attributes:
        kind: `loaded` (an effect's change against the reference row is observed) or `absolute`.
        q, step: joint angles, and their change since the previous row (0 where there is none), shape (n, k), rad.
        p_observed: the point whose displacement is asked for: marker (identification) or TCP (prediction), (n, 3), m.
        p_tcp: TCP by the controller, (n, 3), m.
        moves_with_arm: False for a marker on base_link, (n,).
        force_in_tool, torque_in_tool: environment on robot at the TCP, (n, 3), N and N m.
        tau_gravity: torque that gravity exerts about each axis, (n, k), N m.
        stamp: s; load_since: the stamp from which the row's load has acted (previous row's stamp), s.
        reference: index of the row's reference row, -1 in absolute sessions; previous: of the row before in the same pose
            and repeat (loaded) or of the pose before (absolute), -1 for the first.
        measured_from_station: vector from the station to the measured marker, (n, 3), m; None in predictions.
        modelled_from_station: vector from the station to where the controller believes the marker, (n, 3), m; None in
            predictions.
        sensor_axis_in_tool: mounting axis of the force sensor, (3,).
        station_known, marker_known: False where the pose is an unknown of the session; all known where not given.
        coupling: how passive joints follow the driven ones, dq = coupling dq_driven, (n, k, k); None where all are driven.
        elastic: what the model's elastic effects answer in these rows; only for effects with `needs_elastic`.
    """

    kind: str
    robot: Robot
    kin: Kinematics
    q: Array
    step: Array
    p_observed: Array
    p_tcp: Array
    moves_with_arm: BoolArray
    force_in_tool: Array
    torque_in_tool: Array
    tau_gravity: Array
    stamp: Array
    load_since: Array
    pose: IntArray
    repeat: IntArray
    load_case: IntArray
    reference: IntArray
    previous: IntArray
    driven: BoolArray
    station: IntArray
    stations: tuple[str, ...]
    marker: IntArray
    markers: tuple[str, ...]
    ext: dict[str, Array]
    temperature: dict[str, Array]
    gravity_in_base: Array
    payload: Payload | None = None
    clock: str = "time"
    measured_from_station: Array | None = None
    modelled_from_station: Array | None = None
    sensor_axis_in_tool: tuple[float, float, float] = (0.0, 0.0, 1.0)
    station_known: tuple[bool, ...] = ()
    marker_known: tuple[bool, ...] = ()
    coupling: Array | None = None
    elastic: ElasticResponse | None = None
    _cache: dict[str, Array] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(self.station_known) != len(self.stations):
            object.__setattr__(self, "station_known", (True,) * len(self.stations))
        if len(self.marker_known) != len(self.markers):
            object.__setattr__(self, "marker_known", (True,) * len(self.markers))

    def __len__(self) -> int:
        return len(self.stamp)

    def _once(self, name: str, make: object) -> Array:
        if name not in self._cache:
            value = make()  # type: ignore[operator]
            value.setflags(write=False)
            self._cache[name] = value
        return self._cache[name]

    @property
    def n_joints(self) -> int:
        return int(self.q.shape[1])

    @property
    def axis_in_joint(self) -> Array:
        """Unit vector of each actuated axis in the joint's own frame, (k, 3)."""
        return np.einsum("kji,kj->ki", self.kin.R_joint[0], self.kin.axis[0])

    def followed(self, per_joint: Array) -> Array:
        """Quantities per joint that act on coordinates, (n, ..., k), carried over to the driven joints that passive ones
        follow."""
        return per_joint if self.coupling is None else np.einsum("n...k,nkl->n...l", per_joint, self.coupling)

    @property
    def force(self) -> Array:
        """Force of the environment on the robot in base_link, (n, 3), N."""
        return self._once("force", lambda: np.einsum("nij,nj->ni", self.kin.R_tool, self.force_in_tool))

    @property
    def torque(self) -> Array:
        """Torque of the environment on the robot about the TCP, in base_link, (n, 3), N m."""
        return self._once("torque", lambda: np.einsum("nij,nj->ni", self.kin.R_tool, self.torque_in_tool))

    @property
    def J(self) -> Array:
        """Translational Jacobian of the actuated axes at the observed point, (n, 3, k); 0 where it does not move."""
        return self._once("J", lambda: self.followed(self.kin.jacobian(self.p_observed) * self.moves_with_arm[:, None, None]))

    @property
    def V(self) -> Array:
        """The same for the virtual axes, (n, 3, 2k), ordered 1a, 1b, 2a, ..."""
        return self._once("V", lambda: self.kin.virtual_jacobian(self.p_observed) * self.moves_with_arm[:, None, None])

    @property
    def tau(self) -> Array:
        """Torque of the process wrench about each actuated axis, Eq. (9), (n, k), N m."""
        return self._once("tau", self._actuated_torque)

    @property
    def tau_virtual(self) -> Array:
        """Torque of the process wrench about each virtual axis, Eq. (9), (n, 2k), N m."""
        return self._once("tau_virtual", self._virtual_torque)

    def _actuated_torque(self) -> Array:
        from_force = np.einsum("nik,ni->nk", self.kin.jacobian(self.p_tcp), self.force)
        from_torque = np.einsum("nki,ni->nk", self.kin.axis, self.torque)
        return self.followed(from_force + np.where(self.kin.is_prismatic, 0.0, from_torque))

    def _virtual_torque(self) -> Array:
        from_force = np.einsum("nik,ni->nk", self.kin.virtual_jacobian(self.p_tcp), self.force)
        n, k = self.q.shape
        from_torque = np.einsum("nkvi,ni->nkv", self.kin.virtual_axis, self.torque).reshape(n, 2 * k)
        return from_force + from_torque

    @property
    def tau_virtual_gravity(self) -> Array:
        """Torque of gravity about each virtual axis, (n, 2k), N m."""
        return self._once("tau_virtual_gravity", self._virtual_gravity)

    @property
    def gravity_wrench_at_base(self) -> tuple[Array, Array]:
        """Weight of the moving links and its moment about base_link, (n, 3) each, N and N m."""
        self._virtual_gravity_parts()
        return self._cache["weight"], self._cache["weight_moment"]

    def _virtual_gravity_parts(self) -> tuple[Array, Array]:
        """Weight carried by each joint, (n, k, 3) N, and its moment about the joint's origin, (n, k, 3) N m."""
        if "weight_by_joint" not in self._cache:
            force, moment = self.robot.gravity_wrench(self.q, self.gravity_in_base, self.payload)
            self._cache["weight_by_joint"], self._cache["weight_moment_by_joint"] = force, moment
            self._cache["weight"] = force[:, 0]
            self._cache["weight_moment"] = moment[:, 0] + np.cross(self.kin.origin[:, 0], force[:, 0])
        return self._cache["weight_by_joint"], self._cache["weight_moment_by_joint"]

    def _virtual_gravity(self) -> Array:
        _, moment = self._virtual_gravity_parts()
        n, k = self.q.shape
        return np.einsum("nkvi,nki->nkv", self.kin.virtual_axis, moment).reshape(n, 2 * k)

    def noise_free_from_station(self) -> Array:
        """Vector from the station to the marker, (n, 3), m: measured at the reference, moved on by controller and springs.

        What scales or turns it must not be built on the measured displacement, whose noise would scale and turn too.
        """
        if self.measured_from_station is None:
            raise ValueError("a prediction has no station")
        if self.kind == "absolute":
            return np.nan_to_num(self.measured_from_station)
        p = self.p_observed if self.elastic is None else self.p_observed + self.elastic.displacement
        return np.nan_to_num(self.measured_from_station)[self.reference] + self.change(p)

    def load_torque(self) -> Array:
        """The torque that elastic joints answer to: process (loaded) or process and gravity (absolute), (n, k), N m."""
        return self.tau if self.kind == "loaded" else self.tau + self.tau_gravity

    def with_wrench(self, force_in_tool: Array, torque_in_tool: Array) -> Scene:
        """The same rows under another wrench."""
        kept = {k: v for k, v in self._cache.items() if k in ("J", "V") or "weight" in k}
        return replace(self, force_in_tool=force_in_tool, torque_in_tool=torque_in_tool, _cache=kept)

    def take(self, rows: IntArray) -> Scene:
        """Some rows of an absolute session only; step, load and history of each stay what they were."""
        n = len(self)

        def cut(value: Any) -> Any:
            return value[rows] if isinstance(value, np.ndarray) and len(value) == n else value

        kin = {f.name: getattr(self.kin, f.name) for f in fields(self.kin)}
        position = np.full(n + 1, -1)
        position[rows] = np.arange(len(rows))
        changed: dict[str, Any] = {
            f.name: cut(getattr(self, f.name)) for f in fields(self) if f.name not in ("robot", "gravity_in_base")
        }
        changed |= {
            "kin": Kinematics(**{k: cut(v) if k not in ("is_prismatic", "virtual_in_joint") else v for k, v in kin.items()}),
            "driven": self.driven,
            "previous": position[self.previous[rows]],
            "ext": {k: v[rows] for k, v in self.ext.items()},
            "temperature": {k: v[rows] for k, v in self.temperature.items()},
            "_cache": {},
        }
        return replace(self, **changed)

    def change(self, displacement: Array) -> Array:
        """What a session of this kind observes of a displacement per row: its change against the reference row."""
        if self.kind == "absolute":
            return displacement
        return displacement - displacement[self.reference]


def scene_of(session: Session, *, observe: str = "marker") -> Scene:
    """The scene of a session.

    Args:
        session: any session.
        observe: `marker` (identification: p_observed is where the controller believes the marker) or `tcp` (prediction).
    """
    kin = session.robot.kinematics(session.q)
    n, k = session.q.shape
    previous = _previous_row(session)
    has_previous = previous >= 0
    step = np.where(has_previous[:, None], session.q - session.q[previous], 0.0)
    load_since = np.where(has_previous, session.stamp[previous], session.stamp)
    on_tool = np.array([m.link == "tool0" for m in session.markers])[session.marker]
    p_observed = marker_by_controller(session, kin) if observe == "marker" else session.p_tcp_in_base
    from_station = modelled = None
    if observe == "marker":
        R = np.stack([s.R_in_base for s in session.stations])[session.station]
        from_station = np.einsum("nij,nj->ni", R, session.p_marker_in_station)
        modelled = p_observed - np.array([s.xyz for s in session.stations])[session.station]
    gravity = _gravity(session, kin)
    follow = coupling(session.passive, session.robot.joint_names, session.q)
    tau_gravity = session.robot.gravity_torque(session.q, gravity, session.payload)
    driven = np.array([name not in session.passive for name in session.robot.joint_names])
    axis = session.meta.get("sensor_axis_in_tool", (0.0, 0.0, 1.0))
    return Scene(
        kind=session.kind,
        robot=session.robot,
        kin=kin,
        q=session.q,
        step=step,
        p_observed=p_observed,
        p_tcp=session.p_tcp_in_base,
        moves_with_arm=on_tool if observe == "marker" else np.ones(n, dtype=bool),
        force_in_tool=session.force_in_tool,
        torque_in_tool=session.torque_in_tool,
        tau_gravity=tau_gravity if follow is None else np.einsum("nk,nkl->nl", tau_gravity, follow),
        stamp=session.stamp,
        load_since=load_since,
        pose=session.pose,
        repeat=session.repeat,
        load_case=session.load_case,
        reference=session.reference_row(),
        previous=previous,
        driven=driven,
        station=session.station,
        stations=tuple(s.name for s in session.stations),
        marker=session.marker,
        markers=tuple(m.name for m in session.markers),
        ext=session.ext,
        temperature=session.temperature,
        gravity_in_base=gravity,
        payload=session.payload,
        clock=session.clock,
        measured_from_station=from_station,
        modelled_from_station=modelled,
        sensor_axis_in_tool=tuple(float(x) for x in axis),  # type: ignore[arg-type]
        station_known=tuple(s.known or session.kind == "loaded" for s in session.stations),
        marker_known=tuple(m.known or session.kind == "loaded" for m in session.markers),
        coupling=follow,
    )


def _gravity(session: Session, kin: Kinematics) -> Array:
    """Gravity in base_link, m/s^2: as stated, else by a station that stands level."""
    if "gravity" not in session.meta and any(s.level for s in session.stations):
        level = level_gravity(registered(session, kin).stations)
        if level is not None:
            return level
    return np.asarray(session.gravity_in_base, dtype=float)


def marker_by_controller(session: Session, kin: Kinematics) -> Array:
    """Where the controller (or the URDF) believes the marker to be, in base_link, (n, 3), m."""
    xyz = np.array([m.xyz for m in session.markers])[session.marker]
    on_tool = np.array([m.link == "tool0" for m in session.markers])[session.marker]
    p_on_tool = session.p_tcp_in_base + np.einsum("nij,nj->ni", kin.R_tool, xyz)
    return np.where(on_tool[:, None], p_on_tool, xyz)


def _previous_row(session: Session) -> IntArray:
    """Row before in time: within pose, repeat and marker (loaded) or the pose before with any marker (absolute)."""
    previous = np.full(len(session), -1)
    if session.clock == "none":
        return previous
    order = np.lexsort((session.load_case, session.stamp))
    if session.kind == "loaded":
        last: dict[tuple[int, int, int], int] = {}
        for i in order:
            key = (int(session.pose[i]), int(session.repeat[i]), int(session.marker[i]))
            # the robot is relaxed at its reference: history begins there
            if session.load_case[i] != 0:
                previous[i] = last.get(key, -1)
            last[key] = int(i)
        return previous
    current, before = -1, -1
    for i in order:
        if current >= 0 and session.pose[i] != session.pose[current]:
            before = current
        current = int(i)
        previous[i] = before
    return previous
