# SPDX-License-Identifier: Apache-2.0
"""What an effect may read about the rows of a session (or of a production course): state, load, history.

A scene never holds the model's parameters, and an effect never sees more than a scene. For predictions the scene observes the
TCP and has no measured positions at all, so a prediction can't read marker columns by mistake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..robot import Kinematics, Payload, Robot
from ..typing import Array, BoolArray, IntArray
from .state import Arm, ElasticResponse, Gravity, Instruments, Load, Rows, View, cut

WRIST_AXES = 3


@dataclass(frozen=True)
class Scene:
    """n rows of a robot with k joints: parts of which each derives what follows from it (effects/state.py).

    What effects mostly read is offered here under one name each. A scene whose parts belong to different states of the arm is
    refused: to change one, use `at`, `seen_at`, `with_wrench`.

    Attributes:
        ext: external axes by name, (n,), m or rad. temperature: by name, (n,), degC.
        elastic: what the model's elastic effects answer in these rows; only for effects with `needs_elastic`.
        tau_unseen: torque about the actuated axes of what pulls at the arm and no sensor reads, by the model, (n, k), N m; None:
            nothing does.
        asked: parameters that effects have here, as far as they were asked for (`parameters_of`).
    """

    rows: Rows
    view: View
    load: Load
    gravity: Gravity
    instruments: Instruments
    ext: dict[str, Array] = field(default_factory=dict)
    temperature: dict[str, Array] = field(default_factory=dict)
    elastic: ElasticResponse | None = None
    tau_unseen: Array | None = None
    asked: dict[int, tuple[object, tuple[Any, ...]]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.view.arm is self.load.arm is self.gravity.arm:
            raise ValueError("view, load and gravity of a scene must belong to the same Arm; change them together by Scene.at")

    def __len__(self) -> int:
        return len(self.rows.stamp)

    # -- rows --

    @property
    def kind(self) -> str:
        """`loaded` or `absolute`."""
        return self.rows.kind

    @property
    def pose(self) -> IntArray:
        return self.rows.pose

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
    def wrist(self) -> list[int]:
        """Joints of the wrist, counted from 0: the last three driven ones."""
        found: list[int] = np.flatnonzero(self.driven)[-WRIST_AXES:].tolist()
        return found

    @property
    def n_joints(self) -> int:
        return int(self.q.shape[1])

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
    def tau_acting(self) -> Array:
        """The same with the torque of what no sensor reads, such as hoses, (n, k), N m: what gears carry beside the weight."""
        return self.tau if self.tau_unseen is None else self.tau + self.tau_unseen

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
    def tau_gravity(self) -> Array:
        """Torque that gravity exerts about each axis, (n, k), N m."""
        return self.gravity.tau

    # -- instruments --

    @property
    def station(self) -> IntArray:
        return self.instruments.station

    @property
    def response(self) -> ElasticResponse:
        """What the model's elastic effects answer. ValueError: this scene does not know it (see `needs_elastic`)."""
        if self.elastic is None:
            raise ValueError("the scene was made without the elastic response of a model")
        return self.elastic

    @property
    def stations(self) -> tuple[str, ...]:
        return self.instruments.stations

    @property
    def measured_from_station(self) -> Array | None:
        """Vector from the station to the measured marker, (n, 3), m; None in predictions."""
        return self.instruments.measured_from_station

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

    def load_wrench_in_tool(self) -> tuple[Array, Array]:
        """Force and torque about tool0 that a spring beyond the flange answers to, in tool0, (n, 3) each, N and N m."""
        force = self.total(self.force_in_tool, lambda: self.gravity.payload_in_tool[0])
        return force, self.total(self.torque_in_tool, lambda: self.gravity.payload_in_tool[1])

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
        return self.loaded_otherwise(load=Load(self.arm, force_in_tool, torque_in_tool))

    def loaded_otherwise(self, **changed: Any) -> Scene:
        """With another load, elastic response or torque that no sensor reads, on which the parameters of no effect depend."""
        out = replace(self, **changed)
        object.__setattr__(out, "asked", self.asked)
        return out

    def seen_at(self, p_observed: Array) -> Scene:
        """With another observed point, (n, 3), m, on the same link."""
        return replace(self, view=View(self.arm, p_observed, self.moves_with_arm, self.view.sags, self.view.measured))

    def carrying(self, payload: Payload) -> Scene:
        """With another payload, whose weight loads the axes."""
        g = self.gravity
        tau = self.arm.followed(self.robot.gravity_torque(self.arm.q, g.in_base, payload, g.branches))
        return replace(self, gravity=Gravity(self.arm, g.in_base, tau, payload, g.branches))

    def by_weight(self) -> Scene:
        """The same rows under nothing but the arm's own weight, all of it: as an absolute session without process."""
        kept = self.view.kept.get("by_weight")
        if not isinstance(kept, Scene) or kept.gravity is not self.gravity or kept.rows.reference is not self.rows.reference:
            nothing = np.zeros((len(self), 3))
            kept = replace(
                self,
                rows=replace(self.rows, kind="absolute"),
                view=View(self.arm, self.p_observed, self.moves_with_arm, measured=self.view.measured),
                load=Load(self.arm, nothing, nothing),
                elastic=None,
                tau_unseen=None,
            )
            self.view.kept["by_weight"] = kept
        return kept

    def at(self, arm: Arm, p_observed: Array, tau_gravity: Array) -> Scene:
        """With the arm elsewhere; the wrench in tool0 stays."""
        return replace(
            self,
            view=View(arm, p_observed, self.moves_with_arm, self.view.sags, self.view.measured),
            load=Load(arm, self.force_in_tool, self.torque_in_tool),
            gravity=Gravity(arm, self.gravity_in_base, tau_gravity, self.gravity.payload, self.gravity.branches),
        )

    def take(self, rows: IntArray) -> Scene:
        """Some rows of an absolute session only; step, load and history of each stay what they were."""
        n = len(self)
        position = np.full(n + 1, -1)
        position[rows] = np.arange(len(rows))

        arm = cut(self.arm, rows, kin=cut(self.kin, rows))
        return Scene(
            rows=cut(self.rows, rows, previous=position[self.previous[rows]]),
            view=cut(self.view, rows, arm=arm),
            load=cut(self.load, rows, arm=arm),
            gravity=cut(self.gravity, rows, arm=arm, branches={k: v[rows] for k, v in self.gravity.branches.items()}),
            instruments=cut(self.instruments, rows),
            ext={k: v[rows] for k, v in self.ext.items()},
            temperature={k: v[rows] for k, v in self.temperature.items()},
            elastic=None if self.elastic is None else cut(self.elastic, rows),
            tau_unseen=None if self.tau_unseen is None else self.tau_unseen[rows],
        )
