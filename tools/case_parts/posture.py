# SPDX-License-Identifier: Apache-2.0
"""Posture by the calibrated stiffness (paper 4.3.1): the tool turned about the spindle, on courses not learnt from."""

from __future__ import annotations

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.model.file import load_model
from irec_calibration.poses.posture import Posture, ToolWay, in_line, stiffest, try_turns
from irec_calibration.report.page import Figure, Section, Table
from irec_calibration.report.style import pyplot, save
from irec_calibration.sensors.force_profile import CommonForce
from irec_calibration.session import read_session
from irec_sim.production.ways import Ways

from .jobs import Case
from .learned import expected

STEP = 30  # degrees between two turns
POINTS = 30  # of a course


def posture_section(case: Case, ways: Ways, profile: CommonForce) -> Section:
    """What each turn would do on these courses under the force that the training courses told."""
    cell, session = read_cell(case.cell_path), read_session(case.out / "session")
    model = load_model(case.out / "model_18dof.yaml")
    turns = np.radians(np.arange(-180, 180, STEP))
    told: dict[str, list[Posture]] = {}
    for i in np.unique(np.linspace(0, len(ways.names) - 1, 4).astype(int)):
        told[ways.names[i]] = try_turns(cell, session, model, _way(ways, int(i), profile), turns)
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(9, 3.6), layout="constrained")
    rows: list[list[object]] = []
    for name, found in told.items():
        free = [p for p in found if not p.hindered]
        ax.plot(np.degrees([p.turn for p in free]), [1e3 * p.mean for p in free], marker=".", label=name)
        now, best = next(p for p in found if abs(p.turn) < 1e-9), stiffest(found)
        if best is not None:
            gain = 100.0 * (1.0 - best.mean / now.mean)
            figures = (f"{1e3 * p.mean:.3f}" for p in (now, best))
            rows.append([name, f"{np.degrees(best.turn):.0f}", *figures, f"{gain:.1f} %", len(free)])
    ax.set(xlabel="turn of the tool about the spindle's axis [deg]", ylabel="predicted mean error [mm]", ylim=(0.0, None))
    figure.legend(loc="outside right upper", fontsize=8)
    path = save(figure, case.out / "posture.png")
    text = [
        "The paper chose postures by the stiffness that the calibrated model tells. Here the tool is turned about its spindle, "
        "step by step, under the force that the training courses told; joint limits, singularities, torques and the tooling are "
        "looked at (irec posture)."
    ]
    if joint := in_line(cell):
        text.append(
            f"On this cell the spindle is in line with {joint}: turning it moves no other joint, and the arm stands as it stood. "
            "What the model tells for a turn is the last joint's own elasticity across its axis alone, so the courses were not "
            "driven turned. A spindle across the flange has more to gain: a test holds the model against the plant there."
        )
    header = ["course", "best turn [deg]", "predicted now [mm]", "at the best turn [mm]", "less by", "possible turns"]
    return Section("Posture", text, [Figure(path, "Predicted mean error, turn by turn.")], [Table(header, rows)])


def _way(ways: Ways, i: int, profile: CommonForce) -> ToolWay:
    """Some points of course i with the force expected there."""
    steps = int(ways.driving[:, i].sum())
    k = np.linspace(0.05 * steps, 0.95 * steps, POINTS).astype(int)
    R = ways.R_tool[k, i]
    force = (R @ expected(profile, ways, i)[k][:, :, None])[..., 0]
    return ToolWay(ways.p_in_cell[k, i], R, force, ways.counts[k, i], {})
