# SPDX-License-Identifier: Apache-2.0
"""What is learnt on the training courses (every second one) for the others: latency, force profile, filter, answer of arm and
drives."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from irec_calibration.commands.modes import structure_of
from irec_calibration.errors import RecordingError
from irec_calibration.sensors.force_profile import CommonForce, ForcedCourse, common_force, smoothed
from irec_calibration.sensors.latency import Latency, find_latency
from irec_calibration.sensors.look_ahead import Design, Response, design
from irec_calibration.sensors.motion_recording import read_force_and_motion
from irec_calibration.sensors.structure import Structure, frequency_response
from irec_calibration.typing import Array
from irec_correction.conditioning import make_filters
from irec_correction.filters import Filter
from irec_correction.offset_answer import impulse
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
# of the way, at which an offset is swept on three courses; the force at the first one only. A level of roughing goes all round
PLACES = {"afp": (0.5, 0.15, 0.85), "machining": (0.5, 0.1, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9)}


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


def profile_of(drives: Sequence[Drive], rows: Array) -> CommonForce:
    """What the sensor's readings of the training courses have in common, in the directions of the path; each was driven several
    times, and the more readings, the less of what is unsteady stays in it."""
    courses = []
    for drive, i in product(drives, rows):
        n = int(drive.ways.driving[:, i].sum())
        in_base = (drive.ways.R_tool[:n, i] @ drive.reading[:n, i, :, None])[..., 0]
        local = (drive.ways.path[:n, i].swapaxes(1, 2) @ in_base[:, :, None])[..., 0]
        courses.append(ForcedCourse(drive.ways.way[:n, i] / drive.ways.length[i], local))
    return common_force(courses, PERIOD)


def expected(profile: CommonForce, ways: Ways, i: int, smooth: bool = False) -> Array:
    """Force in tool0 at each step of course i, (n, 3), N; smooth: without what comes too quickly to be answered ahead."""
    n = int(ways.driving[:, i].sum())
    local = profile.along(ways.way[:n, i] / ways.length[i], PERIOD)
    local = smoothed(local, PERIOD) if smooth else local
    in_base = (ways.path[:n, i] @ local[:, :, None])[..., 0]
    return np.asarray((ways.R_tool[:n, i].swapaxes(1, 2) @ in_base[:, :, None])[..., 0])


def write_profiles(profile: CommonForce, ways: Ways, courses: Array, path: Path) -> Path:
    """One expected force per course."""
    np.savez(path, **{f"course_{c}": expected(profile, ways, i, smooth=True) for i, c in enumerate(courses)})  # type: ignore[arg-type]
    return path


def unsteady(case: Case, drive: Drive, rows: Array, profile: CommonForce) -> tuple[Array, float]:
    """Force that no profile tells, (n, 3), N, in tool0 with the notches passed; and the sensor's noise before contact, N."""
    parts, quiet = [], []
    for i in rows:
        n = int(drive.ways.driving[:, i].sum())
        left = filtered(stages_before(filters_of(case)), drive.reading[:n, i] - expected(profile, drive.ways, i))
        inside = drive.counted[:n, i]
        parts.append(left[inside][125:-50])
        quiet.append(left[: round(0.12 / PERIOD)].std(axis=0))
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


@dataclass(frozen=True)
class Swept:
    """Postures (m, n), rad, and the answer of the TCP to an offset at each, (m, length, 3, 3)."""

    postures: Array
    impulses: Array


def shaken_at(case: Case, ways: Ways, rows: Array, processes: int = 2) -> tuple[list[Shaken], Swept]:
    """Shake the standing arm at postures of three training courses; recordings tap_k.mcap and shake_k.npz stay."""
    courses = rows[np.unique(np.linspace(0, len(rows) - 1, 3).astype(int))]
    shares = PLACES[case.name]
    places = [(int(i), int(share * ways.driving[:, i].sum()), share) for share in shares for i in courses]
    jobs = [(case, ways.q[step, i], float(ways.rail[i]), k + 1, share == shares[0]) for k, (i, step, share) in enumerate(places)]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        files = list(pool.map(_shake, jobs))
    found, impulses = [], []
    for (i, step, share), (bag, table) in zip(places, files, strict=True):
        data = np.load(table)
        f, _, to_offset = frequency_response(data["sent"], data["moved"], 1.0 / PERIOD, BLOCK)
        impulses.append(impulse(f, to_offset, 1.0 / PERIOD))
        if share != shares[0]:
            continue
        response, compliance = _response(
            case, ways.counts[step, i], *(data[name] for name in ("force", "motion", "sent", "moved"))
        )
        try:
            structure: Structure | None = structure_of(bag)
        except RecordingError as error:
            print(f"case: no modes from {bag}: {error}")
            structure = None
        found.append(Shaken(ways.names[i], response, compliance, structure))
    return found, Swept(np.array([ways.q[step, i] for i, step, _ in places]), np.array(impulses))


def _shake(job: tuple[Case, Array, float, int, bool]) -> tuple[Path, Path]:
    """Recordings of one posture; the force is swept only where it is asked for."""
    case, q, rail, k, by_force = job
    sim = read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    digest = hashlib.sha256(case.truth_path.read_bytes() + case.cell_path.read_bytes() + q.tobytes()).hexdigest()[:12]
    bag, table = case.out / f"tap_{k}_{digest}.mcap", case.out / f"shake_{k}_{digest}.npz"
    if table.is_file() and (bag.is_file() or not by_force):
        return bag, table
    force, motion = tap(sim, hard, q, rail, seed=20 + k) if by_force else (np.zeros((0, 3)), np.zeros((0, 3)))
    sent, moved = shake(sim, hard, q, rail, seed=30 + k)
    np.savez(table, force=force, motion=motion, sent=sent, moved=moved)
    if by_force:
        pose = forward(sim.chain, q[None])
        n = len(force)
        p, R = np.tile(pose.p_tcp, (n, 1)), np.tile(pose.R_tool, (n, 1, 1))
        write_bag(bag.with_suffix(".part"), force @ pose.R_tool[0], p, R, pose.p_tcp + motion)
        bag.with_suffix(".part").replace(bag)
    return bag, table


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


def _through(stages: Sequence[Filter], sample: Array) -> Array:
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


def filtered(stages: Sequence[Filter], reading: Array) -> Array:
    """Forces (n, 3) as they leave these stages."""
    return np.array([_through(stages, x) for x in reading]) if stages else reading
