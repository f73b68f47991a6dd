# SPDX-License-Identifier: Apache-2.0
"""The generic family of structures: smooth functions of one or two variables of a session along physical directions.

They stand for every cause that has no name. None is written after an effect of the catalogue; a variable is what a row of a
session is described by, a direction is what a force, a turn of an axis or an instrument can move the marker along.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from ..typing import Array, BoolArray, IntArray
from .evidence import Block, Ground
from .study import Study

DEGREE = 3  # of a curve over one variable
TYPICAL_DISPLACEMENT = 3e-5  # m; what a coefficient of 1 moves; the amplitude itself is inferred
AMPLITUDES = np.geomspace(0.1, 1000.0, 9)  # of the coefficients' prior, in units of the typical displacement
SMALLEST = 1e-6  # whitened length of a column below which it can't show
BAD_ROWS_TRIED = 25
BAD_POSES_TRIED = 6
LARGE = 6000  # equations beyond which columns are kept in single precision


@dataclass(frozen=True)
class Direction:
    """Columns along which a structure may act, or all of a structure.

    Attributes:
        words: along what; variables: what they depend on already; columns: (n, 3, d), m; axis: the one that they turn, if one;
            law_of, by_step, is_drift: see `Structure`.
    """

    words: str
    variables: tuple[str, ...]
    columns: Array
    axis: int | None = None
    law_of: int | None = None
    by_step: bool = False
    is_drift: bool = False


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
        by_step: it turns the axis by the step just made, whatever the law: what effects of history are special forms of.
        is_drift: it follows time or a temperature whatever the force, wherever it acts: what a drift may also be.
        is_bad_row: it moves a single row, a single reference or a single pose: a bad reading, not a cause; rows: of the session.
    """

    variables: tuple[str, ...]
    words: str
    columns: slice
    tried: int
    axis: int | None = None
    law_of: int | None = None
    is_bad_row: bool = False
    rows: tuple[int, ...] = ()
    by_step: bool = False
    is_drift: bool = False


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
    def _own_grams(self) -> dict[int, tuple[list[int], Array]]:
        """Structures with equally many columns together: their places, and their Gram matrices (k, m, m)."""
        by_size: dict[int, list[int]] = {}
        for i, s in enumerate(self.structures):
            by_size.setdefault(s.columns.stop - s.columns.start, []).append(i)
        out = {}
        for m, places in by_size.items():
            grams = np.empty((len(places), m, m))
            for j, i in enumerate(places):
                X = self.A[:, self.structures[i].columns]
                grams[j] = X.T @ X
            out[m] = (places, grams)
        return out

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
        for places, grams in self._own_grams.values():
            index = np.array([np.arange(self.structures[i].columns.start, self.structures[i].columns.stop) for i in places])
            Vi = V[:, index].transpose(1, 0, 2)
            S = grams - Vi.transpose(0, 2, 1) @ Vi
            values, vectors = np.linalg.eigh(0.5 * (S + S.transpose(0, 2, 1)))
            values = np.maximum(values, 0.0)
            w2 = np.einsum("kij,ki->kj", vectors, u[index]) ** 2
            a2 = (AMPLITUDES**2)[:, None, None]
            grown = 1.0 + a2 * values
            loss = ground.loss - (a2 * w2 / grown).sum(axis=2)
            all_of = ground.fit_gain(loss) - 0.5 * np.log(grown).sum(axis=2)
            top = all_of.max(axis=0)
            gain[places] = top + np.log(np.exp(all_of - top).mean(axis=0))
            amplitude[places] = AMPLITUDES[all_of.argmax(axis=0)]
        return gain, amplitude


def family_of(study: Study) -> Family:
    """Every structure that can show in a session."""
    structures: list[Structure] = []
    columns: list[Array] = []
    at = 0
    kinds = [list(_plain(study)), list(_drifts(study)), list(_two_variables(study)), list(_shaped(study))]
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
                        d.variables, d.words, place, len(kind), d.axis, d.law_of, by_step=d.by_step, is_drift=d.is_drift
                    )
                )  # fmt: skip
                columns.append(own)
                at += own.shape[1]
    for words, own, tried, here in _bad_rows(study):
        rows = tuple(int(r) for r in study.observation.rows[here])
        structures.append(Structure((), words, slice(at, at + own.shape[1]), tried, is_bad_row=True, rows=rows))
        columns.append(own)
        at += own.shape[1]
    A = np.concatenate(columns, axis=1) if columns else np.zeros((len(study.bench.b), 0))
    return Family(tuple(structures), A.astype(np.float32) if len(A) > LARGE else A)


