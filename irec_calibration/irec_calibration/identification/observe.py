# SPDX-License-Identifier: Apache-2.0
"""From a session to the left side of Eq. (15): measured displacements with their noise."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..effects.of_session import marker_by_controller, scene_of
from ..effects.scene import Scene
from ..errors import SolveError
from ..session.data import Contact, Session
from ..session.registration import registered
from ..typing import Array, BoolArray, IntArray
from .gross_errors import mended
from .noise import Whitening, position_sigma

if TYPE_CHECKING:
    from .bad_rows import BadRow


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
        whiten: noise of the rows; that of down-weighted rows is larger by 1 / sqrt(weight).
        weight: of each row against its stated noise, (m,); 1: counts in full.
        bad: rows that were found to be wrong (`outliers.treated`), left out of this observation or down-weighted.
        repeating: that the residual repeats with the pose, in words; empty where nothing shows it.
        sees: what a row sees of a displacement of its point, (m, 3, 3), in base_link; None: all of it. y and `of` have it.
    """

    session: Session
    scene: Scene
    rows: IntArray
    y: Array
    pose: IntArray
    whiten: Whitening
    weight: Array = field(default_factory=lambda: np.ones(0))
    bad: tuple[BadRow, ...] = ()
    repeating: str = ""
    sees: Array | None = None

    def __post_init__(self) -> None:
        if len(self.weight) != len(self.rows):
            object.__setattr__(self, "weight", np.ones(len(self.rows)))

    @property
    def poses(self) -> IntArray:
        """Distinct observed poses, ascending."""
        return np.unique(self.pose)

    def only(self, keep: BoolArray) -> Observation:
        """Some observed rows only, (m,) mask; the scene stays whole."""
        rows, y, pose, weight = self.rows[keep], self.y[keep], self.pose[keep], self.weight[keep]
        sees = None if self.sees is None else self.sees[keep]
        return replace(self, rows=rows, y=y, pose=pose, whiten=self.whiten.only(keep), weight=weight, sees=sees)

    def seeing(self, sag_share: float) -> Observation:
        """The same where it sees this share of what the arm sags on the way from the reference (`View.sags`), if any at all."""
        if self.session.kind != "loaded" or self.session.contact is not None or self.scene.view.sags == sag_share:
            return self
        return replace(self, scene=replace(self.scene, view=replace(self.scene.view, sags=sag_share)))

    def weighted(self, weight: Array) -> Observation:
        """The same rows, each counting as much less as its weight says, (m,)."""
        whiten = replace(self.whiten, sigma=self.whiten.sigma * np.sqrt(self.weight / weight))
        return replace(self, whiten=whiten, weight=np.asarray(weight, dtype=float))

    def with_force_noise(self, compliance: Array, noise: float) -> Observation:
        """The same with the force sensor's noise, N, carried through the springs: compliance is the displacement of the marker by
        force, of all rows of the session, (n, 3, 3), m/N."""
        through_springs = noise**2 * np.einsum("nij,nij->n", compliance, compliance) / 3.0
        return replace(self, whiten=_whitening(self.session, self.scene, self.rows, through_springs))

    def of(self, displacement: Array) -> Array:
        """What the observed rows see of a displacement per session row: (n, 3[, p]) -> (m, 3[, p])."""
        change = self.scene.change(displacement)[self.rows]
        return change if self.sees is None else np.einsum("mij,mj...->mi...", self.sees, change)


def beyond_controller(session: Session, scene: Scene) -> Array:
    """Where each row's marker was measured, relative to where the controller believes it to be, in base_link, (n, 3), m."""
    R = np.stack([s.R_in_base for s in session.stations])[session.station]
    t = np.array([s.xyz for s in session.stations])[session.station]
    p_measured = np.einsum("nij,nj->ni", R, session.p_marker_in_station) + t
    return np.asarray(p_measured - marker_by_controller(session, scene.kin))


def observe(session: Session) -> Observation:
    """Build the observation of a session, at the noise of the instrument that measures positions.

    Raises:
        SolveError: no row can be used.
    """
    session = registered(session, session.robot.kinematics(session.q))
    scene = scene_of(mended(session))
    difference = beyond_controller(session, scene)
    seen = session.marker_seen
    if session.kind == "loaded":
        rows = np.flatnonzero((session.load_case != 0) & seen & seen[scene.reference])
        if not len(rows):
            where = session.path or session.name
            if session.meta.get("without_tracker") is True:
                raise SolveError(
                    f"{where}: was recorded without a tracker, its marker columns are empty; give --without-tracker to"
                    " irec solve, diagnose or improve, which then take the disc on the tooling as the measured point"
                )
            raise SolveError(
                f"{where}: no loaded row with its marker and its reference seen; nothing to identify from"
                " (irec solve --without-tracker needs none)"
            )
    else:
        rows = np.flatnonzero(seen)
        if not len(rows):
            raise SolveError(f"{session.path or session.name}: the marker was not seen in any row")
    y = scene.change(difference)[rows]
    whiten = _whitening(session, scene, rows)
    plain = Observation(session, scene, rows, y, session.pose[rows], whiten)
    return plain if session.contact is None else _held_by_contact(plain, session.contact)


def _whitening(session: Session, scene: Scene, rows: IntArray, more: Array | float = 0.0) -> Whitening:
    """Noise of the observed rows; more: variance beside that of the tracker, of all rows of the session, (n,), m^2."""
    sigma = np.sqrt(position_sigma(session) ** 2 + more)
    if session.kind == "loaded":
        return Whitening(sigma[rows], sigma[scene.reference[rows]], scene.reference[rows])
    return Whitening(sigma[rows], np.zeros(len(rows)), session.pose[rows])


def _held_by_contact(plain: Observation, contact: Contact) -> Observation:
    """The observation with displacements across tool0 z scaled down, so that all three are as well known as that along it."""
    z = plain.scene.kin.R_tool[plain.rows, :, 2]
    across = contact.normal_m / contact.slip_m
    sees = across * np.eye(3) + (1.0 - across) * z[:, :, None] * z[:, None, :]
    return replace(plain, sees=sees, y=np.einsum("mij,mj->mi", sees, plain.y))
