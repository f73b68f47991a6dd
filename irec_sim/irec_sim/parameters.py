# SPDX-License-Identifier: Apache-2.0
"""Physical parameters of the plant. Every field has a neutral default, so that a plant is elastic unless told otherwise.

Arrays are per robot joint (n,) or per degree of freedom of a 6-spring: translation x, y, z then rotation x, y, z.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .kinematics import Array
from .laws import GearCurve
from .terms import Term


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
class Hose:
    """Hoses and cables of the head, under pressure while the process is on: they pull the tool to where they are fixed.

    Attributes:
        attach: where they are fixed on the tool, in the mount's frame, (3,), m.
        anchor: where they are fixed else, (3,), m: in the frame of a link (joint `link`, from 1), or with link 0 on the floor,
            in the cell frame.
        tension: N, at a distance of `reach` m; it grows by a factor e per `stretch` m, within e^2 either way.
        wrist: relative change with sin(joint n - 2) and sin(joint n), which twist and wind the hoses, (2,).
    """

    attach: Array
    anchor: Array
    link: int
    tension: float
    reach: float
    stretch: float
    wrist: Array


@dataclass(frozen=True)
class PlantParameters:
    """What the elastic plant is made of, for a robot of n joints. The defaults fit n = 6; `plain` takes any n.

    Attributes:
        axial: compliance about each actuated axis, (n,), rad/(N m).
        transverse: about the two axes orthogonal to it, (n, 2), rad/(N m).
        centre: where the springs of `transverse` sit, in the joint's frame, (n, 3), m.
        base, tool: 6-springs under base_link and at the tool's mount, m/N and rad/(N m); 0 is rigid.
        rail: 6-spring of the carriage where it is softest, at rail_place (m) along the travel; rail_floor: share of it far
            away; rail_width: m, of the soft place.
        curves: tables of gears that are softer at small torque.
        backlash: half width of the play of each gear, (n,), rad; backlash_torque: at which it is taken up, (n,), N m;
            backlash_sharpness: how suddenly.
        friction: windup stored by dry friction in each gear, (n,), as a share of the axial compliance;
            friction_torque: largest friction, (n,), N m; friction_form: `sliders` (several, one after the other) or
            `presliding` (after Dahl and LuGre), presliding: its stiffness at rest, times that of the wound part;
            unrelaxed: share of the largest friction that is held when the arm arrives at a reference;
            release: rad of motion of a joint that frees its friction by 1/e.
        creep: delayed compliance as a share of the axial one, (n,); creep_times, creep_weights: of the Maxwell branches, s.
        coupling: off-diagonal compliance between gears, (n, n) symmetric, rad/(N m).
        balancer: of axis 2.
        hose: pulls whenever the process is on.
        joint_zero: true minus nominal joint angle, (n,), rad; p_error, turn_error: of each joint's frame, (n, 3), m, rad.
        gear_heat: relative change of axial compliance per kelvin of that gear above 25 degC, (n,), 1/K.
        neighbour: relative change of axial compliance of joint k with sin(2 q_l), (n, n).
        taper: way that the tool's taper slides along its axis per square of the side load, m/N^2.
        flange_gap: further rocking compliance of the tool's mount about x, y for moments that open it, (2,), rad/(N m).
        bearing_gap: half width of the play across each axis, (n, 2), rad; bearing_torque: that takes it up, (n,), N m.
        torque_product: angle of joint k per product of its torque and that of joint l, (n, n), rad/(N m)^2.
        contact_offset: point where the process force acts, in tool0, (3,), m.
        terms: smooth causes outside the catalogue.
    """

    axial: Array
    transverse: Array
    centre: Array = field(default_factory=lambda: _zeros(6, 3))
    base: Array = field(default_factory=lambda: _zeros(6))
    tool: Array = field(default_factory=lambda: _zeros(6))
    rail: Array = field(default_factory=lambda: _zeros(6))
    rail_floor: float = 0.2
    rail_place: float = 0.0
    rail_width: float = 0.5
    curves: tuple[GearCurve, ...] = ()
    backlash: Array = field(default_factory=lambda: _zeros(6))
    backlash_torque: Array = field(default_factory=lambda: np.full(6, 12.0))
    backlash_sharpness: float = 6.0
    friction: Array = field(default_factory=lambda: _zeros(6))
    friction_torque: Array = field(default_factory=lambda: np.array([190.0, 490.0, 470.0, 100.0, 100.0, 60.0]))
    friction_form: str = "sliders"
    presliding: float = 4.0
    unrelaxed: float = 0.0
    release: float = np.inf
    creep: Array = field(default_factory=lambda: _zeros(6))
    creep_times: Array = field(default_factory=lambda: np.array([12.0]))
    creep_weights: Array = field(default_factory=lambda: np.array([1.0]))
    coupling: Array = field(default_factory=lambda: _zeros(6, 6))
    balancer: Balancer = Balancer()
    hose: Hose | None = None
    joint_zero: Array = field(default_factory=lambda: _zeros(6))
    p_error: Array = field(default_factory=lambda: _zeros(6, 3))
    turn_error: Array = field(default_factory=lambda: _zeros(6, 3))
    gear_heat: Array = field(default_factory=lambda: _zeros(6))
    neighbour: Array = field(default_factory=lambda: _zeros(6, 6))
    taper: float = 0.0
    flange_gap: Array = field(default_factory=lambda: _zeros(2))
    bearing_gap: Array = field(default_factory=lambda: _zeros(6, 2))
    bearing_torque: Array = field(default_factory=lambda: np.array([300.0, 300.0, 200.0, 60.0, 60.0, 40.0]))
    torque_product: Array = field(default_factory=lambda: _zeros(6, 6))
    contact_offset: Array = field(default_factory=lambda: _zeros(3))
    terms: tuple[Term, ...] = ()

    @classmethod
    def plain(cls, axial: Array, transverse: Array, friction_torque: Array | None = None) -> PlantParameters:
        """An elastic robot of any number of joints."""
        n = len(axial)
        torque = np.full(n, 50.0) if friction_torque is None else friction_torque
        return cls(
            axial, transverse, centre=_zeros(n, 3), backlash=_zeros(n), backlash_torque=np.full(n, 12.0), friction=_zeros(n),
            friction_torque=torque, creep=_zeros(n), coupling=_zeros(n, n), joint_zero=_zeros(n), p_error=_zeros(n, 3),
            turn_error=_zeros(n, 3), gear_heat=_zeros(n), neighbour=_zeros(n, n), bearing_gap=_zeros(n, 2),
            bearing_torque=0.5 * torque, torque_product=_zeros(n, n),
        )  # fmt: skip