def _bad_rows(study: Study) -> Iterator[tuple[str, Array, int, BoolArray]]:
    """One row, or the reference of one pose and repeat, moved by itself: words, columns, how many there are, which rows, (m,).

    Only rows that stand out can be bad; the others are not tried.
    """
    observation = study.observation
    size = np.linalg.norm(observation.whiten(study.fit.residual), axis=1)
    rows = np.argsort(-size)[:BAD_ROWS_TRIED]
    key = observation.scene.reference[observation.rows]
    moved = [(i, np.arange(len(size)) == i) for i in rows]
    shared = [k for k in dict.fromkeys(key[rows].tolist()) if k >= 0]
    session = observation.session
    for i, here in moved:
        row = observation.rows[i]
        words = f"pose {observation.pose[i]}, load case {session.case_name(int(session.load_case[row]))}"
        yield words, _moved(study, here), len(size), here
    for k in shared:
        if (key == k).sum() > 1:
            yield f"reference of pose {session.pose[k]}", _moved(study, key == k), len(np.unique(key)), key == k
    for k in shared[:BAD_POSES_TRIED]:
        inside = np.flatnonzero(key == k)
        if 1 < len(inside) <= 8:
            each = [_moved(study, np.arange(len(size)) == i) for i in inside]
            yield f"all of pose {session.pose[k]}", np.concatenate(each, axis=1), len(np.unique(key)), key == k


def _moved(study: Study, rows: BoolArray) -> Array:
    """Whitened columns of a displacement of some observed rows, (equations, 3)."""
    columns = np.eye(3) * (rows * TYPICAL_DISPLACEMENT)[:, None, None]
    out: Array = study.observation.whiten(columns).reshape(-1, 3)
    return out


def varying(study: Study) -> dict[str, Array]:
    """Variables of a session that are there in every row and vary, name -> (n,)."""
    scene = study.ready
    loaded = study.observation.rows
    total = scene.load_torque()
    table: dict[str, Array] = {}
    if scene.clock == "time":
        table["stamp"] = scene.stamp
    table |= {f"temp_{n}": v for n, v in scene.temperature.items()}
    table |= {f"ext_{n}": v for n, v in scene.ext.items()}
    table |= {f"joint_{k + 1}": scene.q[:, k] for k in range(scene.n_joints)}
    table |= {f"tau_{k + 1}": total[:, k] for k in range(scene.n_joints)}
    table |= {f"force_{a}": scene.force_in_tool[:, i] for i, a in enumerate("xyz")}
    return {
        name: values
        for name, values in table.items()
        if np.isfinite(values).all() and np.ptp(values[loaded]) > 1e-9 * max(1.0, float(np.abs(values[loaded]).max()))
    }


def curve(values: Array, seen: Array, degree: int = DEGREE) -> Array:
    """Legendre polynomials over the range of the seen values, (n, degree), without the constant."""
    middle, half = 0.5 * (seen.max() + seen.min()), max(0.5 * float(np.ptp(seen)), 1e-300)
    u = np.clip((values - middle) / half, -1.2, 1.2)
    out: Array = legendre.legvander(u, degree)[:, 1:]
    return out


def shapes(study: Study) -> dict[str, Array]:
    """Shapes over the rows of each variable that varies, name -> (n, m); columns of order 1."""
    scene = study.ready
    loaded = study.observation.rows
    out = {name: curve(values, values[loaded]) for name, values in varying(study).items()}
    cases = np.unique(scene.load_case[loaded])
    if len(cases) > 1:
        out["load_case"] = (scene.load_case[:, None] == cases).astype(float)
    return out


def _scaled(columns: Array, rows: IntArray) -> Array:
    """Columns (n, 3, d) scaled so that their largest typical displacement in the rows is the typical one."""
    size = np.sqrt((columns[rows] ** 2).sum(axis=1).mean(axis=0)).max(initial=0.0)
    return columns * (TYPICAL_DISPLACEMENT / max(float(size), 1e-300))


