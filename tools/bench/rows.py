# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis costs as the session grows: time and peak memory from 155 rows (loaded) to 36 000 rows (absolute).

    python tools/bench/rows.py [ROWS ...] [--fit]

Each size runs in a process of its own, so that its peak memory is its own. The absolute sessions have six markers (one on the
base) and hide a compliance under gravity; `--fit` stops after the robust fit.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SIZES = (155, 600, 1500, 6000, 12000, 36000)
MARKERS_IN_POSE = 6


def made(rows: int):  # type: ignore[no-untyped-def]
    """A session of about so many rows with a known truth."""
    sys.path.insert(0, str(ROOT / "irec_calibration" / "test"))
    import absolute_sessions
    import numpy as np
    import synthetic
    from irec_calibration.session import Marker, Noise

    if rows <= 155:
        return synthetic.session(poses=rows // 5, seed=1)
    markers = tuple(Marker(f"M{i}", "tool0", (0.03 * i - 0.1, (-1) ** i * 0.05, 0.05 + 0.02 * i), known=False) for i in range(5))
    markers += (Marker("B", "base_link", (0.5, 0.4, 0.1), known=False),)

    def bent(session, p):  # type: ignore[no-untyped-def]
        on_tool = np.array([m.link == "tool0" for m in session.markers])[session.marker]
        return absolute_sessions.torsion(np.full(6, 2e-6))(session, p) * on_tool[:, None]

    poses = rows // MARKERS_IN_POSE
    return absolute_sessions.session(noise=Noise(tracker_m=2e-5), markers=markers, poses=poses, moved=bent)


def one(rows: int, fit_only: bool) -> None:
    """Print one line of the table."""
    from irec_calibration.diagnose import diagnose
    from irec_calibration.identification.identify import default_terms, identify

    session = made(rows)
    began, spent = time.monotonic(), time.process_time()
    if fit_only:
        word = f"{1e6 * identify(session, default_terms(session)).rms:.1f} um"
    else:
        said: list[tuple[float, float]] = []
        found = diagnose(session, progress=lambda share, what: said.append((share, time.monotonic() - began)))
        word = " ".join([found.verdict.status, *found.verdict.effects])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    wall, processor = time.monotonic() - began, time.process_time() - spent
    late = "" if fit_only else f"{max(abs(share - at / wall) for share, at in said):8.2f}"
    print(f"{len(session):7d} {wall:9.1f} {processor:9.1f} {peak:8.2f} {late:>8}  {word}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", type=int, default=list(SIZES))
    parser.add_argument("--fit", action="store_true", help="the robust fit only")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        one(args.rows[0], args.fit)
        return
    print("progress: largest error of the share that was said to be done")
    print(f"{'rows':>7} {'wall s':>9} {'CPU s':>9} {'peak GB':>8} {'progress':>8}  answer")
    for rows in args.rows:
        command = [sys.executable, __file__, str(rows), "--one", *(["--fit"] if args.fit else [])]
        subprocess.run(command, check=False)


if __name__ == "__main__":
    main()
