# SPDX-License-Identifier: Apache-2.0
"""What goes plainly wrong in single rows of a recording, and which rows it spoils."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from .kinematics import Array, IntArray, forward
from .recorded import Pass

KINDS = (
    "jump", "swapped_load_cases", "angles_of_another_pose", "bumped_reference", "reseated_reflector", "kilonewtons",
)  # fmt: skip


@dataclass(frozen=True)
class Mishap:
    """Kind, where it happened and how large it was; load case 0 in an absolute session.

    Attributes:
        pose: from 1; load_cases: rows that are wrong against their neighbours (the whole pose when the reference is).
        repeat: pass over the poses, from 0; size_m: displacement of the marker, 0 where none was moved.
    """

    kind: str
    pose: int
    load_cases: tuple[int, ...]
    repeat: int
    size_m: float = 0.0

    def as_data(self) -> dict[str, Any]:
        return {**asdict(self), "load_cases": list(self.load_cases)}


def spoil(run: Pass, repeat: int, kind: str, R_tool: Array, R_station: Array, rng: np.random.Generator) -> tuple[Pass, Mishap]:
    """A pass over the poses in which one thing went wrong.

    Args:
        R_tool: orientation of tool0 in base_link, (N, M + 1, 3, 3); R_station: of each pose's station, (N, 3, 3).
    """
    N, rows = run.stamp.shape
    i, j = int(rng.integers(N)), int(rng.integers(1, rows))
    pose, case = int(run.pose[i]), int(run.case[i, j])
    away = rng.standard_normal(3)
    away /= np.linalg.norm(away)
    q, marker, force = run.q.copy(), run.marker.copy(), run.force.copy()
    cases = run.case.copy()
    everything = tuple(int(c) for c in run.case[i, 1:])
    if kind == "jump":
        size = float(rng.uniform(0.7e-3, 1.5e-3))
        marker[i, j] += size * away
        return replace(run, marker=marker), Mishap(kind, pose, (case,), repeat, size)
    if kind == "swapped_load_cases":
        other = int(rng.choice([k for k in range(1, rows) if k != j]))
        force[i, [j, other]] = force[i, [other, j]]
        cases[i, [j, other]] = cases[i, [other, j]]
        return replace(run, force=force, case=cases), Mishap(kind, pose, (case, int(run.case[i, other])), repeat)
    if kind == "angles_of_another_pose":
        other = int(rng.choice([k for k in range(N) if k != i])) if N > 1 else i
        q[i, j] = run.q[other, j]
        return replace(run, q=q), Mishap(kind, pose, (case,), repeat)
    if kind == "bumped_reference":
        size = float(rng.uniform(0.15e-3, 0.3e-3))
        marker[i, 0] += size * away
        return replace(run, marker=marker), Mishap(kind, pose, everything, repeat, size)
    if kind == "reseated_reflector":
        size = float(rng.uniform(0.06e-3, 0.15e-3))
        at = i * rows + j
        moved = (np.arange(N * rows) >= at).reshape(N, rows)
        in_station = np.einsum("nji,nmjk,k->nmi", R_station, R_tool, size * away)
        after = tuple(int(c) for c in run.case[i, j:])
        return replace(run, marker=marker + in_station * moved[..., None]), Mishap(kind, pose, after, repeat, size)
    force[i, j] /= 1000.0
    return replace(run, force=force), Mishap("kilonewtons", pose, (case,), repeat)


def orientation(run: Pass, chain: Any) -> Array:
    """Of tool0 in base_link by the reported angles, (N, M + 1, 3, 3)."""
    return np.stack([forward(chain, run.q[:, j]).R_tool for j in range(run.q.shape[1])], axis=1)


def spoiled_rows(case: IntArray, pose: IntArray, repeat: int, mishaps: tuple[Mishap, ...]) -> Array:
    """Rows that a mishap spoils, (N, M + 1) bool; a spoiled reference spoils all rows of its pose."""
    out = np.zeros(case.shape, dtype=bool)
    for m in mishaps:
        if m.repeat == repeat:
            out |= (pose == m.pose)[:, None] & np.isin(case, m.load_cases)
    return out
