# SPDX-License-Identifier: Apache-2.0
"""Along what a structure of the generic family may act: forces, turns of axes, instruments, shaped by variables of the rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from ..effects.scene import Scene
from ..robot.ratings import rated_torque
from ..typing import Array, IntArray
from .settings import SETTINGS
from .study import Study

DEGREE = 3  # of a curve over one variable
BEARS = 1e-4  # of what the most loaded axis bears, each by its rated torque; less is rounding, and a law of it a law of nothing
MOST = 1.2  # of the largest value that is seen: no law is carried on beyond
TAKEN_UP = (0.03, 0.1, 0.3)  # share of the largest moment or torque over which a play is taken up
SEEN_AT, TURNS = ("marker_x", "marker_y", "marker_z"), 4  # columns of a reading; waves per turn of an encoder that are tried
IN_BASE = "constant in the base frame"
TURNING, COMPLIANCE = "turning the axes", "as compliance of the axes"
ALONG_DEFLECTION = "along the elastic deflection"
TYPICAL_DISPLACEMENT = 3e-5  # m; what a coefficient of 1 moves; the amplitude itself is inferred


@dataclass(frozen=True)
class Direction:
    """Columns along which a structure may act, or all of a structure.

    Attributes:
        words: along what; variables: what they depend on already; columns: (n, 3, d), m; axis: the one that they turn, if one;
            law_of, softer_by_angle, is_tilt, by_step, is_drift, history_of: see `Structure`; largest: amplitude that can be, in
            units of the columns.
    """

    words: str
    variables: tuple[str, ...]
    columns: Array
    axis: int | None = None
    law_of: int | None = None
    softer_by_angle: int | None = None
    is_tilt: bool = False
    by_step: bool = False
    is_drift: bool = False
    history_of: int | None = None
    largest: float = np.inf


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
    table |= {f"tau_{k + 1}": total[:, k] for k in bearing(study)}
    table |= {f"force_{a}": scene.force_in_tool[:, i] for i, a in enumerate("xyz")}
    return {
        name: values
        for name, values in table.items()
        if np.isfinite(values).all() and np.ptp(values[loaded]) > 1e-9 * max(1.0, float(np.abs(values[loaded]).max()))
    }


def least_torque(study: Study) -> Array:
    """Torque of each axis below which it bears nothing but rounding, (k,), N m: all forces go through it."""
    rated = rated_torque(study.ready.robot)
    return np.asarray(np.maximum(BEARS * (_varies(study) / rated).max(initial=0.0) * rated, 1e-9))


def bearing(study: Study) -> list[int]:
    """Axes whose torque varies by more than rounding, counted from 0."""
    found: list[int] = np.flatnonzero(_varies(study) > least_torque(study)).tolist()
    return found


def _varies(study: Study) -> Array:
    return np.asarray(np.ptp(study.ready.load_torque()[study.observation.rows], axis=0))


def curve(values: Array, seen: Array, degree: int = DEGREE) -> Array:
    """Legendre polynomials over the range of the seen values, (n, degree), without the constant."""
    middle, half = 0.5 * (seen.max() + seen.min()), max(0.5 * float(np.ptp(seen)), 1e-300)
    u = np.clip((values - middle) / half, -MOST, MOST)
    out: Array = legendre.legvander(u, degree)[:, 1:]
    return out


def waves(angle: Array, often: int) -> Array:
    """Sine and cosine of an angle, (n,), rad, and of its multiples up to `often`, (n, 2 often)."""
    return np.stack([f(n * angle) for n in range(1, often + 1) for f in (np.sin, np.cos)], axis=1)


def shapes(study: Study) -> dict[str, Array]:
    """Shapes over the rows of each variable that varies, name -> (n, m); columns of order 1."""
    scene = study.ready
    loaded = study.observation.rows
    out = {name: curve(values, values[loaded]) for name, values in varying(study).items()}
    cases = np.unique(scene.load_case[loaded])
    if len(cases) > 1:
        out["load_case"] = (scene.load_case[:, None] == cases).astype(float)
    return out


def scaled(columns: Array, rows: IntArray) -> Array:
    """Columns (n, 3, d) scaled so that their largest typical displacement in the rows is the typical one."""
    size = np.sqrt((columns[rows] ** 2).sum(axis=1).mean(axis=0)).max(initial=0.0)
    return columns * (TYPICAL_DISPLACEMENT / max(float(size), 1e-300))


def _times(columns: Array, scaled: Array) -> float:
    """What one unit of columns is in units of scaled ones."""
    return float(np.abs(columns).max() / max(float(np.abs(scaled).max()), 1e-300))


def under_load(scene: Scene) -> Array:
    """1 in the rows in which a process force acts, in all rows of an absolute session, else 0, (n, 1, 1)."""
    relaxed = scene.kind == "loaded" and not scene.instruments.by_contact  # references bear no force
    acts = scene.load_case > 0 if relaxed else np.ones(len(scene), dtype=bool)
    return np.asarray(acts[:, None, None], dtype=float)


def directions(study: Study) -> Iterator[Direction]:
    """Directions along which a structure may act: words, variables that they bring along, columns (n, 3, d) in m."""
    scene = study.ready
    rows = study.observation.rows
    on = under_load(scene)
    tau = scene.load_torque()
    yield Direction(IN_BASE, (), np.tile(np.eye(3), (len(scene), 1, 1)) * TYPICAL_DISPLACEMENT * on)
    yield Direction("constant in the tool frame", (), scene.kin.R_tool * TYPICAL_DISPLACEMENT * on)
    yield Direction(ALONG_DEFLECTION, (), scaled(scene.response.displacement[:, :, None] * on, rows))
    yield Direction("as a force at the tool", (), scaled(scene.response.compliance[:, :, :3] * on, rows))
    angle = scaled(scene.J * on, rows)
    size = np.maximum(np.sqrt((tau[rows] ** 2).mean(axis=0)), least_torque(study))
    twist = angle * (tau / size)[:, None, :]
    yield Direction(TURNING, (), angle)
    yield Direction(COMPLIANCE, (), twist)
    for k in range(scene.n_joints):
        yield Direction(f"turning axis {k + 1}", (), angle[:, :, k : k + 1], k)
        yield Direction(f"as compliance of axis {k + 1}", (f"tau_{k + 1}",), twist[:, :, k : k + 1], k)


def shaped(study: Study) -> Iterator[Direction]:
    """Smooth functions of one variable along every direction."""
    forms = shapes(study)
    for d in directions(study):
        is_compliance = d.words == COMPLIANCE or (d.axis is not None and f"tau_{d.axis + 1}" in d.variables)
        as_springs = is_compliance or d.words == ALONG_DEFLECTION
        for name, every in forms.items():
            # what all load cases have in common is the springs', which have priors; in a structure it would be free of them
            shape = every - every.mean(axis=1, keepdims=True) if as_springs and name == "load_case" else every
            columns = (d.columns[:, :, :, None] * shape[:, None, None, :]).reshape(len(shape), 3, -1)
            # an axis that its own torque turns by any curve: what stiffening, play and friction of that axis are forms of
            # also where all axes turn by it: each by itself is a direction of its own
            of_all = d.words in (TURNING, COMPLIANCE)
            by_torque, by_angle = _axis_in(name, "tau"), _axis_in(name, "joint")
            law_of = by_torque if of_all or by_torque == d.axis else None
            softer = by_angle if is_compliance and (of_all or by_angle == d.axis) else None
            variables = (name, *(v for v in d.variables if v != name))
            # in a loaded session it acts under load only, which is no drift
            is_drift = d.words == IN_BASE and follows_course(name) and study.ready.kind == "absolute"
            yield Direction(d.words, variables, columns, d.axis, law_of, softer, is_drift=is_drift)


def follows_course(name: str) -> bool:
    """Whether a variable is time or a temperature."""
    return name == "stamp" or name.startswith("temp_")


def _axis_in(name: str, of: str) -> int | None:
    """The axis, counted from 0, whose torque (`tau`) or angle (`joint`) a variable is; None where it is something else."""
    kind, _, number = name.partition("_")
    return int(number) - 1 if kind == of else None


def two_variables(study: Study) -> Iterator[Direction]:
    """Functions of two variables that turn one axis: torque with its own angle, gravity, history, or another torque."""
    scene, rows = study.ready, study.observation.rows
    angle = scaled(scene.J * under_load(scene), rows)
    tau = scene.load_torque()
    size = np.maximum(np.abs(tau[rows]).max(axis=0), least_torque(study))
    t = tau / size
    q = scene.q
    has = scene.previous >= 0
    before = np.where(has[:, None], np.clip(t[scene.previous], -MOST, MOST), 0.0)
    angle_free = scaled(scene.J, rows)
    bears = bearing(study)
    for k in bears:
        own = angle[:, :, k : k + 1]
        rotary = not bool(scene.kin.is_prismatic[k])
        turn = curve(q[:, k], q[rows, k])
        if rotary:
            turn = waves(q[:, k], 2)
        yield Direction(
            f"as compliance of axis {k + 1}, over its turn",
            (f"joint_{k + 1}", f"tau_{k + 1}"),
            own * (t[:, k : k + 1] * turn)[:, None, :],
            k,
            softer_by_angle=k,
        )
        both = np.stack([t[:, k] ** 2, t[:, k] * np.abs(t[:, k]), t[:, k] ** 3], axis=1)
        with_angle = both * curve(q[:, k], q[rows, k], 1)
        shape = np.column_stack([both, with_angle])
        names = (f"tau_{k + 1}", f"joint_{k + 1}")
        words = f"nonlinear in the torque of axis {k + 1} and its angle"
        yield Direction(words, names, own * shape[:, None, :], k, law_of=k)  # half of it is a law of the torque alone
        yield Direction(f"{words}, as far as the angle matters", names, own * with_angle[:, None, :], k)
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
            yield Direction(words, (f"tau_{k + 1}", "load_case"), own * history[:, None, :], k, history_of=k)
        step = scene.step[:, k] / max(float(np.abs(scene.step[rows, k]).max()), 1e-12)
        if np.ptp(step[rows]) > 1e-6 and scene.clock != "none":
            driven = np.stack([step, step * np.abs(step), np.sign(step)], axis=1)
            words = f"turning axis {k + 1} by the step before"
            columns = angle_free[:, :, k : k + 1] * driven[:, None, :]
            yield Direction(words, (f"joint_{k + 1}",), columns, k, by_step=True)
        for other in bears:
            if other != k:
                product = np.stack([t[:, k] * t[:, other], t[:, other]], axis=1)
                yield Direction(
                    f"turning axis {k + 1} by two torques",
                    (f"tau_{k + 1}", f"tau_{other + 1}"),
                    own * product[:, None, :],
                    k,
                )


def plain(study: Study) -> Iterator[Direction]:
    """Structures that need no variable of their own."""
    scene, rows = study.ready, study.observation.rows
    by_torque = scene.response.compliance[:, :, 3:]
    beside = np.stack([np.einsum("nij,nj->ni", by_torque, np.cross(e, scene.force_in_tool)) for e in np.eye(3)], axis=2)
    yield Direction("as if the force acted beside the TCP", ("load_case", f"tau_{scene.n_joints}"), scaled(beside, rows))
    # with load cases of one size each this passes for different gains of the components, and those for this
    largest = np.maximum(np.abs(scene.force_in_tool[rows]).max(axis=0, initial=0.0), 1e-9)
    change = scene.force_in_tool * np.abs(scene.force_in_tool) / largest  # of a gain that is wrong by 1 at the largest load
    bent = scene.response.compliance[:, :, :3] * change[:, None, :]
    words, bent_scaled = "as if the gain of the force sensor changed with the load", scaled(bent, rows)
    # else one that doubles the force passes for a sensor that is mounted turned
    yield Direction(words, ("force_z", "load_case"), bent_scaled, largest=SETTINGS.most_of_gain * _times(bent, bent_scaled))
    on = under_load(scene)
    yield Direction(IN_BASE, (), np.tile(np.eye(3), (len(scene), 1, 1)) * TYPICAL_DISPLACEMENT * on)
    yield Direction("constant in the tool frame", (), scene.kin.R_tool * TYPICAL_DISPLACEMENT * on)
    if scene.kind == "loaded" and np.any(scene.previous >= 0):
        has = scene.previous >= 0
        last = np.where(has[:, None], scene.force_in_tool[scene.previous], 0.0)
        memory = scene.response.compliance[:, :, :3] * last[:, None, :]
        yield Direction("as if a share of the force before were still there", ("load_case",), scaled(memory, rows))
        change = scene.force_in_tool - last
        lag = scene.response.compliance[:, :, :3] * np.abs(change)[:, None, :]
        yield Direction("as if the change of the force were read wrongly", ("load_case",), scaled(lag, rows))
    if scene.kind == "loaded" and scene.measured_from_station is not None:
        seen = scene.noise_free_from_station()
        sight = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
        moved = seen - seen[scene.reference]
        along = np.einsum("ni,nj,nj->ni", sight, sight, moved)
        for words, part in (("along", along), ("across", moved - along)):
            part = scaled(part[:, :, None], rows)
            yield Direction(f"as if displacement {words} the line of sight were read wrongly", ("load_case",), part)


def readings(study: Study) -> Iterator[Direction]:
    """What a measuring instrument reads wrongly: along its line of sight by the distance, across it by the angles it looks at.

    Loaded sessions measure over millimetres only: there it is a share of the displacement (`plain`).
    """
    scene, rows = study.ready, study.observation.rows
    if scene.kind != "absolute" or scene.measured_from_station is None:
        return
    seen = np.nan_to_num(scene.measured_from_station)
    far = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
    sight = seen / far[:, None]
    by_distance = sight[:, :, None] * curve(far, far[rows])[:, None, :]
    yield Direction("as if the instrument read distances wrongly", SEEN_AT, scaled(by_distance, rows))
    around = np.stack([-sight[:, 1], sight[:, 0], np.zeros(len(far))], axis=1)
    for words, angle, across in (
        ("horizontal", np.arctan2(sight[:, 1], sight[:, 0]), around),
        ("vertical", np.arcsin(np.clip(sight[:, 2], -1.0, 1.0)), np.cross(sight, around)),
    ):
        columns = (far[:, None] * across)[:, :, None] * waves(angle, TURNS)[:, None, :]
        yield Direction(f"as if the instrument read {words} angles wrongly", SEEN_AT, scaled(columns, rows))


def drifts(study: Study) -> Iterator[Direction]:
    """What follows time or a temperature in every row and differs over the poses."""
    scene = study.ready
    if scene.measured_from_station is None:
        return
    far = np.linalg.norm(np.nan_to_num(scene.measured_from_station), axis=1)
    reach = scene.p_tcp / max(float(np.linalg.norm(scene.p_tcp, axis=1).max()), 1e-9)
    by_reach = np.einsum("ni,jk->njik", reach, np.eye(3)).reshape(len(far), 3, -1)
    loaded = study.observation.rows
    for name, values in varying(study).items():
        if not follows_course(name):
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
        # no form of what grows with warmth: the force sensor's zero drifts, or something pulls more and more
        pulled = scaled(scene.response.compliance[:, :, :3], loaded) * (course / TYPICAL_DISPLACEMENT)[:, None, None]
        yield Direction(f"{name}: as a force at the tool", (name,), pulled)
