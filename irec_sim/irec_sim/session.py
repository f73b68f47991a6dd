# SPDX-License-Identifier: Apache-2.0
"""Synthetic calibration sessions in the table form (irec-session/1), generated directly, without ROS or time stepping.

Nothing in a session folder tells the truth behind it.
"""

from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml

from .cellfile import CellFile
from .errors import SimError
from .kinematics import Array, quaternion_of_rotation
from .mishaps import Mishap, orientation, spoil
from .noise import TrueNoise, marker_noise
from .observe import Rows, Schedule, bump, simulate
from .outside import READ_BY_SENSOR
from .poses import Poses, spread_poses
from .recorded import Pass
from .sensing import force_reading
from .truth import Truth

_BODY_TIME = 900.0  # s, in which a heavy part takes on a temperature
_FORCE_SPREAD = 5.0  # N, by which the force controller misses the set point


@dataclass(frozen=True)
class Conduct:
    """How a session is measured.

    Attributes:
        noise: as it truly is; None: as the cell states it. claim: what the header says; None: what the cell states.
        random_order: load cases in an order of their own per pose, not always 1 .. M.
        repeats: passes over the poses; repeated_poses: how many poses the passes after the first have (None: all).
        temperatures: which columns are logged: `all`, `ambient`, `none`.
        mishap: one of mishaps.KINDS that happens once, or None.
    """

    noise: TrueNoise | None = None
    claim: dict[str, float] | None = None
    random_order: bool = False
    repeats: int = 1
    repeated_poses: int | None = None
    temperatures: str = "all"
    mishap: str | None = None


@dataclass(frozen=True)
class Generated:
    """A generated session before it is written: one (schedule, rows, pass as recorded) per repeat."""

    cell: CellFile
    conduct: Conduct
    claim: dict[str, float]
    schedules: list[Schedule]
    rows: list[Rows]
    passes: list[Pass]
    mishaps: list[Mishap] = field(default_factory=list)

    @property
    def noise(self) -> TrueNoise:
        """As it truly is."""
        return self.conduct.noise or TrueNoise.as_stated(self.cell.noise)


def make_schedule(cell: CellFile, poses: Poses, start: float, rng: np.random.Generator, random_order: bool = False) -> Schedule:
    """Stamps, loads and temperatures of one pass over the poses; `start` in s since the session began."""
    N, M = len(poses.q), len(cell.load_cases)
    dwell = rng.uniform(4.0, 8.0, (N, M))
    dwell += np.where(rng.random((N, M)) < 0.08, rng.uniform(10.0, 40.0, (N, M)), 0.0)  # somebody stops the run for a while
    travel = rng.uniform(12.0, 25.0, N)
    stamp = np.cumsum(np.column_stack([travel, dwell]).ravel()).reshape(N, M + 1) + start
    case = np.tile(np.arange(M + 1), (N, 1))
    if random_order:
        case[:, 1:] = rng.permuted(case[:, 1:], axis=1)
    force = np.zeros((N, M + 1, 3))
    force[:, 1:] = cell.load_cases[case[:, 1:] - 1] + rng.normal(0.0, _FORCE_SPREAD, (N, M, 3))
    swing = 2.0 * np.pi * stamp / rng.uniform(1500.0, 3500.0) + rng.uniform(0.0, 2.0 * np.pi)
    ambient = 22.0 + rng.uniform(0.3, 1.0) * np.sin(swing) + rng.uniform(-4e-4, 8e-4) * stamp
    rise = rng.uniform(6.0, 18.0, cell.chain.n)
    time = rng.uniform(1200.0, 3600.0, cell.chain.n)
    gears = ambient[..., None] + 3.0 + rise * (1.0 - np.exp(-stamp[..., None] / time))
    if len(cell.stations) > 1:
        at = poses.p + (poses.rail[:, None] * cell.rail[0] if cell.rail is not None else 0.0)
        station = np.argmin([np.linalg.norm(at - p, axis=1) for _, p, _ in cell.stations], axis=0)
    else:
        station = np.zeros(N, dtype=int)
    gap = cell.reference_distance * rng.uniform(0.8, 1.2, N)
    lagged = _late(np.concatenate([ambient[..., None], gears], axis=2), stamp)
    return Schedule(poses, stamp, force, gap, ambient, gears, station, case, lagged)


def _late(temperature: Array, stamp: Array) -> Array:
    """Temperatures (N, M + 1, k) as a body of slow response has them."""
    flat, keep = temperature.reshape(-1, temperature.shape[2]), np.exp(-np.diff(stamp.ravel()) / _BODY_TIME)
    out = [flat[0]]
    for now, k in zip(flat[1:], keep, strict=True):
        out.append(k * out[-1] + (1.0 - k) * now)
    return np.array(out).reshape(temperature.shape)


