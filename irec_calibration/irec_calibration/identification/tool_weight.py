# SPDX-License-Identifier: Apache-2.0
"""A wrong tool weight, as the force sensor reads it at the references, where nothing touches the tool.

In the difference to the reference it cancels, so that no displacement says how large it is: a fit holds it at what these readings
say. R^T g dm turns with the flange, a bias of the sensor does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..effects import Evidence
from ..effects.scene import Scene
from ..errors import SolveError
from ..model import Estimate, Term
from ..typing import Array, IntArray
from .observe import Observation
from .settings import READINGS


@dataclass(frozen=True)
class AtReferences:
    """The readings at the references of a loaded session.

    Attributes:
        rows: of the session, (k,); force: that was read in them, in tool0, (k, 3), N.
        per_kg: the same that a mass which was not taken off adds to them, (k, 3), N/kg.
        mass, mass_se: wrong mass that they show beside a bias, kg; sign as in the effect: reading = R^T g dm.
    """

    rows: IntArray
    force: Array
    per_kg: Array
    mass: float
    mass_se: float


def reference_rows(scene: Scene) -> IntArray:
    """One row of each reading at a reference, (k,): where several markers are seen, each has a row of its own for it."""
    rows = np.unique(scene.reference[scene.reference >= 0])
    reading = np.column_stack([scene.pose[rows], scene.stamp[rows], scene.force_in_tool[rows]])
    return np.asarray(rows[np.sort(np.unique(reading, axis=0, return_index=True)[1])])


def at_references(scene: Scene, force_noise: float) -> AtReferences | None:
    """What the readings at the references say of a wrong mass; None where there are too few of them, or nothing weighs.

    Args:
        force_noise: of each component, N.
    """
    rows = reference_rows(scene)
    if len(rows) < READINGS.fewest or force_noise <= 0.0 or not np.any(scene.gravity_in_base):
        return None
    force = scene.force_in_tool[rows]
    per_kg = np.einsum("nji,j->ni", scene.kin.R_tool[rows], scene.gravity_in_base)
    width = np.array([READINGS.mass_kg, *[READINGS.bias_n] * 3])
    A = np.column_stack([per_kg.ravel(), np.tile(np.eye(3), (len(rows), 1))]) * width / force_noise
    b = force.ravel() / force_noise
    covariance = np.linalg.inv(A.T @ A + np.eye(4))
    x = covariance @ (A.T @ b)
    spread = max(float(np.sum((b - A @ x) ** 2)) / len(b), 1.0)
    return AtReferences(rows, force, per_kg, float(x[0] * width[0]), float(np.sqrt(spread * covariance[0, 0]) * width[0]))


def as_read(term: Term, observation: Observation) -> Term:
    """A tool weight of a loaded session, held at the mass that the readings at the references show, or at the one that it has
    where they say nothing. Other terms as they are.

    Raises:
        SolveError: the readings say nothing, and the term has no value.
    """
    if term.effect.evidence is not Evidence.REFERENCE_READINGS:
        return term
    session, parameter = observation.session, term.effect.parameters(observation.scene)[0]
    # references in a contact bear a force
    readings = at_references(observation.scene, session.noise.force_n) if session.contact is None else None
    if readings is not None:
        known = Estimate(readings.mass, readings.mass_se, parameter.unit, parameter.lower, parameter.upper, held=True)
    elif parameter.name in term.estimates:
        known = replace(term.estimates[parameter.name], held=True)
    else:
        raise SolveError(
            f"effect '{term.effect.id}' can't be identified from {session.name}: it shows only in force readings where nothing"
            f" touches the tool, and these are needed at {READINGS.fewest} references at least"
        )
    return replace(term, estimates={parameter.name: known})
