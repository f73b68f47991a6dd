# SPDX-License-Identifier: Apache-2.0
"""Drives of a case: each in a process of its own, two at a time, kept on disk so that an interrupted case goes on
where it was."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from demo_parts.processes import die_with_parent
from irec_calibration.cell import read_cell
from irec_correction.conditioning import FilterSettings, make_filters
from irec_correction.correction import CorrectionSettings
from irec_correction.filters import Filter
from irec_correction.fir import read_taps
from irec_correction.limits import Bounds, OffsetLimits
from irec_correction.links import Links
from irec_correction.preview import ForceProfile, Preview
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.production.hard import Hard, read_hard, without
from irec_sim.production.runner import Drive, Oracle, drive
from irec_sim.production.ways import PERIOD, Ways, make_ways

from .corrected import Corrected, Setup

ROOT = Path(__file__).resolve().parents[2]
RECORD = "2"  # of what the record of a drive holds


@dataclass(frozen=True)
class Case:
    """Files of a case. `every`: only every n-th course of the part; truth: its plant (default: as shipped)."""

    name: str
    out: Path
    every: int = 1
    seed: int = 0
    truth: Path | None = None

    @property
    def cell_path(self) -> Path:
        return ROOT / "config" / "cells" / ("afp.yaml" if self.name == "afp" else "milling.yaml")

    @property
    def truth_path(self) -> Path:
        return self.truth or ROOT / "config" / "truths" / f"case_{self.name}.yaml"


@dataclass(frozen=True)
class Job:
    """One drive.

    Attributes:
        rows: courses of the part, from 0. model: file, None without correction, "oracle" for the plant itself.
        off: causes switched off. lead: s, extrapolated; taps, filter_file: designed filter; profiles: npz of one force profile
        per course; ahead: s, of the profiles; slack: s, by which they may be moved in time.
        brisk: with the limits of `BRISK`. zeroed: the force sensor is zeroed in the air before each course.
    """

    name: str
    rows: tuple[int, ...]
    model: str | None = None
    off: tuple[str, ...] = ()
    lead: float = 0.0
    taps: tuple[float, ...] = ()
    filter_file: str | None = None
    profiles: str | None = None
    ahead: float = 0.0
    slack: float = 0.0
    brisk: bool = False
    zeroed: bool = False
    seed: int = 0
    links: bool = False  # secondary encoders are read; the model is of what lies beyond them


def filters_of(case: Case) -> FilterSettings:
    """Filters as somebody sets them up who knows the process: notches where spindle and teeth fold to, and a low-pass below the
    arm's lowest mode (10 to 12 Hz), which cutting forces reach: an offset that follows them there shakes the arm once more."""
    if case.name == "machining":
        return FilterSettings(spindle_speed=199.2, harmonics=3, notch_quality=2.0, cutoff=8.0)
    return FilterSettings()


# An offset that shakes the arm shows in the windup of its gears, so that this is a loop. At a third of the lowest mode (9 Hz), a
# low-pass of second order takes away what a mode of 5 % damping adds.
LINK_FILTERS = FilterSettings(cutoff=3.0)


# cutting forces, and filters that undo what the arm does, need an offset that accelerates faster than the cautious default
BRISK = OffsetLimits(translation=Bounds(3e-3, 0.1, 4.0))


def limits_of(case: Case, brisk: bool = False) -> OffsetLimits:
    """Limits of the offset: cutting forces change faster than a roller's, so the offset may accelerate faster there."""
    if brisk:
        return BRISK
    return OffsetLimits(translation=Bounds(3e-3, 0.05, 2.0)) if case.name == "machining" else OffsetLimits()


def ways_of(case: Case, hard: Hard) -> Ways:
    """Ways of the part, computed once."""
    path = kept_ways(case)
    if path.is_file():
        with path.open("rb") as file:
            return pickle.load(file)  # written by the line below
    ways = make_ways(read_sim_cell(case.cell_path), hard.process)
    part = path.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(ways))
    part.replace(path)
    return ways


def kept_ways(case: Case) -> Path:
    """Where the ways of this part are kept."""
    digest = hashlib.sha256(case.truth_path.read_bytes() + case.cell_path.read_bytes()).hexdigest()[:12]
    return case.out / f"ways_{digest}.pickle"


def path_of(case: Case, job: Job) -> Path:
    return case.out / "drives" / f"{job.name}.npz"


