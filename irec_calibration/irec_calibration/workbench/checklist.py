# SPDX-License-Identifier: Apache-2.0
"""What a folder or recording holds and lacks, before it is opened."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..diagnose import compare_observed, prepare, start_terms
from ..errors import IrecError
from ..lengths import length
from ..recording import BagReader
from ..recording.survey import survey
from ..session import read_session
from .words import claims

FEWEST_POSES = 5


def checklist(path: str) -> list[tuple[str, str]]:
    """What a folder or recording holds (`ok`) and lacks (`note`), what is `lost`, what keeps it from being used (`bad`)."""
    out: list[tuple[str, str]] = []
    place = Path(path)
    if place.suffix == ".mcap" or (place.is_dir() and any(place.glob("*.mcap"))):
        found = survey(BagReader(place))
        out += (
            [("ok", x) for x in found.present]
            + [("note", f"lacks {x}") for x in found.lacking]
            + [("lost", x) for x in found.losses]
        )
    try:
        session = read_session(place)
    except IrecError as error:
        return [*out, ("bad", str(error))]
    loaded = session.load_case != 0 if session.kind == "loaded" else np.ones(len(session), dtype=bool)
    cases = len(np.unique(session.load_case[loaded]))
    out.append(("ok", f"a session '{session.name}' ({session.kind}) of robot {session.serial or 'without serial'}"))
    out.append(("ok", f"{len(session.poses)} poses, {len(session)} rows, {cases} load cases"))
    few = len(session.poses) < FEWEST_POSES
    if few:
        out.append(
            ("note", f"{len(session.poses)} poses are too few to hold some out; {FEWEST_POSES} or more let a model be tested")
        )
    repeats = len(np.unique(session.repeat))
    out.append(
        ("ok", f"{repeats} repeats of rows: the noise can be taken from them")
        if repeats > 1
        else ("note", "no repeats: the noise that the session claims can't be checked by them")
    )
    unseen = int((~session.marker_seen).sum())
    if unseen:
        out.append(("note", f"the marker was not seen in {unseen} rows"))
    claimed = claims(vars(session.noise))
    out.append(("ok", f"noise as claimed: {claimed}") if claimed else ("note", "no noise is claimed under `noise`"))
    out += [("note", n) for n in session.notes]
    try:
        study = prepare(session, start_terms(session))
    except IrecError as error:
        return [*out, ("bad", str(error))]
    c = compare_observed(study.observation, study.terms, study.fit.rank)
    out.append(("ok", f"the first model leaves {length(c.rms_m)} per sample; the noise as claimed is {length(c.noise_floor_m)}"))
    if math.isfinite(c.repeat_floor_m):
        out.append(("ok", f"repeats scatter by {length(c.repeat_floor_m)} per sample: the noise as the data show it"))
    return out + [("note", n) for n in c.notes if n not in session.notes]
