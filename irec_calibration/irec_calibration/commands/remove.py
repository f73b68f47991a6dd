# SPDX-License-Identifier: Apache-2.0
"""`irec remove MODEL EFFECT SESSION -o model2.yaml`: take an effect out, refit, say what changed."""

from __future__ import annotations

import argparse
import json

from ..diagnose.improve import remove_effect
from ..diagnose.study import prepare
from ..model_file import check_belongs, load_model, save_model
from ..session import read_session
from .add import change, what_changed


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("effect", help="id of an effect of the model")
    parser.add_argument("session", help="session that the rest is refitted to")
    parser.add_argument("-o", "--output", default="model2.yaml", help="model file to write (default: model2.yaml)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    model, session = load_model(args.model), read_session(args.session)
    check_belongs(model, session.robot, session.serial)
    new, after = remove_effect(model, args.effect, session)
    before = prepare(session, model.terms)
    path = save_model(new, args.output)
    print(
        json.dumps({"model": str(path), **change(before, after)})
        if args.json
        else f"{what_changed(model, new, before, after)}\nwrote {path}"
    )
    return 0
