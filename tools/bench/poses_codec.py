# SPDX-License-Identifier: Apache-2.0
"""How fast COVER, IOOPS and CODEC are, on one BLAS thread, beside the plain way of computing the same.

    python tools/bench/poses_codec.py [--json]

Prints a table: measured, target, and whether it was met. Each ratio comes from one run on the same data. Times are processor
time, which on one thread and an idle machine is wall time, and on a busy one is what wall time would be.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell, read_cell
from irec_calibration.codec import RIDGE, PoseData, pose_data, run_codec
from irec_calibration.identification.identify import fit, observe_with_force_noise
from irec_calibration.identification.system import System, linearise
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.poses.blocks import gram, identifiable_subspace, observation_blocks
from irec_calibration.poses.pool import Pool, generate_pool
from irec_calibration.poses.select import Candidates, cover, select_poses
from irec_calibration.session import read_session
from scipy.optimize import lsq_linear, nnls

ROOT = Path(__file__).resolve().parents[2]
N = 31
SEED = 1


@dataclass(frozen=True)
class Line:
    """One measured figure; limit is an upper bound for times and a lower one for ratios, None where nothing was promised."""

    name: str
    value: float
    unit: str
    limit: float | None = None

    @property
    def met(self) -> bool | None:
        if self.limit is None:
            return None
        return self.value >= self.limit if self.unit == "x" else self.value <= self.limit

    def __str__(self) -> str:
        limit = "" if self.limit is None else f"{'>=' if self.unit == 'x' else '<='} {self.limit:g} {self.unit}"
        verdict = {None: "", True: "met", False: "MISSED"}[self.met]
        return f"{self.name:<74} {self.value:>10.4g} {self.unit:<4} {limit:<12} {verdict}"


def best_of(repeats: int, work: Callable[[], object]) -> float:
    """Shortest processor time of several runs, s."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def ioops_from_joint_angles(cell: Cell, q: np.ndarray) -> np.ndarray:
    """31 poses by IOOPS, everything from the joint angles on: kinematics, Jacobians, observation blocks, search."""
    blocks = observation_blocks(cell.robot.kinematics(q), cell.forces_in_tool, cell.marker_in_tool)
    grams = gram(blocks)
    reduced = identifiable_subspace(grams).reduce(grams)
    return select_poses("ioops", Candidates(np.zeros((len(q), 3)), gram=reduced), N, seed=SEED)


def ioops_with_one_svd_per_candidate(blocks: np.ndarray, rank: int) -> tuple[list[int], int]:
    """Pseudocode 1 with the singular values of each candidate's whole observation matrix; returns poses and number of SVDs."""
    rows = blocks.reshape(len(blocks), -1, blocks.shape[-1])
    # columns of length 1: O1 of every set changes by the same factor, and singular values of 1e-8 mean what they say
    norm = np.sqrt(np.mean(np.sum(rows**2, axis=1), axis=0))
    rows = rows / np.where(norm > 1e-9 * norm.max(), norm, np.inf)
    count = 0

    def log_o1(poses: list[int]) -> float:
        nonlocal count
        count += 1
        return float(np.sum(np.log(np.linalg.svd(rows[poses].reshape(-1, rows.shape[2]), compute_uv=False)[:rank])))

    chosen = [int(i) for i in np.random.default_rng(SEED).choice(len(rows), size=N, replace=False)]
    while True:
        others = np.setdiff1d(np.arange(len(rows)), chosen)
        chosen.append(int(others[np.argmax([log_o1([*chosen, int(i)]) for i in others])]))
        worst = int(np.argmax([log_o1(chosen[:k] + chosen[k + 1 :]) for k in range(N + 1)]))
        chosen.pop(worst)
        if worst == N:
            return chosen, count


def codec_by_fresh_solves(system: System, data: PoseData, solver: str) -> tuple[np.ndarray, np.ndarray]:
    """Algorithm 1 with COVER and a fresh bounded solve of the stacked system for every training set: E_mean and parameters."""
    p = len(system.scale)
    blocks = [(system.A[system.pose == pose], system.b[system.pose == pose]) for pose in data.poses]
    n_v = round(len(data) / (70 / 30 + 1))
    E, C = [], []
    for first in cover(data.points, len(data)):
        held = cover(data.points, n_v, first=np.array([first]))
        pool = np.setdiff1d(np.arange(len(data)), held)
        for j in range(1, len(pool) + 1):
            chosen = pool[cover(data.points[pool], j)]
            A = np.concatenate([blocks[i][0] for i in chosen])
            b = np.concatenate([blocks[i][1] for i in chosen])
            ridge = np.sqrt(RIDGE * np.sum(A**2, axis=0).max()) * np.eye(p)
            A, b = np.vstack([A, ridge]), np.append(b, np.zeros(p))
            if solver == "nnls":
                x, _ = nnls(A, b)
            else:
                x = lsq_linear(A, b, (system.lower, system.upper), method=solver, tol=1e-14, max_iter=1000).x
            residual = data.y[held] - data.A[held] @ x
            E.append(np.mean(np.abs(residual).reshape(-1, 3), axis=0))
            C.append(x * system.scale)
    shape = (len(data), len(data) - n_v)
    return np.reshape(E, (*shape, 3)), np.reshape(C, (*shape, p))


