# SPDX-License-Identifier: Apache-2.0
"""What comes in by topics, checked and passed on to the chain: wrench, joint states, robot description."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from geometry_msgs.msg import WrenchStamped
from irec_calibration.joint_states import contradiction, named_twice
from irec_calibration.typing import Array
from sensor_msgs.msg import JointState

from ..correction import Correction
from ..input_quality import InputQuality
from ..link_angles import LinkAngles
from ..orientations import Orientations
from ..watchdog import Fault, Finding
from .chain_clock import ChainClock


class CorrectionInputs:
    """Messages into one chain."""

    def __init__(
        self, correction: Correction, names: Sequence[str], clock: ChainClock, rail_joint: str,
        orientations: Orientations | None = None, links: LinkAngles | None = None, *,
        rail_needed: bool = False, strangers: Callable[[Sequence[str]], None] | None = None, quality: InputQuality | None = None,
    ) -> None:  # fmt: skip
        """names: of the robot's joints in joint_states, from base to tool; rail_joint: of the rail there; rail_needed: the cell
        has one. strangers: is told names of joint states without any joint of this robot. quality: None: is not looked at."""
        self._rail_needed, self._strangers, self._quality = rail_needed, strangers, quality
        self._links = links
        self._correction, self._clock, self._orientations = correction, clock, orientations
        self._wanted, self._rail_joint = tuple(names), rail_joint
        self._names: list[str] = []
        self._columns: list[int] = []
        self._rail: int | None = None
        self._twice: list[tuple[str, list[int]]] = []
        self._links_twice: list[tuple[str, list[int]]] = []
        self._link_names: list[str] = []
        self._link_columns: list[int] = []

    def take_wrench(self, message: WrenchStamped) -> float:
        """One reading; the time of the chain, s."""
        f, t = message.wrench.force, message.wrench.torque
        stamp = self._clock.of(message.header.stamp)
        now = self._clock.now(stamp)
        reading = np.array([f.x, f.y, f.z, t.x, t.y, t.z])
        if self._quality is not None:
            self._quality.take("wrench", stamp, now)
        self._correction.take_wrench(stamp, now, message.header.frame_id, reading)
        if self._orientations is not None and np.all(np.isfinite(reading)):
            self._orientations.take_wrench(stamp, reading)
        return now

    def take_joints(self, message: JointState) -> None:
        """Joint angles by name; a message without any joint of the robot is somebody else's."""
        if message.name != self._names:
            self._learn(list(message.name))
        if not self._columns:
            if self._strangers is not None:
                self._strangers(self._names)
            return
        if not self._has_rail() or not self._agree(message):
            return
        # names without a position are missing joints, and the watchdog says how many came
        given = len(message.position)
        q = np.array([message.position[i] for i in self._columns if i < given], dtype=float)
        stamp = self._clock.of(message.header.stamp)
        rail = 0.0
        if self._rail is not None:
            rail = message.position[self._rail] if self._rail < given else math.nan  # named, but without a position
        now = self._clock.now(stamp)
        if self._quality is not None:
            self._quality.take("joint_states", stamp, now)
        self._correction.take_joints(stamp, now, q, rail)
        if self._links is not None and q.shape == (len(self._wanted),) and np.isfinite(q).all():
            self._pass_on(self._links.take_motor(stamp, q))
        if self._orientations is not None and len(q) == len(self._wanted) and math.isfinite(float(q.sum())):
            self._orientations.take_joints(stamp, q)

    def _has_rail(self) -> bool:
        """Whether the rail is among joint states that came in; where it is not, the robot may stand anywhere on it."""
        if not self._rail_needed or self._rail is not None:
            self._correction.watchdog.clear("rail")
            return True
        names = ", ".join(f"'{n}'" for n in self._names)
        self._correction.watchdog.refuse(
            "rail",
            Fault.JOINTS_NAMES,
            f"joint_states: there is no '{self._rail_joint}' among {names}, and the cell file has a rail; the driver has to send"
            " it in each message, under the name of robot.rail.joint_name",
        )
        return False

    def _agree(self, message: JointState) -> bool:
        """Whether a joint that is named twice is at one place."""
        why = contradiction(self._twice, message.position) if self._twice else ""
        if why:
            self._correction.watchdog.refuse("joint names", Fault.JOINTS_NAMES, f"joint_states: {why}")
        else:
            self._correction.watchdog.clear("joint names")
        return not why

    def take_links(self, message: JointState) -> None:
        """Link-side angles by name; a message without any joint of the robot is somebody else's."""
        if self._links is None:
            return
        if message.name != self._link_names:
            self._link_names = list(message.name)
            self._link_columns = [self._link_names.index(j) for j in self._wanted if j in self._link_names]
            self._links_twice = named_twice(self._link_names, self._wanted)
        if not self._link_columns:
            return
        if why := contradiction(self._links_twice, message.position):
            self._correction.refuse_links(Finding(Fault.JOINTS_NAMES, f"link angles: {why}"))
            return
        given = len(message.position)
        angles = np.array([message.position[i] for i in self._link_columns if i < given], dtype=float)
        stamp = self._clock.of(message.header.stamp)
        self._pass_on(self._links.take_link(stamp, self._clock.now(stamp), angles))

    def _pass_on(self, told: tuple[float, Array | Finding] | None) -> None:
        """A windup, as old as its stamp is, or what is wrong with it."""
        if told is None:
            return
        stamp, windup = told
        if isinstance(windup, Finding):
            self._correction.refuse_links(windup)
        else:
            self._correction.take_links(stamp, windup)

    def _learn(self, names: list[str]) -> None:
        self._names = names
        self._columns = [names.index(j) for j in self._wanted if j in names]
        self._rail = names.index(self._rail_joint) if self._rail_joint in names else None
        self._twice = named_twice(names, (*self._wanted, self._rail_joint))
