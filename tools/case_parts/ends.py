# SPDX-License-Identifier: Apache-2.0
"""What the plant of fibre placement would do at the other end of those assumptions whose value was chosen within a range."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from irec_calibration.cell import read_cell
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.production.hard import read_hard

from . import calibrated
from .jobs import Case, Job, kept_ways, load, run_jobs, ways_of
from .table import Drawn, figures, in_draws, line, markdown

SEEDS = (0, 1, 2, 3, 4)
FIRST, APART = 2, 4  # every fourth course, from T_3
ARC_MINUTE = 2.909e-4  # rad


def _widest(truth: dict[str, Any]) -> None:
    """One arc minute in the cycloidal gear of axis 1, three in the gear trains of the wrist."""
    for effect in truth["effects"]:
        if effect["effect"] == "joint_backlash":
            effect["parameters"]["width"] = ARC_MINUTE * (1.0 if effect["parameters"]["joint"] == 1 else 3.0)


def _middle(truth: dict[str, Any]) -> None:
    for effect in truth["effects"]:
        if effect["effect"] == "joint_backlash":
            effect["parameters"]["width"] = 1.2e-4 if effect["parameters"]["joint"] == 1 else 4.0e-4


def _pulse(truth: dict[str, Any]) -> None:
    truth["dynamics"]["process"]["pulse"] = [-30.0, -35.0, 40.0]


ENDS: dict[str, Callable[[dict[str, Any]], None]] = {
    "as it is": lambda truth: None,
    "a pulse of 30, 35, 40 N where tapes are started and cut": _pulse,
    "play A1 0.12, A4 and A5 0.4 mrad": _middle,
    "play A1 0.29, A4 and A5 0.87 mrad": _widest,
}


def at_end(case: Case, name: str) -> Case:
    """The same part on a plant with this assumption; results in a folder of its own."""
    truth = yaml.safe_load(case.truth_path.read_text(encoding="utf-8"))
    ENDS[name](truth)
    folder = case.out / "ends" / str(list(ENDS).index(name))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "truth.yaml"
    path.write_text(yaml.safe_dump(truth, sort_keys=False), encoding="utf-8")
    other = replace(case, out=folder, truth=path)
    if kept_ways(case).is_file() and not kept_ways(other).is_file():  # its courses are the same
        shutil.copy(kept_ways(case), kept_ways(other))
    return other


def print_ends(case: Case, processes: int) -> None:
    """The table, as Markdown."""
    ways_of(case, read_hard(case.truth_path, read_sim_cell(case.cell_path)))
    rows = []
    for name in ENDS:
        print(name, flush=True)
        drawn = drawn_at(at_end(case, name), processes, lambda text: print(text, flush=True))
        rows.append(line(name, [d.short for d in drawn]))
    markdown(f"Every {APART}th course, generated, {len(SEEDS)} draws", "before: mean, maximum, less by: mean, maximum", rows)


def drawn_at(case: Case, processes: int, say: Callable[[str], None]) -> list[Drawn]:
    """What the bands are about, of a session generated directly and five draws of every fourth course."""
    sim, cell = read_sim_cell(case.cell_path), read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    calibrated.eighteen(calibrated.measured_session(sim, cell, hard.truth, case.out / "session"), case.out)
    rows = tuple(range(FIRST, len(ways_of(case, hard).names), APART))
    model = str(Path(case.out) / "model_18dof.yaml")
    without = [Job(f"without_{seed}", rows, seed=seed) for seed in SEEDS]
    corrected = [Job(f"18dof_{seed}", rows, model, seed=seed) for seed in SEEDS]
    run_jobs(case, [*without, *corrected], say, processes)
    before, after = ([figures(load(case, j)[0], cell.tolerance) for j in jobs] for jobs in (without, corrected))
    return in_draws(case.name, before, after)
