# SPDX-License-Identifier: Apache-2.0
"""A calibration in force of the simulated AFP cell from the time before its robot aged, made without nodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model.file import save_model
from irec_calibration.poses.store import read_poses, write_poses
from irec_calibration.recertification.station import with_stations_found
from irec_calibration.recertification.store import Store
from irec_calibration.session import read_session, write_table
from irec_sim.cellfile import read_cell
from irec_sim.kinematics import forward
from irec_sim.poses import Poses
from irec_sim.session import generate, write_session
from irec_sim.truth import make_truth


def calibrated_before(
    cell: Cell, poses_path: Path, folder: Path, work: Path, *, axis: int = 1, softer: float = 1.0, warmer: float = 0.0
) -> Store:
    """Store in `folder` with calibration 0001 in force.

    Args:
        axis: (from 1) that is `softer` times as soft in `cell_node`, by default, as it was when it was calibrated.
        warmer: K, by which everything was warmer then than a session says that is measured now.
        work: folder for what is made on the way.
    """
    file = read_cell(cell.path)
    now = make_truth(file.name, [], 0, effort=file.chain.effort)
    axial = now.axial.copy()
    axial[axis - 1] /= softer
    poses = read_poses(poses_path)
    q, rail = np.array([p.q for p in poses.poses]), np.array([p.ext.get("rail", 0.0) for p in poses.poses])
    where = forward(file.chain, q)
    made = generate(file, replace(now, axial=axial), len(q), 7, at=Poses(q, rail, where.p_tcp, where.R_tool))
    session = with_stations_found(read_session(write_session(made, work / "before", "before")))
    session = replace(session, temperature={name: values + warmer for name, values in session.temperature.items()})
    files = work / "calibration"
    files.mkdir()
    save_model(model_of(identify(session, default_terms(session))), files / "model.yaml")
    write_table(session, files / "session")
    write_poses(poses, files / "poses.yaml")
    store = Store(folder, cell.serial)
    store.put_in_force(store.add(files, "recalibrated", "M. Muster").calibration, "M. Muster")
    return store
