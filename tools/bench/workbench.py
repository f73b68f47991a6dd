# SPDX-License-Identifier: Apache-2.0
"""How fast the workbench answers: "try" of every effect of the catalogue on 31 poses x 5 load cases, and a session of 5000 rows.

`python tools/bench/workbench.py [--poses 31] [--large 834]`; measured at the page's side of the pipe to the worker process. Exit
code 1 where a linear effect takes longer than 0.3 s on the usual session. Run it on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from collections.abc import Awaitable
from pathlib import Path
from typing import TypeVar

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "irec_calibration" / "test"))
LIMIT = 0.3  # s
Answer = TypeVar("Answer")
FORMULAS = ("axis 1: c * tau**3", "tool z: c * f_z * sin(q_4)")


async def _timed(call: Awaitable[Answer]) -> tuple[float, Answer]:
    began = time.perf_counter()
    answer = await call
    return time.perf_counter() - began, answer


async def _session(poses: int, folder: Path, every: bool) -> float:
    """Time each step of one session; returns the slowest answer to "try" of a linear effect, s."""
    from irec_calibration.effects import find_effect
    from irec_calibration.errors import IrecError
    from irec_calibration.session import write_table
    from irec_calibration.workbench import figures
    from irec_calibration.workbench.desk import Desk
    from irec_calibration.workbench.worker import Worker
    from synthetic import session
    from workbench_server import hardening

    path = str(write_table(session(poses, seed=3, extra=hardening), folder / f"poses-{poses}"))
    worker = Worker()
    try:
        await worker.warm()
        print(f"\n{poses} poses, {5 * poses} loaded rows, {6 * poses} rows")
        seconds, view = await _timed(worker.call(Desk.view, path))
        print(f"  {'read and lay out':44} {seconds:7.3f} s")
        seconds, version = await _timed(worker.call(Desk.start, path, "", str(folder / f"v{poses}")))
        print(f"  {'first model fitted':44} {seconds:7.3f} s")
        for by in (figures.BY_RESIDUAL, "tau_2"):
            began = time.perf_counter()
            drawn = figures.cell(view, version, version.residual, magnify=500.0, by=by)
            below = figures.norms(view, version, version.residual)
            size = len(json.dumps(drawn)) + len(json.dumps(below))
            seconds = time.perf_counter() - began
            print(f"  {f'cell and samples drawn, coloured by {by}':44} {seconds:7.3f} s, {size / 1e6:.2f} MB")
        slowest = 0.0
        for text in [*FORMULAS, *(view.effects if every else ())]:
            try:
                seconds, _ = await _timed(worker.call(Desk.quick, path, version.model, text))
            except IrecError:
                continue  # it can't be seen in this session
            shaped = ":" not in text and any(p.grid for p in find_effect(text).parameters(_scene(path)))
            if not shaped:
                slowest = max(slowest, seconds)
            print(f"  {'try ' + text + (' (with a shape)' if shaped else ''):44} {seconds:7.3f} s")
        seconds, _ = await _timed(worker.call(Desk.exact, path, version.model, FORMULAS[0], str(folder / f"v{poses}")))
        print(f"  {'exact fit of the first':44} {seconds:7.3f} s")
        return slowest
    finally:
        worker.close()


def _scene(path: str):
    from irec_calibration.effects.of_session import scene_of
    from irec_calibration.session import read_session

    if path not in _SCENES:
        _SCENES[path] = scene_of(read_session(path))
    return _SCENES[path]


_SCENES: dict[str, object] = {}


def main() -> int:
    """0 if linear effects answer in time, 1 if not."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--poses", type=int, default=31, help="poses of the usual session (default: 31)")
    parser.add_argument("--large", type=int, default=834, help="poses of the large one, 0 for none (default: 834, 5004 rows)")
    args = parser.parse_args()
    np.set_printoptions(precision=3)
    with tempfile.TemporaryDirectory() as place:
        slowest = asyncio.run(_session(args.poses, Path(place), every=True))
        if args.large:
            asyncio.run(_session(args.large, Path(place), every=False))
    print(f"\nslowest answer of a linear effect: {slowest:.3f} s (limit {LIMIT} s)")
    return 0 if slowest <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
