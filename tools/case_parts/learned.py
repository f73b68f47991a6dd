# SPDX-License-Identifier: Apache-2.0
"""What is learnt on the training courses (every second one) for the others: latency, force profile, filter, answer of arm and
drives."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.commands.modes import structure_of
from irec_calibration.errors import RecordingError
from irec_calibration.sensors.latency import Latency, find_latency
from irec_calibration.sensors.motion_recording import read_force_and_motion
from irec_calibration.sensors.structure import Structure, frequency_response
from irec_calibration.typing import Array
from irec_correction.ahead import Design, Response, design
from irec_correction.conditioning import make_filters
from irec_correction.filters import Filter
from irec_sim.cellfile import read_cell
from irec_sim.kinematics import forward
from irec_sim.production.hard import read_hard
from irec_sim.production.runner import Drive
from irec_sim.production.tap import shake, tap
from irec_sim.production.ways import PERIOD, Ways

from .bag import write_bag
from .jobs import Case, filters_of, limits_of, stages_before

SWEPT = (3.0, 28.0)  # Hz, in which responses are taken from sweeps
BLOCK = 1000  # samples, over which they are averaged
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
    parts, quiet = [], []
    for i in rows:
        n = int(drive.ways.driving[:, i].sum())
        stages = stages_before(filters_of(case))
        left = drive.reading[:n, i] - profile.along(drive.ways, i)
        for stage in stages:
            left = np.array([stage.step(x) for x in left])
        inside = drive.counted[:n, i]
        parts.append(left[inside][125:-50])
        quiet.append(drive.reading[: round(0.12 / PERIOD), i].std(axis=0))
    return np.concatenate(parts), float(np.sqrt((np.array(quiet) ** 2).mean()))


@dataclass(frozen=True)
class Shaken:
    """What a swept force and a swept offset told at one posture.

    Attributes:
        where: course. response: in the direction that counts; compliance: m/N, largest static one of the TCP.
        structure: modes as `irec modes` finds them in the recording, or None where it says that it can't.
    """

    where: str
    response: Response
    compliance: float
    structure: Structure | None


def shaken_at(case: Case, ways: Ways, rows: Array) -> list[Shaken]:
    """Shake the standing arm at three postures of the training courses; recordings tap_k.mcap and shake_k.npz stay."""
    sim = read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    found = []
    for k, i in enumerate(rows[np.unique(np.linspace(0, len(rows) - 1, 3).astype(int))]):
        step = int(0.5 * ways.driving[:, i].sum())
        q, counts = ways.q[step, i], ways.counts[step, i]
        digest = hashlib.sha256(case.truth_path.read_bytes() + case.cell_path.read_bytes() + q.tobytes()).hexdigest()[:12]
        bag, table = case.out / f"tap_{k + 1}_{digest}.mcap", case.out / f"shake_{k + 1}_{digest}.npz"
        if not (bag.is_file() and table.is_file()):
            force, motion = tap(sim, hard, q, float(ways.rail[i]), seed=20 + k)
            sent, moved = shake(sim, hard, q, float(ways.rail[i]), seed=30 + k)
            np.savez(table, force=force, motion=motion, sent=sent, moved=moved)
            pose = forward(sim.chain, q[None])
            n = len(force)
            p, R = np.tile(pose.p_tcp, (n, 1)), np.tile(pose.R_tool, (n, 1, 1))
            write_bag(bag.with_suffix(".part"), force @ pose.R_tool[0], p, R, pose.p_tcp + motion)
            bag.with_suffix(".part").replace(bag)
        data = np.load(table)
        response, compliance = _response(case, counts, *(data[name] for name in ("force", "motion", "sent", "moved")))
        try:
            structure: Structure | None = structure_of(bag)
        except RecordingError as error:
            print(f"case: no modes from {bag}: {error}")
            structure = None
        found.append(Shaken(ways.names[i], response, compliance, structure))
    return found


def _response(case: Case, counts: Array, force: Array, motion: Array, sent: Array, moved: Array) -> tuple[Response, float]:
    """In the direction that counts, for a force that has passed the stages before the designed filter."""
    f, _, to_force = frequency_response(force, motion, 1.0 / PERIOD, BLOCK)
    _, _, to_offset = frequency_response(sent, moved, 1.0 / PERIOD, BLOCK)
    used, low = (f >= SWEPT[0]) & (f <= SWEPT[1]), (f >= SWEPT[0]) & (f <= SWEPT[0] + 1.5)
    P, Q = (to_force @ counts) @ counts, (to_offset @ counts) @ counts
    stages = stages_before(filters_of(case))
    impulse = np.zeros((500, 6))
    impulse[0] = 1.0
    for stage in stages:
        stage.step(np.zeros(6))  # stages take their first sample as having stood for ever
    out = [_through(stages, x)[0] for x in impulse]
    before = np.exp(-2j * np.pi * f[:, None] * np.arange(len(out)) * PERIOD) @ np.array(out)
    response = Response(f[used], P[used] / float(np.abs(P[low]).mean()) / before[used], Q[used])
    return response, float(np.linalg.norm(np.abs(to_force[low]).mean(axis=0), 2))


def _through(stages: list[Filter], sample: Array) -> Array:
    for stage in stages:
        sample = stage.step(sample)
    return sample


def designs(case: Case, force: Array, noise: float, lead: float, shaken: list[Shaken]) -> tuple[Design, Design]:
    """Filters for the measured spectrum: that look ahead by a lead, and that undo what arm and drives do."""
    settings = {
        "compliance": max(s.compliance for s in shaken),
        "acceleration": limits_of(case).translation.acceleration / 3.0,  # so that the limit itself acts rarely
        "cutoff": filters_of(case).cutoff,
    }
    plain = design(force, 1.0 / PERIOD, lead, noise, **settings)
    return plain, design(force, 1.0 / PERIOD, lead, noise, responses=[s.response for s in shaken], **settings)
