# SPDX-License-Identifier: Apache-2.0
"""The `irec` command. Each subcommand is a module of `irec_calibration.commands` and is imported only when used."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from . import __version__
from .errors import Cancelled, IrecError

# name: (module below irec_calibration.commands, one line of help)
COMMANDS: dict[str, tuple[str, str]] = {
    "plan": ("plan", "choose engagement poses on a tooling surface"),
    "solve": ("solve", "identify a model from a session"),
    "predict": ("predict", "deflections that a model predicts for a session"),
    "codec": ("codec", "accuracy competency development chart of a session (Algorithm 1)"),
    "compare": ("compare", "predicted against measured, residual against noise floor"),
    "diagnose": ("diagnose", "where a model fails and which effect is missing"),
    "add": ("add", "add an effect to a model and refit"),
    "remove": ("remove", "take an effect out of a model and refit"),
    "improve": ("improve", "add effects as long as the evidence justifies it"),
    "history": ("history", "how a model came about"),
    "effects": ("effects", "the catalogue of physical effects"),
    "inspect": ("inspect_bag", "what an MCAP recording holds and lacks"),
    "export": ("export", "MCAP session to a table"),
    "import": ("import_session", "table (or a foreign one, by a profile) to a session"),
    "joint-stiffness": ("joint_stiffness", "joint stiffness from motor and link encoders"),
    "tool-load": ("tool_load", "tool mass, centre of mass and bias from a recording without contact"),
    "rsi-config": ("rsi_config", "KRC configuration and KRL example for RSI"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; 0 done, 1 done but bad news, 2 bad input."""
    parser = argparse.ArgumentParser(
        prog="irec", description="In-situ elastic calibration of robots and correction of deflection under load."
    )
    parser.add_argument("--version", action="version", version=f"irec {__version__}")
    names = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    wanted = next((a for a in (sys.argv[1:] if argv is None else argv) if not a.startswith("-")), None)
    for name, (module_name, help_text) in COMMANDS.items():
        sub = names.add_parser(name, help=help_text, description=help_text[0].upper() + help_text[1:] + ".")
        if name == wanted:
            module = import_module(f"irec_calibration.commands.{module_name}")
            module.configure(sub)
            sub.add_argument(
                "--effects", metavar="FILE", action="append", default=[], help="Python file with effects of your own"
            )
            sub.set_defaults(run=module.run)
    args = parser.parse_args(argv)
    try:
        for path in args.effects:
            from .effects.user import register_file  # only who names a file pays for it

            register_file(path)
        return int(args.run(args) or 0)
    except Cancelled as error:
        print(f"irec {args.command}: {error}", file=sys.stderr)
        return 130
    except IrecError as error:
        print(f"irec {args.command}: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"irec {args.command}: cancelled", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return 0


if __name__ == "__main__":
    sys.exit(main())
