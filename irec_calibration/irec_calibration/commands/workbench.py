# SPDX-License-Identifier: Apache-2.0
"""`irec workbench [SESSION] [MODEL]`: a local page to see where a model fails, try effects and watch the error fall."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import IrecError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", nargs="?", default="", help="session to open (default: the page asks for one)")
    parser.add_argument("model", nargs="?", default="", help="model.yaml whose effects to start from (default: as irec diagnose)")
    parser.add_argument("--cell", default="", help="cell file: the tooling surface in the picture, the tolerance on /cell")
    parser.add_argument("-o", "--output", default=".", help="folder for saved models, plans and reports (default: here)")
    parser.add_argument(
        "--calibrations", default="", help="folder of calibration_node, for /cell (default: calibrations beside the cell file)"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=8765, help="port (default: 8765)")
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser")
    parser.add_argument("--follow", action="store_true", help="the session is still being recorded: read it as it grows")


def run(args: argparse.Namespace) -> int:
    from ..recertification.store import calibration_folder
    from ..workbench.app import Settings, serve
    from ..workbench.versions import state_folder

    for path in filter(None, (args.session, args.model, args.cell)):
        if not Path(path).exists():
            raise IrecError(f"{path}: no such file or folder")
    if not 0 < args.port < 65536:
        raise IrecError(f"--port {args.port}: must lie between 1 and 65535")
    calibrations = Path(args.calibrations).resolve() if args.calibrations or not args.cell else calibration_folder(args.cell)
    session, model = (str(Path(p).resolve()) if p else "" for p in (args.session, args.model))
    serve(
        Settings(
            session=session, model=model, cell=args.cell, out=Path(args.output).resolve(), root=state_folder(),
            effect_files=tuple(str(Path(e).resolve()) for e in args.effects), host=args.host, port=args.port,
            show=not args.no_browser, follow=args.follow, calibrations=calibrations,
        )
    )  # fmt: skip
    return 0
