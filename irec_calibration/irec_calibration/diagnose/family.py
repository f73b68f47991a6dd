# SPDX-License-Identifier: Apache-2.0
"""The generic family of structures: smooth functions of one or two variables of a session along physical directions.

They stand for every cause that has no name. None is written after an effect of the catalogue; a variable is what a row of a
session is described by, a direction is what a force, a turn of an axis or an instrument can move the marker along.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..identification.bad_rows import SHOWN_AGAIN
from ..typing import Array, BoolArray, IntArray
from .directions import TYPICAL_DISPLACEMENT, drifts, plain, readings, shaped, two_variables
from .evidence import Block
from .ground import Ground
from .memories import memories
from .ripples import ripples
from .study import Study
from .tilts import on_the_ground, tilts

AMPLITUDES = np.geomspace(0.1, 1000.0, 9)  # of the coefficients' prior, in units of the typical displacement
TYPICAL_ANGLE = 1e-5  # rad, of a ripple
SMALLEST = 1e-6  # whitened length of a column below which it can't show
BAD_ROWS_TRIED = 25
BAD_POSES_TRIED = 6
STEPS_TRIED = 5  # moments at which a reflector may have been seated anew, of each marker
ROUNDING = 1e-12  # of the largest diagonal entry of a Gram matrix: eigenvalues up to that are nothing but rounding
LARGE = 6000  # equations beyond which columns are kept in single precision


@dataclass(frozen=True)
class Structure:
    """One member of the family.

    Attributes:
        variables: session columns or `tau_k` that it depends on, the one that shapes it first.
        words: along what it acts.
        columns: which columns of the family are its own.
        tried: how many of its kind there are.
        axis: the only axis that it turns, counted from 0; None: it does something else.
        law_of: the axis whose law of torque it is, whatever the law's form: what effects of that family are special forms of.
        softer_by_angle: the axis whose compliance goes with its own angle, whatever the form: what a balancer of it is a form of.
        is_tilt: a link tilts across its axis: seldom, and hardly told from a law of an axis that is parallel to that.
        by_step: it turns the axis by the step just made, whatever the law: what effects of history are special forms of.
        history_of: the axis that it turns by the torque which that axis bore before, whatever the law: what friction of it is a
            form of.
        is_drift: it follows time or a temperature whatever the force, wherever it acts: what a drift may also be.
        ripple: joint, counted from 0, and how many times per turn of it this repeats; found in a residual.
        largest: amplitude of its coefficients' prior that can be.
        is_bad_row: it moves a single row, a single reference or a single pose, or the reflector from some row on: bad readings,
            no cause; rows: of the session, where they are single ones; seated: marker and stamp of a reflector that is elsewhere
            from there on.
    """

    variables: tuple[str, ...]
    words: str
    columns: slice
    tried: int
    axis: int | None = None
    law_of: int | None = None
    softer_by_angle: int | None = None
    is_tilt: bool = False
    is_bad_row: bool = False
    rows: tuple[int, ...] = ()
    seated: tuple[int, float] | None = None
    by_step: bool = False
    is_drift: bool = False
    history_of: int | None = None
    ripple: tuple[int, float] | None = None
    largest: float = np.inf


@dataclass(frozen=True)
class Family:
    """All structures on one session, as whitened columns (equations, columns)."""

    structures: tuple[Structure, ...]
    A: Array

    def block(self, structure: Structure, amplitude: float) -> Block:
        """The columns of one structure with the prior of an amplitude."""
        A = np.asarray(self.A[:, structure.columns], dtype=float)
        free = np.full(A.shape[1], np.inf)
        return Block(A, -free, free, np.full(A.shape[1], amplitude))

    @cached_property
    def _alike(self) -> tuple[_Alike, ...]:
        """Structures with equally many columns together."""
        by_size: dict[int, list[int]] = {}
        for i, s in enumerate(self.structures):
            by_size.setdefault(s.columns.stop - s.columns.start, []).append(i)
        out = []
        for m, places in by_size.items():
            grams = np.empty((len(places), m, m))
            for j, i in enumerate(places):
                X = self.A[:, self.structures[i].columns]
                grams[j] = X.T @ X
            start = np.array([self.structures[i].columns.start for i in places])
            largest = np.maximum([self.structures[i].largest for i in places], AMPLITUDES[0])
            out.append(_Alike(np.array(places), start[:, None] + np.arange(m), grams, AMPLITUDES[:, None] <= largest))
        return tuple(out)

    @cached_property
    def _rows(self) -> dict[int, Array]:
        return {}

    def crossed(self, structure: Structure) -> Array:
        """Products of a structure's columns with all columns of the family, (own, columns)."""
        at = structure.columns
        if at.start not in self._rows:
            self._rows[at.start] = np.asarray(self.A[:, at].T @ self.A, dtype=float)
        return self._rows[at.start]

    def gains(self, ground: Ground, products: tuple[Array, Array] | None = None) -> tuple[Array, Array]:
        """Log evidence that each structure adds to a ground, averaged over amplitudes, and its best amplitude, (k,) each.

        Args:
            products: of all columns with the ground's block and with b (see `Ground.reduced`), where they are known already.
        """
        V, u = ground.reduce(self.A) if products is None else ground.reduced(*products)
        gain, amplitude = np.empty(len(self.structures)), np.empty(len(self.structures))
        for alike in self._alike:
            Vi = V[:, alike.columns].transpose(1, 0, 2)
            gain[alike.places], amplitude[alike.places] = _gained(ground, alike, Vi, u[alike.columns])
        return gain, amplitude

    def gain_of(self, place: int, ground: Ground, products: tuple[Array, Array]) -> tuple[float, float]:
        """As `gains`, of one structure."""
        at = self.structures[place].columns
        crossed, by_b = products
        V, u = ground.reduced(crossed[:, at], by_b[at])
        of = next(a for a in self._alike if a.columns.shape[1] == len(u))
        i = np.flatnonzero(of.places == place)
        gain, amplitude = _gained(ground, _Alike(of.places[i], of.columns[i], of.grams[i], of.can_be[:, i]), V[None], u[None])
        return float(gain[0]), float(amplitude[0])


