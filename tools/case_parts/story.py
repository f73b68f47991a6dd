# SPDX-License-Identifier: Apache-2.0
"""A case from calibration to report: calibrate, solve, improve, drive the part, take the error down step by step, say where it
comes from."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.typing import Array
from irec_correction.course_filter import CourseFilter
from irec_correction.fir import TapTable, write_taps
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.errors import SimError
from irec_sim.production.hard import read_hard
from irec_sim.production.runner import Drive
from irec_sim.production.ways import Ways

from . import calibrated, learned
from .axes_filter import Expected, teaching
from .budget import Budget, budget_jobs
from .jobs import Case, Job, load, meanwhile, run_jobs, ways_of
from .left import Left, section, steady_job, what_is_left
from .moving import improved_in_motion
from .numbered import numbered
from .page import LAST, LEARNT, NOT_KEPT, PAPERS, START, Found, write_report
from .posture import posture_section
from .table import Figures, average, figures, in_draws, reduction

FEWEST = 4  # courses
# seeds of the training courses that are driven with the filter learnt on them: other unsteady force than it was learnt from
AGAIN = (5, 6, 7, 8, 9)
DRAWS = (1, 2, 3, 4)  # seeds of further drives: other unsteady force, other noise and drift, the same model


class Teller:
    """Lines with the time since the case began."""

    def __init__(self) -> None:
        self.begun = time.monotonic()

    def __call__(self, text: str) -> None:
        print(f"[{time.monotonic() - self.begun:5.0f} s] {text}", flush=True)

    def shares(self) -> Callable[[float, str], None]:
        """Progress of one long step, told about every tenth."""
        told = [-1.0]

        def progress(share: float, what: str) -> None:
            if share > told[-1] + 0.1:
                told.append(share)
                self(f"~{100 * share:.0f} % {what}")

        return progress


LINKS = "18 DOF, secondary encoders"
CONTACT, CONTACT_DISC = "18 DOF, without the tracker", "the same, its disc measured before"
THROUGH_NODES = "through the nodes: simulated cell on the hard plant, procedure node, session.mcap"
GENERATED = "generated directly from the plant at the planned poses (--no-nodes), not through the nodes"


def run_case(case: Case, processes: int, budget: bool, nodes: bool) -> int:
    """0: within the real cell's bands, 1: outside."""
    say = Teller()
    _state(case, "running")
    sim, cell = read_sim_cell(case.cell_path), read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    ways = ways_of(case, hard)
    rows = courses_of(case, len(ways.names))
    how = THROUGH_NODES if nodes else GENERATED
    say(f"calibrating on the hard plant at the planned poses, {how}")
    draws = {seed: Job(f"without_{seed}", rows, seed=seed) for seed in DRAWS}
    if nodes:
        with meanwhile(case, [Job("without", rows), *draws.values(), Job("oracle", rows, "oracle")]):
            session = calibrated.recorded_session(cell, hard.truth, case.truth_path, case.out / "session", say)
    else:
        session = calibrated.measured_session(sim, cell, hard.truth, case.out / "session")
    six, eighteen = calibrated.six(session, case.out), calibrated.eighteen(session, case.out)
    say(f"6 DOF leave {_um(six)} um on held-out poses, 18 DOF {_um(eighteen)} um")
    behind = calibrated.link_session(sim, cell, hard.truth, case.out / "session_links")
    calibrated.beyond_links(behind, case.out)
    held = calibrated.by_contact(session, case.out)
    calibrated.by_contact(session, case.out, calibrated.DISC)
    say(f"without the tracker: {' + '.join(held.effects)}, {_um(held)} um on held-out poses, mostly along the normal")
    plan = budget_jobs(case, say) if budget else None
    models = {k: str(case.out / f"model_{k}.yaml") for k in ("6dof", "18dof", "improved", "contact", "contact_disc")}
    whole = {
        "without": Job("without", rows),
        "18 DOF": Job("18dof", rows, models["18dof"]),
        "improved": Job("improved", rows, models["improved"]),
        "6 DOF": Job("6dof", rows, models["6dof"]),
        LINKS: Job("links", rows, str(case.out / "model_links.yaml"), links=True),
        CONTACT: Job("contact", rows, models["contact"]),
        CONTACT_DISC: Job("contact_disc", rows, models["contact_disc"]),
        "oracle": Job("oracle", rows, "oracle"),
    }
    corrected = {seed: replace(whole["18 DOF"], name=f"18dof_{seed}", seed=seed) for seed in DRAWS}
    jobs = [*whole.values(), *draws.values(), *corrected.values(), *(plan.jobs if plan else [])]
    say(f"diagnosing and improving; meanwhile driving {len(rows)} courses without and with correction")
    with meanwhile(case, [job for job in jobs if job.model != models["improved"]]):
        best = calibrated.improved(session, case.out, say.shares())
    say(f"improved: {' + '.join(best.effects)}, {_um(best)} um on held-out poses")
    run_jobs(case, jobs, say, processes)
    say("learning on every second course: the arm in motion, latency, force profile, answer of arm and drives, filter")
    ladder, told = _ladder(case, ways, rows, whole, list(draws.values()), say, processes)
    rungs = {name: _in_all_draws(job) for name, job in ladder.items()}
    rungs[NOT_KEPT] = rungs.pop(NOT_KEPT)[:1]  # the last line of the table
    run_jobs(case, [*(job for jobs in rungs.values() for job in jobs), steady_job(ladder[LAST])], say, processes)
    rungs = {
        START: [whole["without"], *draws.values()],
        PAPERS: [whole["18 DOF"], *corrected.values()],
        **rungs,
    }  # driven with all courses already
    say("drawing the figures")
    left = what_is_left(case, ladder[LAST], cell.tolerance)
    before, after = ([figures(load(case, j)[0], cell.tolerance) for j in jobs] for jobs in (
        (whole["without"], *draws.values()), (whole["18 DOF"], *corrected.values())
    ))  # fmt: skip
    drawn = in_draws(case.name, before, after)
    found = _collect(case, rows, whole, rungs, told, hard, plan.of(case, cell.tolerance) if plan else None, how, drawn, processes)
    found.numbered.insert(0, section(left, found.rungs[START][0]))
    report = write_report(found, case.out)
    _finish(case, found, left, say, report)
    return 1 if found.outside else 0


