# SPDX-License-Identifier: Apache-2.0
"""What went wrong in rows of a session, and how it is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..session.data import Session
from .settings import OUTLIERS

SHOWN_AGAIN = "kept: another measurement of the same pose and load case shows it again, so that it is no accident"


@dataclass(frozen=True)
class BadRow:
    """One accident.

    Attributes:
        kind: `jump`, `swapped`, `moved` (from one row of a pose on, or its reference), `joints`, `force`, `nest`, `tail`.
        rows: indices of session rows that it spoils.
        size_m: displacement, m; NaN where it is none.
        sentence: what is wrong, in plain words, without the action.
        action: `left out`, `down-weighted` or why it is kept.
        sigmas: by how many robust standard deviations it stands out; inf where it shows without any model.
        shift: of a `jump`: by what the reading is moved, m, in base_link.
    """

    kind: str
    rows: tuple[int, ...]
    size_m: float
    sentence: str
    action: str = "left out"
    sigmas: float = np.inf
    shift: tuple[float, float, float] | None = None

    @property
    def is_left_out(self) -> bool:
        return self.action == "left out"

    def __str__(self) -> str:
        return f"{self.sentence}; {self.action}"


def place(session: Session, row: int) -> str:
    """Where a row is, for a sentence."""
    repeat = f", repeat {session.repeat[row]}" if np.any(session.repeat) else ""
    marker = f", marker {session.markers[session.marker[row]].name}" if len(session.markers) > 1 else ""
    if session.kind == "absolute":
        return f"pose {session.pose[row]}{repeat}{marker}"
    return f"pose {session.pose[row]}{repeat}, load case {session.case_name(int(session.load_case[row]))}{marker}"


def mm(metres: float) -> str:
    """A length for a sentence, in the unit that suits it."""
    return f"{metres:.3g} m" if metres >= 1.0 else f"{1e3 * metres:.3g} mm" if metres >= 1e-4 else f"{1e6 * metres:.0f} um"


def shown_again(session: Session, bad: Sequence[BadRow]) -> set[int]:
    """Rows of a loaded session that jump as they do in another repeat of their pose and load case.

    A repeat has its own reference and its own contact: nothing is knocked twice by the same. What bends one load case of a pose,
    such as a flange that gapes there, is an effect.
    """
    if session.kind != "loaded":
        return set()
    jumps = [(b.rows[0], np.array(b.shift)) for b in bad if b.shift is not None and len(b.rows) == 1]
    out: set[int] = set()
    for i, one in jumps:
        for j, other in jumps:
            same = session.pose[i] == session.pose[j] and session.load_case[i] == session.load_case[j]
            far = np.linalg.norm(one - other) > OUTLIERS.shown_again * max(np.linalg.norm(one), np.linalg.norm(other))
            if same and session.repeat[i] != session.repeat[j] and not far:
                out |= {i, j}
    return out
