# SPDX-License-Identifier: Apache-2.0
"""Calibration of a case: a session on the hard plant at the cell's own poses, models of 6 and 18 degrees of freedom,
the improved one."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell
from irec_calibration.diagnose.improve import improve
from irec_calibration.identification.identify import default_terms
from irec_calibration.model import EIGHTEEN_DOF, SIX_DOF, Model, blank_model
from irec_calibration.model.file import load_model, save_model
from irec_calibration.poses.store import read_poses
from irec_calibration.session import read_session, write_table
from irec_calibration.session.without_tracker import without_tracker
from irec_sim.cellfile import CellFile
from irec_sim.kinematics import forward
from irec_sim.poses import Poses
from irec_sim.session import Generated, generate, write_session
from irec_sim.truth import Truth

from irec_calibration import diagnose

from .through_nodes import record

ENCODER = 2e-6  # rad, noise of a secondary encoder
DISC = (4.2e6, 1.43e6)  # N/m along and across, as somebody measures it on a bench: 5 % off


def planned_poses(sim: CellFile, cell: Cell) -> Poses:
    """The engagement poses that `irec plan` wrote for this cell, as the simulator takes them."""
    poses = read_poses(cell.poses_path, cell.serial, cell.robot.sha256).poses
    q = np.array([p.q for p in poses])
    pose = forward(sim.chain, q)
    return Poses(q, np.array([p.ext.get("rail", 0.0) for p in poses]), pose.p_tcp, pose.R_tool)


def measured_session(sim: CellFile, cell: Cell, truth: Truth, folder: Path, seed: int = 11) -> Path:
    """Calibrate the simulated cell: all load cases at all poses, with the noise of its instruments. Written only once whole.

    A session of another plant that lies there is measured anew, and the models made of it are made anew.
    """
    return _kept(cell, truth, folder, "", lambda half: write_session(_generated(sim, cell, truth, seed), half, folder.name))


def recorded_session(cell: Cell, truth: Truth, truth_path: Path, folder: Path, say: Callable[[str], None]) -> Path:
    """The same through the nodes; the recording is beside it. One that was broken off on this plant is gone on with."""
    recording = folder.with_suffix(".mcap")

    def measure(half: Path) -> None:
        mark, digest = recording.with_suffix(".mcap.sha256"), _digest(cell, truth, "nodes")
        if not (mark.is_file() and mark.read_text() == digest):
            recording.unlink(missing_ok=True)
            mark.write_text(digest)
        record(cell, truth_path, recording, say)
        write_table(read_session(recording), half)

    return _kept(cell, truth, folder, "nodes", measure)


def link_session(sim: CellFile, cell: Cell, truth: Truth, folder: Path, seed: int = 11) -> Path:
    """The same of a robot with secondary encoders: the joint angles are those behind the gears."""

    def write(half: Path) -> None:
        made, rng = _generated(sim, cell, truth, seed), np.random.default_rng([seed, 7])
        for k, (one, rows) in enumerate(zip(made.passes, made.rows, strict=True)):
            q = rows.q_link + rng.normal(0.0, ENCODER, rows.q_link.shape)
            p = forward(sim.chain, q.reshape(-1, q.shape[-1])).p_tcp.reshape(*q.shape[:2], 3)
            made.passes[k] = replace(one, q=q, p_controller=p)
        write_session(made, half, folder.name)

    return _kept(cell, truth, folder, "links", write)


def _generated(sim: CellFile, cell: Cell, truth: Truth, seed: int) -> Generated:
    return generate(sim, truth, 1, seed, at=planned_poses(sim, cell))


def _digest(cell: Cell, truth: Truth, how: str) -> str:
    plant = json.dumps(truth.as_data(), sort_keys=True).encode() + cell.path.read_bytes() + cell.poses_path.read_bytes()
    return hashlib.sha256(plant + how.encode()).hexdigest()


def _kept(cell: Cell, truth: Truth, folder: Path, how: str, measure: Callable[[Path], object]) -> Path:
    """`folder` where it holds this plant's session, measured this way; measured else."""
    mark, digest = folder.with_name(folder.name + ".sha256"), _digest(cell, truth, how)
    if (folder / "samples.csv").is_file() and mark.is_file() and mark.read_text() == digest:
        return folder
    stale = [folder.parent / "model_links.yaml"] if how == "links" else folder.parent.glob("model_*.yaml")
    for old in stale:
        old.unlink(missing_ok=True)
    half = folder.with_name(folder.name + ".part")
    for there in (half, folder):
        shutil.rmtree(there, ignore_errors=True)
    measure(half)
    half.rename(folder)
    mark.write_text(digest)
    return folder


def solved(session: Path, effects: tuple[str, ...] | list[str], path: Path) -> Model:
    """A model of these effects; read where it is there already."""
    if not path.is_file():
        save_model(diagnose.solved(read_session(session), blank_model(list(effects)))[0], path)
    return load_model(path)


def beyond_links(session: Path, folder: Path) -> Model:
    """Of what lies beyond the secondary encoders of a session with link-side angles: the structure."""
    return solved(session, EIGHTEEN_DOF, folder / "model_links.yaml")


def by_contact(session: Path, folder: Path, disc: tuple[float, float] | None = None) -> Model:
    """18 DOF from the same session without a reading of its tracker: the disc on the tooling is the measured point.

    Args:
        disc: its stiffness along and across, N/m, as measured before; None: identified along.
    """
    path = folder / ("model_contact.yaml" if disc is None else "model_contact_disc.yaml")
    if not path.is_file():
        held = without_tracker(read_session(session), disc=disc)
        save_model(diagnose.solved(held, default_terms(held))[0], path)
    return load_model(path)


def six(session: Path, folder: Path) -> Model:
    return solved(session, SIX_DOF, folder / "model_6dof.yaml")


def eighteen(session: Path, folder: Path) -> Model:
    return solved(session, EIGHTEEN_DOF, folder / "model_18dof.yaml")


def improved(session: Path, folder: Path, progress: Callable[[float, str], None] | None = None) -> Model:
    """As far as the evidence goes (`irec improve`)."""
    path = folder / "model_improved.yaml"
    if not path.is_file():
        save_model(improve(read_session(session), progress=progress).model, path)
    return load_model(path)