def _in_all_draws(job: Job) -> list[Job]:
    return [job, *(replace(job, name=f"{job.name}_{seed}", seed=seed) for seed in DRAWS)]


def courses_of(case: Case, count: int) -> tuple[int, ...]:
    """Courses that are driven, of `count`. Raises SimError: too few."""
    rows = tuple(range(0, count, case.every))
    if len(rows) < FEWEST:
        raise SimError(
            f"--every {case.every} leaves {len(rows)} of {count} courses; {FEWEST} are needed, half of them to learn "
            f"from and half to judge on: use --every {(count - 1) // (FEWEST - 1)} or less"
        )
    return rows


def _um(model) -> str:  # type: ignore[no-untyped-def]
    return f"{1e6 * model.figures['cv_rms_m']:.0f}"


def _state(case: Case, state: str) -> None:
    (case.out / "state.json").write_text(json.dumps({"case": case.name, "state": state}) + "\n", encoding="utf-8")


def _ladder(
    case: Case, ways: Ways, rows: tuple[int, ...], whole: dict[str, Job], again: list[Job], say: Teller, processes: int
) -> tuple[dict[str, Job], dict[str, object]]:
    """Jobs on the held-out courses, each with what the one before has and one thing more; and what was learnt.

    again: drives without correction with other noise and other drift: the filters have many numbers to learn.
    """
    held_out = tuple(rows[1::2])
    jobs = {
        "+ static effects (improve)": Job("ladder_1", held_out, whole["improved"].model),
        "+ force sensor zeroed before each course": Job("ladder_zeroed", held_out, whole["improved"].model, zeroed=True),
    }
    # these two wait for nothing, and learning keeps one processor busy for most of the time
    with meanwhile(case, [one for job in jobs.values() for one in _in_all_draws(job)], gently=False):
        return _learnt(case, ways, rows, jobs, whole, again, say, processes)


