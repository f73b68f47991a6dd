# SPDX-License-Identifier: Apache-2.0
"""What an effect is in real time: the forms that the live correction can evaluate in every tick.

An effect answers `live(scene, theta)` with one of these, in its own file, next to its regressor. The correction assembles
them and knows no effect by name. Columns are those of the chain of drives and virtual axes that the correction builds:
`joint_3` (drive of axis 3), `joint_3a`, `joint_3b` (its virtual axes), `joint_3tz`, `joint_3ta`, `joint_3tb` (shifts of the
joint along these three), `base_t_x` .. `base_r_z` (spring at base_link), `tool_x` .. `tool_z` (spring in tool0). The torque of
a column is in N m (N where it slides), its displacement in rad (m).

What is computed is the change against the same joint angles without process force and without history: all that
`model.predict` computes for a loaded row against a reference row at the same joint angles.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from ..typing import Array


class Tick:
    """The state of one tick.

    Attributes:
        q: joint angles, (k,), rad.
        drives: places of the drives among all columns, (k,).
        tau: torque of the process about each drive, (k,), N m; kept up to date where the model has an `ElasticLaw`.
        tau_gravity: torque of gravity about each drive, (k,), N m; zeros where no form asks for it.
        tau_unseen: torque about each drive of what pulls at the arm and no sensor reads (`Pull`), (k,), N m.
        dt: time since the tick before, s.
        rail_position: of the external axis, m.
        force, torque: of the process at the TCP as they really act, in tool0, (3,) each, N and N m.
        directions: unit vectors in base_link of the columns that a `Pull` asks for, (3, c).
        moments: of these about the origin of base_link, p x direction, (3, c), m.
    """

    __slots__ = (
        "directions", "drives", "dt", "force", "moments", "q", "rail_position", "tau", "tau_gravity", "tau_unseen", "torque",
    )  # fmt: skip

    def __init__(self, n_joints: int) -> None:
        self.q = np.zeros(n_joints)
        self.drives = np.arange(n_joints)
        self.tau = np.zeros(n_joints)
        self.tau_gravity = np.zeros(n_joints)
        self.tau_unseen = np.zeros(n_joints)
        self.dt = 0.0
        self.rail_position = 0.0
        self.force = np.zeros(3)
        self.torque = np.zeros(3)
        self.directions = np.zeros((3, 0))
        self.moments = np.zeros((3, 0))


@dataclass(frozen=True)
class Springs:
    """Springs that never change: (column that moves, column whose torque moves it, compliance)."""

    entries: tuple[tuple[str, str, float], ...]


@dataclass(frozen=True)
class SensorMap:
    """What really acts, from what the force sensor reads: f = force @ f_read + weight @ g, m = torque @ m_read.

    Attributes:
        force, torque: (3, 3), in tool0.
        weight: (3, 3), kg; g is gravity in tool0, m/s^2.
    """

    force: Array = field(default_factory=lambda: np.eye(3))
    torque: Array = field(default_factory=lambda: np.eye(3))
    weight: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def after(self, first: SensorMap) -> SensorMap:
        """This map applied to the result of another one."""
        return SensorMap(self.force @ first.force, self.torque @ first.torque, self.force @ first.weight + self.weight)


class ColumnLaw(ABC):
    """Displacement of some columns from their own torque and the state of the tick; may keep a history.

    Attributes:
        columns: names of the columns, c of them.
        elastic: a spring (linear in the torque): part of the elastic response that creep and external forces refer to.
        needs_gravity: reads `tick.tau_gravity`.
        springs: linear part of it, that is left out of `displacement`: part of the elastic response too.
    """

    columns: tuple[str, ...]
    elastic = False
    springs = Springs(())
    needs_gravity = False

    def reset(self) -> None:
        """Forget history: the robot stands relaxed, without process force."""
        return None

    @abstractmethod
    def displacement(self, tick: Tick, tau: Array) -> Array:
        """Displacement (c,) under the torque tau (c,) of the process."""


class ElasticLaw(ABC):
    """A displacement of all columns that follows the elastic response to the process, such as creep."""

    def reset(self) -> None:
        """Forget history."""
        return None

    @abstractmethod
    def displacement(self, tick: Tick, elastic: Array, tcp: Array) -> Array:
        """Displacement of all columns from their elastic one and that of the TCP by it, (3,), m."""


class Pull(ABC):
    """A force and torque at the TCP that no sensor reads; the springs of the model answer to it.

    Attributes:
        columns: names of columns whose directions and moments it reads (`tick.directions`, `tick.moments`).
        beyond: drives between two links that it pulls together: only what gives way there answers (`between`); none: it does not.
    """

    columns: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()

    @abstractmethod
    def force(self, tick: Tick, p_tcp: Array, R_tool: Array) -> Array:
        """Force on the robot in base_link, (3,), N; `p_tcp` (3,), m, and `R_tool` (3, 3): tool0 in base_link."""

    def torque(self, tick: Tick, p_tcp: Array, R_tool: Array) -> Array:
        """Torque on the robot about the TCP, in base_link, (3,), N m."""
        return np.zeros(3)

    def between(self, tick: Tick, p_tcp: Array, R_tool: Array) -> tuple[Array, Array]:
        """For a pull between two links: force and torque about the TCP on the one beyond, in base_link, (3,) each, N and N m."""
        return np.zeros(3), np.zeros(3)


@dataclass(frozen=True)
class ByDisplacement:
    """The effect's own `displacement`, evaluated without and with the process force. Some 0.2 ms a tick."""


@dataclass(frozen=True)
class LeftOut:
    """No part of a correction; `why` completes the sentence 'effect X has no part in the correction: it ...'."""

    why: str


@dataclass(frozen=True)
class Refused:
    """A model with this effect can't be activated; `why` completes the sentence 'effect X ...'."""

    why: str


LiveForm = Springs | SensorMap | ColumnLaw | ElasticLaw | Pull | ByDisplacement | LeftOut | Refused


def drives(n_joints: int) -> tuple[str, ...]:
    """Names of the columns of the drives."""
    return tuple(f"joint_{k + 1}" for k in range(n_joints))
