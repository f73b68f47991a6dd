# SPDX-License-Identifier: Apache-2.0
"""An integrator's own robot and tooling, from a vendor's description to a corrected deflection, in simulation without ROS."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cell_runner import run_procedure
from irec_calibration.cell import Cell, read_cell
from irec_calibration.cli import main
from irec_calibration.diagnose import validated
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import Model
from irec_calibration.poses.pool import generate_pool
from irec_correction.deflection import Deflection
from irec_sim.cell import Cell as SimulatedCell
from irec_sim.cellfile import read_cell as read_simulated
from irec_sim.truth import make_truth
from three_robots import irb6700, panda, ur10e

pytest.importorskip("trimesh", reason="extra 'mesh' is not installed")


def stl_in_mm(path: Path, inwards: bool) -> None:
    """A mould as CAD programs export it: millimetres; 0.7 m by 0.9 m, curved, its normals as wanted."""
    u, v = np.meshgrid(np.linspace(-0.35, 0.35, 15), np.linspace(-0.45, 0.45, 19), indexing="ij")
    p = 1000.0 * np.stack([u, v, -(u**2) / 3.0 - v**2 / 4.0], axis=-1)
    triangles = []
    for i in range(14):
        for j in range(18):
            a, b, c, d = p[i, j], p[i + 1, j], p[i + 1, j + 1], p[i, j + 1]
            triangles += [(a, b, c), (a, c, d)]
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", len(triangles)))
        for t in triangles:
            corners = t[::-1] if inwards else t
            file.write(struct.pack("<12f", 0, 0, 0, *np.concatenate(corners)) + b"\0\0")


def probed_points(path: Path) -> None:
    """A plate touched at 30 points, in millimetres, in base_link: before the robot, leaning a little."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.35, 0.60, 40), rng.uniform(-0.2, 0.2, 40)
    corners = np.array([[0.33, -0.22], [0.62, -0.22], [0.62, 0.22], [0.33, 0.22]])
    x, y = np.r_[x, corners[:, 0]], np.r_[y, corners[:, 1]]
    z = 0.12 + 0.08 * (x - 0.5)
    path.write_text(
        "x;y;z\n" + "\n".join(f"{1000 * a:.2f};{1000 * b:.2f};{1000 * c:.3f}" for a, b, c in zip(x, y, z, strict=True))
    )


def options(robot: str, tmp_path: Path) -> list[str]:
    """What an integrator would type for each robot."""
    description = tmp_path / f"{robot}_vendor.urdf"
    common = f"--urdf {description} --serial {robot}-1 "
    if robot == "ur10e":
        description.write_text(ur10e())
        rest = (
            "--surface block 0.5 0.7 0.3 --surface-xyz 0.75 0 0.05 --tool-xyz 0 0 0.18 --sensor-range 250 --payload 12.5"
            " --station A 0.3 -2.5 1.8 --station B 0.3 2.5 1.8 --friction 0.6"
        )
    elif robot == "panda":
        description.write_text(panda())
        probed_points(tmp_path / "probed.csv")
        rest = (
            f"--base-frame panda_link0 --tool-frame panda_link8 --tool-xyz 0 0 0.12 --surface {tmp_path}/probed.csv"
            " --station A 0.2 -2.0 1.4 --station B 0.2 2.0 1.4 --sensor-range 100 --payload 3 --marker 0 0 -0.04"
        )
    else:
        description.write_text(irb6700())
        stl_in_mm(tmp_path / "mould.stl", inwards=True)
        rest = (
            f"--base-frame abb_base --tool-frame flange --tool-xyz 0.35 0 0 --tool-rpy 0 90 0 --surface {tmp_path}/mould.stl"
            " --surface-xyz 1.9 0 0.9 --surface-rpy 0 -30 0 --station A 0.5 -3.5 2.4 --station B 0.5 3.5 2.4"
            " --sensor-range 2500 --payload 200"
        )
    return (common + rest).split()


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        ("ur10e", []),
        ("panda", ["probed points", "taken as millimetres"]),
        ("irb6700", ["scale: 0.001", "turned round (flip: true)"]),
    ],
)
def test_a_cell_file_comes_from_a_vendors_description_and_is_right(robot, said, tmp_path, capsys):
    cell = tmp_path / "mine.yaml"
    code = main(["init-cell", "-o", str(cell), *options(robot, tmp_path)])
    out = capsys.readouterr().out
    assert code == 0, out
    for part in said:
        assert part in out
    assert main(["check", str(cell)]) == 0
    assert read_cell(cell).robot.n_joints == (7 if robot == "panda" else 6)


def test_what_is_not_given_is_named_at_once(tmp_path, capsys):
    assert main(["init-cell", "-o", str(tmp_path / "c.yaml")]) == 2
    said = capsys.readouterr().err
    for option in ("--urdf", "--serial", "--surface", "--station", "--sensor-range", "--payload"):
        assert option in said


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("robot", ["ur10e", *(pytest.param(r, marks=pytest.mark.long) for r in ("panda", "irb6700"))])
def test_three_foreign_robots_are_planned_measured_identified_and_corrected(robot, tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    assert main(["init-cell", "-o", str(path), *options(robot, tmp_path)]) == 0
    assert main(["plan", str(path), "-n", "6", "--pool", "30"]) == 0
    assert main(["show-cell", str(path)]) == 0
    out = capsys.readouterr().out
    assert path.with_suffix(".png").stat().st_size > 20_000
    assert "sees the marker best" in out
    cell = read_cell(path)
    session, procedure = run_procedure(cell, tmp_path / "session")
    assert procedure.counts.complete >= 5, procedure.stopped_because
    fit = identify(session, default_terms(session))
    measured = float(np.sqrt((fit.observation.y**2).sum(axis=1).mean()))
    left = validated(session, fit.terms).held_out.rms_m
    assert left < 0.3 * measured, f"{1e6 * left:.1f} um of {1e6 * measured:.1f} um are left at poses that the fit has not seen"
    without, corrected = corrected_at_new_poses(cell, model_of(fit))
    assert corrected < 0.3 * without, f"corrected {1e6 * corrected:.1f} um, without {1e6 * without:.1f} um"


def corrected_at_new_poses(cell: Cell, model: Model) -> tuple[float, float]:
    """RMS of the true deviation at poses that were not measured, under the largest load case, without and with correction, m."""
    pool = generate_pool(cell, 3, seed=77)
    file = read_simulated(cell.path)
    truth = make_truth(file.name, [], 1, effort=file.chain.effort)  # that of run_procedure
    force = cell.forces_in_tool[1]
    deviation: list[list[float]] = [[], []]
    for q, rail in zip(pool.q, pool.rail, strict=True):
        translation, turn = Deflection(model, cell.robot)(q, force, np.zeros(3), 0.004)
        for corrected in (0, 1):
            plant = SimulatedCell(replace(file, home=q), truth, 5)
            plant.command(q, float(rail))
            plant.set_process(force)
            for _ in range(150):
                if corrected:
                    plant.set_offset(-translation, -turn, plant.time)
                plant.step()
            deviation[corrected].append(float(np.linalg.norm(plant.true_deviation())))
    without, left = (float(np.sqrt(np.mean(np.square(d)))) for d in deviation)
    return without, left
