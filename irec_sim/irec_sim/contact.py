# SPDX-License-Identifier: Apache-2.0
"""Urethane disc on the tooling: elastic normal and tangential contact with Coulomb friction and micro-slip.

The disc's area is split into rings with different shares of the pressure. Each ring is a tangential spring with a
slider: it sticks until its spring force reaches friction times its share of the normal force, then slips (return mapping).
The outer rings slip first, so that displacement and force are never simply proportional: micro-slip. The disc pivots on
its ball joint and carries no moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .kinematics import Array

Gap = Callable[[Array], tuple[float, Array]]

RING_STIFFNESS = np.array([0.45, 0.30, 0.15, 0.10])  # share of the tangential stiffness
RING_PRESSURE = np.array([0.60, 0.27, 0.09, 0.04])  # share of the normal force
_EYE = np.eye(3)
_TOLERANCE = 0.01  # N


@dataclass(frozen=True)
class Disc:
    """normal, tangential: N/m at small loads; hardening: relative gain of normal stiffness per metre; friction: coefficient."""

    normal: float = 4.0e6
    tangential: float = 1.5e6
    hardening: float = 400.0
    friction: float = 0.6


@dataclass(frozen=True)
class Contact:
    """Memory of the contact: where each ring is anchored on the tooling, (rings, 3) in the cell frame; touching."""

    anchors: Array = field(default_factory=lambda: np.zeros((len(RING_STIFFNESS), 3)))
    touching: bool = False


def contact_force(disc: Disc, gap: Gap, p: Array, memory: Contact) -> tuple[Array, Array, Contact]:
    """Force of the tooling on the robot when the TCP is at p, without settling the memory.

    Args:
        gap: signed distance (m) and outward normal of the tooling at a point, cell frame.
        p: TCP in the cell frame, (3,), m.

    Returns:
        force (3,), N; its derivative by p, (3, 3), N/m; the memory that holds if this becomes the state.
    """
    g, n = gap(p)
    if g >= 0.0:
        return np.zeros(3), np.zeros((3, 3)), Contact(memory.anchors, False)
    depth = -g
    pressure = disc.normal * depth * (1.0 + disc.hardening * depth)
    slope = disc.normal * (1.0 + 2.0 * disc.hardening * depth)
    stiffness = disc.tangential * RING_STIFFNESS
    stretch = p - memory.anchors if memory.touching else np.zeros_like(memory.anchors)
    stretch = stretch - (stretch @ n)[:, None] * n
    pull = stiffness * np.sqrt((stretch * stretch).sum(axis=1))
    limit = disc.friction * RING_PRESSURE * pressure
    sliding = pull > limit
    share = np.where(sliding, limit / np.maximum(pull, 1e-12), 1.0)
    held = share[:, None] * stretch  # spring of each ring after slipping
    along = float(stiffness @ share)
    derivative = (along - slope) * (n[:, None] * n) - along * _EYE
    if sliding.any():
        for i in np.flatnonzero(sliding):
            direction = stretch[i] * (stiffness[i] / pull[i])
            derivative += direction[:, None] * (
                stiffness[i] * share[i] * direction + disc.friction * RING_PRESSURE[i] * slope * n
            )
    return pressure * n - stiffness @ held, derivative, Contact(p - held, True)


def solve_contact(disc: Disc, gap: Gap, p_free: Array, compliance: Array, memory: Contact, start: Array) -> tuple[Array, Contact]:
    """Contact force in equilibrium with an elastic support: F = contact(p_free + compliance F).

    Args:
        p_free: TCP without contact force, cell frame, (3,), m; compliance: of the support, (3, 3), m/N.
        start: first guess of the force, (3,), N.

    Returns:
        force on the robot (3,), N, and the memory after it.
    """
    force = start
    for _ in range(25):
        answer, derivative, after = contact_force(disc, gap, p_free + compliance @ force, memory)
        residual = answer - force
        if np.abs(residual).max() < _TOLERANCE:
            return answer, after
        force = force + np.linalg.solve(_EYE - derivative @ compliance, residual)
    # Newton alternates between two branches only where a ring is just about to slip: both are within that ring's force
    return answer, after
