# SPDX-License-Identifier: Apache-2.0
"""`make demo-hidden`: a cell with an effect that the 18-DOF model lacks. Calibrate, see where the model fails, learn which
effect is missing, add it, watch the error fall, and drive the loaded course without correction, with the old and with the
new model.

Only the simulated cell reads the truth file. Results go to out/demo-hidden: report.html tells the story.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import textwrap
from pathlib import Path
from typing import Any

import demo
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.model.file import save_model
from irec_calibration.session import read_session

OUT = demo.ROOT / "out" / "demo-hidden"
TRUTH = demo.ROOT / "config" / "truths" / "demo_hidden.yaml"
RUNS = {"without": "no correction", "old": "18-DOF model", "new": "improved model"}


def main() -> int:
    """Run the story; 0 if it went through, 2 if not."""
    parser = argparse.ArgumentParser(
        description="Find a hidden effect of the simulated AFP cell, add it, drive the course again."
    )
    parser.add_argument("--out", type=Path, default=OUT, help="folder for results (default: out/demo-hidden)")
    parser.add_argument("--cell", type=Path, default=demo.ROOT / "config" / "cells" / "afp.yaml", help="cell file")
    parser.add_argument("--truth", type=Path, default=TRUTH, help="truth file, read by the simulated cell only")
    parser.add_argument("--poses", type=int, default=demo.N_POSES, help=f"number of engagement poses (default: {demo.N_POSES})")
    parser.add_argument(
        "--speed", type=float, default=demo.SPEED, help=f"simulated seconds per second, at most (default: {demo.SPEED:g})"
    )
    return demo.guarded(parser.parse_args(), _run)


def _run(args: argparse.Namespace) -> None:
    from demo_parts.operator import Operator
    from demo_parts.processes import Processes
    from demo_parts.progress import Progress

    out: Path = args.out
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    progress = Progress()
    progress.stage("plan", f"planning {args.poses} engagement poses on the mould")
    poses = demo.plan_poses(args, out)
    progress.stage("start", "starting a simulated cell that hides something, procedure, calibration and recorder")
    with Processes(out / "log", {}) as processes:
        demo.start_nodes(processes, args, out, truth=str(args.truth))
        operator = Operator(processes.check)
        try:
            made = demo.calibrate(operator, progress, args, out, poses)
            ladder, session = _improve(made, out, progress)
            progress.stage("course", "driving the loaded course: without correction, with the old and the new model")
            demo.start_correction(processes, args)
            models = {"without": None, "old": made["models"]["18 DOF"][0], "new": out / "model_improved.yaml"}
            courses = demo.drive(operator, progress, args, out, models)
        finally:
            operator.close()
    _print_result(args, out, ladder, session, courses, progress)


def _improve(made: dict[str, Any], out: Path, progress: Any) -> tuple[Any, Any]:
    """Diagnose the session and add what the evidence justifies; leaves the diagnosis' report and the improved model."""
    from irec_calibration.diagnose import improve, write_json
    from irec_calibration.report.diagnosis import write_diagnosis_report

    progress.stage("diagnose", "where does the model fail, and which effect is missing?")
    session = read_session(made["session"])
    ladder = improve(session, progress=lambda share, what: progress.update(f"{100 * share:.0f} %  {what}"))
    write_diagnosis_report(ladder.before, session, out / "diagnosis")
    write_json(ladder.before.to_json(), out / "diagnosis.json")
    write_json(ladder.to_json(), out / "ladder.json")
    save_model(ladder.model, out / "model_improved.yaml")
    for line in textwrap.wrap(f"{ladder.before.verdict.status.replace('_', ' ')}: {ladder.before.verdict.text}", 105):
        progress.say(line)
    return ladder, session


def _print_result(
    args: argparse.Namespace, out: Path, ladder: Any, session: Any, courses: dict[str, Path], progress: Any
) -> None:
    from demo_parts.course import figures_mm, read_course, reduction_percent
    from irec_calibration.report.ladder import write_ladder_report
    from irec_calibration.report.models import course
    from irec_calibration.report.page import Figure, Section, Table

    progress.stage("figures", "drawing figures")
    cell = read_cell(args.cell)
    driven = {name: read_course(path) for name, path in courses.items()}
    deviation = {name: figures_mm(c.lateral) for name, c in driven.items()}
    total = {name: figures_mm(c.total) for name, c in driven.items()}
    figure = course(
        {RUNS[n]: c.way for n, c in driven.items()}, {RUNS[n]: abs(c.lateral) for n, c in driven.items()}, cell.tolerance,
        out / "course.png", title="Lateral deviation along the loaded course",
    )  # fmt: skip
    rows = [[RUNS[n], *(f"{deviation[n][k]:.3f}" for k in ("mean", "max", "std")),
             *(f"{total[n][k]:.3f}" for k in ("mean", "max"))] for n in RUNS]  # fmt: skip
    header = ["run", "lateral mean [mm]", "max", "std", "total mean [mm]", "max"]
    section = Section(
        "The course driven again",
        ["The same loaded course on the same cell; its poses were not used for calibration."],
        [Figure(figure, "Absolute lateral deviation of the physical TCP from the commanded course.")],
        [Table(header, rows)],
    )
    files = write_ladder_report(ladder, session, out, (section,))
    summary = {
        "format": "irec-summary/1",
        "cell": cell.name,
        "deviation_mm": {"without": deviation["without"], "with": deviation["new"], "with_old_model": deviation["old"]},
        "total_deviation_mm": {"without": total["without"], "with": total["new"], "with_old_model": total["old"]},
        "reduction_percent": reduction_percent(deviation["without"], deviation["new"]),
        "calibration": {
            "poses": len(session.poses),
            "load_cases": len(cell.forces_in_tool),
            "residual_rms_m": ladder.rungs[-1].fit_rms_m,
            "noise_floor_m": ladder.noise_floor_m,
        },
        "verdict": {
            "status": ladder.before.verdict.status,
            "effects": list(ladder.before.verdict.effects),
            "proven": {e: list(p.proven) for e, p in ladder.before.verdict.parts.items()},
        },
        "wall_s": progress.finish(),
        "files": {
            p.stem: os.path.relpath(p, out)
            for p in (*files, out / "model_improved.yaml", out / "model.yaml", out / "session.mcap")
        },
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(f"\n  {'held-out error':34} {'um':>8}")
    for r in ladder.rungs:
        print(f"  {r.title:34} {1e6 * r.cv_rms_m:8.1f}")
    print(f"  {'noise of the instruments':34} {1e6 * ladder.noise_floor_m:8.1f}\n")
    print(f"  {'lateral deviation on the course':34} {'mean':>8} {'max':>8} {'std':>8}  [mm]")
    for row in rows:
        print(f"  {row[0]:34} {row[1]:>8} {row[2]:>8} {row[3]:>8}")
    print(f"\n  results in {out}: report.html, diagnosis/report.html, model_improved.yaml, summary.json")


if __name__ == "__main__":
    try:
        sys.exit(main())
    except IrecError as error:
        print(f"\ndemo-hidden: {error}", file=sys.stderr)
        sys.exit(2)
