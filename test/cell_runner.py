# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 on the simulated cell without ROS: the state machine of the procedure and the plant in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell
from irec_calibration.errors import IrecError
from irec_calibration.poses.store import read_poses
from irec_calibration.procedure.checks import plan_targets
from irec_calibration.procedure.commands import CancelMove, Event, ForceSetpoint, MoveJoint, MoveLinear, Row, SwitchMode
from irec_calibration.procedure.machine import Procedure
from irec_calibration.procedure.settings import read_settings
from irec_calibration.procedure.standstill import Streams
from irec_calibration.session import Session, read_session
from irec_sim.cell import Cell as SimulatedCell
from irec_sim.cellfile import read_cell as read_simulated
from irec_sim.kinematics import quaternion_of_rotation
from irec_sim.motion import joint_move, linear_move
from irec_sim.truth import make_truth

STEPS = 5  # of the plant between two looks of the procedure
LONGEST = 3600.0  # s of the cell
ARRIVAL = 0.2  # s


def run_procedure(cell: Cell, folder: Path, seed: int = 1) -> tuple[Session, Procedure]:
    """Measure the poses of a cell file on the simulator, write the table of the session, read it back."""
    settings = read_settings(cell)
    file = read_simulated(cell.path)
    plant = SimulatedCell(file, make_truth(file.name, [], seed, effort=file.chain.effort), seed)
    poses = read_poses(cell.poses_path, cell.serial, cell.robot.sha256)
    rail = np.array([p.ext.get("rail", 0.0) for p in poses.poses])
    targets = plan_targets(cell, settings, np.array([p.q for p in poses.poses]), rail, [p.index for p in poses.poses])
    streams = Streams(5.0 + settings.window_s)
    rotation = {s.name: s.R_in_cell for s in cell.stations}
    procedure = Procedure(targets, cell.forces_in_tool, cell.home, settings, streams, rotation)
    names = tuple(cell.robot.joint_names) + plant.rail_names
    rows: list[Row] = []
    move, since = None, 0.0
    procedure.watch.robot_said(plant.mode)
    procedure.start()
    while procedure.state != "finished":
        if plant.time > LONGEST:
            raise TimeoutError(f"still in {procedure.state}: {procedure.message}")
        for _ in range(STEPS):
            if move is not None:
                t = plant.time + plant.period - since
                plant.command(*move.at(move.way.distance(t)))
                if move.way.done(t - ARRIVAL):
                    move = None
                    procedure.move_finished(True)
            plant.step()
            q, at = plant.joints()
            streams.add_joints(plant.time, names, (*q.tolist(), at) if plant.rail_names else tuple(q.tolist()))
            p, R = plant.tcp()
            streams.add_tcp(plant.time, *p.tolist(), *quaternion_of_rotation(R).tolist())
            streams.add_wrench(plant.time, tuple(plant.wrench().tolist()))
        reading = plant.tracker()
        if reading is not None:
            streams.add_marker(plant.time, *reading[1].tolist(), reading[0])
        procedure.watch.robot_said(plant.mode)
        for command in procedure.step(plant.time, plant.time):
            if isinstance(command, MoveJoint):
                goal = command.q, plant.joints()[1] if command.rail is None else command.rail
                move, since = joint_move(plant.chain, plant.commanded, goal, command.speed, 0.5), plant.time
            elif isinstance(command, MoveLinear):
                q, at = plant.commanded
                move, since = linear_move(plant.chain, q, at, command.p_in_base, command.R_in_base, command.speed), plant.time
            elif isinstance(command, CancelMove):
                move = None
            elif isinstance(command, SwitchMode):
                plant.control_force(command.force_in_tool) if command.force else plant.control_position()
                procedure.mode_switched(True, "", 0.5)
            elif isinstance(command, ForceSetpoint):
                plant.set_force(command.force_in_tool)
            elif isinstance(command, Row):
                rows.append(command)
            elif isinstance(command, Event) and command.kind == "stopped":
                raise IrecError(f"the run stopped: {command.text}")
    return session_of(cell, rows, folder), procedure


def session_of(cell: Cell, rows: list[Row], folder: Path) -> Session:
    """Write the rows as the table of a session, and read it back."""
    import yaml

    folder.mkdir(parents=True)
    n = cell.robot.n_joints
    head = ["pose", "load_case", "repeat", "stamp", *(f"joint_{k + 1}" for k in range(n))]
    head += ["ext_rail"] * (cell.rail is not None)
    head += [f"{v}_{a}" for v in ("tcp", "marker", "force", "torque") for a in "xyz"] + ["station"]
    lines = [",".join(head)]
    for row in rows:
        w = row.window
        values = [w.q, w.p_tcp_in_base, w.p_marker_in_station, w.force_in_tool, w.torque_in_tool]
        numbers = [repr(float(v)) for block in values for v in block.mean(axis=0)]
        lines.append(",".join([str(row.pose), str(row.load_case), str(row.repeat), repr(w.end), *numbers, w.station]))
    (folder / "samples.csv").write_text("\n".join(lines) + "\n")
    (folder / "robot.urdf").write_text(cell.robot.urdf_text)
    header = {
        "format": "irec-session/1", "name": cell.name, "robot": {"urdf": "robot.urdf", "serial": cell.serial},
        "marker_in_tool0": cell.marker_in_tool.tolist(), "stations": [dict(s) for s in cell.raw["stations"]], "noise": cell.noise,
    }  # fmt: skip
    if cell.rail is not None:
        header["ext_axes"] = {"rail": {"kind": "prismatic", "axis": cell.rail.axis.tolist()}}
    (folder / "session.yaml").write_text(yaml.safe_dump(header))
    return read_session(folder)
