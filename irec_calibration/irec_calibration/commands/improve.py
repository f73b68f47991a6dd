# SPDX-License-Identifier: Apache-2.0
"""`irec improve SESSION -o DIR`: add effects one at a time as long as the evidence justifies it."""

from __future__ import annotations

import argparse
import json
import textwrap
from pathlib import Path

from ..diagnose import Ladder, improve, write_json
from ..diagnose.tables import write_tables
from ..files import all_or_none, check_no_input
from ..identification.validation import ESTIMATOR
from ..model.file import check_model_target, save_model
from ..report import course
from ..report.course import course_section, drive
from ..report.ladder import write_ladder_report
from ..report.next_steps import after_improvement, in_lines
from ._expected_error import expected_in_words
from ._progress import Progress
from ._report import report
from ._session import as_read, configure_plausible, configure_without_tracker, plausible_session, starting_model


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("--model", help="model.yaml whose effects to start from (default: 18 DOF; absolute sessions: geometric)")
    parser.add_argument(
        "-o", "--output", default="improved", help="folder for model.yaml, ladder.json, diagnosis.json (default: improved)"
    )
    parser.add_argument("--cell", default="", help="cell file: its process course as predicted before and after")
    configure_plausible(parser)
    configure_without_tracker(parser)
    parser.add_argument("--json", action="store_true", help="ladder.json on standard output too")


def run(args: argparse.Namespace) -> int:
    target = check_model_target(Path(args.output) / "model.yaml")
    check_no_input(target, (args.model,))
    session = as_read(args, plausible_session(args))
    model = starting_model(args, session)
    ladder = improve(session, model, progress=Progress())
    folder = Path(args.output)
    driven = drive(args.cell, session, ladder.rungs[0].model, ladder.model)
    with all_or_none():
        path = save_model(ladder.model, folder / "model.yaml")
        write_json(ladder.to_json(), folder / "ladder.json")
        write_json(ladder.before.to_json(), folder / "diagnosis.json")
        write_tables(ladder.before, session, folder)
        named = (args.session, str(path))
        files = report(lambda: write_ladder_report(ladder, session, folder, tuple(course_section(driven, folder)), named=named))
    if args.json:
        print(json.dumps(ladder.to_json()))
    else:
        print(in_words(ladder))
        if driven:
            print(course.in_words(driven))
        print(f"wrote {path}, ladder.json, diagnosis.json{', ' + files[0].name if files else ''}")
        print(in_lines(after_improvement(ladder, args.session, str(path), without_tracker=args.without_tracker)))
    return 0


def in_words(ladder: Ladder) -> str:
    """The ladder for a terminal."""
    lines = [f"{'model':40} {'held-out um':>12} {'+-':>6} {'fit um':>8}"]
    for r in ladder.rungs:
        lines.append(f"{r.title:40} {1e6 * r.cv_rms_m:12.1f} {1e6 * r.cv_rms_se_m:6.1f} {1e6 * r.fit_rms_m:8.1f}")
    lines.append(f"{'noise floor':40} {1e6 * ladder.noise_floor_m:12.1f}")
    if any(r.one_of for r in ladder.rungs):
        lines.append("or: these data do not tell which it is; the model has the first")
    if any(r.usual for r in ladder.rungs):
        lines.append("(usual): of a size that every robot has; no cause to look for")
    if any(r.stands_in for r in ladder.rungs):
        lines.append("(no name): predicts structure that no effect can be named for; it is no diagnosis")
    lines += [textwrap.fill(where, 100, subsequent_indent="  ") for where in ladder.before.verdict.where.values()]
    lines.append(f"stopped: {ladder.stopped}")
    lines += expected_in_words(ladder.model)
    if ladder.model.made.get("caution"):
        lines.append(textwrap.fill(f"caution: {ladder.model.made['caution']}", 100, subsequent_indent="  "))
    lines.append(textwrap.fill(f"estimator: {ESTIMATOR}", 100, subsequent_indent="  "))
    return "\n".join(lines)
