# SPDX-License-Identifier: Apache-2.0
"""`irec report SESSION [--model M] [-o DIR]`: the page that people print: verdict, one figure, what to do next; then evidence."""

from __future__ import annotations

import argparse
import importlib.util
import json
from pathlib import Path

from ..diagnose import Diagnosis, diagnose, write_json
from ..diagnose.tables import write_tables
from ..errors import IrecError
from ..files import all_or_none
from ..report.course import course_section, drive, in_words, with_named_effects
from ..report.diagnosis import write_diagnosis_report
from ..report.next_steps import after_diagnosis, in_lines
from ..report.page import Section
from ..session import Session, read_session
from ._progress import Progress
from ._session import starting_model


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("--model", help="model.yaml whose effects to report on (default: 18 DOF; absolute sessions: geometric)")
    parser.add_argument("-o", "--output", default="report", help="folder for report.html, its figures and diagnosis.json")
    parser.add_argument("--cell", default="", help="cell file: its process course as predicted without and with correction")
    parser.add_argument("--plain", action="store_true", help="no figure to turn: a smaller page without scripts")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    session = read_session(args.session)
    model = starting_model(args, session)
    if missing := [m for m in ("matplotlib", "jinja2") if importlib.util.find_spec(m) is None]:
        raise IrecError(f"a report needs {' and '.join(missing)}: pip install 'irec_calibration[report]'")
    result = diagnose(session, model, progress=Progress())
    folder = Path(args.output)
    driven = drive(args.cell, session, result.model, with_named_effects(result, session)) if args.cell else ""
    with all_or_none():
        write_json(result.to_json(), folder / "diagnosis.json")
        write_tables(result, session, folder)
        more = course_section(driven, folder)
        more += [] if args.plain else turnable(result, session)
        files = write_diagnosis_report(result, session, folder, named=(args.session, args.model or ""), more=more)
    if args.json:
        said = {"report": str(files[0]), "verdict": result.verdict.status, "effects": list(result.verdict.effects)}
        print(json.dumps({**said, "files": [str(f) for f in files]}))
    else:
        print(f"{result.verdict.in_short}; wrote {files[0]}")
        if driven:
            print(in_words(driven))
        print(in_lines(after_diagnosis(result, args.session, args.model or "")))
    return 0


def turnable(result: Diagnosis, session: Session) -> list[Section]:
    """The cell in 3D with the residuals, to turn and to point at; plotly goes into the page. Nothing where plotly is missing."""
    if importlib.util.find_spec("plotly") is None:
        return []
    from plotly.offline import get_plotlyjs

    from ..workbench.cell_picture import cell_of

    figure = json.dumps(cell_of(result, session), allow_nan=False).replace("</", "<\\/")
    script = f"Plotly.newPlot('cell', {figure});"
    html = f'<div id="cell" style="height: 34rem"></div><script>{get_plotlyjs()}</script><script>{script}</script>'
    text = "Turn it with the mouse, point at a sample to read its pose, load case and residual. It is not printed."
    return [Section("The cell, to turn", [text], html=html)]
