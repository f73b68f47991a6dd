# SPDX-License-Identifier: Apache-2.0
"""Whether the force across the tool is what deflected the robot: its signs and axes, each channel of its own.

The force along the tool is the same in most load cases and hides what is wrong across it, so that differences between load cases
of one pose are judged: springs give way along the difference of two forces, whatever is common to both readings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..typing import Array, IntArray
from .data import Session

AXES = "xyz"
ALONG_AXIS = 0.8  # share of a difference of forces that is along one axis of tool0, for it to be judged as that axis
LARGE_ENOUGH = 0.2  # of the largest usual difference
ABOVE_FORCE_NOISE, ABOVE_NOISE = 10.0, 5.0  # of a difference of forces, and of points, to be judged
FEWEST_PAIRS = 6
WORK = 0.5  # median cosine between differences of force and deflection, at least; sound sessions have 0.76 to 0.99
TURNED = -0.3  # cosine of a pair that is turned
MANY_TURNED = 0.25  # of the pairs; a few are rows with a mistake of their own
SURE = 0.8  # median size of the cosine of pairs that answer to this force, whatever its sign; by chance it is a half
FITS = 0.7  # median cosine that an alteration has to give
USUAL = 0.8  # median cosine from which nothing is looked for
CLEARLY = 0.2  # by which an alteration has to do better
SAME = 0.05  # by which it may do worse on the whole deflection
AGREES = 0.6  # median cosine by which forces are what deflected the robot, whatever load_cases says
SLOPE = 0.3  # of force over nominal force of the load cases, below which they contradict each other
STATED_N = 0.03  # of the largest nominal force: how far load cases have to differ along an axis for it to be judged

Fit = Callable[[Array], float]


@dataclass(frozen=True)
class Pairs:
    """Pairs of loaded rows of one pose, repeat, marker and station whose forces differ along one axis of tool0.

    Attributes:
        session: with all of its rows.
        a, b: rows, (m,).
        axis: 0, 1 or 2, (m,).
        moved: difference of the deflections in base_link, (m, 3), m.
        R_tool: rotation of tool0 into base_link, all rows, (n, 3, 3).
    """

    session: Session
    a: IntArray
    b: IntArray
    axis: IntArray
    moved: Array
    R_tool: Array

    def cosine(self, force_in_base: Array | None = None) -> Array:
        """Cosine between difference of force and of deflection, (m,); the force in base_link of all rows, (n, 3), N."""
        force = self.force_in_base if force_in_base is None else force_in_base
        f = force[self.a] - force[self.b]
        size = np.linalg.norm(f, axis=1) * np.linalg.norm(self.moved, axis=1)
        return np.asarray(np.einsum("ni,ni->n", f, self.moved) / np.maximum(size, 1e-30))

    @cached_property
    def force_in_base(self) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self.R_tool, self.session.force_in_tool))


def pairs_of(session: Session, deflection: Array, R_tool: Array) -> Pairs:
    """Pairs by which the force across the tool is judged.

    Args:
        session: a loaded one.
        deflection: marker in base_link less where the controller has it, (n, 3), m; NaN where it was not seen.
        R_tool: rotation of tool0 into base_link, (n, 3, 3).
    """
    loaded = np.flatnonzero((session.load_case != 0) & session.marker_seen & session.on_tool)
    key = np.stack([session.pose, session.repeat, session.marker, session.station], axis=1)[loaded]
    group = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1) if len(loaded) else np.zeros(0, dtype=np.int64)
    order = np.argsort(group, kind="stable")
    rows, group = loaded[order], group[order]
    first: list[IntArray] = []
    second: list[IntArray] = []
    most = int(np.bincount(group).max()) if len(group) else 0
    for step in range(1, min(most, 12)):  # every row with the ones after it in its pose
        same = np.flatnonzero(group[step:] == group[:-step])
        first.append(rows[same])
        second.append(rows[same + step])
    a = np.concatenate(first) if first else np.zeros(0, dtype=np.int64)
    b = np.concatenate(second) if second else np.zeros(0, dtype=np.int64)
    f = session.force_in_tool[a] - session.force_in_tool[b]
    size = np.linalg.norm(f, axis=1)
    axis = np.abs(f).argmax(axis=1) if len(f) else np.zeros(0, dtype=np.int64)
    moved = deflection[a] - deflection[b]
    enough = size > max(
        ABOVE_FORCE_NOISE * session.noise.force_n, LARGE_ENOUGH * float(np.quantile(size, 0.95)) if len(size) else 0.0
    )
    # forces and points that no force moved so far are mistakes of single rows
    clear = np.linalg.norm(moved, axis=1) > ABOVE_NOISE * 2.0 * session.noise.tracker_m
    kept = enough & clear & (np.abs(f).max(axis=1, initial=0.0) > ALONG_AXIS * size)
    return Pairs(session, a[kept], b[kept], axis[kept], moved[kept], R_tool)


def across(session: Session, pairs: Pairs, fit: Fit) -> tuple[list[str], list[str]]:
    """What speaks against the force across the tool, as it shows in the work of differences between load cases: doubts, notes.

    Args:
        session: a loaded one.
        pairs: of its rows.
        fit: how well a force in base_link, (n, 3), N, goes with the whole deflection (median cosine).
    """
    cosine = pairs.cosine()
    of = {k: cosine[pairs.axis == k] for k in range(3) if (pairs.axis == k).sum() >= FEWEST_PAIRS}
    wrong = [k for k in of if np.median(of[k]) < WORK or (of[k] < TURNED).mean() > MANY_TURNED]
    weak = [k for k in of if np.median(of[k]) < USUAL]
    if not weak and not wrong:
        return [], []
    named = " and ".join(f"force_{AXES[k]}" for k in wrong or weak)
    mine = np.concatenate([of[k] for k in wrong or weak])
    usual = float(np.median(mine))
    said = (
        f"between load cases of one pose the robot gives way by {usual:.2f} of its deflection along the difference of {named} "
        f"(median cosine), {WORK:g} and more is expected of springs"
    )
    whole = fit(pairs.force_in_base)
    others = {name: (fit(f), least(pairs, f)) for name, f in alterations(session, pairs.R_tool)}
    best, fits = best_of({name: min(both) for name, both in others.items()})
    better = fits > usual + CLEARLY
    if wrong and fits >= FITS and better:
        return [f"{said}; it would fit ({fits:.2f}) with {best}"], []
    turned = np.isin(pairs.axis, wrong) & (cosine < TURNED)
    if wrong and (usual < TURNED or (turned.sum() > MANY_TURNED * len(mine) and np.median(np.abs(mine)) > SURE)):
        poses = np.unique(session.pose[pairs.a[turned]])
        return [
            f"{said}; it is turned in {len(poses)} of {len(np.unique(session.pose[pairs.a]))} poses, first in pose {poses[0]}: "
            "signs or axes of force_*, or names of load cases?"
        ], []
    best, fits = best_of({name: across if along > whole - SAME else -1.0 for name, (along, across) in others.items()})
    if fits >= USUAL and fits > usual + CLEARLY:
        said = said.replace(f"{WORK:g} and more is expected of springs", f"{USUAL:g} and more is usual")
        return [], [f"{said}; it would fit better ({fits:.2f}) with {best}"]
    if wrong:
        return [], [f"{said}: are axes of force_* and of tool0 the same, and the angle of each joint?"]
    return [], []


def _next_in_pose(session: Session) -> IntArray:
    """The loaded row after each in its pose and repeat, the first after the last; references stay; (n,)."""
    out = np.arange(len(session))
    loaded = np.flatnonzero(session.load_case != 0)
    group = np.unique(np.stack([session.pose, session.repeat], axis=1)[loaded], axis=0, return_inverse=True)[1].reshape(-1)
    order = np.argsort(group, kind="stable")
    rows, group = loaded[order], group[order]
    first = np.r_[True, np.diff(group) != 0]
    begin = rows[first][np.cumsum(first) - 1]
    last = np.r_[first[1:], True]
    out[rows] = np.where(last, begin, np.roll(rows, -1))
    return out


def least(pairs: Pairs, force: Array, none: float = -1.0) -> float:
    """The lowest median cosine of the axes of tool0 along which forces differ; `none` where they do along none."""
    cosine = pairs.cosine(force)
    found = [float(np.median(cosine[pairs.axis == k])) for k in range(3) if (pairs.axis == k).sum() >= FEWEST_PAIRS]
    return min(found, default=none)


def best_of(found: dict[str, float]) -> tuple[str, float]:
    """The name of the largest value, and the value."""
    best = max(found, key=lambda k: found[k])
    return best, found[best]


def alterations(session: Session, R_tool: Array) -> Iterator[tuple[str, Array]]:
    """The force in base_link, (n, 3), N, as it would be without one mistake, with the name of the mistake."""
    f = session.force_in_tool

    def in_base(force: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", R_tool, force))

    yield "force_* of the other sign, or marker_*", -in_base(f)
    yield "force_* in base_link", f
    if len(session.stations):
        R = np.stack([s.R_in_base for s in session.stations])[session.station]
        yield "force_* in the frame of the station", np.asarray(np.einsum("nij,nj->ni", R, f))
    for name, signs in (
        ("force_x of the other sign", (-1, 1, 1)), ("force_y of the other sign", (1, -1, 1)),
        ("force_z of the other sign", (1, 1, -1)),
        ("force_x and force_y of the other sign (sensor or tool0 turned by 180 deg about z)", (-1, -1, 1)),
        ("force_y and force_z of the other sign (sensor or tool0 turned by 180 deg about x)", (1, -1, -1)),
        ("force_x and force_z of the other sign (sensor or tool0 turned by 180 deg about y)", (-1, 1, -1)),
    ):  # fmt: skip
        yield name, in_base(f * np.array(signs, dtype=float))
    swapped = f[:, [1, 0, 2]]
    for name, signs in (
        ("force_x and force_y exchanged", (1, 1, 1)), ("sensor or tool0 turned by +90 deg about z", (1, -1, 1)),
        ("sensor or tool0 turned by -90 deg about z", (-1, 1, 1)),
        ("force_x and force_y exchanged and of the other sign", (-1, -1, 1)),
    ):  # fmt: skip
        yield name, in_base(swapped * np.array(signs, dtype=float))
    yield "force_x and force_z exchanged", in_base(f[:, [2, 1, 0]])
    yield "force_y and force_z exchanged", in_base(f[:, [0, 2, 1]])
    yield "force_* of one row later", in_base(np.roll(f, -1, axis=0))
    yield "force_* of one row before", in_base(np.roll(f, 1, axis=0))
    yield "force_* of the next load case of the pose", in_base(f[_next_in_pose(session)])
    # an angle that turns the tool about its own axis shows in no position of the TCP
    last = session.q.shape[1] - 1
    q = session.q.copy()
    q[:, last] = -q[:, last]
    yield f"joint_{last + 1} of the other sign", np.asarray(np.einsum("nij,nj->ni", session.robot.kinematics(q).R_tool, f))


@dataclass(frozen=True)
class Stated:
    """How forces follow what load_cases says, axis by axis.

    Attributes:
        slope: of the force over the nominal force of the load cases, (3,); NaN where these do not differ along an axis.
        off: mean of the force over the load cases less slope times that of the nominal force, (3,), N; largest: of the nominal
            forces along any axis, N.
        other: the axis that each axis of load_cases is measured by, (3,), and its slope; -1 where by none.
    """

    slope: Array
    off: Array
    largest: float
    other: tuple[tuple[int, float], ...]


def as_stated(session: Session) -> Stated | None:
    """Forces of the load cases against load_cases; None where fewer than two are stated."""
    cases = [c for c in session.load_cases if c != 0 and (session.load_case == c).any()]
    if len(cases) < 2:
        return None
    nominal = np.array([session.load_cases[c] for c in cases], dtype=float)
    measured = np.array([np.median(session.force_in_tool[session.load_case == c], axis=0) for c in cases])
    n, m = nominal - nominal.mean(axis=0), measured - measured.mean(axis=0)
    spread = np.linalg.norm(n, axis=0)
    largest = float(np.abs(nominal).max())
    judged = np.ptp(nominal, axis=0) > STATED_N * max(largest, 1e-9)
    slopes = (m.T @ n) / np.maximum(spread**2, 1e-30)  # slopes[i, j]: force i over nominal force j
    other = []
    for j in range(3):
        i = int(np.abs(slopes[:, j]).argmax())
        other.append((i, float(slopes[i, j])) if judged[j] and i != j and abs(slopes[i, j]) > SLOPE else (-1, 0.0))
    slope = np.where(judged, np.diag(slopes), np.nan)
    return Stated(slope, measured.mean(axis=0) - slope * nominal.mean(axis=0), largest, tuple(other))


def dead_channels(session: Session) -> list[str]:
    """Channels that stand still while load_cases differ along them."""
    stated = as_stated(session)
    if stated is None:
        return []
    values = {k: constant(session, k) for k in _contradicted(stated)}
    return [
        f"force_{AXES[k]} is exactly {value:g} N in every loaded row although load_cases differ along it: the channel is dead"
        for k, value in values.items()
        if value is not None
    ]


def _contradicted(stated: Stated) -> list[int]:
    """Axes along which forces do not follow load_cases."""
    return [int(k) for k in np.flatnonzero(np.nan_to_num(stated.slope, nan=1.0) < SLOPE)]


def against_stated(session: Session, pairs: Pairs | None) -> tuple[list[str], list[str]]:
    """What is wrong between force_* and load_cases, by axis, dead channels apart: doubts, and notes where the robot gives way as
    force_* says."""
    stated = as_stated(session)
    if stated is None:
        return [], []
    notes: list[str] = []
    said: list[str] = []
    works = None if pairs is None or not len(pairs.axis) else least(pairs, pairs.force_in_base)
    for k in _contradicted(stated):
        name, (by, slope) = f"force_{AXES[k]}", stated.other[k]
        if constant(session, k) is not None:
            continue
        if by < 0 and stated.slope[k] > -SLOPE:
            notes.append(f"{name} goes by {stated.slope[k]:.2f} times with the {AXES[k]} of load_cases, about 1 is expected")
            continue
        with_it = f", and force_{AXES[by]} by {slope:.2f} times" if by >= 0 else ""
        said.append(f"{name} goes by {stated.slope[k]:.2f} times with the {AXES[k]} of load_cases{with_it}")
    if not said:
        return [], notes
    what = f"{', '.join(said)}; about 1 is expected"
    if works is None:  # no deflection says which of the two is right
        return [], [*notes, f"{what}: signs or axes of force_*, or load cases exchanged?"]
    if works > AGREES:
        return [], [*notes, f"{what}; the robot gives way as force_* says: are numbers or forces of load_cases exchanged?"]
    return [f"{what}: signs or axes of force_*, or load cases exchanged?"], notes


def constant(session: Session, k: int) -> float | None:
    """The value of force axis k in all loaded rows of two load cases or more, where it is one to the last digit; else None."""
    loaded = session.load_case != 0
    values: Array = session.force_in_tool[loaded, k]
    if len(values) < FEWEST_PAIRS or len(np.unique(session.load_case[loaded])) < 2 or np.ptp(values) > 0.0:
        return None
    return float(values[0])