def _learnt(
    case: Case, ways: Ways, rows: tuple[int, ...], jobs: dict[str, Job], whole: dict[str, Job], again: list[Job], say: Teller,
    processes: int,
) -> tuple[dict[str, Job], dict[str, object]]:  # fmt: skip
    """The further rows of the ladder, by what the training courses tell, and that."""
    train, held_out = np.arange(0, len(rows), 2), np.arange(1, len(rows), 2)
    moving = improved_in_motion(case, [whole["without"], *again], train, say.shares())
    say(f"in motion: {' + '.join(moving.effects)}, {_um(moving)} um on held-out places of the training courses")
    drive = load(case, whole["improved"])[0].zeroed
    latency, bag = learned.latency_of(case, drive, train)
    lead = learned.lead_of(case, latency)
    without = [load(case, j)[0].zeroed for j in (whole["without"], *again)]
    profile = learned.profile_of(without, train)
    force, noise = learned.unsteady(case, drive, train, profile)
    driven = ways.only(np.array(rows))
    shaken, swept = learned.shaken_at(case, driven, train, processes)
    plain, shaped = learned.designs(case, force, noise, lead, shaken)
    slack = round(min(2.0 * profile.spread, 0.2), 4)
    known = Expected({driven.names[i]: learned.expected(profile, driven, i, smooth=True) for i in train}, lead, slack)
    some, taught = (tuple(int(rows[i]) for i in part) for part in (held_out, train))
    path, to_teach = (
        learned.write_profiles(profile, ways.only(np.array(part)), np.array(part), case.out / f"{name}.npz")
        for name, part in (("profiles", some), ("profiles_training", taught))
    )
    ahead = float(min(latency.delay, 0.1))
    moved = Job("ladder_2", some, str(case.out / "model_moving.yaml"), zeroed=True)
    expecting = replace(moved, name="ladder_3", profiles=str(path), ahead=ahead, slack=slack)
    filtering = replace(expecting, name="ladder_4", taps=_taps(plain.taps), ahead=lead)
    undoing = replace(filtering, name="ladder_5", taps=_taps(shaped.taps))
    teach = replace(undoing, rows=taught, profiles=str(to_teach), taps=(), brisk=True)
    jobs |= {
        "+ the arm measured in motion (improve)": moved,
        NOT_KEPT: replace(moved, name="ladder_lead", lead=ahead),
        "+ known force profile": expecting,
        "+ filter for the measured spectrum": filtering,
        "+ answer of arm and drives undone": undoing,
    }
    # learning keeps one processor busy, and these wait for nothing
    beside = [one for job in (moved, expecting, filtering, undoing) for one in _in_all_draws(job)]
    with meanwhile(case, beside, gently=False):
        uncorrected = teaching(case, moving, [(drive, train) for drive in without], swept, known)
        own = uncorrected.learnt()
        table = str(_written(case, "filter.csv", own, uncorrected.postures))
        say("learning once more on training courses that are corrected with what was learnt")
        taught_again = [replace(teach, name=f"training_{seed}", seed=seed, filter_file=table) for seed in AGAIN]
        run_jobs(case, taught_again, say, processes)
        corrected = [(load(case, job)[0].zeroed, np.arange(len(taught))) for job in taught_again]
        once_more = teaching(case, moving, corrected, swept, known, uncorrected).learnt()
    again_table = str(_written(case, "filter_again.csv", once_more, uncorrected.postures))
    jobs[LEARNT] = replace(undoing, name="ladder_6", taps=(), filter_file=table, brisk=True)
    jobs[LAST] = replace(jobs[LEARNT], name="ladder_7", filter_file=again_table)
    told = {
        "latency": latency,
        "bag": bag,
        "lead": lead,
        "noise": noise,
        "shaken": shaken,
        "swept": len(swept.postures),
        "plain": plain,
        "shaped": shaped,
        "own": own,
        "once_more": once_more,
        "again": len(AGAIN),
        "slack": slack,
        "profile": profile,
        "moving": moving,
    }
    return jobs, told


