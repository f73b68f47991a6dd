# SPDX-License-Identifier: Apache-2.0
"""Whether the readings at the references of a loaded session carry an effect that was found in differences.

What an instrument does to a difference of some millimetres it does to the metres that it reads too: a scale of 3 %, seen in
differences, moves every reading by centimetres. What readings have beyond the controller's positions is known to a millimetre
or so, and follows smoothly from the joint angles. So they tell such a cause from a spring that passes for it in differences.
"""

from __future__ import annotations

import numpy as np

from ..identification.observe import beyond_controller
from ..model import Term
from ..model.model import displacement_of
from ..typing import Array, IntArray
from .lasting import fitted, usually_beyond
from .settings import SETTINGS
from .study import Study

READINGS = SETTINGS.lasting
FARTHEST = 5.0  # standard errors between a value that readings show and the one of differences, which other causes bend


def carried(study: Study, term: Term) -> float:
    """Log odds that the readings at the references carry an effect, over that they do not.

    Args:
        study: a model of a loaded session with the effect in it.
        term: that effect, with its values.

    Returns:
        natural log; 0 where it does not show in readings by itself (`Effect.in_readings`), or where too few poses were measured.
    """
    if not term.effect.in_readings or study.ready.kind != "loaded":
        return 0.0
    scene, session = study.ready, study.session
    rows = np.unique(scene.reference[study.observation.rows])
    seen = beyond_controller(session, scene)
    rows = rows[np.isfinite(seen[rows]).all(axis=1)]
    if len(np.unique(session.pose[rows])) < 2 * READINGS.fewest:
        return 0.0
    values = seen[rows]
    for other in study.terms:
        if other.effect.in_readings and other.effect.id != term.effect.id:
            values = values - displacement_of(other, scene)[rows]
    parameters = term.effect.parameters(scene)
    theta = term.theta(parameters)
    errors = np.array([term.estimates[p.name].se if p.name in term.estimates else 0.0 for p in parameters])
    # what differences know of a value only together with others, they know by its order of magnitude
    errors = np.where(np.isfinite(errors), errors, np.abs(theta))
    moved = displacement_of(term, scene)[rows]
    within = (term.effect.regressor(scene, theta)[rows] * errors)[:, :, errors > 0.0]
    ground = np.concatenate([_placed(scene.station[rows]), usually_beyond(study, rows)], axis=2)
    with_it, x = fitted(values - moved, np.concatenate([ground, within], axis=2))
    odds = with_it - fitted(values, ground)[0]
    # something else moves the readings, where that would be far from the value that differences show
    elsewhere = np.abs(x[ground.shape[2] :]).max(initial=0.0) > FARTHEST
    return min(odds, 0.0) if elsewhere else odds


def _placed(station: IntArray) -> Array:
    """Place of each station in base_link, of which differences know nothing: in metres, (rows, 3, 3 stations)."""
    return np.concatenate([(station == s)[:, None, None] * np.eye(3) for s in np.unique(station)], axis=2)
