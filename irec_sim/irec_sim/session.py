# SPDX-License-Identifier: Apache-2.0
"""Synthetic calibration sessions in the table form (irec-session/1), generated directly, without ROS or time stepping.

Nothing in a session folder tells the truth behind it.
"""

from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from .cellfile import CellFile
from .errors import SimError
from .kinematics import Array, quaternion_of_rotation
from .observe import Rows, Schedule, simulate
from .poses import Poses, spread_poses
from .sensing import force_reading
from .truth import Truth

_FORCE_SPREAD = 5.0  # N, by which the force controller misses the set point


@dataclass(frozen=True)
class Generated:
    """A generated session before it is written: one (schedule, rows, noisy marker, noisy force) per repeat."""

    cell: CellFile
    schedules: list[Schedule]
    rows: list[Rows]
    markers: list[Array]
    forces: list[Array]


def make_schedule(cell: CellFile, poses: Poses, start: float, rng: np.random.Generator) -> Schedule:
    """Stamps, loads and temperatures of one pass over the poses; `start` in s since the session began."""
    N, M = len(poses.q), len(cell.load_cases)
    dwell = rng.uniform(4.0, 8.0, (N, M))
    dwell += np.where(rng.random((N, M)) < 0.08, rng.uniform(10.0, 40.0, (N, M)), 0.0)  # somebody stops the run for a while
    travel = rng.uniform(12.0, 25.0, N)
    stamp = np.cumsum(np.column_stack([travel, dwell]).ravel()).reshape(N, M + 1) + start
    force = np.zeros((N, M + 1, 3))
    force[:, 1:] = cell.load_cases + rng.normal(0.0, _FORCE_SPREAD, (N, M, 3))
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
    return Schedule(poses, stamp, force, gap, ambient, gears, station)


def generate(cell: CellFile, truth: Truth, poses: int, seed: int, repeats: int = 1) -> Generated:
    """Simulate a session with instrument noise; everything random but the truth comes from `seed`."""
    rng = np.random.default_rng([seed, 1])
    if poses < 1 or repeats < 1:
        raise SimError("a session needs at least one pose and one repeat")
    where = spread_poses(cell, poses, rng)
    physics = truth.physics()
    out = Generated(cell, [], [], [], [])
    start = 0.0
    for _ in range(repeats):
        schedule = make_schedule(cell, where, start, rng)
        start = float(schedule.stamp[-1, -1])
        rows = simulate(cell, physics, schedule)
        sigma = np.hypot(cell.noise["tracker_m"], cell.noise["tracker_m_per_m"] * rows.distance)
        marker = rows.p_marker + rng.standard_normal(rows.p_marker.shape) * sigma[..., None]
        marker += rng.normal(0.0, cell.noise.get("settling_m", 0.0), marker.shape)
        out.schedules.append(schedule)
        out.rows.append(rows)
        out.markers.append(marker)
        out.forces.append(rows.force_reading + rng.normal(0.0, cell.noise["force_n"], rows.force_reading.shape))
    return out


_LARGEST_SCALE = 60.0
_NEVER_LOADED = ("encoder_harmonics",)  # the same at the reference and under load
_READING_EFFECTS = ("sensor_gain", "sensor_alignment", "tool_weight")


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
        force_reading(sensing, cell.sensor_axis, schedule.force[:, j], schedule.poses.R) for j in range(schedule.force.shape[1])
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
        "noise": dict(cell.noise),
        "load_cases": {j + 1: f.tolist() for j, f in enumerate(cell.load_cases)},
        "load_case_names": {j + 1: n for j, n in enumerate(cell.load_case_names)},
    }
    if cell.rail is not None:
        header["ext_axes"] = {"rail": {"kind": "prismatic", "axis": cell.rail[0].tolist()}}
    (folder / "session.yaml").write_text(yaml.safe_dump(header, sort_keys=False), encoding="utf-8")
    joints = [f"joint_{k + 1}" for k in range(cell.chain.n)]
    temperatures = ["temp_ambient"] + [f"temp_gear_{k + 1}" for k in range(cell.chain.n)]
    columns = ["pose", "load_case", "repeat", "stamp", *joints, *(["ext_rail"] if cell.rail is not None else [])]
    columns += [
        "tcp_x",
        "tcp_y",
        "tcp_z",
        "marker_x",
        "marker_y",
        "marker_z",
        "station",
        "force_x",
        "force_y",
        "force_z",
        *temperatures,
    ]
    with open(folder / "samples.csv", "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(columns)
        for repeat, (schedule, rows) in enumerate(zip(generated.schedules, generated.rows, strict=True)):
            marker, force = generated.markers[repeat], generated.forces[repeat]
            for i in range(marker.shape[0]):
                for j in range(marker.shape[1]):
                    row: list[object] = [i + 1, j, repeat, f"{schedule.stamp[i, j]:.4f}", *(f"{v:.9f}" for v in rows.q[i, j])]
                    if cell.rail is not None:
                        row.append(f"{schedule.poses.rail[i]:.6f}")
                    row += [f"{v:.9f}" for v in rows.p_controller[i, j]] + [f"{v:.8f}" for v in marker[i, j]]
                    row += [cell.stations[schedule.station[i]][0]] + [f"{v:.4f}" for v in force[i, j]]
                    row += [f"{schedule.ambient[i, j]:.2f}"] + [f"{v:.2f}" for v in schedule.gears[i, j]]
                    writer.writerow(row)
    return folder


def write_deflections(generated: Generated, path: str | Path) -> None:
    """True deflection of the physical TCP against its reference row, without noise, in the form of predictions.csv."""
    with open(path, "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(["pose", "load_case", "repeat", "deflection_x", "deflection_y", "deflection_z"])
        for repeat, rows in enumerate(generated.rows):
            deflection = rows.deflection
            for i in range(deflection.shape[0]):
                for j in range(deflection.shape[1]):
                    writer.writerow([i + 1, j + 1, repeat, *(f"{v:.9e}" for v in deflection[i, j])])
