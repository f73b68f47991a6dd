# SPDX-License-Identifier: Apache-2.0
"""What an effect may read about the rows of a session (or of a production course): state, load, history.

A scene never holds the model's parameters, and an effect never sees more than a scene. For predictions the scene observes the
TCP and has no measured positions at all, so a prediction can't read marker columns by mistake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..robot import Kinematics, Payload, Robot
from ..robot.coupled import coupling
from ..session.data import Session
from ..session.registration import level_gravity, registered
from ..typing import Array, BoolArray, IntArray
from .state import Arm, Gravity, Instruments, Load, Rows, View


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
    """n rows of a robot with k joints: parts of which each derives what follows from it (effects/state.py).

    What effects mostly read is offered here under one name each. A scene whose parts belong to different states of the arm is
    refused: to change one, use `at`, `seen_at`, `with_wrench`.

    Attributes:
        ext: external axes by name, (n,), m or rad. temperature: by name, (n,), degC.
        elastic: what the model's elastic effects answer in these rows; only for effects with `needs_elastic`.
    """

    rows: Rows
    view: View
    load: Load
    gravity: Gravity
    instruments: Instruments
    ext: dict[str, Array] = field(default_factory=dict)
    temperature: dict[str, Array] = field(default_factory=dict)
    elastic: ElasticResponse | None = None

    def __post_init__(self) -> None:
        if not self.view.arm is self.load.arm is self.gravity.arm:
            raise ValueError("view, load and gravity of a scene must belong to the same Arm; change them together by Scene.at")

    def __len__(self) -> int:
        return len(self.rows.stamp)

    @cached_property
    def remembered(self) -> dict[str, Any]:
        """What functions of this very scene keep for the next call, by a name of their own."""
        return {}

    # -- rows --

    @property
    def kind(self) -> str:
        """`loaded` or `absolute`."""
        return self.rows.kind

    @property
    def pose(self) -> IntArray:
        return self.rows.pose

    @property
    def repeat(self) -> IntArray:
        return self.rows.repeat

    @property
    def load_case(self) -> IntArray:
        return self.rows.load_case

    @property
    def stamp(self) -> Array:
        """Time since the session began, (n,), s."""
        return self.rows.stamp

    @property
    def load_since(self) -> Array:
        """The stamp from which the row's load has acted, (n,), s."""
        return self.rows.load_since

    @property
    def reference(self) -> IntArray:
        """Index of each row's reference row, -1 in absolute sessions, (n,)."""
        return self.rows.reference

    @property
    def previous(self) -> IntArray:
        """Index of the row (absolute: of the pose) before, -1 for the first, (n,)."""
        return self.rows.previous

    @property
    def clock(self) -> str:
        """`time`, `order` or `none`."""
        return self.rows.clock

    # -- arm --

    @property
    def arm(self) -> Arm:
        return self.view.arm

    @property
    def robot(self) -> Robot:
        return self.arm.robot

    @property
    def kin(self) -> Kinematics:
        return self.arm.kin

    @property
    def q(self) -> Array:
        """Joint angles, (n, k), rad."""
        return self.arm.q

    @property
    def step(self) -> Array:
        """Change of the joint angles since the previous row, 0 where there is none, (n, k), rad."""
        return self.arm.step

    @property
    def p_tcp(self) -> Array:
        """TCP by the controller, (n, 3), m."""
        return self.arm.p_tcp

    @property
    def driven(self) -> BoolArray:
        """False for passive joints, (k,)."""
        return self.arm.driven

    @property
    def coupling(self) -> Array | None:
        """How passive joints follow the driven ones, (n, k, k)."""
        return self.arm.coupling

    @property
    def n_joints(self) -> int:
        return int(self.q.shape[1])

    @property
    def axis_in_joint(self) -> Array:
        """Unit vector of each actuated axis in the joint's own frame, (k, 3)."""
        return np.einsum("kji,kj->ki", self.kin.R_joint[0], self.kin.axis[0])

    # -- observed point --

    @property
    def p_observed(self) -> Array:
        """The point whose displacement is asked for, (n, 3), m."""
        return self.view.p_observed

    @property
    def moves_with_arm(self) -> BoolArray:
        """False for a marker on base_link, (n,)."""
        return self.view.moves_with_arm

    @property
    def J(self) -> Array:
        """Translational Jacobian of the actuated axes at the observed point, (n, 3, k); 0 where it does not move."""
        return self.view.J

    @property
    def V(self) -> Array:
        """The same for the virtual axes, (n, 3, 2k), ordered 1a, 1b, 2a, ..."""
        return self.view.V

    # -- process wrench --

    @property
    def force_in_tool(self) -> Array:
        """Force of the environment on the robot at the TCP, in tool0, (n, 3), N."""
        return self.load.force_in_tool

    @property
    def torque_in_tool(self) -> Array:
        """Torque about the TCP, in tool0, (n, 3), N m."""
        return self.load.torque_in_tool

    @property
    def force(self) -> Array:
        """Force of the environment on the robot in base_link, (n, 3), N."""
        return self.load.force

    @property
    def torque(self) -> Array:
        """Torque of the environment on the robot about the TCP, in base_link, (n, 3), N m."""
        return self.load.torque

    @property
    def tau(self) -> Array:
        """Torque of the process wrench about each actuated axis, Eq. (9), (n, k), N m."""
        return self.load.tau

    @property
    def tau_virtual(self) -> Array:
        """Torque of the process wrench about each virtual axis, Eq. (9), (n, 2k), N m."""
        return self.load.tau_virtual

    # -- gravity --

    @property
    def gravity_in_base(self) -> Array:
        """Gravity, (3,), m/s^2."""
        return self.gravity.in_base

    @property
    def payload(self) -> Payload | None:
        return self.gravity.payload

    @property
    def tau_gravity(self) -> Array:
        """Torque that gravity exerts about each axis, (n, k), N m."""
        return self.gravity.tau

    # -- instruments --

    @property
    def station(self) -> IntArray:
        return self.instruments.station

    @property
    def stations(self) -> tuple[str, ...]:
        return self.instruments.stations

    @property
    def station_known(self) -> tuple[bool, ...]:
        return self.instruments.station_known

    @property
    def marker(self) -> IntArray:
        return self.instruments.marker

    @property
    def markers(self) -> tuple[str, ...]:
        return self.instruments.markers

    @property
    def marker_known(self) -> tuple[bool, ...]:
        return self.instruments.marker_known

    @property
    def measured_from_station(self) -> Array | None:
        """Vector from the station to the measured marker, (n, 3), m; None in predictions."""
        return self.instruments.measured_from_station

    @property
    def modelled_from_station(self) -> Array | None:
        """Vector from the station to where the controller believes the marker, (n, 3), m; None in predictions."""
        return self.instruments.modelled_from_station

    @property
    def sensor_axis_in_tool(self) -> tuple[float, float, float]:
        return self.instruments.sensor_axis_in_tool

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

    # -- what a loaded and an absolute session take for the load, and what they observe --

    def total(self, process: Array, by_gravity: Callable[[], Array]) -> Array:
        """What springs answer to: the process alone in a loaded session, where that of gravity cancels; both in an absolute one.

        The one place where both kinds of session differ for springs.

        Args:
            process: any quantity that the process wrench causes. by_gravity: gives the same by gravity.
        """
        return process if self.kind == "loaded" else process + by_gravity()

    def load_torque(self) -> Array:
        """The torque about the actuated axes that springs answer to, (n, k), N m."""
        return self.total(self.tau, lambda: self.tau_gravity)

    def load_torque_virtual(self) -> Array:
        """The torque about the virtual axes that springs answer to, (n, 2k), N m."""
        return self.total(self.tau_virtual, lambda: self.gravity.tau_virtual)

    def load_wrench_at_base(self) -> tuple[Array, Array]:
        """Force and moment about the origin of base_link that a spring there answers to, (n, 3) each, N and N m."""
        force = self.total(self.force, lambda: self.gravity.wrench_at_base[0])
        moment = np.cross(self.p_tcp, self.force) + self.torque
        return force, self.total(moment, lambda: self.gravity.wrench_at_base[1])

    def preload(self) -> Array:
        """Torque about the actuated axes whose effect cancels in what is observed, (n, k), N m: gravity's, or none."""
        return self.tau_gravity if self.kind == "loaded" else np.zeros_like(self.tau_gravity)

    def change(self, displacement: Array) -> Array:
        """What a session of this kind observes of a displacement per row: its change against the reference row."""
        if self.kind == "absolute":
            return displacement
        return displacement - displacement[self.reference]

    # -- the same rows otherwise --

    def with_wrench(self, force_in_tool: Array, torque_in_tool: Array) -> Scene:
        """Under another wrench, (n, 3) each, N and N m in tool0."""
        return replace(self, load=Load(self.arm, force_in_tool, torque_in_tool))

    def seen_at(self, p_observed: Array) -> Scene:
        """With another observed point, (n, 3), m, on the same link."""
        return replace(self, view=View(self.arm, p_observed, self.moves_with_arm))

    def at(self, arm: Arm, p_observed: Array, tau_gravity: Array) -> Scene:
        """With the arm elsewhere; the wrench in tool0 stays."""
        return replace(
            self,
            view=View(arm, p_observed, self.moves_with_arm),
            load=Load(arm, self.force_in_tool, self.torque_in_tool),
            gravity=Gravity(arm, self.gravity_in_base, tau_gravity, self.payload, self.gravity.branches),
        )

    def take(self, rows: IntArray) -> Scene:
        """Some rows of an absolute session only; step, load and history of each stay what they were."""
        n = len(self)
        position = np.full(n + 1, -1)
        position[rows] = np.arange(len(rows))

        def cut(part: Any, **changed: Any) -> Any:
            per_row = {
                f.name: getattr(part, f.name)[rows]
                for f in fields(part)
                if f.name not in NOT_PER_ROW and isinstance(getattr(part, f.name), np.ndarray)
            }
            return replace(part, **{**per_row, **changed})

        arm = cut(self.arm, kin=cut(self.kin))
        return Scene(
            rows=cut(self.rows, previous=position[self.previous[rows]]),
            view=cut(self.view, arm=arm),
            load=cut(self.load, arm=arm),
            gravity=cut(self.gravity, arm=arm, branches={k: v[rows] for k, v in self.gravity.branches.items()}),
            instruments=cut(self.instruments),
            ext={k: v[rows] for k, v in self.ext.items()},
            temperature={k: v[rows] for k, v in self.temperature.items()},
            elastic=None if self.elastic is None else cut(self.elastic),
        )


