# SPDX-License-Identifier: Apache-2.0
"""Sessions and models as commands take them and tell of them: checked for plausibility first, of the same robot."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import IrecError, SessionError
from ..identification.identify import with_disc
from ..model import Model
from ..model.file import check_belongs, load_model
from ..session import Session, read_session
from ..session.plausible import check_plausible, judged
from ..session.without_tracker import SLIP_M, without_tracker


def configure_plausible(parser: argparse.ArgumentParser) -> None:
    """The option to go on all the same."""
    parser.add_argument(
        "--accept-implausible",
        action="store_true",
        help="go on although the session can't be what it says (units, signs, columns, frames)",
    )


def configure_without_tracker(parser: argparse.ArgumentParser) -> None:
    """The option to read a session without its tracker."""
    parser.add_argument(
        "--without-tracker",
        action="store_true",
        help="do not read the marker: the disc on the tooling is the measured point (docs/without-tracker.md)",
    )
    parser.add_argument(
        "--slip", type=float, metavar="M", help=f"m by which the disc slips across, with --without-tracker (default: {SLIP_M:g})"
    )
    parser.add_argument(
        "--disc",
        type=float,
        nargs=2,
        metavar=("NORMAL", "LATERAL"),
        help="N/m, stiffness of the disc as measured, with --without-tracker (default: identified along)",
    )


def as_read(args: argparse.Namespace, session: Session) -> Session:
    """The session as `--without-tracker` says. IrecError: it can't be read so, or an option is left without it."""
    if not args.without_tracker:
        for name in ("slip", "disc"):
            if getattr(args, name) is not None:
                raise IrecError(f"--{name} says how the session is read --without-tracker; give both or none")
        return session
    slip = SLIP_M if args.slip is None else args.slip
    return without_tracker(session, slip, disc=tuple(args.disc) if args.disc else None)


def starting_model(args: argparse.Namespace, session: Session) -> Model | None:
    """The model of `--model`, of this robot, with the disc where the session has one; None where none was given.

    Raises:
        ModelError: it is another robot's, or can't be read.
    """
    model = load_model(args.model) if args.model else None
    if model is not None:
        check_belongs(model, session.robot, session.serial)
        model = replace(model, terms=with_disc(model.terms, session))
    return model


def tell_written(session: Session, output: Path, as_json: bool) -> int:
    """Say what was written where; 0."""
    if as_json:
        summary = {"session": str(output), "poses": len(session.poses), "rows": len(session), "notes": list(session.notes)}
        print(json.dumps(summary))
    else:
        for note in session.notes:
            print(f"note: {note}")
        print(f"{len(session.poses)} poses, {len(session)} rows; wrote {output}")
    return 0


def check_no_session(folder: Path) -> None:
    """Refuse to write a table where one is already, or where one of its files is. SessionError names it."""
    for name in ("session.yaml", "samples.csv", "robot.urdf"):
        if (folder / name).exists():
            raise SessionError(f"{folder / name}: exists, and a session is never overwritten; name another folder with -o")


def plausible_session(args: argparse.Namespace) -> Session:
    """The session of a command.

    Raises:
        ImplausibleSession: it can't be what it says, and `--accept-implausible` was not given.
    """
    session = read_session(args.session)
    as_judged = session
    if getattr(args, "without_tracker", False):  # what the tracker says is not read
        as_judged = replace(session, p_marker_in_station=np.full_like(session.p_marker_in_station, np.nan))
    if not args.accept_implausible:
        return replace(session, notes=check_plausible(as_judged).notes)
    doubts, notes = judged(as_judged)
    went_on = (f"went on by --accept-implausible although {d}" for d in doubts)
    return replace(session, notes=(*session.notes, *notes, *went_on))
