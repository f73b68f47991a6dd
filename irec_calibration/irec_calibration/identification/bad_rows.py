# SPDX-License-Identifier: Apache-2.0
"""What went wrong in rows of a session, and how it is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..session.data import Session


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
    """

    kind: str
    rows: tuple[int, ...]
    size_m: float
    sentence: str
    action: str = "left out"
    sigmas: float = np.inf

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