NOT_PER_ROW = ("driven", "in_base", "is_prismatic", "virtual_in_joint")  # arrays of the parts of a scene that are not per row


def scene_of(session: Session, *, observe: str = "marker") -> Scene:
    """The scene of a session.

    Args:
        session: any session.
        observe: `marker` (identification: p_observed is where the controller believes the marker) or `tcp` (prediction).
    """
    kin = session.robot.kinematics(session.q)
    n = len(session)
    previous = _previous_row(session)
    has_previous = previous >= 0
    on_tool = np.array([m.link == "tool0" for m in session.markers])[session.marker]
    p_observed = marker_by_controller(session, kin) if observe == "marker" else session.p_tcp_in_base
    from_station = modelled = None
    if observe == "marker":
        R = np.stack([s.R_in_base for s in session.stations])[session.station]
        from_station = np.einsum("nij,nj->ni", R, session.p_marker_in_station)
        modelled = p_observed - np.array([s.xyz for s in session.stations])[session.station]
    in_base = _gravity(session, kin)
    x, y, z = (float(v) for v in session.meta.get("sensor_axis_in_tool", (0.0, 0.0, 1.0)))
    branches = {n: v for n, v in session.ext.items() if n in session.robot.branch_joints}
    arm = Arm(
        session.robot, kin, session.q,
        step=np.where(has_previous[:, None], session.q - session.q[previous], 0.0),
        p_tcp=session.p_tcp_in_base,
        driven=np.array([name not in session.passive for name in session.robot.joint_names]),
        coupling=coupling(session.passive, session.robot.joint_names, session.q), repeatability=session.noise.robot_m,
    )  # fmt: skip
    return Scene(
        rows=Rows(
            session.kind, session.pose, session.repeat, session.load_case, session.stamp,
            load_since=np.where(has_previous, session.stamp[previous], session.stamp),
            reference=session.reference_row(), previous=previous, clock=session.clock,
        ),
        view=View(arm, p_observed, on_tool if observe == "marker" else np.ones(n, dtype=bool)),
        load=Load(arm, session.force_in_tool, session.torque_in_tool),
        gravity=Gravity(
            arm, in_base, arm.followed(session.robot.gravity_torque(session.q, in_base, session.payload, branches)),
            session.payload, branches,
        ),
        instruments=Instruments(
            session.station, tuple(s.name for s in session.stations), session.marker, tuple(m.name for m in session.markers),
            station_known=tuple(s.known or session.kind == "loaded" for s in session.stations),
            marker_known=tuple(m.known or session.kind == "loaded" for m in session.markers),
            measured_from_station=from_station, modelled_from_station=modelled, sensor_axis_in_tool=(x, y, z),
        ),
        ext=session.ext,
        temperature=session.temperature,
    )  # fmt: skip


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
