# SPDX-License-Identifier: Apache-2.0
"""Physical parameters of the plant. Every field has a neutral default, so that a plant is elastic unless told otherwise.

Arrays are per robot joint (n,) or per degree of freedom of a 6-spring: translation x, y, z then rotation x, y, z.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .kinematics import Array


def _zeros(*shape: int) -> Array:
    return np.zeros(shape)


@dataclass(frozen=True)
class Balancer:
    """Gas cylinder between link 1 and link 2 that carries part of the load of axis 2.

    Attributes:
        stiffness: of the enclosed fluid column and its linkage against quick changes of load, N/m.
        anchor: distance of the cylinder's foot from axis 2, m; arm: of its head, m.
        angle: of joint 2 at which foot, axis and head are in line, rad.
    """

    stiffness: float = 0.0
    anchor: float = 0.42
    arm: float = 0.20
    angle: float = -2.6

    def lever(self, q2: Array) -> Array:
        """Moment arm of the cylinder about axis 2, m."""
        a = q2 - self.angle
        length = np.sqrt(self.anchor**2 + self.arm**2 - 2.0 * self.anchor * self.arm * np.cos(a))
        return self.anchor * self.arm * np.sin(a) / length


@dataclass(frozen=True)
class PlantParameters:
    """What the elastic plant is made of, for a robot of n = 6 joints.

    Attributes:
        axial: compliance about each actuated axis, (n,), rad/(N m).
        transverse: about the two axes orthogonal to it, (n, 2), rad/(N m).
        base, tool: 6-springs under base_link and at the tool's mount, m/N and rad/(N m); 0 is rigid.
        rail: 6-spring of the carriage at the ends of the travel; rail_middle: share of it in mid-travel; rail_half: m.
        backlash: half width of the play of each gear, (n,), rad; backlash_torque: at which the play is crossed, N m.
        soft_zone: extra compliance of each gear near zero torque as a share, (n,); soft_torque: its extent, (n,), N m.
        friction: windup stored by dry friction in each gear, (n,), as a share of the axial compliance.
        friction_torque: at which its elements slip, (n,), N m.
        creep: delayed compliance as a share of the axial one, (n,); creep_time: s.
        coupling: off-diagonal compliance between gears, (n, n) symmetric, rad/(N m).
        balancer: of axis 2.
        cable_in_base, cable_in_tool: force of hoses that acts on the tool whenever the process is on, N;
            cable_wrist: its change with sin(joint 4), sin(joint 6), in the tool, (2, 3), N.
        joint_zero: true minus nominal joint angle, (n,), rad; p_error, turn_error: of each joint's frame, (n, 3), m, rad.
        gear_heat: relative change of axial compliance per kelvin of that gear above 25 degC, (n,), 1/K.
        neighbour: relative change of axial compliance of joint k with sin(2 q_l), (n, n).
        taper: way that the tool's taper slides along its axis per square of the side load, m/N^2.
        flange_gap: further rocking compliance of the tool's mount about x, y for moments that open it, (2,), rad/(N m).
        torque_product: angle of joint k per product of its torque and that of joint l, (n, n), rad/(N m)^2.
        contact_offset: point where the process force acts, in tool0, (3,), m.
    """

    axial: Array
    transverse: Array
    base: Array = field(default_factory=lambda: _zeros(6))
    tool: Array = field(default_factory=lambda: _zeros(6))
    rail: Array = field(default_factory=lambda: _zeros(6))
    rail_middle: float = 0.2
    rail_half: float = 1.5
    backlash: Array = field(default_factory=lambda: _zeros(6))
    backlash_torque: float = 12.0
    soft_zone: Array = field(default_factory=lambda: _zeros(6))
    soft_torque: Array = field(default_factory=lambda: np.array([250.0, 300.0, 220.0, 80.0, 80.0, 50.0]))
    friction: Array = field(default_factory=lambda: _zeros(6))
    friction_torque: Array = field(default_factory=lambda: np.array([190.0, 490.0, 470.0, 100.0, 100.0, 60.0]))
    creep: Array = field(default_factory=lambda: _zeros(6))
    creep_time: float = 12.0
    coupling: Array = field(default_factory=lambda: _zeros(6, 6))
    balancer: Balancer = Balancer()
    cable_in_base: Array = field(default_factory=lambda: _zeros(3))
    cable_in_tool: Array = field(default_factory=lambda: _zeros(3))
    cable_wrist: Array = field(default_factory=lambda: _zeros(2, 3))
    joint_zero: Array = field(default_factory=lambda: _zeros(6))
    p_error: Array = field(default_factory=lambda: _zeros(6, 3))
    turn_error: Array = field(default_factory=lambda: _zeros(6, 3))
    gear_heat: Array = field(default_factory=lambda: _zeros(6))
    neighbour: Array = field(default_factory=lambda: _zeros(6, 6))
    taper: float = 0.0
    flange_gap: Array = field(default_factory=lambda: _zeros(2))
    torque_product: Array = field(default_factory=lambda: _zeros(6, 6))
    contact_offset: Array = field(default_factory=lambda: _zeros(3))
