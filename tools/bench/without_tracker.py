# SPDX-License-Identifier: Apache-2.0
"""What a calibration without the tracker foretells, beside one with it, on simulated robots of the AFP cell.

All models (18 DOF) come from one session at the planned poses. Their predictions are held against the plant's true deflection at
other poses: error along tool0 z and across it, um RMS per axis, under the normal force alone and with a force across the tool.
The plant's disc gives way by 2.5e-7 m/N along and 6.7e-7 m/N across; in the last pair of columns it is known but for 5 %.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.diagnose import solved
from irec_calibration.effects.of_session import scene_of
from irec_calibration.identification.identify import default_terms
from irec_calibration.model import Model
from irec_calibration.session import Session, read_session
from irec_calibration.session.without_tracker import without_tracker
from irec_calibration.typing import Array
from irec_sim.cellfile import CellFile
from irec_sim.cellfile import read_cell as read_sim_cell
from irec_sim.kinematics import forward
from irec_sim.production.hard import read_hard
from irec_sim.session import Generated, generate, write_session
from irec_sim.truth import Truth

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from case_parts.calibrated import DISC, planned_poses  # noqa: E402

CELL, HARD = ROOT / "config" / "cells" / "afp.yaml", ROOT / "config" / "truths" / "case_afp.yaml"
ENCODER = 2e-6  # rad
LIGHT = (0.0, 0.0, -300.0)  # N, a sixth load case


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=40, help="other poses that predictions are judged at (default: 40)")
    parser.add_argument("--only", type=int, help="number of one plant, from 0")
    args = parser.parse_args(arguments)
    sim = read_sim_cell(CELL)
    print(f"{'':42} {'':10} {'deflection':>14}   {'with tracker':>14}   {'without':>14}   {'disc known':>14}   disc, m/N")
    heads = "   ".join([f"{'z':>5} {'across':>8}"] * 4)
    print(f"{'plant':42} {'force':10} {heads}   {'normal':>9}  {'lateral':>9}")
    for name, make in list(plants(sim).items())[slice(args.only, None if args.only is None else args.only + 1)]:
        row(name, *make(), args.poses)
    return 0


def plants(sim: CellFile) -> dict[str, Callable[[], tuple[CellFile, Truth, float]]]:
    """Name -> cell, plant and noise of the encoders, rad."""
    hard = read_hard(HARD, sim).truth
    elastic = replace(hard, hidden=())
    springy = replace(hard, hidden=tuple(h for h in hard.hidden if h.effect == "tool_compliance"))
    light = replace(sim, load_cases=np.vstack([sim.load_cases, LIGHT]), load_case_names=(*sim.load_case_names, "light"))
    return {
        "springs of joints and links": lambda: (sim, elastic, ENCODER),
        "+ a sixth load case of 300 N": lambda: (light, elastic, ENCODER),
        "+ a head of 20 N/um across, 50 along": lambda: (sim, springy, ENCODER),
        "+ a head three times as soft": lambda: (sim, springy.scaled("tool_compliance", 3.0), ENCODER),
        "the hard plant": lambda: (sim, hard, ENCODER),
        "the hard plant, encoders of 20 urad": lambda: (sim, hard, 10.0 * ENCODER),
        "the hard plant, a sixth load case of 300 N": lambda: (light, hard, ENCODER),
    }


def row(name: str, cell: CellFile, truth: Truth, encoder: float, poses: int) -> None:
    """Measure, solve twice, hold both against the truth elsewhere; a line each for loads without and with a force across."""
    with tempfile.TemporaryDirectory() as place:
        made = generate(cell, truth, 1, 11, at=planned_poses(cell, read_cell(CELL)))
        session = _written(_with_encoders(made, encoder), Path(place) / "session")
        other = generate(cell, truth, poses, 5)
        elsewhere, true = _written(other, Path(place) / "other"), other.rows[0].deflection.reshape(-1, 3)
    read = (session, without_tracker(session), without_tracker(session, disc=DISC))
    models = [solved(s, default_terms(s))[0] for s in read]
    scene = scene_of(elsewhere, observe="tcp")
    loaded = elsewhere.load_case > 0
    R = scene.kin.R_tool[loaded]
    shown = [_in_tool(R, x) for x in (true, *(m.predict(scene)[loaded] - true for m in models))]
    sideways = np.linalg.norm(elsewhere.force_in_tool[loaded][:, :2], axis=1) > 100.0
    for title, what, rows, disc in ((name, "normal", ~sideways, _disc(models[1])), ("", "across too", sideways, "")):
        print(f"{title:42} {what:10} {'   '.join(_figures(x[rows]) for x in shown)}   {disc}".rstrip(), flush=True)


def _figures(x: Array) -> str:
    along, across = np.sqrt((x[:, 2] ** 2).mean()), np.sqrt((x[:, :2] ** 2).mean())
    return f"{1e6 * along:5.0f} {1e6 * across:8.0f}"


def _disc(model: Model) -> str:
    found = model.terms[-1].estimates
    return "  ".join(f"{found[n].value:9.2e}" if n in found else f"{'-':>9}" for n in ("c_normal", "c_lateral"))


def _in_tool(R: Array, x: Array) -> Array:
    return np.asarray(np.einsum("nji,nj->ni", R, x))


def _with_encoders(made: Generated, noise: float) -> Generated:
    rng = np.random.default_rng(3)
    for k, one in enumerate(made.passes):
        q = one.q + rng.normal(0.0, noise, one.q.shape)
        p = forward(made.cell.chain, q.reshape(-1, q.shape[-1])).p_tcp.reshape(*q.shape[:2], 3)
        made.passes[k] = replace(one, q=q, p_controller=p)
    return made


def _written(made: Generated, folder: Path) -> Session:
    return read_session(write_session(made, folder, folder.name))


if __name__ == "__main__":
    sys.exit(main())
