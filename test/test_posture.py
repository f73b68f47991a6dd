# SPDX-License-Identifier: Apache-2.0
"""`irec posture`: the turn of a spindle that stands across the flange, held against the simulator's own plant."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.cli import main
from irec_calibration.errors import CellError
from irec_calibration.model import EIGHTEEN_DOF, Model, blank_model
from irec_calibration.model.file import save_model
from irec_calibration.poses.posture import ToolWay, in_line, stiffest, try_turns, way_of_table
from irec_calibration.session import Session, read_session
from irec_sim.cellfile import CellFile
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.plant import Conditions, Plant
from irec_sim.session import generate, write_session
from irec_sim.truth import Truth, read_truth

from irec_calibration import diagnose

ROOT = Path(__file__).parents[1]
TURNS = np.radians(np.arange(-60.0, 61.0, 20.0))


@dataclass(frozen=True)
class Milling:
    """A cell of the second case study whose spindle stands across the flange, calibrated."""

    folder: Path
    cell: Cell
    sim: CellFile
    truth: Truth
    session: Session
    model: Model
    way: ToolWay


@pytest.fixture(scope="module")
def across(tmp_path_factory: pytest.TempPathFactory) -> Milling:
    folder = tmp_path_factory.mktemp("across")
    urdf = (ROOT / "config" / "robots" / "kr300_r2500_ultra.urdf").read_text(encoding="utf-8")
    in_flange = '<origin xyz="0 0 0.4" rpy="0 0 0"/>'
    assert urdf.count(in_flange) == 1
    (folder / "robot.urdf").write_text(
        urdf.replace(in_flange, '<origin xyz="0.30 0 0.15" rpy="0 1.5707963 0"/>'), encoding="utf-8"
    )
    text = (ROOT / "config" / "cells" / "milling.yaml").read_text(encoding="utf-8")
    path = folder / "cell.yaml"
    path.write_text(text.replace("../robots/kr300_r2500_ultra.urdf", "robot.urdf"), encoding="utf-8")
    sim = read_sim_cell(path)
    truth = read_truth(ROOT / "config" / "truths" / "elastic.yaml", sim.name, 0, sim.chain.effort)
    write_session(generate(sim, truth, 15, 3), folder / "session", "across")
    session = read_session(folder / "session")
    model = diagnose.solved(session, blank_model(EIGHTEEN_DOF))[0]
    save_model(model, folder / "model.yaml")
    rows = [
        f"{1.75 + 0.02 * i:.3f},{0.1 - 0.02 * i:.3f},0.9,0,0,-1,-125,-260,235,0,1,0" for i in range(8)
    ]  # across the upper face of the block
    head = "x,y,z,axis_x,axis_y,axis_z,force_x,force_y,force_z,counts_x,counts_y,counts_z"
    (folder / "way.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return Milling(folder, read_cell(path), sim, truth, session, model, way_of_table(folder / "way.csv", session))


def _of_plant(m: Milling, q: np.ndarray) -> float:
    """Mean deviation that counts, by the simulator's plant, m."""
    plant = Plant(m.sim.chain, m.truth.physics().plant)
    frames = plant.frames(q, np.zeros((len(q), plant.dof)))
    C = plant.tcp_compliance(frames, plant.compliance(q, Conditions.idle(len(q), plant.chain.n)))
    moved = (C @ m.way.force[:, :, None])[..., 0]
    assert m.way.counts is not None
    return float(np.abs((moved * m.way.counts).sum(axis=1)).mean())


def test_the_turn_that_the_calibrated_model_finds_is_stiffer_on_the_plant_too(across: Milling) -> None:
    found = try_turns(across.cell, across.session, across.model, across.way, TURNS)
    free = [p for p in found if not p.hindered]
    best = stiffest(found)
    assert best is not None and best.q is not None and len(free) > 1
    worst = max(free, key=lambda p: p.mean)
    assert worst.q is not None
    assert best.mean < 0.95 * worst.mean  # there is something to gain
    assert _of_plant(across, best.q) / _of_plant(across, worst.q) == pytest.approx(best.mean / worst.mean, rel=0.05)


def test_a_posture_keeps_to_the_way_and_turns_the_tool_only(across: Milling) -> None:
    (turned,) = try_turns(across.cell, across.session, across.model, across.way, [np.radians(20.0)])
    assert turned.q is not None
    kin = across.cell.robot.kinematics(turned.q)
    np.testing.assert_allclose(kin.p_tcp, across.way.p, atol=1e-6)
    np.testing.assert_allclose(kin.R_tool[:, :, 2], across.way.R[:, :, 2], atol=1e-6)
    cosine = (kin.R_tool[:, :, 0] * across.way.R[:, :, 0]).sum(axis=1)
    np.testing.assert_allclose(np.degrees(np.arccos(cosine)), 20.0, atol=1e-3)


def test_what_hinders_a_turn_is_named(across: Milling) -> None:
    def hindered(cell: Cell) -> str:
        return try_turns(cell, across.session, across.model, across.way, [0.0])[0].hindered

    assert hindered(across.cell) == ""
    assert hindered(replace(across.cell, joint_margin=3.0)) == "a joint limit"
    assert hindered(replace(across.cell, singularity=5.0)) == "too close to a singularity"
    assert hindered(replace(across.cell, continuous_torque=np.full(6, 1.0))) == "the continuous torque of an axis"
    assert stiffest(try_turns(replace(across.cell, joint_margin=3.0), across.session, across.model, across.way, [0.0])) is None


def test_a_way_out_of_reach_or_a_wrong_table_is_refused(across: Milling) -> None:
    far = replace(across.way, p=across.way.p + np.array([5.0, 0.0, 0.0]))
    with pytest.raises(CellError, match="does not reach the beginning"):
        try_turns(across.cell, across.session, across.model, far, [0.0])
    table = across.folder / "wrong.csv"
    table.write_text("x,y,z\n1,2,3\n1,2,3\n", encoding="utf-8")
    with pytest.raises(CellError, match="no column axis_x"):
        way_of_table(table, across.session)
    lines = (across.folder / "way.csv").read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join([*lines[:2], lines[2].replace("0.9", "none", 1)]) + "\n", encoding="utf-8")
    with pytest.raises(CellError, match="line 3: x, y, z is not a number"):
        way_of_table(table, across.session)


def test_the_command_names_the_stiffest_turn(across: Milling, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["posture", *(str(across.folder / n) for n in ("model.yaml", "session", "cell.yaml")), "--step", "45"]
    assert main([*words, "--way", str(across.folder / "way.csv"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    free = [t for t in told["turns"] if not t["hindered"]]
    assert told["best_turn_deg"] == min(free, key=lambda t: t["mean_m"])["turn_deg"]
    assert in_line(across.cell) == ""


def test_a_spindle_in_line_with_the_last_axis_has_nothing_to_turn(across: Milling) -> None:
    cell = read_cell(ROOT / "config" / "cells" / "milling.yaml")
    session = replace(across.session, robot=cell.robot)
    q = [p.q for p in try_turns(cell, session, across.model, across.way, TURNS[2:5]) if p.q is not None]
    assert in_line(cell) == "joint_6" and len(q) == 3
    for other in q[1:]:
        np.testing.assert_allclose(other[:, :5], q[0][:, :5], atol=1e-6)
