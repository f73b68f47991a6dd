# SPDX-License-Identifier: Apache-2.0
"""`irec diagnose SESSION [--model M] -o DIR`: compare, where, which in one go; exit code 1 where something is missing."""

from __future__ import annotations

import argparse
import json
import textwrap
from pathlib import Path

from ..diagnose import Diagnosis, diagnose, write_json
from ..diagnose.tables import write_tables
from ..files import all_or_none
from ..identification.validation import ESTIMATOR
from ..report.diagnosis import write_diagnosis_report
from ..report.next_steps import after_diagnosis, in_lines
from ..report.why_named import contradiction
from ._progress import Progress
from ._report import report
from ._session import as_read, configure_plausible, configure_without_tracker, plausible_session, starting_model

SHOWN, WIDTH = 5, 100


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("--model", help="model.yaml whose effects to start from (default: 18 DOF; absolute sessions: geometric)")
    parser.add_argument("-o", "--output", default="diagnosis", help="folder for diagnosis.json and tables (default: diagnosis)")
    configure_plausible(parser)
    configure_without_tracker(parser)
    parser.add_argument("--json", action="store_true", help="diagnosis.json on standard output too")


def run(args: argparse.Namespace) -> int:
    session = as_read(args, plausible_session(args))
    model = starting_model(args, session)
    result = diagnose(session, model, progress=Progress())
    folder = Path(args.output)
    with all_or_none():
        path = write_json(result.to_json(), folder / "diagnosis.json")
        write_tables(result, session, folder)
        files = report(lambda: write_diagnosis_report(result, session, folder, named=(args.session, args.model or "")))
    if args.json:
        print(json.dumps(result.to_json()))
    else:
        print(in_words(result))
        print(f"wrote {path}{', ' + str(files[0]) if files else ''}")
        print(in_lines(after_diagnosis(result, args.session, args.model or "", without_tracker=args.without_tracker)))
    return 0 if result.verdict.status == "adequate" else 1


def in_words(result: Diagnosis) -> str:
    """The diagnosis for a terminal."""
    lines = [textwrap.fill(f"{result.verdict.in_short}: {result.verdict.text}", WIDTH)]
    shown = sorted(result.candidates, key=lambda c: (c.effect not in result.verdict.effects, -c.log_evidence))[:SHOWN]
    if shown:
        lines += ["", f"{'candidate, best evidence first':31} {'trial um':>12} {'+-':>6} {'log odds':>9}  where it acts"]
    for c in shown:
        where = textwrap.shorten(", ".join(c.groups), 36, placeholder=" ..")
        lines.append(f"{c.effect:31} {1e6 * c.cv_rms_m:12.1f} {1e6 * c.cv_rms_se_m:6.1f} {c.log_evidence:9.1f}  {where}".rstrip())
    why = contradiction(shown, result.verdict.effects, result.verdict.one_of)
    lines += [textwrap.fill(text, WIDTH) for text in why]
    lines.append(textwrap.fill(f"estimator: {ESTIMATOR}", WIDTH, subsequent_indent="  "))
    if shown:
        lines.append("trial: held-out error with it, in the linear problem about the model; `irec add` fits it exactly")
    if result.proposals:
        lines += ["", f"{'formula for what has no name':<66}{'held-out um':>12}{'+-':>7}{'log odds':>10}"]
        for p in result.proposals:
            lines.append(f"{p.formula:<66}{p.cv_rms_m * 1e6:>12.1f}{p.cv_rms_se_m * 1e6:>7.1f}{p.log_evidence:>10.1f}")
    seen = [v for v in result.where if v.shows]
    lines.append("")
    lines += [textwrap.fill(f"where: {v.sentence}", WIDTH, subsequent_indent="       ") for v in seen[:SHOWN]]
    lines += [textwrap.fill(f"note: {n}", WIDTH, subsequent_indent="      ") for n in result.notes]
    return "\n".join(lines)
