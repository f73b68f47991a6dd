# SPDX-License-Identifier: Apache-2.0
"""Where each link is relative to its parent, from a URDF and joint angles: what `/tf` and `/tf_static` hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import RobotError
from ..typing import Array

TURNS = ("revolute", "continuous")
MOVES = (*TURNS, "prismatic")
FAR = 1e6  # m or rad: nothing of a robot is there


@dataclass(frozen=True)
class Transform:
    """A frame in its parent: translation (3,), m, and rotation as a quaternion x, y, z, w (4,)."""

    parent: str
    child: str
    xyz: Array
    quat_xyzw: Array


@dataclass(frozen=True)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    xyz: Array
    turn: Rotation
    axis: Array
    mimic: tuple[str, float, float] | None


class LinkTree:
    """The joints of a robot description, without any library of a robot."""

    def __init__(self, urdf_text: str, source: str = "robot description") -> None:
        """Read it. Raises RobotError: not a URDF."""
        try:
            root = ElementTree.fromstring(urdf_text)
            self._joints = [_joint(j) for j in root.findall("joint")]
        except (ElementTree.ParseError, AttributeError, KeyError, ValueError) as error:
            raise RobotError(f"{source}: not a robot description that can be read: {error}") from error
        if not self._joints:
            raise RobotError(f"{source}: no joint in it")

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the joints that move by themselves."""
        return tuple(j.name for j in self._joints if j.kind in MOVES and j.mimic is None)

    def fixed(self) -> list[Transform]:
        """Frames that never move in their parent."""
        return [Transform(j.parent, j.child, j.xyz, j.turn.as_quat()) for j in self._joints if j.kind not in MOVES]

    def at(self, positions: Mapping[str, float]) -> list[Transform]:
        """Frames that move, where the joints are; joints that are not named are left out."""
        out = []
        for j in self._joints:
            leader, factor, offset = j.mimic or (j.name, 1.0, 0.0)
            if j.kind not in MOVES or leader not in positions:
                continue
            q = factor * positions[leader] + offset
            if j.kind in TURNS:
                out.append(Transform(j.parent, j.child, j.xyz, (j.turn * Rotation.from_rotvec(q * j.axis)).as_quat()))
            else:
                out.append(Transform(j.parent, j.child, j.xyz + j.turn.apply(q * j.axis), j.turn.as_quat()))
        return out


def _joint(element: ElementTree.Element) -> _Joint:
    origin, axis, mimic = element.find("origin"), element.find("axis"), element.find("mimic")
    xyz = _numbers(origin.get("xyz", "0 0 0")) if origin is not None else np.zeros(3)
    rpy = _numbers(origin.get("rpy", "0 0 0")) if origin is not None else np.zeros(3)
    along = _numbers(axis.get("xyz", "1 0 0")) if axis is not None else np.array([1.0, 0.0, 0.0])
    length = float(np.linalg.norm(along))
    follows = None
    if mimic is not None:
        follows = (mimic.attrib["joint"], float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0)))
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise ValueError(f"joint '{element.get('name')}' has no parent or no child")
    return _Joint(
        element.attrib["name"], element.attrib["type"], parent.attrib["link"], child.attrib["link"], xyz,
        Rotation.from_euler("xyz", rpy), along / length if length > 0.0 else along, follows,
    )  # fmt: skip


def _numbers(text: str) -> Array:
    values = np.array([float(v) for v in text.split()])
    if values.shape != (3,) or not np.abs(values).max() < FAR:
        raise ValueError(f"'{text}' are not three numbers below {FAR:g}")
    return values
