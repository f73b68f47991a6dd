# SPDX-License-Identifier: Apache-2.0
"""`irec history MODEL`: the versions that led to a model, with the error that each earned."""

from __future__ import annotations

import argparse
import json

from ..model_file import load_model


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    model = load_model(args.model)
    if args.json:
        print(json.dumps(list(model.history)))
        return 0
    if not model.history:
        made = ", ".join(f"{k} {v}" for k, v in model.made.items())
        print(f"no earlier version is recorded; made: {made or 'unknown'}")
    for i, entry in enumerate(model.history, 1):
        cv = entry.get("cv_rms_m")
        error = f"{1e6 * cv:.1f} um on held-out poses" if isinstance(cv, (int, float)) else "held-out error unknown"
        print(
            f"{i}. {entry.get('date', '')}  {entry.get('change', '')}: {error}  [{', '.join(entry.get('effects', []))}] on "
            f"{entry.get('session', '')}"
        )
    return 0
