# SPDX-License-Identifier: Apache-2.0
"""CODEC of a recording that is still being written: chart and verdict after every pose, beside the running procedure."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import PlanError, RecordingError, SessionError
from ..model import Term
from ..session import Session, read_session
from ..typing import IntArray
from .algorithm1 import Codec
from .growth import Growth, growth_so_far

PATIENCE = 600.0  # s without a new pose after which a recording that was never closed counts as abandoned


@dataclass(frozen=True)
class News:
    """What one more pose has brought; codec and growth are None while there are too few poses to judge: then `why` says so."""

    poses: int
    codec: Codec | None = None
    growth: Growth | None = None
    why: str = ""


def follow(
    path: str | Path,
    terms: Sequence[Term],
    *,
    period: float = 2.0,
    patience: float = PATIENCE,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[News]:
    """Read a recording again and again, and yield news whenever poses have been completed, until it is closed.

    Args:
        path: MCAP file that the procedure writes (it may not exist yet), or any finished session.
        period: s between looks at the file.
        patience: s without a new pose after which to give up.

    Raises:
        PlanError: no new pose for `patience` seconds.
    """
    known, waited, why = 0, 0.0, "the recording has not begun"
    while True:
        closed = False
        try:
            session = read_session(path)
        except (SessionError, RecordingError) as error:  # nothing recorded yet, or only part of its beginning
            why = str(error)
        else:
            closed = session.is_whole
            complete = session.poses if closed else complete_poses(session)
            if len(complete) > known:
                known, waited, why = len(complete), 0.0, "no further pose was completed"
                yield _news(session.select_poses(complete), terms)
        if closed:
            return
        if waited >= patience:
            raise PlanError(f"{path}: nothing new for {patience:.0f} s with {known} poses complete: {why}")
        sleep(period)
        waited += period


def complete_poses(session: Session) -> IntArray:
    """All poses but the one under way: the last, as long as it holds fewer rows than the fullest one."""
    poses, rows = np.unique(session.pose, return_counts=True)
    last = session.pose[np.argmax(session.stamp)]
    return poses[(poses != last) | (rows == rows.max())]


def _news(session: Session, terms: Sequence[Term]) -> News:
    n = len(session.poses)
    try:
        return News(n, *growth_so_far(session, terms))
    except PlanError as error:
        return News(n, why=str(error))