def directions(study: Study) -> Iterator[Direction]:
    """Directions along which a structure may act: words, variables that they bring along, columns (n, 3, d) in m."""
    scene = study.ready
    rows = study.observation.rows
    on = ((scene.load_case > 0) if scene.kind == "loaded" else np.ones(len(scene), dtype=bool))[:, None, None].astype(float)
    tau = scene.load_torque()
    yield Direction("constant in the base frame", (), np.tile(np.eye(3), (len(scene), 1, 1)) * TYPICAL_DISPLACEMENT * on)
    yield Direction("constant in the tool frame", (), scene.kin.R_tool * TYPICAL_DISPLACEMENT * on)
    yield Direction("along the elastic deflection", (), _scaled(scene.response.displacement[:, :, None] * on, rows))
    yield Direction("as a force at the tool", (), _scaled(scene.response.compliance[:, :, :3] * on, rows))
    angle = _scaled(scene.J * on, rows)
    size = np.maximum(np.sqrt((tau[rows] ** 2).mean(axis=0)), 1e-9)
    twist = angle * (tau / size)[:, None, :]
    yield Direction("turning the axes", (), angle)
    yield Direction("as compliance of the axes", (), twist)
    for k in range(scene.n_joints):
        yield Direction(f"turning axis {k + 1}", (), angle[:, :, k : k + 1], k)
        yield Direction(f"as compliance of axis {k + 1}", (f"tau_{k + 1}",), twist[:, :, k : k + 1], k)


def _shaped(study: Study) -> Iterator[Direction]:
    """Smooth functions of one variable along every direction."""
    shaped = shapes(study)
    for d in directions(study):
        for name, shape in shaped.items():
            columns = (d.columns[:, :, :, None] * shape[:, None, None, :]).reshape(len(shape), 3, -1)
            # an axis that its own torque turns by any curve: what stiffening, play and friction of that axis are forms of
            law_of = d.axis if d.axis is not None and name == f"tau_{d.axis + 1}" else None
            yield Direction(d.words, (name, *(v for v in d.variables if v != name)), columns, d.axis, law_of)


def _two_variables(study: Study) -> Iterator[Direction]:
    """Functions of two variables that turn one axis: torque with its own angle, gravity, history, or another torque."""
    scene, rows = study.ready, study.observation.rows
    angle = _scaled(scene.J * ((scene.load_case > 0)[:, None, None] if scene.kind == "loaded" else 1.0), rows)
    tau = scene.load_torque()
    size = np.maximum(np.abs(tau[rows]).max(axis=0), 1e-9)
    t = tau / size
    q = scene.q
    has = scene.previous >= 0
    before = np.where(has[:, None], t[scene.previous], 0.0)
    angle_free = _scaled(scene.J, rows)
    for k in range(scene.n_joints):
        if np.ptp(tau[rows, k]) <= 1e-6:
            continue
        own = angle[:, :, k : k + 1]
        rotary = not bool(scene.kin.is_prismatic[k])
        turn = curve(q[:, k], q[rows, k])
        if rotary:
            turn = np.stack([f(n * q[:, k]) for n in (1, 2) for f in (np.sin, np.cos)], axis=1)
        yield Direction(
            f"as compliance of axis {k + 1}, over its turn",
            (f"joint_{k + 1}", f"tau_{k + 1}"),
            own * (t[:, k : k + 1] * turn)[:, None, :],
            k,
        )
        both = np.stack([t[:, k] ** 2, t[:, k] * np.abs(t[:, k]), t[:, k] ** 3], axis=1)
        shape = np.column_stack([both, both * curve(q[:, k], q[rows, k], 1)])
        names = (f"tau_{k + 1}", f"joint_{k + 1}")
        yield Direction(f"nonlinear in the torque of axis {k + 1} and its angle", names, own * shape[:, None, :], k)
        total = tau[:, k] + (scene.tau_gravity[:, k] if scene.kind == "loaded" else 0.0)
        yield Direction(
            f"nonlinear in the whole torque of axis {k + 1}, gravity included",
            (f"tau_{k + 1}",),
            angle_free[:, :, k : k + 1] * curve(total, total[rows], 5)[:, None, :],
            k,
            law_of=k,
        )
        if has.any() and scene.kind == "loaded":
            change = t[:, k] - before[:, k]
            history = np.stack([before[:, k], before[:, k] ** 2, before[:, k] * t[:, k], np.tanh(5.0 * change)], axis=1)
            words = f"turning axis {k + 1} by its torque before"
            yield Direction(words, (f"tau_{k + 1}", "load_case"), own * history[:, None, :], k)
        step = scene.step[:, k] / max(float(np.abs(scene.step[rows, k]).max()), 1e-12)
        if np.ptp(step[rows]) > 1e-6 and scene.clock != "none":
            driven = np.stack([step, step * np.abs(step), np.sign(step)], axis=1)
            words = f"turning axis {k + 1} by the step before"
            columns = angle_free[:, :, k : k + 1] * driven[:, None, :]
            yield Direction(words, (f"joint_{k + 1}",), columns, k, by_step=True)
        for other in range(scene.n_joints):
            if other != k:
                product = np.stack([t[:, k] * t[:, other], t[:, other]], axis=1)
                yield Direction(
                    f"turning axis {k + 1} by two torques",
                    (f"tau_{k + 1}", f"tau_{other + 1}"),
                    own * product[:, None, :],
                    k,
                )


