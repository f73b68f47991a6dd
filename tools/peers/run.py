# SPDX-License-Identifier: Apache-2.0
"""irec beside FIGAROH (PyPI `figaroh`) on measured data: the UR5 grid, the same 800 poses to fit and 200 to predict.

FIGAROH is installed into an environment of its own, out/peers/venv. Data are looked for in IREC_REAL_DATA, or ../shared/data.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

import numpy as np
from irec_calibration.identification.absolute import base_terms
from irec_calibration.identification.identify import fit
from irec_calibration.identification.observe import observe
from irec_calibration.model import blank_model, total_displacement
from irec_calibration.session import Session
from irec_calibration.session.foreign import import_table

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("IREC_REAL_DATA", ROOT.parent / "shared" / "data"))
TABLE = DATA / "jacobi_ur5_wam_lasertracker" / "UR5" / "3D_UR5_uncalibrated_grid_cleaned.csv"
TRAIN = 800
AT_MOST_S = 600


def main() -> int:
    if not TABLE.exists():
        print(f"skipped: {TABLE} is not there; set IREC_REAL_DATA to the folder with measured data")
        return 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        session = import_table(ROOT / "docs" / "real-data" / "ur5-jacobi.profile.yaml", TABLE, folder)
        order = np.random.default_rng(0).permutation(len(session))
        print(f"{'':10} {'model':34} {'rms, other poses, mm':>17} {'parameters':>11} {'seconds':>8}")
        ours(session, order)
        write(session, order, folder)
        theirs(folder)
    return 0


def ours(session: Session, order: np.ndarray) -> None:
    """Fit on the first poses of the order, predict the others with everything held, station and marker too."""
    train = np.zeros(len(session), dtype=bool)
    train[order[:TRAIN]] = True
    for name, extra in (("geometry", ()), ("geometry and joint elasticity", ("joint_torsion",))):
        start = time.perf_counter()
        whole = observe(session)
        found = fit([*base_terms(), *blank_model(extra)], whole.only(train))
        residual = (whole.y - total_displacement(found.terms, whole.scene))[~train]
        show("irec", name, 1e3 * float(np.sqrt((residual**2).sum(axis=1).mean())), found.rank, time.perf_counter() - start)


def write(session: Session, order: np.ndarray, folder: Path) -> None:
    """The same poses in FIGAROH's columns."""
    for name, rows in (("train", order[:TRAIN]), ("test", order[TRAIN:])):
        with (folder / f"{name}.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["x1", "y1", "z1", *(f"joint_{k + 1}" for k in range(session.q.shape[1]))])
            table.writerows([*session.p_marker_in_station[i], *session.q[i]] for i in rows)


def theirs(folder: Path) -> None:
    home = ROOT / "out" / "peers" / "venv"
    python = home / "bin" / "python"
    if not python.exists():
        print("installing figaroh into an environment of its own ..", file=sys.stderr)
        venv.create(home, with_pip=True)
        installed = subprocess.run([python, "-m", "pip", "install", "-q", "figaroh"], capture_output=True, text=True)
        if installed.returncode:
            shutil.rmtree(home)
            print(f"figaroh can't be installed: {installed.stderr.strip().splitlines()[-1]}")
            return
    script = Path(__file__).with_name("figaroh_ur5.py")
    try:
        done = subprocess.run([python, script, folder], capture_output=True, text=True, timeout=AT_MOST_S, cwd=folder)
    except subprocess.TimeoutExpired:
        print(f"figaroh: no answer in {AT_MOST_S} s")
        return
    results = [json.loads(line[7:]) for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    for r in results:
        show("figaroh", r["model"], r["held_out_rms_mm"], r["parameters"], r["seconds"])
    if len(results) < 2:
        print(f"figaroh stopped: {(done.stderr.strip().splitlines() or ['without a word'])[-1]}")


def show(who: str, model: str, rms_mm: float, parameters: int, seconds: float) -> None:
    print(f"{who:10} {model:34} {rms_mm:17.4f} {parameters:11d} {seconds:8.1f}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
