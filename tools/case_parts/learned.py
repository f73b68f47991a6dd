# SPDX-License-Identifier: Apache-2.0
"""What is learnt on the training courses (every second one) for the others: latency, force profile, filter, modes of
the structure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.commands.modes import structure_of
from irec_calibration.errors import RecordingError
from irec_calibration.sensors.latency import Latency, find_latency
from irec_calibration.sensors.motion_recording import read_force_and_motion
from irec_calibration.sensors.structure import Structure
from irec_calibration.typing import Array
from irec_correction.ahead import Design, StructureMode, design
from irec_correction.conditioning import make_filters
from irec_sim.cellfile import read_cell
from irec_sim.kinematics import forward
from irec_sim.production.hard import read_hard
from irec_sim.production.runner import Drive
from irec_sim.production.tap import tap
from irec_sim.production.ways import PERIOD, Ways

from .bag import write_bag
from .jobs import Case, filters_of

HEAD, TAIL = 2.0, 1.2  # s at either end of a course in which the profile goes by time, in between by the share of the way


def _longest(drive: Drive, rows: Array) -> int:
    return int(rows[np.argmax(drive.ways.driving[:, rows].sum(axis=0))])


def latency_of(case: Case, drive: Drive, rows: Array) -> tuple[Latency, Path]:
    """Record the longest training course, and measure the latency from the recording as `irec latency` does."""
    i = _longest(drive, rows)
    n = int(drive.ways.driving[:, i].sum())
    p = forward(read_cell(case.cell_path).chain, drive.ways.q[:n, i]).p_tcp + drive.offset[:n, i]
    path = write_bag(case.out / "course.mcap", drive.reading[:n, i], p, drive.ways.R_tool[:n, i])
    data = read_force_and_motion(path, "wrench", "tcp_pose", "")
    return find_latency(data.force_stamp, data.force, data.pose_stamp, data.p), path


def lead_of(case: Case, latency: Latency) -> float:
    """Delay without that of the low-pass, which a designed filter replaces, s."""
    filters = make_filters(filters_of(case))
    return float(np.clip(latency.delay - filters[-1].delay, 0.0, 0.1))


@dataclass(frozen=True)
class Profile:
    """Expected force in the directions of the path: by time at the head and the tail, by the share of the way between, N."""

    head: Array
    tail: Array
    middle: Array

    def along(self, ways: Ways, i: int) -> Array:
        """In tool0 at each step of course i, (n, 3), N."""
        n = int(ways.driving[:, i].sum())
        share = ways.way[:n, i] / ways.length[i]
        grid = np.linspace(0.0, 1.0, len(self.middle))
        local = np.stack([np.interp(share, grid, self.middle[:, k]) for k in range(3)], axis=1)
        a, b = min(len(self.head), n // 2), min(len(self.tail), n // 2)
        fade_a, fade_b = _fade(a)[:, None], _fade(b)[::-1][:, None]
        local[:a] = self.head[:a] * fade_a + local[:a] * (1.0 - fade_a)
        local[n - b :] = self.tail[len(self.tail) - b :] * fade_b + local[n - b :] * (1.0 - fade_b)
        in_base = (ways.path[:n, i] @ local[:, :, None])[..., 0]
        return (ways.R_tool[:n, i].swapaxes(1, 2) @ in_base[:, :, None])[..., 0]


def _fade(n: int) -> Array:
    """1, and over the last quarter down to 0."""
    x = np.clip((np.arange(n) - 0.75 * n) / (0.25 * n), 0.0, 1.0)
    return 1.0 - x * x * (3.0 - 2.0 * x)


def profile_of(drive: Drive, rows: Array) -> Profile:
    """Mean of the sensor's readings over the training courses."""
    head, tail, middle = [], [], []
    grid = np.linspace(0.0, 1.0, 201)
    for i in rows:
        n = int(drive.ways.driving[:, i].sum())
        in_base = (drive.ways.R_tool[:n, i] @ drive.reading[:n, i, :, None])[..., 0]
        local = (drive.ways.path[:n, i].swapaxes(1, 2) @ in_base[:, :, None])[..., 0]
        a, b = round(HEAD / PERIOD), round(TAIL / PERIOD)
        if n < a + b + 50:
            continue
        share = drive.ways.way[:n, i] / drive.ways.length[i]
        head.append(local[:a])
        tail.append(local[n - b :])
        middle.append(np.stack([np.interp(grid, share, local[:, k]) for k in range(3)], axis=1))
    mean = np.mean(middle, axis=0)
    wide = np.ones(15) / 15.0  # of the 201 points, so that single courses' noise is not taken for the process
    smooth = np.stack([np.convolve(np.pad(mean[:, k], 7, mode="edge"), wide, "valid") for k in range(3)], axis=1)
    return Profile(np.mean(head, axis=0), np.mean(tail, axis=0), smooth)


