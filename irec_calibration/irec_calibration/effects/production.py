# SPDX-License-Identifier: Apache-2.0
"""One pose without and with process force: the scene in which effects are asked what production would see of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..robot import Payload, Robot
from ..typing import Array
from .scene import Scene
from .state import Arm, Gravity, Instruments, Load, Rows, View

POINTS = np.vstack([np.zeros(3), np.eye(3)])  # m off the TCP; from what they see the rotation comes
LOADED = np.repeat([0, 1], len(POINTS))  # without, then with process force
ROWS = len(LOADED)


def at(scene: Scene, q: Array, rail_position: float) -> Scene:
    """The rows of a production scene at other joint angles (k,), rad, and rail position, m, without process force."""
    rows = np.tile(q, (ROWS, 1))
    kin = scene.robot.kinematics(rows)
    arm = replace(scene.arm, q=rows, kin=kin, p_tcp=kin.p_tcp)
    tau_gravity = scene.robot.gravity_torque(rows, scene.gravity_in_base, scene.gravity.payload)
    there = scene.at(arm, kin.p_tcp + np.tile(POINTS, (2, 1)), tau_gravity)
    return replace(there, ext={name: np.full(ROWS, rail_position) for name in scene.ext})


def production_scene(robot: Robot, gravity_in_base: Array, payload: Payload | None = None, rail_name: str = "rail") -> Scene:
    """One pose without and with process force, at joint angles zero: what effects are asked about in production."""
    q = np.zeros((ROWS, robot.n_joints))
    kin = robot.kinematics(q)
    none, count = np.zeros((ROWS, 3)), np.zeros(ROWS, dtype=np.int64)
    arm = Arm(robot, kin, q, q, kin.p_tcp, np.ones(robot.n_joints, dtype=bool))
    return Scene(
        Rows("loaded", count, count, LOADED, np.zeros(ROWS), np.zeros(ROWS), count, LOADED - 1, clock="none"),
        View(arm, kin.p_tcp, np.ones(ROWS, dtype=bool)),
        Load(arm, none, none),
        Gravity(arm, np.asarray(gravity_in_base), q, payload),
        Instruments(count, ("",), count, ("tcp",)),
        ext={rail_name: np.zeros(ROWS)},
    )
