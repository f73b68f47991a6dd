# SPDX-License-Identifier: Apache-2.0
"""The tables of docs/case-studies.md: from the summaries of both cases, and from drives with models of a session that was
generated directly in place of the nodes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.production.hard import read_hard

from . import calibrated
from .ends import print_ends
from .jobs import Case, Job, load, run_jobs, ways_of
from .page import START
from .story import CONTACT, CONTACT_DISC, DRAWS, courses_of
from .table import Drawn, Figures, cuts_in_draws, figures, in_draws, line, markdown, reduction

CALLED = {"afp": "fibre placement", "machining": "roughing"}


def print_tables(cases: Sequence[Case], processes: int) -> None:
    """All of them, as Markdown; raises IrecError where a case is not done."""
    done = {case.name: _summary(case) for case in cases}
    rows: dict[str, list[str]] = {"bands": [], "tracker": []}
    for case in cases:
        summary, name = done[case.name], CALLED[case.name]
        nodes = f"{name}, through the nodes" if "through the nodes:" in summary["calibrated"] else f"{name}, generated (the case)"
        table = {k: Figures(**f) for k, f in summary["table"].items()}
        rows["bands"].append(line(nodes, [Drawn(**d).short for d in summary["draws"]]))
        rows["tracker"].append(line(nodes, [_cut(table["without"], table[k]) for k in ("18 DOF", CONTACT, CONTACT_DISC)]))
        drawn, pairs = _generated(case, processes)
        rows["bands"].append(line(f"{name}, generated", [d.short for d in drawn]))
        rows["tracker"].append(line(f"{name}, generated", pairs))
    markdown("What the 18 DOF of the paper leave, five draws", "before: mean, maximum, less by: mean, maximum", rows["bands"])
    markdown("Without the tracker: mean, maximum less by", "with tracker, without, without with disc measured", rows["tracker"])
    for case in cases:
        if case.name == "afp":
            print_ends(case, processes)
    markdown("The ladder: mean, maximum less by", ", ".join(CALLED[c.name] for c in cases), _ladder(done))


def _say(text: str) -> None:
    print(text, flush=True)


def _summary(case: Case) -> dict[str, Any]:
    path = case.out / "summary.json"
    if not path.is_file():
        raise IrecError(f"{path} is not there; run make case-{case.name} first")
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def _generated(case: Case, processes: int) -> tuple[list[Drawn], list[str]]:
    """Bands, and reductions with and without the tracker, by models of a session generated directly from the plant."""
    sim, cell = read_sim_cell(case.cell_path), read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    folder = case.out / "generated"
    folder.mkdir(exist_ok=True)
    session = calibrated.measured_session(sim, cell, hard.truth, folder / "session")
    calibrated.eighteen(session, folder)
    calibrated.by_contact(session, folder)
    calibrated.by_contact(session, folder, calibrated.DISC)
    rows = courses_of(case, len(ways_of(case, hard).names))
    model = str(folder / "model_18dof.yaml")
    without = [Job("without" + (f"_{seed}" if seed else ""), rows, seed=seed) for seed in (0, *DRAWS)]
    corrected = [replace(job, name=f"generated_18dof_{job.seed}", model=model) for job in without]
    held = [Job(f"generated_{k}", rows, str(folder / f"model_{k}.yaml")) for k in ("contact", "contact_disc")]
    run_jobs(case, [*without, *corrected, *held], _say, processes)
    before, after, other = (
        [figures(load(case, j)[0], cell.tolerance) for j in jobs] for jobs in (without, corrected, held)
    )  # fmt: skip
    return in_draws(case.name, before, after), [_cut(before[0], f) for f in (after[0], *other)]


def _cut(before: Figures, after: Figures) -> str:
    mean, largest, _ = reduction(before, after)
    return f"{mean:.1f} %, {largest:.1f} %"


def _ladder(done: dict[str, dict[str, Any]]) -> list[str]:
    """Rows of the ladder, means over the draws; done: summaries by the name of the case."""
    steps = list(dict.fromkeys(step for summary in done.values() for step in summary["ladder"] if step != START))
    out = []
    for step in steps:
        cells = []
        for name, summary in done.items():
            ladder = {k: [Figures(**f) for f in draws] for k, draws in summary["ladder"].items()}
            told = cuts_in_draws(name, ladder[START], ladder[step]) if step in ladder else ()
            cells.append(", ".join(d.short for d in told))
        out.append(line(step, cells))
    return out
