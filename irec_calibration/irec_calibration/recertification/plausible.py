# SPDX-License-Identifier: Apache-2.0
"""Whether a stored model may be put in force in this cell: what it predicts over its envelope, before the correction is asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cell import Cell
from ..effects.production import LOADED, POINTS, at, production_scene
from ..errors import IrecError, ModelError
from ..model.file import load_model
from ..model.plausibility import LARGEST_OFFSET, Plausible, check_plausible
from ..typing import Array

GRAVITY = np.array([0.0, 0.0, -9.81])  # in base_link, m/s^2


def check_before_force(path: str | Path, cell: Cell, largest_offset: float = LARGEST_OFFSET) -> Plausible:
    """The same rules as the correction's, from the model's own predictions.

    Args:
        largest_offset: m, that a prediction over the envelope may reach.

    Raises:
        ModelError: with file, value and limit.
    """
    model = load_model(path)
    scene = production_scene(cell.robot, GRAVITY, cell.payload)

    def predict(q: Array, force: Array, torque: Array) -> Array:
        here = at(scene, q, 0.0).with_wrench(np.outer(LOADED, force), np.outer(LOADED, torque))
        return np.asarray(model.predict(here)[len(POINTS)])

    try:
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            return check_plausible(
                model, cell.robot, cell.serial, scene, predict, tool=cell.tool_name, largest_offset=largest_offset
            )
    except IrecError as error:
        raise ModelError(f"{path}: {error}") from error
    except Exception as error:  # effects of users are evaluated
        raise ModelError(f"{path}: can't be evaluated: {type(error).__name__}: {error}") from error
