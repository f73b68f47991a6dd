# SPDX-License-Identifier: Apache-2.0
"""Measure more where the tool could not tell: does it know then?

    python tools/hidden/follow_up.py DIR OUT-SAID -o NEW [-n 8] [--by to_tell|cover] [--presence]

For each loaded session of a matrix whose verdict (in OUT-SAID, as run.py leaves it) has a `one_of`, poses are planned by `irec
plan`, which never sees the truth; the hidden robot is measured there, and `irec join` makes one session of both. NEW is a matrix
of these sessions and NEW-truth their truth, for run.py, score.py and promised.py. NEW/promised.csv: what the plan expected.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import shutil
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import yaml

CELLS = Path(__file__).resolve().parents[2] / "config" / "cells"
SEED = 4242  # of poses and noise of what is measured later


def unsettled(said: Path, presence: bool) -> bool:
    """Whether a verdict leaves open which effect it is (or, with presence, anything at all)."""
    path = said / "diagnosis.json"
    if not path.exists():
        return False
    verdict = json.loads(path.read_text(encoding="utf-8"))["verdict"]
    return bool(verdict.get("one_of")) or (presence and verdict["status"] == "unexplained")


def plan(session: str, cell: str, out: str, n: int, by: str) -> dict[str, Any]:
    """Plan blind; what `irec plan` says."""
    from irec_calibration.cli import main as irec
    from run import blindfold

    blindfold()
    how = ["--to-tell", session] if by == "to_tell" else ["--method", by]
    said, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        code = irec(["plan", cell, *how, "-n", str(n), "-o", out, "--json"])
    if code > 1:
        return {"error": told.getvalue().strip().splitlines()[-1]}
    return json.loads(said.getvalue().strip().splitlines()[-1])


def measure(truth: Path, cell_name: str, poses: Path, temperatures: str, out: Path) -> None:
    """What the hidden robot shows at a pose file, with the noise that it has."""
    from irec_sim.cellfile import read_cell
    from irec_sim.noise import TrueNoise
    from irec_sim.poses import poses_of_file
    from irec_sim.session import Conduct, generate, write_session
    from irec_sim.truth import read_truth

    data = yaml.safe_load((truth / "truth.yaml").read_text(encoding="utf-8"))
    cell = read_cell(cell_name)
    conduct = Conduct(TrueNoise(**data["noise"]), data["claim"], random_order=True, temperatures=temperatures)
    at = poses_of_file(poses, cell)
    robot = read_truth(truth / "truth.yaml", cell_name)
    write_session(generate(cell, robot, len(at.q), SEED, conduct=conduct, at=at), out, "later")


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure more where the tool could not tell.")
    parser.add_argument("matrix", type=Path, help="folder with sessions/ and validation/; the truth stands beside it")
    parser.add_argument("said", type=Path, help="what tools/hidden/run.py left")
    parser.add_argument("-o", "--output", type=Path, required=True, help="new matrix; its truth: NEW-truth")
    parser.add_argument("-n", type=int, default=8, help="poses more (default: 8)")
    parser.add_argument("--by", default="to_tell", help="to_tell, or a method of irec plan, for comparison")
    parser.add_argument("--presence", action="store_true", help="unexplained sessions without a one_of too")
    args = parser.parse_args()
    from irec_calibration.cli import main as irec

    truth, new_truth = (p.with_name(p.name + "-truth") for p in (args.matrix, args.output))
    for place in (args.output, new_truth):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
    with open(truth / "matrix.csv", encoding="utf-8") as f:
        lines = list(csv.DictReader(f))
    open_ones = [r for r in lines if r["kind"] != "absolute" and unsettled(args.said / r["name"], args.presence)]
    print(f"{len(open_ones)} of {len(lines)} sessions leave open what it is")
    kept, promised = [], []
    for row in open_ones:
        name, cell = row["name"], row["cell"]
        work = args.output / "work" / name
        with ProcessPoolExecutor(1) as pool:  # a process of its own, which can't open a truth file any more
            told = pool.submit(
                plan, str(args.matrix / "sessions" / name), str(CELLS / f"{cell}.yaml"), str(work / "poses.yaml"), args.n, args.by
            ).result()
        if "error" in told:
            print(f"{name}: no poses planned: {told['error']}")
            continue
        for one in told.get("to_tell", ()):
            least, needed = min(one["nats"]), max(one["lacks"])
            promised.append([name, "/".join(one["names"]), f"{one['chance']:.2f}", f"{least:.1f}", f"{needed:.1f}"])
            figures = f"{100 * one['chance']:.0f} of 100 ({least:.1f} of {needed:.1f} nats)"
            print(f"{name}: {'/'.join(one['names'])}: {figures}", flush=True)
        measure(truth / name, cell, work / "poses.yaml", row["temperatures"], work / "later")
        with contextlib.redirect_stdout(io.StringIO()):
            both = str(args.output / "sessions" / name)
            if irec(["join", str(args.matrix / "sessions" / name), str(work / "later"), "-o", both]):
                raise SystemExit(f"{name}: the sessions could not be joined")
        shutil.copytree(args.matrix / "validation" / name, args.output / "validation" / name)
        shutil.copytree(truth / name, new_truth / name)
        kept.append(row)
    for path, header, rows in (
        (new_truth / "matrix.csv", list(lines[0]), [list(r.values()) for r in kept]),
        (args.output / "promised.csv", ["name", "question", "chance", "nats", "needed"], promised),
    ):
        with open(path, "w", newline="", encoding="utf-8") as f:
            writer = csv.writer(f, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
