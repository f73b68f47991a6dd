# SPDX-License-Identifier: Apache-2.0
"""How a robot's elasticity has gone over the years: every stored calibration asked about the same poses and loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..effects.of_session import scene_of
from ..errors import IrecError
from ..model import Estimate, axis_compliances
from ..model.file import load_model
from ..session import read_session
from .store import Store


@dataclass(frozen=True)
class TrendPoint:
    """One calibration.

    Attributes:
        calibration: its number in the store; at: ISO date. verdict: of the run that made it.
        deflection_m: mean norm of the predicted deflection of the tool over the rows of the oldest session, m.
        compliance: joint (from 0) -> estimate, rad/(N m); only axes that are known singly.
        held_out_rms_m: error on poses that its fit had not seen, m; NaN where none was recorded.
        in_force: it is the one now.
    """

    calibration: str
    at: str
    verdict: str
    deflection_m: float
    compliance: dict[int, Estimate]
    held_out_rms_m: float
    in_force: bool


def trend(store: Store) -> tuple[TrendPoint, ...]:
    """All stored calibrations, oldest first. A calibration whose model can't be read any more is left out."""
    added = [e for e in store.entries() if e.event == "added"]
    scene = None
    for entry in added:
        path = store.session_path(entry.calibration)
        if path is not None:
            scene = scene_of(read_session(path), observe="tcp")
            break
    now = store.in_force_entry()
    out = []
    for entry in added:
        try:
            model = load_model(store.model_path(entry.calibration))
            moved = np.linalg.norm(model.predict(scene), axis=1) if scene is not None else np.array([np.nan])
        except IrecError:
            continue
        known = axis_compliances(model.terms, scene) if scene is not None else {}
        loaded = moved[moved > 0.0] if np.isfinite(moved).all() else moved
        out.append(
            TrendPoint(
                entry.calibration, entry.at, entry.verdict, float(np.mean(loaded)) if len(loaded) else float("nan"), known,
                float(entry.figures.get("held_out_rms_new_m") or "nan"),
                now is not None and now.calibration == entry.calibration,
            )
        )  # fmt: skip
    return tuple(out)