def generate(
    cell: CellFile, truth: Truth, poses: int, seed: int, repeats: int = 1, conduct: Conduct | None = None, at: Poses | None = None
) -> Generated:  # fmt: skip
    """Simulate a session with instrument noise; everything random but the truth comes from `seed`.

    Args:
        repeats: only without `conduct`, which states them. at: engagement poses; None: spread over the surface.
    """
    rng = np.random.default_rng([seed, 1])
    conduct = conduct or Conduct(repeats=repeats)
    if poses < 1 or conduct.repeats < 1:
        raise SimError("a session needs at least one pose and one repeat")
    every = at if at is not None else spread_poses(cell, poses, rng)
    poses = len(every.q)
    few = np.sort(rng.choice(poses, min(conduct.repeated_poses or poses, poses), replace=False))
    physics = truth.physics()
    out = Generated(cell, conduct, dict(conduct.claim or cell.noise), [], [], [])
    start, clean, bumped = 0.0, [], None
    for repeat in range(conduct.repeats):
        again = few if repeat else np.arange(poses)
        where = Poses(every.q[again], every.rail[again], every.p[again], every.R[again])
        schedule = make_schedule(cell, where, start, rng, conduct.random_order)
        start = float(schedule.stamp[-1, -1])
        bumped = bump(schedule, physics.sensing) if bumped is None else bumped  # a station stays where it was bumped to
        rows = simulate(cell, physics, schedule, out.rows[-1].q[-1, -1] if out.rows else None, bumped)
        out.schedules.append(schedule)
        out.rows.append(rows)
        clean.append(again + 1)
    shapes = [rows.distance.shape for rows in out.rows]
    flat = [np.concatenate([x.ravel() for x in parts]) for parts in (
        [s.stamp for s in out.schedules],
        [np.repeat(r.station[:, None], r.distance.shape[1], axis=1) for r in out.rows],
        [r.distance for r in out.rows],
    )]  # fmt: skip
    error = marker_noise(out.noise, flat[0], flat[1], flat[2], rng)
    error_of = np.split(error, np.cumsum([n * m for n, m in shapes])[:-1])
    for schedule, rows, pose, e in zip(out.schedules, out.rows, clean, error_of, strict=True):
        force = rows.force_reading + rng.normal(0.0, out.noise.force_n, rows.force_reading.shape)
        marker = rows.p_marker + e.reshape(rows.p_marker.shape)
        out.passes.append(Pass(pose, schedule.case, schedule.stamp, rows.q, rows.p_controller, marker, force))
    if conduct.mishap is not None:
        repeat = int(rng.integers(conduct.repeats))
        run = out.passes[repeat]
        R_station = np.stack([cell.stations[k][2] for k in out.rows[repeat].station])
        out.passes[repeat], mishap = spoil(run, repeat, conduct.mishap, orientation(run, cell.chain), R_station, rng)
        out.mishaps.append(mishap)
    return out


_LARGEST_SCALE = 60.0
_NEVER_LOADED = ("encoder_harmonics",)  # the same at the reference and under load
_READING_EFFECTS = ("sensor_gain", "sensor_alignment", "tool_weight", *READ_BY_SENSOR)


def effect_share(cell: CellFile, truth: Truth, effect: str, schedule: Schedule, before: Rows) -> float:
    """RMS of what an effect changes in the observed deflection, over the RMS deflection `before` it was there.

    For errors of the force sensor: of the deflection that the wrong reading would cause, against the true one.
    """
    base = before.apparent_deflection(cell)
    if effect in _READING_EFFECTS:
        read = force_reading_of(cell, truth, schedule)
        read[:, 0] = 0.0
        wrong = replace(schedule, force=read)
        change = simulate(cell, truth.without(effect).physics(), wrong).deflection - before.deflection
    else:
        change = simulate(cell, truth.physics(), schedule).apparent_deflection(cell) - base
    return float(np.sqrt((change**2).sum(-1).mean() / (base**2).sum(-1).mean()))


def force_reading_of(cell: CellFile, truth: Truth, schedule: Schedule) -> Array:
    """What the force sensor reads along a schedule, without noise, (N, M + 1, 3), N."""
    sensing = truth.physics().sensing
    rows = [
        force_reading(
            sensing, cell.sensor_axis, schedule.force[:, j], schedule.poses.R, schedule.before(j), schedule.ambient[:, j]
        )
        for j in range(schedule.force.shape[1])
    ]
    return np.stack(rows, axis=1)