def fingerprint(case: Case, job: Job) -> str:
    """Of everything that a drive depends on: what is on disk is used again only where nothing has changed."""
    parts = [
        RECORD,
        json.dumps(job.__dict__, sort_keys=True, default=str),
        str(case.seed),
        repr((filters_of(case), limits_of(case, job.brisk), LINK_FILTERS)),
    ]
    for path in (
        case.truth_path,
        case.cell_path,
        *(Path(p) for p in (job.model, job.profiles, job.filter_file) if p and p != "oracle"),
    ):
        parts.append(hashlib.sha256(path.read_bytes()).hexdigest())
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def run_job(case: Case, job: Job) -> str:
    """Drive and keep the record; the path of it."""
    path, mark = path_of(case, job), fingerprint(case, job)
    if path.is_file() and str(np.load(path)["fingerprint"]) == mark:
        return str(path)
    sim = read_sim_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    ways = ways_of(case, hard).only(np.array(job.rows))
    hard = without(hard, *job.off)
    path.parent.mkdir(parents=True, exist_ok=True)
    told = path.with_suffix(".progress")
    controller: Corrected | Oracle | None = None
    if job.model == "oracle":
        (low_pass,) = make_filters(replace(filters_of(case), spindle_speed=0.0))
        controller = Oracle(low_pass.step)
    elif job.model is not None:
        controller = corrected(case, job, ways)
    begun = drive(sim, hard, ways, controller, case.seed + job.seed, lambda share: told.write_text(f"{share:.3f}"))
    what = controller.told() if isinstance(controller, Corrected) else {}
    part = path.with_suffix(".part.npz")
    np.savez(
        part,
        fingerprint=mark,
        told=json.dumps(what),
        rows=np.array(job.rows),
        **{
            k: getattr(begun, k).astype(np.float32)
            for k in ("deviation", "measured", "static", "offset", "sent", "force", "reading")
        },
        in_air=begun.in_air,
        counted=begun.counted,
        judged=begun.judged,
    )
    part.replace(path)
    told.unlink(missing_ok=True)
    return str(path)


def corrected(case: Case, job: Job, ways: Ways) -> Corrected:
    """The correction as this job configures it."""
    cell = read_cell(case.cell_path)
    filters = replace(filters_of(case), taps=job.taps or (1.0,))
    if job.filter_file:
        table = read_taps(job.filter_file, cell.robot.joint_names)
        filters = replace(filters, posture_taps=table.taps.tolist(), postures=table.postures.tolist())
    settings = CorrectionSettings(lead=job.lead, lead_limit=3e-4, limits=limits_of(case, job.brisk))
    made = Corrected(cell, Setup(Path(str(job.model)), settings, filters, job.zeroed), PERIOD * ways.driving.sum(axis=0))
    profiles = np.load(job.profiles) if job.profiles else None
    for i, chain in enumerate(made.chains):
        if job.links:
            chain.links = Links(cell.robot, make_filters(LINK_FILTERS))
        if profiles is not None:
            steps = int(ways.driving[:, i].sum())
            wrench = np.zeros((steps, 6))
            wrench[:, :3] = profiles[f"course_{job.rows[i]}"][:steps]
            chain.preview = Preview(ForceProfile(ways.q[:steps, i], wrench), job.ahead, make_filters(filters), slack=job.slack)
    return made


def stages_before(filters: FilterSettings) -> list[Filter]:
    """All stages but the low-pass or the designed filter."""
    return make_filters(replace(filters, cutoff=0.0, taps=(1.0,)))


def load(case: Case, job: Job) -> tuple[Drive, dict[str, float]]:
    """The record of a job, and what the correction told of itself."""
    data = np.load(path_of(case, job))
    hard = read_hard(case.truth_path, read_sim_cell(case.cell_path))
    ways = ways_of(case, hard).only(np.array(job.rows))
    fields = {k: data[k].astype(float) for k in ("deviation", "measured", "static", "offset", "sent", "force", "reading")}
    kept = {k: data[k] for k in ("in_air", "counted", "judged")}
    return Drive(ways, **kept, **fields), json.loads(str(data["told"]))


def run_jobs(case: Case, jobs: Sequence[Job], say: Callable[[str], None], processes: int = 2) -> None:
    """All jobs, two at a time, with progress and an estimate. What is done stays on disk where this is interrupted."""
    left = [j for j in jobs if not _done(case, j)]
    if not left:
        return
    begun = time.monotonic()
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    pool = ProcessPoolExecutor(min(processes, len(left)), mp_context=get_context("spawn"), initializer=die_with_parent)
    try:
        waiting: dict[Future[str], Job] = {pool.submit(run_job, case, job): job for job in left}
        while waiting:
            done, _ = wait(waiting, timeout=8.0, return_when=FIRST_COMPLETED)
            for future in done:
                job = waiting.pop(future)
                future.result()
                say(f"drive '{job.name}' done")
            share = (len(left) - len(waiting) + sum(_share(case, j) for j in waiting.values())) / len(left)
            spent = time.monotonic() - begun
            if waiting:
                rest = f"about {spent * (1.0 - share) / share:.0f} s left" if share > 0.03 else "estimating the time left"
                say(f"~{len(left) - len(waiting)} of {len(left)} drives, {100 * share:.0f} %, {rest}")
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def meanwhile(case: Case, jobs: Sequence[Job], gently: bool = True) -> Iterator[None]:
    """Drive what depends on nothing that is still being measured, one after the other.

    What is not done at the end is left for `run_jobs`, but for the drive that is under way, which is waited for.

    Args:
        gently: as far as the processors are free, where something else must not be late.
    """
    left = [j for j in jobs if not _done(case, j)]
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    begin = _in_the_background if gently else die_with_parent
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=begin)
    futures = [pool.submit(run_job, case, job) for job in left]
    try:
        yield
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    for future in futures:
        if not future.cancelled():
            future.result()


def _in_the_background() -> None:
    die_with_parent()
    os.nice(10)


def _done(case: Case, job: Job) -> bool:
    path = path_of(case, job)
    try:
        return path.is_file() and str(np.load(path)["fingerprint"]) == fingerprint(case, job)
    except (OSError, ValueError, KeyError):
        return False


def _share(case: Case, job: Job) -> float:
    try:
        return float(path_of(case, job).with_suffix(".progress").read_text() or 0.0)
    except (OSError, ValueError):
        return 0.0