def write_profiles(profile: Profile, ways: Ways, courses: Array, path: Path) -> Path:
    """One expected force per course."""
    np.savez(path, **{f"course_{c}": profile.along(ways, i) for i, c in enumerate(courses)})  # type: ignore[arg-type]
    return path


def unsteady(case: Case, drive: Drive, rows: Array, profile: Profile) -> tuple[Array, float]:
    """Force that no profile tells, (n, 3), N, in tool0 with the notches passed; and the sensor's noise before contact, N."""
    from .jobs import _notches

    parts, quiet = [], []
    for i in rows:
        n = int(drive.ways.driving[:, i].sum())
        stages = _notches(filters_of(case))
        left = drive.reading[:n, i] - profile.along(drive.ways, i)
        for stage in stages:
            left = np.array([stage.step(x) for x in left])
        inside = drive.counted[:n, i]
        parts.append(left[inside][125:-50])
        quiet.append(drive.reading[: round(0.12 / PERIOD), i].std(axis=0))
    return np.concatenate(parts), float(np.sqrt((np.array(quiet) ** 2).mean()))


def structures_of(case: Case, ways: Ways, rows: Array) -> list[tuple[str, Structure]]:
    """Swept force at three postures of the training courses, recorded, and identified as `irec modes` does."""
    sim = read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    found = []
    for k, i in enumerate(rows[np.linspace(0, len(rows) - 1, 3).astype(int)]):
        step = int(0.5 * ways.driving[:, i].sum())
        path = case.out / f"tap_{k + 1}.mcap"
        if not path.is_file():
            q = ways.q[step, i]
            force, motion = tap(sim, hard, q, float(ways.rail[i]), seed=20 + k)
            pose = forward(sim.chain, q[None])
            n = len(force)
            write_bag(
                path.with_suffix(".part"),
                force @ pose.R_tool[0],
                np.tile(pose.p_tcp, (n, 1)),
                np.tile(pose.R_tool, (n, 1, 1)),
                pose.p_tcp + motion,
            )
            path.with_suffix(".part").replace(path)
        try:
            found.append((f"{ways.names[i]} ({path.name})", structure_of(path)))
        except RecordingError as error:
            print(f"case: no modes from {path}: {error}")
    return found


def modes_for_design(found: list[tuple[str, Structure]]) -> list[StructureMode]:
    """Modes of all postures, each with its part of the whole: the filter is one for all of them."""
    return [
        StructureMode(m.frequency, min(max(m.damping, 0.02), 0.5), max(m.share, 0.0) / len(found))
        for _, s in found
        for m in s.modes
        if m.share > 0.02
    ]


def designs(force: Array, noise: float, lead: float, modes: list[StructureMode], cutoff: float) -> tuple[Design, Design]:
    """Filters for the measured spectrum, without and with the structure's modes."""
    plain = design(force, 1.0 / PERIOD, lead, noise, cutoff=cutoff)
    return plain, design(force, 1.0 / PERIOD, lead, noise, modes=modes, cutoff=cutoff)
