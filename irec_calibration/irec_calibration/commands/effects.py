# SPDX-License-Identifier: Apache-2.0
"""`irec effects [ID]`: the catalogue, with the physics of one effect; effects of the user are listed too."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap

from ..effects import broken_effects, find_effect, known_effects
from ..effects.formula import FUNCTIONS, VARIABLES


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("effect", nargs="?", help="show one effect")
    parser.add_argument("--variables", action="store_true", help="what a formula may use")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    if args.variables and args.json:
        print(json.dumps({"variables": VARIABLES, "functions": list(FUNCTIONS), "constants": ["pi"]}))
        return 0
    if args.variables:
        for name, meaning in VARIABLES.items():
            print(f"{name:14} {meaning}")
        print(f"functions: {', '.join(FUNCTIONS)}; constant: pi")
        return 0
    shown = [find_effect(args.effect)] if args.effect else list(known_effects().values())
    if args.json:
        print(json.dumps([{"id": e.id, "label": e.label, "acts_on": e.acts_on, "physics": e.physics} for e in shown]))
    elif args.effect:
        print(f"{shown[0].id}: {shown[0].label} (acts on: {shown[0].acts_on})")
        print(textwrap.fill(shown[0].physics, 100))
    else:
        for e in shown:
            print(f"{e.id:22} {e.acts_on:11} {e.label}")
        for why in broken_effects().values():
            print(f"can't be used: {why}", file=sys.stderr)
    return 0
