# SPDX-License-Identifier: Apache-2.0
"""What is told of bad readings: each once, as it is treated where the verdict is reached.

Rows may be kept beside the model that was asked about and left out beside what was added, or count for nothing beside model and
remainder. Notes of several fits would contradict each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..identification.bad_rows import BadRow
from ..identification.force_readings import NOTE as OF_FORCES
from ..identification.marker_noise import NOTE as BY_MARKER
from ..session.data import Session
from ..typing import Json
from .remainder import Part
from .sag import NOTE as OF_SAG
from .settings import Settings
from .study import Study

FAR = 2.0  # RMS of the noise, beyond which a reading of a pose that is put aside stands out: by chance one in 140 does
SET_ASIDE = "counts for nothing in the verdict"


def as_treated(bad: Sequence[BadRow], aside: Sequence[Part]) -> tuple[BadRow, ...]:
    """Accidents that were found before any model was compared, those that were put aside after that marked so.

    Args:
        aside: parts of a remainder that are readings which stand out.
    """
    return tuple(replace(b, action=_action(b, aside)) for b in bad)


def _action(bad: BadRow, aside: Sequence[Part]) -> str:
    here = [p.structure for p in aside if set(p.structure.rows) & set(bad.rows)]
    if bad.is_left_out or not here:
        return bad.action
    if set(bad.rows) <= {int(r) for s in here for r in s.rows}:
        return SET_ASIDE
    return f"kept, but for this, which {SET_ASIDE}: {', '.join(s.words for s in here)}"


def one_note_each(notes: Sequence[str], bad: Sequence[BadRow], aside: Sequence[Part], later: Sequence[BadRow]) -> tuple[str, ...]:
    """Notes of several fits of one session without those that say something else of the same rows.

    Args:
        notes: of the model that was asked about, then of others.
        bad: accidents beside the model that was asked about; later: beside the model with what was added.
        aside: as of `as_treated`.
    """
    true = {str(b): str(t) for b, t in zip(bad, as_treated(bad, aside), strict=True)}
    known = {r for b in bad for r in b.rows}
    new = {str(b): "" if known & set(b.rows) else f"{b}, beside what was added" for b in later if str(b) not in true}
    told = dict.fromkeys(true.get(n, new.get(n, n)) for n in notes)
    by_marker = [n for n in told if n.startswith(BY_MARKER)]
    of_best = (OF_SAG, OF_FORCES)  # the last model is the best one
    earlier = [n for begin in of_best for n in [t for t in told if t.startswith(begin)][:-1]]
    return tuple(n for n in told if n and n not in by_marker[1:] and n not in earlier)


def rows_json(session: Session, bad: Sequence[BadRow], aside: Sequence[Part]) -> tuple[Json, ...]:
    """One entry for each row: those that were found before any model was compared, and those that were put aside after that."""
    weighed = {int(r): p.structure.words for p in aside for r in p.structure.rows}
    out = [
        _row(session, r, b.kind, b.size_m, SET_ASIDE if r in weighed and not b.is_left_out else b.action, b.sentence)
        for b in bad
        if b.kind != "tail"
        for r in b.rows
    ]
    known = {r for b in bad if b.kind != "tail" for r in b.rows}
    return (*out, *(_row(session, r, "stands out", float("nan"), SET_ASIDE, w) for r, w in weighed.items() if r not in known))


def _row(session: Session, row: int, kind: str, size_m: float, action: str, text: str) -> Json:
    return {
        "pose": int(session.pose[row]), "load_case": session.case_name(int(session.load_case[row])),
        "repeat": int(session.repeat[row]), "kind": kind, "size_m": size_m, "action": action, "text": text,
    }  # fmt: skip


def too_many_aside(study: Study, aside: Sequence[Part], noise_m: float, settings: Settings) -> bool:
    """Whether so many readings, or poses of a loaded session as a whole or by their references, count for nothing that something
    systematic is behind them. Arguments as of `put_aside`."""
    if rows_as_a_whole(study, aside, settings):
        return True
    poses = sum(len(p.structure.rows) > 1 for p in aside) if study.ready.kind == "loaded" else 0
    if poses > settings.several and poses > settings.most_put_aside * len(study.observation.poses):
        return True
    return len(aside) >= settings.several and put_aside(study, aside, noise_m) > settings.most_put_aside


def rows_as_a_whole(study: Study, aside: Sequence[Part], settings: Settings) -> list[int]:
    """Rows of poses of a loaded session that stand out in all load cases, each by itself, as no wrong reference makes them, where
    so many poses do that it is no accident; else none. Arguments as of `put_aside`."""
    whole = [p for p in aside if len(p.structure.rows) > 1 and not _is_single(p)] if study.ready.kind == "loaded" else []
    return [r for p in whole for r in p.structure.rows] if len(whole) >= settings.several_as_a_whole else []


def _is_single(part: Part) -> bool:
    """Whether one reading is off: that of a row, or a reference."""
    return part.structure.columns.stop - part.structure.columns.start <= 3


def put_aside(study: Study, aside: Sequence[Part], noise_m: float) -> float:
    """Share of all readings that count for nothing because they stand out; the reference of a pose is one of them.

    Of a pose that is put aside as a whole, by few of its readings, the others do not stand out.

    Args:
        study: the model beside which they stand out; aside: parts of a remainder that are such readings.
        noise_m: RMS over samples of the norm of the noise, m.
    """
    observation, residual = study.observation, np.linalg.norm(study.fit.residual, axis=1)
    references = study.ready.reference[observation.rows]
    readings = len(references) + len(np.unique(references[references >= 0]))
    far = observation.rows[residual > FAR * noise_m]
    count = sum(1 if _is_single(p) else int(np.isin(p.structure.rows, far).sum()) for p in aside)
    return count / max(readings, 1)