@dataclass(frozen=True)
class _Alike:
    """k structures with m columns each: their places, columns (k, m), Gram matrices (k, m, m), and which amplitudes can be,
    (amplitudes, k)."""

    places: IntArray
    columns: IntArray
    grams: Array
    can_be: BoolArray


def _gained(ground: Ground, alike: _Alike, V: Array, u: Array) -> tuple[Array, Array]:
    """Log evidence that structures add to a ground and their best amplitudes, (k,) each.

    Args:
        V: (k, free, m), u: (k, m), of their columns, as `Ground.reduce`.
    """
    S = alike.grams - V.transpose(0, 2, 1) @ V
    values, vectors = np.linalg.eigh(0.5 * (S + S.transpose(0, 2, 1)))
    values = np.maximum(values, 0.0)
    w2 = np.einsum("kij,ki->kj", vectors, u) ** 2
    w2[values <= ROUNDING * np.einsum("kii->ki", alike.grams).max(axis=1)[:, None]] = 0.0
    a2 = (AMPLITUDES**2)[:, None, None]
    grown = 1.0 + a2 * values
    loss = ground.loss - (a2 * w2 / grown).sum(axis=2)
    all_of = ground.fit_gain(loss) - 0.5 * np.log(grown).sum(axis=2)
    all_of[~alike.can_be] = -np.inf
    top = all_of.max(axis=0)
    gain: Array = top + np.log(np.exp(all_of - top).sum(axis=0) / alike.can_be.sum(axis=0))
    return gain, AMPLITUDES[all_of.argmax(axis=0)]


def family_of(study: Study) -> Family:
    """Every structure that can show in a session."""
    structures: list[Structure] = []
    columns: list[Array] = []
    at = 0
    kinds = [list(f(study)) for f in (plain, memories, readings, drifts, two_variables, tilts, on_the_ground, shaped)]
    for kind in kinds:
        if not kind:
            continue
        A = study.columns(np.concatenate([d.columns for d in kind], axis=2))
        first = 0
        for d in kind:
            own = A[:, first : first + d.columns.shape[2]]
            first += d.columns.shape[2]
            own = own[:, np.linalg.norm(own, axis=0) > SMALLEST]
            if own.shape[1]:
                place = slice(at, at + own.shape[1])
                structures.append(
                    Structure(
                        d.variables, d.words, place, len(kind), d.axis, d.law_of, d.softer_by_angle, d.is_tilt, by_step=d.by_step,
                        is_drift=d.is_drift, history_of=d.history_of, largest=d.largest,
                    )
                )  # fmt: skip
                columns.append(own)
                at += own.shape[1]
    A = np.concatenate(columns, axis=1) if columns else np.zeros((len(study.bench.b), 0))
    whole = Family(tuple(structures), A.astype(np.float32) if len(A) > LARGE else A)
    return with_bad_rows(whole, study, study.fit.residual)


