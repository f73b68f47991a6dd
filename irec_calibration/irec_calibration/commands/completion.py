# SPDX-License-Identifier: Apache-2.0
"""`irec completion SHELL`: code for the shell's start file."""

from __future__ import annotations

import argparse

from ..errors import IrecError


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", nargs="?", default="bash", choices=("bash", "zsh", "fish"), help="your shell (default: bash)")


def run(args: argparse.Namespace) -> int:
    try:
        import argcomplete
    except ImportError as error:
        raise IrecError("completion needs argcomplete: pip install 'irec_calibration[completion]'") from error
    print(argcomplete.shellcode(["irec"], shell=args.shell))
    return 0
