# SPDX-License-Identifier: Apache-2.0
"""The pictures of README and tutorial, drawn anew: `make pictures`. No ROS is needed.

A simulated cell hides an effect that the 18-DOF model lacks; irec improves the model, and the simulator says what the tool really
does along the loaded course, at rest in each point: without correction, corrected with the old and with the improved model.
Pictures of the workbench and of the report need Chromium.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.cli import main as irec
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model.file import load_model
from irec_calibration.poses.course import course_of
from irec_calibration.report.models import course as course_figure
from irec_calibration.session import read_session
from irec_sim.cellfile import read_cell as simulated_cell
from irec_sim.plant import Plant
from irec_sim.session import generate, write_session
from irec_sim.truth import read_truth
from workbench_pictures import draw

ROOT = Path(__file__).parents[2]
CELL = ROOT / "config" / "cells" / "afp.yaml"
IMAGES = ROOT / "docs" / "images"


def main() -> int:
    """Draw them into docs/images."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        cell = simulated_cell(CELL)
        truth = read_truth(ROOT / "config" / "truths" / "demo_hidden.yaml", cell.name, 0, cell.chain.effort)
        session = write_session(generate(cell, truth, 31, 5), folder / "hidden-effect", "hidden-effect")
        for words in (
            ["solve", str(session), "-o", str(folder / "model.yaml")],
            ["report", str(session), "--plain", "-o", str(folder / "report")],
            ["improve", str(session), "-o", str(folder / "improved")],
        ):
            if irec(words) not in (0, 1):
                return 2
        shutil.copy(folder / "report" / "candidates.png", IMAGES / "candidates.png")
        models = {"18-DOF model": folder / "model.yaml", "improved model": folder / "improved" / "model.yaml"}
        _course(cell, truth, session, models)
        draw(session, CELL)
    return 0


def _course(cell, truth, session: Path, models: dict[str, Path]) -> None:
    """The deviation of the simulated tool along the course, at rest in each point."""
    course = course_of(read_cell(CELL), read_session(session))
    if course is None:
        raise SystemExit(f"{CELL} has no course")
    rows = course.session
    scene = scene_of(rows, observe="tcp")
    pressed = rows.load_case != 0
    force = np.einsum("nij,nj->ni", scene.kin.R_tool, rows.force_in_tool)[pressed]
    true = Plant(cell.chain, truth.physics().plant).deflection(rows.q[pressed], force)
    left = {"no correction": true}
    left |= {name: true - load_model(path).predict(scene)[pressed] for name, path in models.items()}
    deviation = {name: np.abs(course.across(d)) for name, d in left.items()}
    for name, d in deviation.items():
        print(f"{name:16} mean {1e3 * d.mean():.3f} mm, max {1e3 * d.max():.3f} mm")
    course_figure(
        dict.fromkeys(deviation, course.s), deviation, course.tolerance, IMAGES / "course.png",
        title="Lateral deviation along the loaded course",
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
