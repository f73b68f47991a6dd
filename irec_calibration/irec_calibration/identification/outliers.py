# SPDX-License-Identifier: Apache-2.0
"""Rows that are plainly wrong: found, named in plain words, left out, kept or down-weighted.

Every pose is predicted from all others (`neighbours`). A row, or the rows of one pose together, must stand out far beyond the
tail of all the others, and one simple accident (a jump, a swap, a moved reference, ...) must explain it. What bends many poses in
the same way is a missing effect and stays in.

In a loaded session only what no missing effect could do is left out; a row that a cause outside the catalogue may have bent is
named and kept at full weight, since leaving it out would hide the effect from who looks for it. All that fits a session (solve,
compare, codec, diagnose, ...) sees the rows that `treated` leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..model import Term, total_displacement
from ..session.data import Session
from ..typing import Array, IntArray
from .gauss_newton import fitted
from .neighbours import MIDDLE, Block, Neighbours, neighbours
from .observe import Observation

LEAST = 7.0  # robust standard deviations (norm of three) below which nothing is called wrong
TAIL = 8.0  # beyond the upper quartile by so many times the distance of median and upper quartile: heavy tails are no accident
LEAST_STEP, TAIL_STEP = 5.0, 6.0  # the same for a step in time within a pose, which no cause but an accident makes
EXPLAINED = 0.6  # of a block's squared residual that an accident must explain
MOST = 0.2  # of the rows; where more seem wrong, they are weighted only
ROUNDS = 8
SMALLEST_WEIGHT = 1e-12
CERTAIN = 25.0  # robust standard deviations from which a row of a loaded session is wrong whatever effect is missing
CERTAIN_STEP = 150.0  # the same for rows that moved together: a station that was bumped is an effect of the catalogue
KEPT = "kept: a missing effect could do this too"
WORST_FIRST = 1e-4  # of the largest squared residual of a block: less waits for the next round
STARTS = 6  # robust fits before anything is decided
REDESCENDS = 8.0  # robust standard deviations beyond which a row hardly counts in them
FEWEST_BLOCKS = 6
COMMON = 0.9  # share of the displacements of flagged rows along one axis that makes them a common cause
COMMON_SIZE = 30.0  # robust standard deviations up to which a common cause is thought of
COMMON_POSES = 3
DOWN_WEIGHTED = 0.35  # weight by the Student-t from which a row is down-weighted; above, it counts in full
TAILS_AT_MOST = 0.04  # of the rows
SPARSE = 0.25  # of the rows in which play of an axis shows at most to be told from a missing effect that bends many poses
ALONG = 0.97  # cosine of a displacement with what play does there
FORCE_FACTOR = 30.0  # between the force of a row and that of its load case elsewhere
ELSEWHERE = (0.1, 20.0)  # rad within a pose (near a singularity a wrist turns by 0.02), and multiples of what is usual there
SAME_JOINTS = 2e-3  # rad
NEST_M = 0.02  # m; further off, another nest is likelier than a knock


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


def find(observation: Observation, terms: Sequence[Term]) -> tuple[BadRow, ...]:
    """Rows of a session that are plainly wrong, worst first.

    Args:
        observation: all rows that were observed.
        terms: effects to start from, with or without values.
    """
    return _find(observation, terms)[0]


def treated(observation: Observation, terms: Sequence[Term]) -> Observation:
    """The observation without its wrong rows; `bad` and the session's notes say which.

    In an absolute session rows in the tails are down-weighted. In a loaded one all others count in full.
    """
    bad, weight = _find(observation, terms)
    if observation.session.kind == "loaded":
        bad = tuple(b if b.sigmas >= (CERTAIN_STEP if b.kind == "moved" else CERTAIN) else replace(b, action=KEPT) for b in bad)
        weight = np.ones(len(weight))
    out = np.isin(observation.rows, [r for b in bad if b.is_left_out for r in b.rows])
    tail = (weight < DOWN_WEIGHTED) & ~out
    if tail.mean() > TAILS_AT_MOST:
        tail[:] = False  # so many are no tail but structure, which a verdict needs in full
    if tail.any():
        worst = int(np.argmin(np.where(tail, weight, np.inf)))
        count = f"{int(tail.sum())} of {len(tail)} rows scatter more than normal noise"
        where = place(observation.session, int(observation.rows[worst]))
        rows = tuple(int(r) for r in observation.rows[tail])
        bad = (*bad, BadRow("tail", rows, float("nan"), f"{count}, most {where}", "down-weighted"))
    if not bad:
        return observation
    kept = observation.weighted(np.where(tail, weight, 1.0)).only(~out)
    session = replace(kept.session, notes=(*kept.session.notes, *(str(b) for b in bad)))
    return replace(kept, session=session, bad=bad)


def again(observation: Observation, like: Observation) -> Observation:
    """Another observation of the same session with the rows and weights of one whose wrong rows were treated."""
    weight = dict(zip(like.rows.tolist(), like.weight.tolist(), strict=True))
    kept = observation.only(np.isin(observation.rows, like.rows))
    kept = kept.weighted(np.array([weight[r] for r in kept.rows.tolist()]))
    return replace(kept, session=replace(kept.session, notes=like.session.notes), bad=like.bad)


def place(session: Session, row: int) -> str:
    """Where a row is, for a sentence."""
    repeat = f", repeat {session.repeat[row]}" if np.any(session.repeat) else ""
    marker = f", marker {session.markers[session.marker[row]].name}" if len(session.markers) > 1 else ""
    if session.kind == "absolute":
        return f"pose {session.pose[row]}{repeat}{marker}"
    return f"pose {session.pose[row]}{repeat}, load case {session.case_name(int(session.load_case[row]))}{marker}"


def _find(observation: Observation, terms: Sequence[Term]) -> tuple[tuple[BadRow, ...], Array]:
    gross = [*_wrong_joints(observation), *_wrong_forces(observation)]
    out = np.isin(observation.rows, [r for b in gross for r in b.rows])
    found: list[BadRow] = list(gross)
    weight = np.ones(len(observation.rows))
    if len(np.unique(observation.whiten.group[~out])) < FEWEST_BLOCKS:
        return tuple(found), weight
    kept_in: set[int] = set()
    if observation.session.kind == "absolute":
        weight = _robust_start(observation, terms)
    for _ in range(ROUNDS):
        live = observation.only(~out)
        near = neighbours(live, fitted(terms, live.weighted(weight[~out]))[0])
        weight[~out] = near.weight
        more = [b for b in _accidents(live, near, any(b.kind == "moved" for b in found)) if not kept_in & set(b.rows)]
        common = _common_cause(live, near, more)
        kept_in |= {r for b in common for r in b.rows}
        more = [b for b in more if b not in common]
        new = np.isin(observation.rows, [r for b in more for r in b.rows])
        if not more or (out | new).mean() > MOST:
            break
        found += more
        out = out | new
    found.sort(key=lambda b: -(b.size_m if np.isfinite(b.size_m) else 1e3))
    return tuple(found), np.where(out, 1.0, weight)


def _robust_start(observation: Observation, terms: Sequence[Term]) -> Array:
    """Weights by which rows far from the truth do not bend a fit of the terms, (m,); each marker has its own scale."""
    marker = observation.session.marker[observation.rows]
    weight = np.ones(len(marker))
    for _ in range(STARTS):
        # from the start each time: wrong rows hide which geometric parameters the poses determine
        found = fitted(terms, observation.weighted(weight))[0]
        r = np.linalg.norm(observation.y - observation.of(total_displacement(found, observation.scene)), axis=1)
        z = r / observation.whiten.sigma
        for m in np.unique(marker):
            z[marker == m] *= np.sqrt(MIDDLE) / max(float(np.median(z[marker == m])), 1e-12)
        new = np.maximum(np.where(z > REDESCENDS, (REDESCENDS / z) ** 4, 1.0), SMALLEST_WEIGHT)
        if np.abs(new - weight).max() < 0.1:
            break
        weight = new
    return weight


def _accidents(observation: Observation, near: Neighbours, stepped: bool) -> list[BadRow]:
    """The simplest explanation of every block that stands out from the others of its kind.

    Args:
        stepped: rows of a pose moved together in what was found before.
    """
    single = _limit(near.z, LEAST, TAIL)
    shifts = [_shifts(observation, block) for block in near.blocks]
    steps = _limit(np.sqrt([max(t[0] for t in tries[1:]) for tries in shifts if len(tries) > 1]), LEAST_STEP, TAIL_STEP)
    whole = _limit(np.sqrt([tries[0][0] for tries in shifts if tries]), LEAST, TAIL)
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
    least = WORST_FIRST * max((squared for squared, _ in found), default=0.0)
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
    if swap > max(single, together, limit**2) and swap > EXPLAINED * total:
        names = [session.case_name(int(session.load_case[rows[i]])) for i in pair]
        size = float(np.linalg.norm(block.residual[list(pair)], axis=1).max())
        repeat = f" (repeat {session.repeat[rows[0]]})" if np.any(session.repeat) else ""
        text = f"load cases {names[0]} and {names[1]} of pose {session.pose[rows[0]]}{repeat} look swapped"
        return BadRow("swapped", tuple(int(rows[i]) for i in pair), size, f"{text} ({what}): the other way round they fit")
    # where both fail to explain it alone there are several things at once, and the row that stands out most goes first
    if shift is not None and together > max(single, EXPLAINED * total):
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
        if size > NEST_M:
            return BadRow("nest", (row,), size, f"{text}another nest or a reading that belongs to another row")
    return BadRow("jump", (row,), size, f"{text}a knocked reflector or a wrong reading")


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


def _common_cause(observation: Observation, near: Neighbours, bad: list[BadRow]) -> list[BadRow]:
    """Those of the accidents that are one cause: at three poses or more, alike turns about one axis; or play of an axis whose
    torque changes its sign in few rows, and just there."""
    scene = observation.scene
    size = near.scale * float(np.median(observation.whiten.sigma)) * COMMON_SIZE
    small = [b for b in bad if b.kind in ("jump", "moved") and b.size_m < size]
    if not small:
        return []
    block_of = {int(observation.rows[i]): block for block in near.blocks for i in block.rows}
    shift = []
    for b in small:
        block = block_of[b.rows[0]]
        shift.append(block.gain(np.isin(observation.rows[block.rows], b.rows).astype(float))[1])
    d, rows = np.array(shift), np.array([b.rows[0] for b in small])
    played = [b for b, along in zip(small, _along_play(observation, d, small), strict=True) if along]
    if len({int(scene.pose[r]) for r in rows}) < COMMON_POSES:
        return played
    columns = np.concatenate([scene.J[rows], scene.V[rows]], axis=2)
    for c in np.moveaxis(columns, 2, 0):
        length = np.linalg.norm(c, axis=1)
        if length.min() < 0.05 * max(length.max(), 1e-9):
            continue
        along = np.einsum("ni,ni->n", d, c) / length
        angle = np.abs(along) / length
        if (along**2).sum() > COMMON * (d**2).sum() and angle.std() < 0.5 * angle.mean():
            return small
    return played


def _along_play(observation: Observation, d: Array, bad: list[BadRow]) -> Array:
    """Whether each displacement is what play of an axis does in poses where its torque has changed its sign, (k,)."""
    scene, rows = observation.scene, np.array([b.rows[0] for b in bad])
    if scene.kind == "absolute":
        return np.zeros(len(rows), dtype=bool)
    sign = np.sign(scene.tau + scene.tau_gravity)
    flips = sign != sign[scene.reference]
    sparse = flips[observation.rows].mean(axis=0) < SPARSE
    beside = np.empty((len(bad), scene.n_joints), dtype=bool)
    for i, b in enumerate(bad):
        mates = observation.rows[scene.reference[observation.rows] == scene.reference[b.rows[0]]]
        among = np.isin(mates, b.rows)
        # of rows that moved together just these must have changed their sign
        together = flips[mates[among]].all(axis=0) & ~flips[mates[~among]].any(axis=0)
        beside[i] = flips[mates].any(axis=0) if b.kind == "jump" else together
    c = scene.J[rows]
    length = np.linalg.norm(d, axis=1)[:, None] * np.linalg.norm(c, axis=1)
    cosine = np.abs(np.einsum("ni,nik->nk", d, c)) / np.maximum(length, 1e-12)
    found: Array = ((cosine > ALONG) & beside & sparse).any(axis=1)
    return found


def _wrong_forces(observation: Observation) -> list[BadRow]:
    """Rows whose force differs from that of the same load case at other poses by a factor that no contact makes."""
    session = observation.session
    if session.kind != "loaded":
        return []
    rows = observation.rows
    size = np.linalg.norm(session.force_in_tool[rows], axis=1)
    found = []
    for case in np.unique(session.load_case[rows]):
        mine = np.flatnonzero(session.load_case[rows] == case)
        usual = float(np.median(size[mine]))
        if usual <= 0.0 or len(mine) < 4:
            continue
        for i in mine[(size[mine] < usual / FORCE_FACTOR) | (size[mine] > usual * FORCE_FACTOR)]:
            ratio = size[i] / usual
            unit = "; looks like kN for N" if 3e-4 < ratio < 3e-3 else "; looks like N for kN" if 300 < ratio < 3000 else ""
            text = f"{place(session, int(rows[i]))}: force {size[i]:.4g} N, other poses {usual:.4g} N in this load case{unit}"
            found.append(BadRow("force", (int(rows[i]),), float("nan"), text))
    return found


def _wrong_joints(observation: Observation) -> list[BadRow]:
    """Rows of a loaded session whose joint angles are far from those of their pose."""
    session = observation.session
    if session.kind != "loaded":
        return []
    q = session.q
    _, index = np.unique(np.column_stack([session.pose, session.repeat]), axis=0, return_inverse=True)
    index = index.ravel()
    middle = np.empty_like(q)
    for mine in _grouped(index):
        middle[mine] = np.median(q[mine], axis=0)
    off = np.abs(q - middle).max(axis=1)
    limit = max(ELSEWHERE[0], ELSEWHERE[1] * float(np.median(off)))
    found = []
    for row in np.flatnonzero(off > limit):
        group = np.flatnonzero(index == index[row])
        if (off[group] > limit).sum() * 2 > len(group):
            continue  # the pose has no angles of its own
        away = np.abs(q - q[row]).max(axis=1)
        away[index == index[row]] = np.inf
        twin = int(np.argmin(away))
        like = f"those of pose {session.pose[twin]}" if away[twin] < 0.5 * off[row] else "not those of this pose"
        text = f"{place(session, int(row))}: joint angles up to {off[row]:.3f} rad from the pose's other rows; look like {like}"
        spoilt = group[session.load_case[group] != 0] if session.load_case[row] == 0 else np.array([row])
        found.append(BadRow("joints", tuple(int(r) for r in spoilt), float("nan"), text))
    return found


def _same_joints(session: Session, row: int) -> int | None:
    """Another pose with the very joint angles of a row."""
    away = np.abs(session.q - session.q[row]).max(axis=1)
    away[session.pose == session.pose[row]] = np.inf
    twin = int(np.argmin(away))
    return int(session.pose[twin]) if away[twin] < SAME_JOINTS else None


def _grouped(index: IntArray) -> list[IntArray]:
    order = np.argsort(index, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(index[order])) + 1)


def mm(metres: float) -> str:
    """A length for a sentence, in the unit that suits it."""
    return f"{metres:.3g} m" if metres >= 1.0 else f"{1e3 * metres:.3g} mm" if metres >= 1e-4 else f"{1e6 * metres:.0f} um"
