# SPDX-License-Identifier: Apache-2.0
"""The simplest accident that explains a pose which stands out from all the others: a jump, a swap, rows that moved together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..session.data import Session
from ..typing import Array
from .bad_rows import BadRow, mm, place
from .neighbours import Block, Neighbours
from .observe import Observation
from .settings import OUTLIERS


def accidents(observation: Observation, near: Neighbours, stepped: bool) -> list[BadRow]:
    """The simplest explanation of every block that stands out from the others of its kind.

    Args:
        stepped: rows of a pose moved together in what was found before.
    """
    single = _limit(near.z, OUTLIERS.least, OUTLIERS.tail)
    shifts = [_shifts(observation, block) for block in near.blocks]
    steps = _limit(
        np.sqrt([max(t[0] for t in tries[1:]) for tries in shifts if len(tries) > 1]), OUTLIERS.least_step, OUTLIERS.tail_step
    )
    whole = _limit(np.sqrt([tries[0][0] for tries in shifts if tries]), OUTLIERS.least, OUTLIERS.tail)
    stepping = sum(any(t[0] > steps**2 for t in tries[1:]) for tries in shifts)
    if stepped or stepping > 1:
        steps = max(steps, whole)  # several small steps are drift
    found = []
    for block, tries in zip(near.blocks, shifts, strict=True):
        # the first moves the whole pose, the others begin within it
        standing = [t for i, t in enumerate(tries) if t[0] > (whole if i == 0 else steps) ** 2]
        if standing or block.squared > single**2:
            shift = max(standing, key=lambda t: t[0], default=None)
            accident = _accident(observation, block, near.z[block.rows], shift, single)
            if accident is not None:
                found.append((block.squared, accident))
    # what is far worse than the rest may have bent the fit for it: first things first
    least = OUTLIERS.worst_first * max((squared for squared, _ in found), default=0.0)
    return [a for squared, a in found if squared >= least]


def _limit(z: Array, least: float, tail: float) -> float:
    """How far something must stand out to be an accident, where most of its kind do as z tells."""
    if not len(z):
        return np.inf
    half, upper = np.quantile(z, (0.5, 0.75))
    return float(max(least, upper + tail * (upper - half)))


def _shifts(observation: Observation, block: Block) -> list[tuple[float, Array, Array]]:
    """Displacements of several rows of a block together: what each explains, the displacement, which rows, (s,)."""
    s, session = len(block.rows), observation.session
    rows = observation.rows[block.rows]
    tries = []
    if session.kind == "loaded":
        order = np.argsort(session.stamp[rows], kind="stable")
        for first in range(s - 1):
            w = np.zeros(s)
            w[order[first:]] = 1.0
            tries.append(w)
    else:
        moving = observation.scene.moves_with_arm[rows].astype(float)
        if moving.sum() > 1:
            tries.append(moving)
    return [(*block.gain(w), w) for w in tries]


def _accident(
    observation: Observation, block: Block, z: Array, shift: tuple[float, Array, Array] | None, limit: float
) -> BadRow | None:
    """What happened to a block, or None.

    Args:
        z: of its rows; shift: of several rows, where one stands out; limit: on z.
    """
    session, s, total = observation.session, len(block.rows), block.squared
    rows = observation.rows[block.rows]
    worst = int(np.argmax(z))
    single, together = float(z[worst]) ** 2, 0.0 if shift is None else shift[0]
    swap, pair, what = _swap(observation, block) if session.kind == "loaded" and s > 1 else (0.0, (0, 0), "")
    if swap > max(single, together, limit**2) and swap > OUTLIERS.explained * total:
        names = [session.case_name(int(session.load_case[rows[i]])) for i in pair]
        size = float(np.linalg.norm(block.residual[list(pair)], axis=1).max())
        repeat = f" (repeat {session.repeat[rows[0]]})" if np.any(session.repeat) else ""
        text = f"load cases {names[0]} and {names[1]} of pose {session.pose[rows[0]]}{repeat} look swapped"
        return BadRow("swapped", tuple(int(rows[i]) for i in pair), size, f"{text} ({what}): the other way round they fit")
    # where both fail to explain it alone there are several things at once, and the row that stands out most goes first
    if shift is not None and together > max(single, OUTLIERS.explained * total):
        moved = _moved(session, tuple(int(r) for r in rows[shift[2] > 0]), float(np.linalg.norm(shift[1])), s)
        return replace(moved, sigmas=float(np.sqrt(together)))
    if single > limit**2:
        displacement = block.gain(np.eye(s)[worst])[1]
        jump = _jump(observation, int(rows[worst]), displacement, float(np.linalg.norm(displacement)))
        return replace(jump, sigmas=float(np.sqrt(single)))
    return None


def _jump(observation: Observation, row: int, shift: Array, size: float) -> BadRow:
    session, scene = observation.session, observation.scene
    text = f"{place(session, row)}: moved by {mm(size)} against its neighbours; looks like "
    if session.kind == "absolute":
        twin = _same_joints(session, row)
        if twin is not None:
            return BadRow("joints", (row,), size, f"{text}the joint angles of pose {twin}")
        own = session.markers[session.marker[row]]
        frame = scene.kin.R_tool[row].T if scene.moves_with_arm[row] else np.eye(3)
        local = frame @ shift
        for other in session.markers:
            if other.link == own.link and other.name != own.name:
                away = np.array(other.xyz) - np.array(own.xyz)
                if np.linalg.norm(local - away) < 0.1 * np.linalg.norm(away):
                    return BadRow("nest", (row,), size, f"{text}marker {other.name} measured for {own.name}")
        if size > OUTLIERS.nest_m:
            return BadRow("nest", (row,), size, f"{text}another nest or a reading that belongs to another row")
    x, y, z = shift.tolist()
    return BadRow("jump", (row,), size, f"{text}a knocked reflector or a wrong reading", shift=(x, y, z))


def _moved(session: Session, rows: tuple[int, ...], size: float, s: int) -> BadRow:
    pose = f"pose {session.pose[rows[0]]}" + (f", repeat {session.repeat[rows[0]]}" if np.any(session.repeat) else "")
    if session.kind == "absolute":
        twin = _same_joints(session, rows[0])
        text = f"{pose}: all its markers on the tool are moved by {mm(size)} against the other poses; looks like "
        if twin is not None:
            return BadRow("joints", rows, size, f"{text}the joint angles of pose {twin}")
        return BadRow("moved", rows, size, f"{text}joint angles that are not those of this measurement")
    if len(rows) == s:
        text = f"{pose}: its reference is moved by {mm(size)} against all its load cases"
        return BadRow("moved", rows, size, f"{text}; looks like a reflector or station that was bumped in between")
    by_time = sorted(rows, key=lambda r: session.stamp[r])
    text = f"{pose}: from load case {session.case_name(int(session.load_case[by_time[0]]))} on all rows are moved by {mm(size)}"
    return BadRow("moved", rows, size, f"{text}; looks like a reflector or station that was bumped")


def _swap(observation: Observation, block: Block) -> tuple[float, tuple[int, int], str]:
    """The exchange of two load cases that reduces the squared residual most: by how much, which, of what."""
    rows = observation.rows[block.rows]
    believed = observation.scene.p_observed[rows]
    before, best = block.squared, (0.0, (0, 0), "")
    if len(rows) < 2:
        return best
    predicted = observation.y[block.rows] - block.residual
    for i in range(len(rows)):
        for j in range(i):
            for what in ("the tracker's readings", "the forces"):
                r = block.residual.copy()
                if what == "the forces":
                    r[i], r[j] = observation.y[block.rows[i]] - predicted[j], observation.y[block.rows[j]] - predicted[i]
                else:
                    r[i] = observation.y[block.rows[j]] + believed[j] - believed[i] - predicted[i]
                    r[j] = observation.y[block.rows[i]] + believed[i] - believed[j] - predicted[j]
                after = float(r.ravel() @ block.precision @ r.ravel())
                if before - after > best[0]:
                    best = (before - after, (j, i), what)
    return best


def _same_joints(session: Session, row: int) -> int | None:
    """Another pose with the very joint angles of a row."""
    away = np.abs(session.q - session.q[row]).max(axis=1)
    away[session.pose == session.pose[row]] = np.inf
    twin = int(np.argmin(away))
    return int(session.pose[twin]) if away[twin] < OUTLIERS.same_joints_rad else None
