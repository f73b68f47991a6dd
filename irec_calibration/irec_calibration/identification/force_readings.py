# SPDX-License-Identifier: Apache-2.0
"""How much of the scatter of force readings within a load case is force, and how much the sensor's noise.

A load case is meant to press alike in all poses. Where a reading differs from what is usual in its load case, either the force
did or the sensor erred. In the first case the arm follows the difference, in the second it does not, and a model that is
evaluated at the reading is wrong by what it says of that difference: structure that follows the force and has no cause in the
robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..session.data import Session
from ..typing import Array, IntArray
from .gross_errors import TO_NORMAL
from .observe import Observation
from .settings import FORCES

NOTE = "force readings differ by "  # how a note of it begins
RIDGE = 1e-3  # of what a column is known by, which keeps those apart that a session does not tell apart


@dataclass(frozen=True)
class Scatter:
    """Readings against what is usual in their load case.

    Attributes:
        off: change of the force against the reference, less what is usual in its load case, in tool0, (n, 3), N; 0 in
            references, and where it is further off than scatter is.
        sd: robust standard deviation along each axis of tool0, (3,), N.
        followed: share of it that the arm follows, 0 to 1, in tenths, (3,).
    """

    off: Array
    sd: Array
    followed: Array

    def noise_left(self, session: Session) -> float:
        """Standard deviation of each component of each reading, N, once the rest is left out."""
        share = np.maximum(self.followed * (1.0 - self.followed), 1.0 / max(len(session.poses), 1))
        return min(session.noise.force_n, float(np.sqrt(0.5 * (share * self.sd**2).mean())))


def scatter(observation: Observation, residual: Array, compliance: Array) -> Scatter | None:
    """What the residual of a first fit says of the scatter of the force readings; None where they have none, or it was left out.

    Args:
        observation: of a loaded session.
        residual: of a fit of springs to it, (m, 3), m.
        compliance: displacement of the marker by force in tool0, of all rows of the session, (n, 3, 3), m/N.
    """
    session = observation.session
    if session.kind != "loaded" or session.contact is not None or session.noise.force_n <= 0.0:
        return None
    if any(n.startswith(NOTE) for n in session.notes):  # a model may ask to see again what was observed before
        return None
    off = _off_its_load_case(session, observation.scene.reference)
    known = off[observation.rows]
    known = known[np.abs(known).max(axis=1) > 0.0]
    if not len(known):
        return None
    sd = np.maximum(TO_NORMAL * np.median(np.abs(known), axis=0), 1e-12)
    off = np.where((np.abs(off) > FORCES.outside * sd).any(axis=1, keepdims=True), 0.0, off)
    stated = np.minimum(2.0 * session.noise.force_n**2 / sd**2, 1.0)  # share of noise in it, by what the session states
    most = np.minimum(FORCES.factor**2 * stated, 1.0)
    columns = np.concatenate([-observation.of(compliance * off[:, None, :]), _other_causes(observation, compliance)], axis=2)
    size = np.sqrt((columns**2).sum(axis=(0, 1))) + 1e-30
    precision = np.concatenate([np.full(3, FORCES.believed**-2), RIDGE * size[3:] ** 2 / max(float((residual**2).mean()), 1e-30)])
    x = np.concatenate([stated, np.zeros(columns.shape[2] - 3)])
    for _ in range(FORCES.rounds):
        left = np.linalg.norm(residual - columns @ x, axis=1)
        weight = np.maximum(left, max(2.0 * float(np.median(left)), 1e-12)) ** -2  # bad rows count for less
        per_row = weight / max(float(np.sum(weight * left**2)) / (3.0 * len(left)), 1e-30)
        told = np.einsum("m,mij,mik->jk", per_row, columns, columns)
        seen = np.einsum("m,mij,mi->j", per_row, columns, residual)
        seen[:3] += precision[:3] * stated
        x = np.linalg.solve(told + np.diag(precision), seen)
    noise = np.clip(x[:3], 0.0, most)
    return Scatter(off, sd, np.where(most < FORCES.least, 1.0, 1.0 - np.round(10.0 * noise) / 10.0))


def _other_causes(observation: Observation, compliance: Array) -> Array:
    """What else goes with the force, in the observed rows, (m, 3, k): curves of the torque about each axis, and a sensor whose
    channels are off. A gear that stiffens follows a change of the force less than its fitted spring does."""
    scene = observation.scene
    torque = scene.tau + scene.tau_gravity
    curves = [scene.J * law(torque)[:, None, :] for law in (lambda t: t, lambda t: t * np.abs(t), lambda t: t**3)]
    channels = [compliance * scene.force_in_tool[:, None, k, None] for k in range(3)]
    return observation.of(np.concatenate([*curves, *channels], axis=2))


def _off_its_load_case(session: Session, reference: IntArray) -> Array:
    """See `Scatter.off`, (n, 3), N."""
    change = session.force_in_tool - session.force_in_tool[np.maximum(reference, 0)]
    cases = [c for c in np.unique(session.load_case) if c != 0]
    cases = [c for c in cases if len(np.unique(session.pose[session.load_case == c])) >= FORCES.fewest]
    middle = {c: np.median(change[session.load_case == c], axis=0) for c in cases}
    if not cases:
        return np.zeros_like(change)
    sd = TO_NORMAL * np.median(np.concatenate([np.abs(change[session.load_case == c] - middle[c]) for c in cases]), axis=0)
    usual = _usual(session, change, middle, np.maximum(sd, 1e-12))
    off = np.zeros_like(change)
    for c in cases:
        of_case = session.load_case == c
        off[of_case] = change[of_case] - usual[c]
    return off


def _usual(session: Session, change: Array, middle: dict[int, Array], sd: Array) -> dict[int, Array]:
    """What a load case usually reads, (3,), N: the mean of its readings, nearer to what it was meant to be, but for one gain of
    all load cases, where these means agree with that better (James and Stein)."""
    mean: dict[int, Array] = {}
    se: dict[int, Array] = {}
    for c, at in middle.items():
        samples = np.unique(np.column_stack([session.pose, session.repeat, change])[session.load_case == c], axis=0)[:, 2:]
        near = samples[(np.abs(samples - at) <= FORCES.outside * sd).all(axis=1)]
        mean[c], se[c] = (near.mean(axis=0), sd / np.sqrt(len(near))) if len(near) else (at, sd)
    meant = {c: np.array(session.load_cases[c]) for c in middle if np.any(session.load_cases.get(c, (0.0, 0.0, 0.0)))}
    if not meant:
        return mean
    gain = sum(float(mean[c] @ f) for c, f in meant.items()) / sum(float(f @ f) for f in meant.values())
    chi2 = sum(float((((mean[c] - gain * f) / se[c]) ** 2).sum()) for c, f in meant.items())
    kept = max(1.0 - (3 * len(meant) - 1) / max(chi2, 1e-30), 0.0)
    return mean | {c: gain * f + kept * (mean[c] - gain * f) for c, f in meant.items()}


def without_noise(session: Session, found: Scatter) -> Session:
    """A session with forces that are as far from their load case's as the arm follows, which a note says."""
    force = session.force_in_tool - (1.0 - found.followed) * found.off
    sizes, shares = ", ".join(f"{v:.2g}" for v in found.sd), ", ".join(f"{100 * v:.0f}" for v in found.followed)
    note = (
        f"{NOTE}{sizes} N along x, y, z of tool0 within a load case, and the arm follows {shares} % of that: the"
        " rest is taken for the sensor's noise and left out"
    )
    return replace(session, force_in_tool=force, notes=(*session.notes, note))