def scale_to_share(cell: CellFile, truth: Truth, share: float, seed: int = 0, poses: int = 24) -> tuple[Truth, set[str]]:
    """Scale each hidden effect of a truth so that it alone causes `share` of the RMS deflection.

    Returns:
        the truth, and the effects that could be scaled; the others don't show in a loaded session at all (encoder
        harmonics cancel, play shows only where the torque changes sign) or can't become so strong, and keep scale 1.

    Raises:
        SimError: share not in (0, 1].
    """
    if not 0.0 < share <= 1.0:
        raise SimError(f"strength is {share:g}: a share of the RMS deflection in (0, 1] is needed, 0.08 for 8 %")
    rng = np.random.default_rng([seed, 2])
    schedule = make_schedule(cell, spread_poses(cell, poses, rng), 0.0, rng)
    before = simulate(cell, truth.without(*(h.effect for h in truth.hidden)).physics(), schedule)
    shown = set()
    for hidden in truth.hidden:
        name, scale = hidden.effect, 1.0
        alone = truth.without(*(h.effect for h in truth.hidden if h.effect != name))
        for _ in range(10):
            now = effect_share(cell, alone.scaled(name, scale), name, schedule, before)
            if now < 1e-4 or scale > _LARGEST_SCALE or name in _NEVER_LOADED:
                break
            if abs(now / share - 1.0) < 0.02:
                truth = truth.scaled(name, scale)
                shown.add(name)
                break
            scale *= float(np.clip(share / now, 0.1, 10.0))
    return truth, shown


def write_session(generated: Generated, folder: str | Path, name: str) -> Path:
    """Write session.yaml, samples.csv and robot.urdf into a new folder.

    Raises:
        SimError: the folder has files already.
    """
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir()):
        raise SimError(f"{folder}: exists and is not empty; name another folder with -o")
    folder.mkdir(parents=True, exist_ok=True)
    cell = generated.cell
    shutil.copyfile(cell.urdf, folder / "robot.urdf")
    header = {
        "format": "irec-session/1",
        "name": name,
        "kind": "loaded",
        "robot": {"urdf": "robot.urdf", "serial": cell.serial},
        "marker_in_tool0": cell.marker_in_tool0.tolist(),
        "stations": [
            {"name": n, "xyz": p.tolist(), "quat_xyzw": quaternion_of_rotation(R).tolist()} for n, p, R in cell.stations
        ],
        "noise": dict(generated.claim),
        "load_cases": {j + 1: f.tolist() for j, f in enumerate(cell.load_cases)},
        "load_case_names": {j + 1: n for j, n in enumerate(cell.load_case_names)},
    }
    if cell.rail is not None:
        header["ext_axes"] = {"rail": {"kind": "prismatic", "axis": cell.rail[0].tolist()}}
    (folder / "session.yaml").write_text(yaml.safe_dump(header, sort_keys=False), encoding="utf-8")
    joints = [f"joint_{k + 1}" for k in range(cell.chain.n)]
    logged = {"all": 1 + cell.chain.n, "ambient": 1, "none": 0}[generated.conduct.temperatures]
    temperatures = ["temp_ambient", *(f"temp_gear_{k + 1}" for k in range(cell.chain.n))][:logged]
    columns = ["pose", "load_case", "repeat", "stamp", *joints, *(["ext_rail"] if cell.rail is not None else [])]
    columns += [f"{what}_{axis}" for what in ("tcp", "marker") for axis in "xyz"] + ["station"]
    columns += [*(f"force_{axis}" for axis in "xyz"), *temperatures]
    with open(folder / "samples.csv", "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(columns)
        for repeat, (schedule, run) in enumerate(zip(generated.schedules, generated.passes, strict=True)):
            for i, j in np.ndindex(run.stamp.shape):
                row: list[object] = [run.pose[i], run.case[i, j], repeat, f"{run.stamp[i, j]:.4f}"]
                row += [f"{v:.9f}" for v in run.q[i, j]]
                if cell.rail is not None:
                    row.append(f"{schedule.poses.rail[i]:.6f}")
                row += [f"{v:.9f}" for v in run.p_controller[i, j]] + [f"{v:.8f}" for v in run.marker[i, j]]
                row += [cell.stations[schedule.station[i]][0]] + [f"{v:.4f}" for v in run.force[i, j]]
                row += [f"{v:.2f}" for v in [schedule.ambient[i, j], *schedule.gears[i, j]][:logged]]
                writer.writerow(row)
    return folder


def write_deflections(generated: Generated, path: str | Path) -> None:
    """True deflection of the physical TCP against its reference row, without noise, in the form of predictions.csv."""
    with open(path, "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(["pose", "load_case", "repeat", "deflection_x", "deflection_y", "deflection_z"])
        for repeat, (run, rows) in enumerate(zip(generated.passes, generated.rows, strict=True)):
            deflection = rows.deflection
            for i, j in np.ndindex(deflection.shape[:2]):
                writer.writerow([run.pose[i], run.case[i, j + 1], repeat, *(f"{v:.9e}" for v in deflection[i, j])])
