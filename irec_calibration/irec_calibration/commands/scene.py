# SPDX-License-Identifier: Apache-2.0
"""`irec scene SESSION [--model M] -o scene.mcap`: robot, residuals and surface for Foxglove, RViz and PlotJuggler."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..cell import read_cell
from ..diagnose import compare, solved
from ..diagnose.run import start_terms
from ..effects.of_session import carrying
from ..model.file import check_belongs, load_model
from ..report.scene_file import write_scene
from ..session import read_session
from ..workbench.figures import nice_scale
from ..workbench.view import view_of


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("--model", help="model.yaml whose residuals to draw (default: 18 DOF fitted to the session)")
    parser.add_argument("--cell", help="cell file, for the tooling surface (drawn where base_link is at the rail's zero)")
    parser.add_argument("-o", "--output", default="scene.mcap", help="file to write (default: scene.mcap)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    session = read_session(args.session)
    if args.model:
        model = load_model(args.model)
        check_belongs(model, session.robot, session.serial)
    else:
        model = solved(session, start_terms(session))[0]
    result = compare(carrying(session, model.carried), model.terms, model.sag_share)
    mesh = read_cell(args.cell).surface.mesh() if args.cell else None
    magnify = nice_scale(view_of(session), result.residual)
    surface = (mesh.vertices, mesh.corners) if mesh is not None else None
    count = write_scene(session, result, Path(args.output), magnify=magnify, surface=surface)
    if args.json:
        print(json.dumps({"scene": args.output, "messages": count, "magnify": magnify}))
    else:
        print(f"{count} messages, residuals drawn {magnify:g} times longer than they are; wrote {args.output}")
    return 0