def larger_pool(pool: Pool, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (size, 6) and points (size, 3) for timing: a pool and jittered copies of it."""
    rng = np.random.default_rng(0)
    times = -(-size // len(pool))
    q = np.tile(pool.q, (times, 1))[:size] + 0.02 * rng.normal(size=(size, pool.q.shape[1]))
    return q, np.tile(pool.p_in_cell, (times, 1))[:size] + 0.02 * rng.normal(size=(size, 3))


def bench_selection(cell: Cell) -> list[Line]:
    start = time.process_time()
    pool = generate_pool(cell, 3000)
    lines = [Line("pool of 3000 from the AFP cell, all checks", time.process_time() - start, "s")]
    lines.append(Line("COVER, 31 of 3000", 1e3 * best_of(20, lambda: cover(pool.p_in_cell, N)), "ms", 10.0))
    anew = itertools.count(1)  # other joint angles every time: the robot remembers the kinematics of the last ones
    seconds = best_of(3, lambda: ioops_from_joint_angles(cell, pool.q + 1e-9 * next(anew)))
    lines.append(Line("IOOPS, 31 of 3000, with kinematics and Jacobians", seconds, "s", 1.0))
    blocks = observation_blocks(cell.robot.kinematics(pool.q), cell.forces_in_tool, cell.marker_in_tool)
    rank = identifiable_subspace(gram(blocks)).rank
    start = time.process_time()
    plain, count = ioops_with_one_svd_per_candidate(blocks, rank)
    plain_seconds = time.process_time() - start
    lines.append(Line(f"the same with one SVD per candidate ({count} SVDs, without kinematics)", plain_seconds, "s"))
    lines.append(Line("ratio", plain_seconds / seconds, "x", 30.0))
    same = len(set(plain) & set(ioops_from_joint_angles(cell, pool.q).tolist()))
    lines.append(Line("poses chosen alike, of 31", same, ""))
    for size in (3000, 10_000, 30_000):
        q, points = larger_pool(pool, size)
        lines.append(Line(f"COVER, 31 of {size}, per 1000", 1e6 * best_of(5, lambda p=points: cover(p, N)) / size, "ms"))
        seconds = best_of(1, lambda q=q: ioops_from_joint_angles(cell, q))
        lines.append(Line(f"IOOPS, 31 of {size}, with Jacobians, per 1000", 1e6 * seconds / size, "ms"))
    return lines


def bench_codec() -> list[Line]:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "session"
        irec_sim = Path(sys.executable).with_name("irec-sim")
        command = [str(irec_sim), "session", "--cell", "afp", "--poses", str(N), "--seed", "1", "-o", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=300)
        session = read_session(out)
    terms = blank_model(EIGHTEEN_DOF)
    prepare = best_of(1, lambda: pose_data(session, terms))  # the first time, nothing remembered
    data = pose_data(session, terms)
    observation = observe_with_force_noise(session, terms)
    system = linearise(fit(terms, observation).terms, observation)
    seconds = best_of(5, lambda: run_codec(data))
    codec = run_codec(data)
    lines = [
        Line("observation system of the session, 18 DOF", prepare, "s"),
        Line("CODEC, 31 combinations, COVER, 18 DOF, with the observation system", prepare + seconds, "s", 0.5),
        Line("CODEC, 31 combinations, COVER, 18 DOF, from the observation system on", seconds, "s"),
    ]
    for solver, limit in (("bvls", 20.0), ("trf", None), ("nnls", None)):
        start = time.process_time()
        E, C = codec_by_fresh_solves(system, data, solver)
        fresh = time.process_time() - start
        name = f"lsq_linear {solver}" if solver != "nnls" else "nnls (bound 0 only)"
        lines.append(Line(f"the same, fresh solve of the stack at each step, scipy {name}", fresh, "s"))
        lines.append(Line("  ratio", fresh / seconds, "x", limit))
        lines.append(Line("  largest relative difference of E_mu", float(np.abs(E / codec.E_mean - 1).max()), ""))
        largest = np.abs(C).max(axis=2, keepdims=True)
        apart = float((np.abs(C - codec.C) / largest).max())
        lines.append(Line("  largest difference of a compliance, of the largest", apart, ""))
    for combinations in (8, 16, 31):
        seconds = best_of(5, lambda n=combinations: run_codec(data, combinations=n))
        lines.append(Line(f"CODEC, {combinations} combinations, per combination", 1e3 * seconds / combinations, "ms"))
    many = replace(data, **{name: np.concatenate([getattr(data, name)] * 2) for name in _PER_POSE})
    many = replace(many, points=many.points + 1e-3 * np.random.default_rng(0).normal(size=many.points.shape))
    lines.append(Line("CODEC of 62 poses, 62 combinations", best_of(3, lambda: run_codec(many)), "s"))
    return lines


_PER_POSE = ("A", "y", "seen", "gram", "rhs", "points", "poses", "sigma", "sigma_reference")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="machine-readable")
    args = parser.parse_args()
    one_thread = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
    if not one_thread.items() <= os.environ.items():  # numpy reads them when it is loaded
        return subprocess.run([sys.executable, *sys.argv], env=os.environ | one_thread, check=False).returncode
    lines = bench_selection(read_cell(ROOT / "config" / "cells" / "afp.yaml")) + bench_codec()
    if args.json:
        print(json.dumps([{"name": x.name.strip(), "value": x.value, "unit": x.unit, "limit": x.limit} for x in lines]))
    else:
        print("poses and CODEC, one BLAS thread, processor time")
        print("\n".join(str(x) for x in lines))
        print("lsq_linear trf stops short of the minimum where a single pose leaves combinations open: hence its differences.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