def _plain(study: Study) -> Iterator[Direction]:
    """Structures that need no variable of their own."""
    scene, rows = study.ready, study.observation.rows
    by_torque = scene.response.compliance[:, :, 3:]
    beside = np.stack([np.einsum("nij,nj->ni", by_torque, np.cross(e, scene.force_in_tool)) for e in np.eye(3)], axis=2)
    yield Direction("as if the force acted beside the TCP", ("load_case", f"tau_{scene.n_joints}"), _scaled(beside, rows))
    on = ((scene.load_case > 0) if scene.kind == "loaded" else np.ones(len(scene), dtype=bool))[:, None, None].astype(float)
    yield Direction("constant in the base frame", (), np.tile(np.eye(3), (len(scene), 1, 1)) * TYPICAL_DISPLACEMENT * on)
    yield Direction("constant in the tool frame", (), scene.kin.R_tool * TYPICAL_DISPLACEMENT * on)
    if scene.kind == "loaded" and np.any(scene.previous >= 0):
        has = scene.previous >= 0
        last = np.where(has[:, None], scene.force_in_tool[scene.previous], 0.0)
        memory = scene.response.compliance[:, :, :3] * last[:, None, :]
        yield Direction("as if a share of the force before were still there", ("load_case",), _scaled(memory, rows))
        change = scene.force_in_tool - last
        lag = scene.response.compliance[:, :, :3] * np.abs(change)[:, None, :]
        yield Direction("as if the change of the force were read wrongly", ("load_case",), _scaled(lag, rows))


def _drifts(study: Study) -> Iterator[Direction]:
    """What follows time or a temperature in every row and differs over the poses."""
    scene = study.ready
    if scene.measured_from_station is None:
        return
    far = np.linalg.norm(np.nan_to_num(scene.measured_from_station), axis=1)
    reach = scene.p_tcp / max(float(np.linalg.norm(scene.p_tcp, axis=1).max()), 1e-9)
    by_reach = np.einsum("ni,jk->njik", reach, np.eye(3)).reshape(len(far), 3, -1)
    loaded = study.observation.rows
    for name, values in varying(study).items():
        if name != "stamp" and not name.startswith("temp_"):
            continue
        change = study.observation.of(np.tile(values[:, None], (1, 3)))[:, 0]
        size = float(np.abs(change).max())
        if size <= 1e-9 * max(1.0, float(np.abs(values).max())):
            continue
        course = (values - values[loaded].mean()) / size * TYPICAL_DISPLACEMENT
        square = np.eye(3) * (course * (far / max(far.max(), 1e-9)) ** 2)[:, None, None]
        yield Direction(f"{name}: growing with the square of the distance", (name,), square, is_drift=True)
        yield Direction(f"{name}: growing with the reach", (name,), by_reach * course[:, None, None], is_drift=True)
        yield Direction(f"{name}: turning the axes", (name,), scene.J * course[:, None, None], is_drift=True)
        yield Direction(f"{name}: along the tool", (name,), scene.kin.R_tool * course[:, None, None], is_drift=True)
