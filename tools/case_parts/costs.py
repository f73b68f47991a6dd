# SPDX-License-Identifier: Apache-2.0
"""What each cause of the hard plant costs alone: an elastic plant under the same process, with that cause and no other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from irec_calibration.cell import read_cell
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.production.hard import CAUSES, read_hard, without

from .calibrated import eighteen, measured_session
from .jobs import Case, Job, load, run_jobs, ways_of
from .table import figures, reduction


def few_courses(case: Case, count: int = 4) -> tuple[int, ...]:
    """Some courses from all over the part."""
    sim = read_sim_cell(case.cell_path)
    n = len(ways_of(case, read_hard(case.truth_path, sim)).names)
    return tuple(int(i) for i in np.unique(np.linspace(1, n - 2, count).astype(int)))


def model_without(case: Case, off: tuple[str, ...]) -> str:
    """18-DOF model of a session measured on the plant without these causes."""
    sim, cell = read_sim_cell(case.cell_path), read_cell(case.cell_path)
    hard = without(read_hard(case.truth_path, sim), *off)
    name = "variant_" + ("none" if not off else "_".join(str(list(CAUSES).index(c)) for c in sorted(off, key=list(CAUSES).index)))
    folder = case.out / "variants" / name
    folder.mkdir(parents=True, exist_ok=True)
    session = measured_session(sim, cell, hard.truth, folder / "session")
    eighteen(session, folder)
    return str(folder / "model_18dof.yaml")


def print_costs(case: Case, processes: int) -> None:
    """The table, as Markdown."""
    rows, process = few_courses(case, 2), "unsteady process force"
    plans: list[tuple[str, tuple[str, ...]]] = [("nothing: an elastic plant", tuple(c for c in CAUSES if c != process))]
    plans += [(cause, tuple(c for c in CAUSES if c not in (cause, process))) for cause in CAUSES if cause != process]
    plans.append(("all of them", ()))
    jobs: list[tuple[str, Job, Job]] = []
    for k, (name, off) in enumerate(plans):
        model = model_without(case, off)
        print(f"calibrated on: {name}", flush=True)
        without_correction = Job(f"cost_{k}_without", rows, off=off)
        jobs.append((name, without_correction, replace(without_correction, name=f"cost_{k}_with", model=model)))
    run_jobs(case, [j for _, a, b in jobs for j in (a, b)], lambda text: print(text, flush=True), processes)
    cell = read_cell(case.cell_path)
    print("\n| cause | before: mean, max (mm) | with 18 DOF: mean, max (mm) | reduction of mean, max (%) |\n|---|---|---|---|")
    for name, first, second in jobs:
        a, b = (figures(load(case, j)[0], cell.tolerance) for j in (first, second))
        cut = reduction(a, b)
        print(f"| {name} | {a.mean:.3f}, {a.max:.3f} | {b.mean:.3f}, {b.max:.3f} | {cut[0]:.1f}, {cut[1]:.1f} |")
