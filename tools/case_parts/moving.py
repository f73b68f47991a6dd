# SPDX-License-Identifier: Apache-2.0
"""A session measured on the moving arm: training courses driven dry and then under the process, with the tracker on the tool.

A standing arm is held by the friction of its gears, a moving one is not: the compliances of production are those of a moving arm.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import yaml
from irec_calibration.diagnose.improve import improve
from irec_calibration.model import Model
from irec_calibration.model.file import load_model, save_model
from irec_calibration.session import read_session
from irec_calibration.typing import Array
from irec_sim.cellfile import read_cell
from irec_sim.kinematics import Chain, forward
from irec_sim.production.runner import Drive
from irec_sim.production.ways import PERIOD

from .jobs import Case, Job, fingerprint, load

APART, WINDOW = 0.4, 0.2  # s between two rows of a course, over which a row is the mean
BEGIN, END = 0.4, 0.2  # s left out after touch-down, where the force still changes quickly, and before the end of a course


def moving_session(chain: Chain, drives: Sequence[Drive], courses: Array, standing: Path, folder: Path) -> Path:
    """Write rows of these courses (rows of the drives) as a session; the robot and the instruments are those of `standing`.

    The courses were driven several times: rows are taken from one drive after the other.

    A row's reference is the same place on the dry course: no force, and the marker (at the TCP) where the controller has it.
    """
    header = yaml.safe_load((standing / "session.yaml").read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(standing / "robot.urdf", folder / "robot.urdf")
    station = {"name": "A", "xyz": [0.0, 0.0, 0.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}  # rows are in base_link already
    for key in ("load_cases", "load_case_names", "ext_axes"):
        header.pop(key, None)
    header.update(name=folder.name, marker_in_tool0=[0.0, 0.0, 0.0], stations=[station])
    (folder / "session.yaml").write_text(yaml.safe_dump(header, sort_keys=False), encoding="utf-8")
    ways = drives[0].ways
    chain_columns = [f"joint_{k + 1}" for k in range(ways.q.shape[2])]
    columns = ["pose", "load_case", "stamp", *chain_columns, "tcp_x", "tcp_y", "tcp_z", "marker_x", "marker_y", "marker_z"]
    lines = [",".join([*columns, "force_x", "force_y", "force_z"])]
    pose, clock, half = 0, 0.0, round(0.5 * WINDOW / PERIOD)
    for i, (turn, drive) in product(courses, enumerate(drives)):
        counted = np.flatnonzero(drive.counted[:, i])
        begin, end = counted[0] + round(BEGIN / PERIOD), counted[-1] - round(END / PERIOD)
        first, step = begin + half + round(turn * APART / PERIOD), round(len(drives) * APART / PERIOD)
        for k in range(first, end - half, step):
            part, pose = slice(k - half, k + half + 1), pose + 1
            moved, force = drive.measured[part, i].mean(axis=0), drive.reading[part, i].mean(axis=0)
            q = ways.q[k, i]
            p = forward(chain, q[None]).p_tcp[0]
            loaded = (k - counted[0]) * PERIOD  # s since the touch-down
            for number, shift, wrench in ((0, np.zeros(3), np.zeros(3)), (1, moved, force)):
                numbers = [clock + number * loaded, *q, *p, *(p + shift), *wrench]
                lines.append(f"{pose},{number}," + ",".join(f"{x:.9g}" for x in numbers))
            clock += loaded + 5.0
    (folder / "samples.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def improved_in_motion(case: Case, without: Sequence[Job], courses: Array, progress: Callable[[float, str], None]) -> Model:
    """The model of these courses of drives without correction, as far as the evidence goes (`irec improve`); kept on disk."""
    path, mark = case.out / "model_moving.yaml", case.out / "model_moving.sha256"
    now = "".join(fingerprint(case, j) for j in without) + str(courses.tolist()) + str((APART, WINDOW, BEGIN, END))
    if not (path.is_file() and mark.is_file() and mark.read_text() == now):
        chain = read_cell(case.cell_path).chain
        drives = [load(case, j)[0].zeroed for j in without]
        folder = moving_session(chain, drives, courses, case.out / "session", case.out / "session_moving")
        save_model(improve(read_session(folder), progress=progress).model, path)
        mark.write_text(now)
    return load_model(path)