def _written(case: Case, name: str, found: CourseFilter, postures: Array) -> Path:
    write_taps(case.out / name, TapTable(found.taps, postures, read_cell(case.cell_path).robot.joint_names))
    return case.out / name


def _taps(taps) -> tuple[float, ...]:  # type: ignore[no-untyped-def]
    return tuple(float(f"{x:.9g}") for x in taps / taps.sum())


def _collect(case, rows, whole, ladder, told, hard, budget: Budget | None, how: str, drawn, processes: int) -> Found:  # type: ignore[no-untyped-def]
    tolerance = read_cell(case.cell_path).tolerance
    drives = {name: load(case, job) for name, job in whole.items()}
    table: dict[str, Figures] = {name: figures(d, tolerance) for name, (d, _) in drives.items()}
    held_out = np.arange(1, len(rows), 2)
    rungs = {name: [figures(_on(case, job, held_out), tolerance) for job in jobs] for name, jobs in ladder.items()}
    steps = {name: load(case, jobs[0])[1] for name, jobs in ladder.items()}
    sections = numbered(case, processes)
    if case.name == "machining":
        sections.append(posture_section(case, ways_of(case, hard).only(np.array(rows)[held_out]), told["profile"]))
    return Found(
        case.name,
        tolerance,
        {n: d for n, (d, _) in drives.items()},
        table,
        rungs,
        {**{n: t for n, (_, t) in drives.items()}, **steps},
        told,
        hard,
        budget,
        drawn,
        sections,
        how,
    )


def _on(case: Case, job: Job, held_out: Array) -> Drive:
    """Record of a job on the held-out courses; held_out: their numbers among those that the case drives."""
    drive = load(case, job)[0]
    return drive if len(job.rows) == len(held_out) else drive.only(held_out)


def _finish(case: Case, found: Found, left: Left, say: Teller, report: Path) -> None:
    before = found.table["without"]
    print(f"\n  {'mm':34} {'mean':>8} {'max':>8} {'std':>8}   reduction of mean, max, std (%)   inside")
    for name, f in found.table.items():
        cut = "" if name == "without" else "{:8.1f} {:8.1f} {:8.1f}".format(*reduction(before, f))
        print(f"  {name:34} {f.mean:8.3f} {f.max:8.3f} {f.std:8.3f}   {cut:27}   {100 * f.inside:12.1f} %")
    print(f"  on courses that nothing was learnt from, mean of {1 + len(DRAWS)} draws: mean, maximum, reduction of mean, maximum")
    for name, draws in found.rungs.items():
        f, cut = average(draws), ", ".join(d.short for d in found.cuts(name))
        print(f"  {name:45} {f.mean:8.3f} {f.max:8.3f}   {'' if name == START else cut}")
    print("  what is left on the last row of the ladder, mean and maximum:")
    for name, (mean, largest) in left.parts.items():
        print(f"  {name:50} {mean:8.3f} {largest:8.3f}")
    for drawn in found.drawn:
        print(f"  {drawn.told}")
    for text in found.outside:
        print(f"  this plant is outside the real cell's bands: {text}")
    summary = {
        "format": "irec-case/1",
        "case": case.name,
        "calibrated": found.calibrated,
        "table": {n: asdict(f) for n, f in found.table.items()},
        "ladder": {n: [asdict(f) for f in draws] for n, draws in found.rungs.items()},
        "outside_bands": found.outside,
        "draws": [asdict(d) for d in found.drawn],
        "last_rung_reduction": [asdict(d) for d in found.cuts(LAST)],
        "left_mm": left.parts,
        "left_without_common_mm": (left.own.mean, left.own.max),
        "budget_mm": found.budget.parts if found.budget else None,
        "wall_s": round(time.monotonic() - say.begun, 1),
    }
    (case.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    _state(case, "done")
    say(f"report: {report}")
