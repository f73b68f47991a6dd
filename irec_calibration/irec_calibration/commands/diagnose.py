# SPDX-License-Identifier: Apache-2.0
"""`irec diagnose SESSION [--model M] -o DIR`: compare, where, which in one go; exit code 1 where something is missing."""

from __future__ import annotations

import argparse
import json
import textwrap
from pathlib import Path

from ..diagnose import Diagnosis, diagnose, write_json
from ..diagnose.tables import write_tables
from ..model_file import check_belongs, load_model
from ..report.diagnosis import write_diagnosis_report
from ..session import read_session
from ._progress import Progress
from ._report import report

SHOWN = 5


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("--model", help="model.yaml whose effects to start from (default: 18 DOF; absolute sessions: geometric)")
    parser.add_argument("-o", "--output", default="diagnosis", help="folder for diagnosis.json and tables (default: diagnosis)")
    parser.add_argument("--json", action="store_true", help="diagnosis.json on standard output too")


def run(args: argparse.Namespace) -> int:
    session = read_session(args.session)
    model = load_model(args.model) if args.model else None
    if model is not None:
        check_belongs(model, session.robot, session.serial)
    result = diagnose(session, model, progress=Progress())
    folder = Path(args.output)
    path = write_json(result.to_json(), folder / "diagnosis.json")
    write_tables(result, session, folder)
    files = report(lambda: write_diagnosis_report(result, session, folder))
    if args.json:
        print(json.dumps(result.to_json()))
    else:
        print(in_words(result))
        print(f"wrote {path}{', ' + str(files[0]) if files else ''}")
    return 0 if result.verdict.status == "adequate" else 1


def in_words(result: Diagnosis) -> str:
    """The diagnosis for a terminal."""
    lines = [textwrap.fill(f"{result.verdict.status.replace('_', ' ')}: {result.verdict.text}", 110)]
    if result.candidates:
        lines.append(f"{'candidate':24} {'held-out um':>12} {'+-':>6} {'log odds':>9}  parts")
    for c in result.candidates[:SHOWN]:
        lines.append(
            f"{c.effect:24} {1e6 * c.cv_rms_m:12.1f} {1e6 * c.cv_rms_se_m:6.1f} {c.log_evidence:9.1f}  {', '.join(c.groups)}"
        )
    lines += [f"where: {v.sentence}" for v in result.where[:SHOWN] if not v.sentence.startswith("No sign")]
    for m in result.next_measurements[:2]:
        at = f"pose {m.pose}" if m.pose else "new pose at joints " + ", ".join(f"{x:.2f}" for x in m.q)
        lines.append(
            f"measure next: {at}, load case {m.load_case}: parts {' and '.join(m.separates)} by {1e6 * m.difference_m:.0f} um"
        )
    lines += [f"note: {n}" for n in result.notes]
    return "\n".join(lines)
