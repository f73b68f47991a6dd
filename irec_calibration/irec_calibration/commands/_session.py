# SPDX-License-Identifier: Apache-2.0
"""Sessions as commands take them from which something is identified: checked for plausibility first."""

from __future__ import annotations

import argparse
from dataclasses import replace

from ..session import Session, read_session
from ..session.plausible import check_plausible, doubts


def configure_plausible(parser: argparse.ArgumentParser) -> None:
    """The option to go on all the same."""
    parser.add_argument(
        "--accept-implausible",
        action="store_true",
        help="go on although the session can't be what it says (units, signs, columns, frames)",
    )


def plausible_session(args: argparse.Namespace) -> Session:
    """The session of a command.

    Raises:
        ImplausibleSession: it can't be what it says, and `--accept-implausible` was not given.
    """
    session = read_session(args.session)
    if not args.accept_implausible:
        check_plausible(session)
        return session
    return replace(session, notes=(*session.notes, *(f"went on by --accept-implausible although {d}" for d in doubts(session))))
