# SPDX-License-Identifier: Apache-2.0
"""How a robot's elasticity has gone over the years: every stored calibration asked about the same poses and loads.

Between them stand the quick checks that were passed. Such a check identifies nothing; it confirms what the calibration says.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.of_session import scene_of
from ..errors import IrecError
from ..model import Estimate, axis_compliances
from ..model.file import load_model
from ..session import read_session
from .journal import Entry
from .store import Store
from .verdict import Kind, kind_of


@dataclass(frozen=True)
class TrendPoint:
    """One calibration, or a check of it that was passed.

    Attributes:
        event: `added` (identified anew) or `checked`. calibration: its number in the store. at: ISO date of the event.
        verdict: of the run.
        deflection_m: mean norm of the predicted deflection of the tool over the rows of the oldest session, m.
        compliance: joint (from 0) -> estimate, rad/(N m); only axes that are known singly.
        held_out_rms_m: error on poses that its fit had not seen, m; NaN where none was recorded, and for a check.
        in_force: it is the one now.
        softer_below: of a check: joint (from 0) -> share of that compliance by which the axis would have been found softer.
    """

    calibration: str
    at: str
    verdict: str
    deflection_m: float
    compliance: dict[int, Estimate]
    held_out_rms_m: float
    in_force: bool
    event: str = "added"
    softer_below: dict[int, float] = field(default_factory=dict)


def trend(store: Store) -> tuple[TrendPoint, ...]:
    """All stored calibrations and passed checks of them, oldest first; without those whose model can't be read any more."""
    entries = store.entries()
    added = [e for e in entries if e.event == "added"]
    scene = None
    for entry in added:
        path = store.session_path(entry.calibration)
        if path is not None:
            scene = scene_of(read_session(path), observe="tcp")
            break
    now = store.in_force_entry()
    out: list[TrendPoint] = []
    of: dict[str, TrendPoint] = {}
    for entry in entries:
        if entry.event == "checked" and entry.calibration in of and kind_of(entry.verdict) is Kind.PASS:
            out.append(_confirmed(of[entry.calibration], entry))
        if entry.event != "added":
            continue
        try:
            model = load_model(store.model_path(entry.calibration))
            moved = np.linalg.norm(model.predict(scene), axis=1) if scene is not None else np.array([np.nan])
        except IrecError:
            continue
        known = axis_compliances(model.terms, scene) if scene is not None else {}
        loaded = moved[moved > 0.0] if np.isfinite(moved).all() else moved
        of[entry.calibration] = TrendPoint(
            entry.calibration, entry.at, entry.verdict, float(np.mean(loaded)) if len(loaded) else float("nan"), known,
            float(entry.figures.get("held_out_rms_new_m") or "nan"),
            now is not None and now.calibration == entry.calibration,
        )  # fmt: skip
        out.append(of[entry.calibration])
    return tuple(out)


def _confirmed(calibration: TrendPoint, check: Entry) -> TrendPoint:
    below = check.figures.get("softer_below") or {}  # not in journals of before
    known = {k: float(below[f"axis {k + 1}"]) for k in calibration.compliance if f"axis {k + 1}" in below}
    return replace(
        calibration, at=check.at, verdict=check.verdict, held_out_rms_m=float("nan"), in_force=False, event="checked",
        softer_below=known,
    )  # fmt: skip
