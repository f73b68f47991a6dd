# SPDX-License-Identifier: Apache-2.0
"""`irec predict MODEL SESSION -o predictions.csv`: deflection of the TCP in each loaded row."""

from __future__ import annotations

import argparse
import json

import numpy as np

from ..effects.of_session import scene_of
from ..files import check_replaceable, write_file
from ..files.outputs import beginning
from ..model.file import check_belongs, load_model
from ..session import read_session
from ._expected_error import expected_in_words


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder; its marker columns are not read")
    parser.add_argument("-o", "--output", default="predictions.csv", help="table to write (default: predictions.csv)")
    parser.add_argument("--json", action="store_true", help="machine-readable summary on standard output")


def run(args: argparse.Namespace) -> int:
    head = "pose,load_case,repeat,deflection_x,deflection_y,deflection_z"
    path = check_replaceable(args.output, "a table of predictions", (beginning(head),))
    model = load_model(args.model)
    session = read_session(args.session)
    check_belongs(model, session.robot, session.serial)
    deflection = model.predict(scene_of(session, observe="tcp"))
    rows = np.flatnonzero(session.load_case != 0) if session.kind == "loaded" else np.arange(len(session))
    lines = [head]
    for i in rows:
        key = f"{session.pose[i]},{session.load_case[i]},{session.repeat[i]}"
        lines.append(key + "".join(f",{v:.9e}" for v in deflection[i]))
    write_file(path, "\n".join(lines) + "\n")
    size = np.linalg.norm(deflection[rows], axis=1)
    summary = {"predictions": str(path), "rows": len(rows), "mean_m": float(size.mean()), "max_m": float(size.max())}
    print(json.dumps(summary) if args.json else
          f"{len(rows)} rows, deflection mean {1e3 * size.mean():.3f} mm, max {1e3 * size.max():.3f} mm; "
          f"wrote {path}")  # fmt: skip
    if not args.json:
        for line in expected_in_words(model):
            print(line)
    return 0
