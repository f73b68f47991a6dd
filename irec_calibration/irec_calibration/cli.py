# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""The `irec` command. Each subcommand is a module of `irec_calibration.commands` and is imported only when used."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

from . import __version__
from .commands.guidance import WELCOME, example, what_follows
from .errors import Cancelled, ImplausibleSession, IrecError

# name: (module below irec_calibration.commands, or in full one of irec_correction, loaded only when asked for; one line of help)
COMMANDS: dict[str, tuple[str, str]] = {
    "check": ("check", "everything that is wrong in cell, poses, session, model, truth or profile files"),
    "init-cell": ("init_cell", "write a commented cell file from what is known on the first day"),
    "show-cell": ("show_cell", "draw a cell: robot, surface, stations, poses, sight lines"),
    "plan": ("plan", "choose engagement poses on a tooling surface"),
    "solve": ("solve", "identify a model from a session"),
    "predict": ("predict", "deflections that a model predicts for a session"),
    "codec": ("codec", "accuracy competency development chart of a session (Algorithm 1)"),
    "compare": ("compare", "predicted against measured, residual against noise floor"),
    "diagnose": ("diagnose", "where a model fails and which effect is missing"),
    "add": ("add", "add an effect to a model and refit"),
    "remove": ("remove", "take an effect out of a model and refit"),
    "improve": ("improve", "add effects as long as the evidence justifies it"),
    "report": ("report", "a page to print: verdict, one figure, what to do next, evidence"),
    "scene": ("scene", "robot, residuals and surface as an MCAP for Foxglove, RViz, PlotJuggler"),
    "workbench": ("workbench", "a local page: see where a model fails, try effects, watch the error fall"),
    "history": ("history", "how a model came about"),
    "effects": ("effects", "the catalogue of physical effects"),
    "inspect": ("inspect_bag", "what an MCAP recording holds and lacks"),
    "export": ("export", "MCAP session to a table"),
    "import": ("import_session", "table (or a foreign one, by a profile) to a session"),
    "join": ("join", "several sessions of one robot as one, where more poses were measured later"),
    "joint-stiffness": ("joint_stiffness", "joint stiffness from motor and link encoders"),
    "tool-load": ("tool_load", "tool mass, centre of mass and bias from a recording without contact"),
    "latency": ("latency", "how late the robot follows the force, from a recording"),
    "posture": ("posture", "how to turn the tool about its axis for the least deviation under the process"),
    "filter": ("filter", "a filter of the wrench that looks ahead, for the measured spectrum of the force"),
    "course-filter": ("irec_correction.course_command", "a filter of each axis of the force, learnt on courses with the tracker"),
    "profile": ("profile", "the force that courses have in common, for the correction to look ahead"),
    "links": ("links", "what secondary encoders read without process, for the correction to take off"),
    "modes": ("modes", "modes of arm and head from a recorded tap or swept force"),
    "completion": ("completion", "code that makes your shell complete irec's commands and options"),
    "rsi-config": ("rsi_config", "KRC configuration and KRL example for RSI"),
}


# what a disk or its rights refuse; anything else (no such file, ...) is a mistake of the program where nobody has caught it
OF_THE_MACHINE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO)
WRITTEN = ("output", "picture")  # arguments that name a file to be written; all others may name one that is read


def command_module(name: str) -> ModuleType:
    """Module of a subcommand. Raises IrecError: it is of a package that is not installed."""
    whole = name if "." in name else f"irec_calibration.commands.{name}"
    try:
        return import_module(whole)
    except ModuleNotFoundError as error:
        package = whole.partition(".")[0]
        if error.name != package:
            raise
        raise IrecError(f"it is part of {package}, which is not installed: pip install ./{package}") from error


def _keep_inputs(args: argparse.Namespace) -> None:
    """Refuse to begin what would overwrite a file that it reads. Raises IrecError."""
    from .files.outputs import check_no_input

    written = [getattr(args, name, None) for name in WRITTEN]
    values = [value for name, value in vars(args).items() if name not in WRITTEN]
    given = [v for value in values for v in (value if isinstance(value, list) else [value])]
    for path in written:
        if path:
            check_no_input(path, given)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; 0 done, 1 done but bad news, 2 bad input or output that can't be written."""
    given = list(sys.argv[1:] if argv is None else argv)
    completing = "_ARGCOMPLETE" in os.environ
    if not given and not completing:
        print(WELCOME)
        return 0
    parser = argparse.ArgumentParser(
        prog="irec", description="In-situ elastic calibration of robots and correction of deflection under load."
    )
    parser.add_argument("--version", action="version", version=f"irec {__version__}")
    names = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    words = os.environ.get("COMP_LINE", "").split()[1:] if completing else given
    wanted = next((a for a in words if not a.startswith("-")), None)
    for name, (module_name, help_text) in COMMANDS.items():
        sub = names.add_parser(
            name,
            help=help_text,
            description=help_text[0].upper() + help_text[1:] + ".",
            epilog=example(name),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name == wanted:
            try:
                module = command_module(module_name)
            except IrecError as error:
                print(f"irec {name}: error: {error}", file=sys.stderr)
                return 2
            module.configure(sub)
            sub.add_argument(
                "--effects", metavar="FILE", action="append", default=[], help="Python file with effects of your own"
            )
            sub.set_defaults(run=module.run)
    if completing:
        import argcomplete  # only the shell's completion comes here

        argcomplete.autocomplete(parser)
    args = parser.parse_args(given)
    try:
        for path in args.effects:
            from .effects.user import register_file  # only who names a file pays for it

            register_file(path)
        _keep_inputs(args)
        code = int(args.run(args) or 0)
        follow = "" if getattr(args, "json", False) else what_follows(args.command, vars(args))
        if follow:
            print(follow)
        sys.stdout.flush()  # what can't be written is told here, and not by the interpreter when it ends
        return code
    except Cancelled as error:
        print(f"irec {args.command}: {error}", file=sys.stderr)
        return 130
    except ImplausibleSession as error:
        print(f"irec {args.command}: implausible: {error}; --accept-implausible goes on all the same", file=sys.stderr)
        return 2
    except IrecError as error:
        print(f"irec {args.command}: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"irec {args.command}: cancelled", file=sys.stderr)
        return 130
    except BrokenPipeError:
        _leave_standard_output()
        return 0
    except OSError as error:
        if error.errno not in OF_THE_MACHINE:
            raise
        if error.filename is None:
            _leave_standard_output()
        place = "standard output can't be written" if error.filename is None else f"{error.filename}: can't be read or written"
        print(f"irec {args.command}: error: {place}: {error.strerror}", file=sys.stderr)
        return 2


def _leave_standard_output() -> None:
    """Send what is still to be printed nowhere: it can't be written, and the interpreter would try again when it ends."""
    with contextlib.suppress(OSError, ValueError):  # of a stream that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
