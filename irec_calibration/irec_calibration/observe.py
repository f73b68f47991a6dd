# SPDX-License-Identifier: Apache-2.0
"""From a session to the left side of Eq. (15): measured displacements with their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .errors import SolveError
from .noise import Whitening, position_sigma
from .registration import registered
from .scene import Scene, marker_by_controller, scene_of
from .session.data import Session
from .typing import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Observation:
    """Measured displacements of a session; m observed rows.

    Attributes:
        session: with stations and markers placed, where their poses are unknowns.
        scene: all n rows of the session, observing the marker.
        rows: indices of the observed rows, (m,).
        y: measured displacement of the marker relative to where the controller believes it to be, in base_link, (m, 3), m: its
            change against the reference row in a loaded session, Eq. (12)-(13) with the sign of the session format.
        pose: pose number of each observed row, (m,).
        whiten: noise of the rows.
    """

    session: Session
    scene: Scene
    rows: IntArray
    y: Array
    pose: IntArray
    whiten: Whitening

    @property
    def poses(self) -> IntArray:
        """Distinct observed poses, ascending."""
        return np.unique(self.pose)

    def only(self, keep: BoolArray) -> Observation:
        """Some observed rows only, (m,) mask; the scene stays whole."""
        w = self.whiten
        whiten = Whitening(w.sigma[keep], w.sigma_reference[keep], w.group[keep])
        return replace(self, rows=self.rows[keep], y=self.y[keep], pose=self.pose[keep], whiten=whiten)

    def of(self, displacement: Array) -> Array:
        """What the observed rows see of a displacement per session row: (n, 3[, p]) -> (m, 3[, p])."""
        return self.scene.change(displacement)[self.rows]


def observe(session: Session, compliance: Array | None = None) -> Observation:
    """Build the observation of a session.

    Args:
        session: any session.
        compliance: displacement of the marker by force, (n, 3, 3), m/N: where given, the force sensor's noise is propagated too.

    Raises:
        SolveError: no row can be used.
    """
    session = registered(session, session.robot.kinematics(session.q))
    scene = scene_of(session)
    R = np.stack([s.R_in_base for s in session.stations])[session.station]
    t = np.array([s.xyz for s in session.stations])[session.station]
    p_measured = np.einsum("nij,nj->ni", R, session.p_marker_in_station) + t
    difference = p_measured - marker_by_controller(session, scene.kin)
    seen = session.marker_seen
    if session.kind == "loaded":
        rows = np.flatnonzero((session.load_case != 0) & seen & seen[scene.reference])
        if not len(rows):
            raise SolveError(
                f"{session.path or session.name}: no loaded row with its marker and its reference seen; nothing to identify from"
            )
    else:
        rows = np.flatnonzero(seen)
        if not len(rows):
            raise SolveError(f"{session.path or session.name}: the marker was not seen in any row")
    y = scene.change(difference)[rows]
    variance = position_sigma(session) ** 2
    if compliance is not None:
        variance = variance + session.noise.force_n**2 * np.einsum("nij,nij->n", compliance, compliance) / 3.0
    sigma = np.sqrt(variance)
    shared = sigma[scene.reference[rows]] if session.kind == "loaded" else np.zeros(len(rows))
    return Observation(session, scene, rows, y, session.pose[rows], Whitening(sigma[rows], shared, scene.reference[rows]))