def with_bad_rows(family: Family, study: Study, *residuals: Array) -> Family:
    """A family with the bad readings that may stand out of any of some residuals, (m, 3), m, in place of those that it has, and
    with the ripples that these show."""
    structures = [s for s in family.structures if not s.is_bad_row and s.ripple is None]
    at = structures[-1].columns.stop if structures else 0
    columns = [family.A[:, :at]]
    for k, n, words, waves, tried in ripples(study, residuals):
        own = study.columns(waves * TYPICAL_ANGLE)
        structures.append(Structure((f"joint_{k + 1}",), words, slice(at, at + own.shape[1]), tried, ripple=(k, n)))
        columns.append(own.astype(family.A.dtype))
        at += own.shape[1]
    for words, own, tried, here in _bad_rows(study, residuals):
        rows = tuple(int(r) for r in study.observation.rows[here])
        structures.append(Structure((), words, slice(at, at + own.shape[1]), tried, is_bad_row=True, rows=rows))
        columns.append(own.astype(family.A.dtype))
        at += own.shape[1]
    for words, own, tried, seated in _seated_anew(study, residuals):
        structures.append(Structure((), words, slice(at, at + own.shape[1]), tried, is_bad_row=True, seated=seated))
        columns.append(own.astype(family.A.dtype))
        at += own.shape[1]
    return Family(tuple(structures), np.concatenate(columns, axis=1))


def _bad_rows(study: Study, residuals: Sequence[Array]) -> Iterator[tuple[str, Array, int, BoolArray]]:
    """One row, or the reference of one pose and repeat, moved by itself: words, columns, how many there are, which rows, (m,).

    Only rows that stand out can be bad; the others are not tried.
    """
    observation = study.observation
    sizes = [np.linalg.norm(observation.whiten(r), axis=1) for r in residuals]
    size = sizes[0]
    rows = np.array(list(dict.fromkeys(int(i) for s in sizes for i in np.argsort(-s)[:BAD_ROWS_TRIED])))
    key = observation.scene.reference[observation.rows]
    moved = [(i, np.arange(len(size)) == i) for i in rows]
    shared = [k for k in dict.fromkeys(key[rows].tolist()) if k >= 0]
    session = observation.session
    no_accident = {r for b in observation.bad if b.action == SHOWN_AGAIN for r in b.rows}
    for i, here in moved:
        row = observation.rows[i]
        if int(row) in no_accident:
            continue
        words = f"pose {observation.pose[i]}, load case {session.case_name(int(session.load_case[row]))}"
        yield words, _moved(study, here), len(size), here
    for k in shared:
        if (key == k).sum() > 1:
            words = f"reference of pose {session.pose[k]} (read wrongly, or station or reflector were moved right after it)"
            yield words, _moved(study, key == k), len(np.unique(key)), key == k
    for k in shared[:BAD_POSES_TRIED]:
        inside = np.flatnonzero(key == k)
        if 1 < len(inside) <= 8:
            each = [_moved(study, np.arange(len(size)) == i) for i in inside]
            yield f"all of pose {session.pose[k]}", np.concatenate(each, axis=1), len(np.unique(key)), key == k


def _seated_anew(study: Study, residuals: Sequence[Array]) -> Iterator[tuple[str, Array, int, tuple[int, float]]]:
    """A reflector that was seated anew on the tool in an absolute session: from some row on it is elsewhere in the tool frame.

    Of each marker the moments at which the residual in the tool frame steps most; words, columns, how many moments there are,
    marker and stamp.
    """
    if study.ready.kind != "absolute":
        return
    observation, session = study.observation, study.session
    R = observation.scene.kin.R_tool[observation.rows]
    stamp, marker = session.stamp[observation.rows], session.marker[observation.rows]
    turned = [np.einsum("nji,nj->ni", R, r) / observation.whiten.sigma[:, None] for r in residuals]
    for m in np.unique(marker):
        if session.markers and session.markers[m].link != "tool0":
            continue
        rows = np.flatnonzero(marker == m)
        rows = rows[np.argsort(stamp[rows], kind="stable")]
        n = len(rows)
        count = np.arange(1, n)
        moments: list[int] = []
        for t in turned:
            before = np.cumsum(t[rows], axis=0)[:-1]
            step = ((before - before[-1:] * (count / n)[:, None]) ** 2).sum(axis=1) * n / (count * (n - count))
            moments += [int(k) for k in np.argsort(-step)[:STEPS_TRIED]]
        for k in dict.fromkeys(moments):
            row = rows[k + 1]
            here = (marker == m) & (stamp >= stamp[row])
            of = f"reflector {session.markers[m].name} " if len(np.unique(marker)) > 1 else "the reflector "
            words = f"{of}seated anew at pose {observation.pose[row]}, elsewhere on the tool from there on"
            yield words, _moved(study, here, R), n - 1, (int(m), float(stamp[row]))


def _moved(study: Study, rows: BoolArray, R: Array | None = None) -> Array:
    """Whitened columns of a displacement of some observed rows, (equations, 3); R: frame of it at each row, (m, 3, 3)."""
    columns = (np.eye(3) if R is None else R) * (rows * TYPICAL_DISPLACEMENT)[:, None, None]
    out: Array = study.observation.whiten(columns).reshape(-1, 3)
    return out
