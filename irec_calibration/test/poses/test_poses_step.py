# SPDX-License-Identifier: Apache-2.0
"""Tooling from a STEP file: in metres whatever its unit, near enough to the true surface, and refused with what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.cell.mesh import read_mesh
from irec_calibration.cli import main
from irec_calibration.errors import CellError, PlanError
from irec_calibration.poses import step_file
from irec_calibration.poses.step_file import DEVIATION, mesh_of_step
from step_text import rounded_shell

URDF = Path(__file__).parents[3] / "config" / "robots" / "kr120_r2700_extra_ha.urdf"
RADIUS, LENGTH, ANGLE = 1.5, 1.2, 0.3  # m, m, rad
needs_cascadio = pytest.mark.skipif(step_file.find_spec("cascadio") is None, reason="cascadio is missing: run `make build`")


@needs_cascadio
@pytest.mark.parametrize("in_mm", [True, False])
def test_a_step_surface_is_within_a_tenth_of_a_millimetre_whatever_its_unit(in_mm: bool, tmp_path: Path) -> None:
    unit = 1e3 if in_mm else 1.0
    source, target = tmp_path / "mould.step", tmp_path / "mould.obj"
    source.write_text(rounded_shell(unit * RADIUS, unit * LENGTH, ANGLE, in_mm))
    assert "1.2 " in mesh_of_step(source, target)[0]
    vertices, corners = read_mesh(target)
    assert np.abs(np.hypot(vertices[:, 0], vertices[:, 2]) - RADIUS).max() < 1e-6
    weights = np.random.default_rng(1).dirichlet((1, 1, 1), (len(corners), 20))
    inside = np.einsum("mkc,mcx->mkx", weights, vertices[corners])
    assert np.abs(np.hypot(inside[..., 0], inside[..., 2]) - RADIUS).max() < 1.05 * DEVIATION
    area = 0.5 * np.linalg.norm(np.cross(*(vertices[corners[:, k]] - vertices[corners[:, 0]] for k in (1, 2))), axis=1).sum()
    assert area == pytest.approx(2 * ANGLE * RADIUS * LENGTH, rel=1e-3)


@needs_cascadio
def test_init_cell_makes_a_cell_of_a_step_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "mould.STP"
    source.write_text(rounded_shell(1e3 * RADIUS, 1e3 * LENGTH, ANGLE))
    words = f"init-cell -o {tmp_path}/mine/mine.yaml --urdf {URDF} --serial 1 --tool-frame tool0 --surface {source}"
    words += " --surface-xyz 1.6 0 -1.0 --station A 0.2 -3.0 1.8 --sensor-range 2500 --payload 120"
    assert main(words.split()) in (0, 2), capsys.readouterr().out
    said = capsys.readouterr().out
    assert "triangles within 0.05 mm of its faces" in said
    mesh = read_cell(tmp_path / "mine" / "mine.yaml").surface.mesh()
    assert mesh.vertices[:, 2].max() == pytest.approx(RADIUS - 1.0, abs=1e-4)
    assert (mesh.normal[:, 2] > 0.9).all(), "the tool presses from above"
    again = words.replace("mine.yaml", "again.yaml").split()
    assert main([*again, "--scale", "0.001"]) == 2
    assert "a STEP file states its unit" in capsys.readouterr().err


@needs_cascadio
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("solid nothing", "does not begin with ISO-10303-21"),
        (rounded_shell(1500.0, 1200.0, 0.3)[:2000], "not a STEP file that can be read"),
        (rounded_shell(1500.0, 1200.0, 0.3).replace("CYLINDRICAL", "NONSENSICAL"), "no faces that can be pressed on"),
    ],
)
def test_a_step_file_that_says_nothing_is_refused_with_what_to_do(text: str, sentence: str, tmp_path: Path) -> None:
    source = tmp_path / "mould.step"
    source.write_text(text)
    with pytest.raises(CellError, match=sentence) as refused:
        mesh_of_step(source, tmp_path / "mould.obj")
    assert "export STL from the CAD program" in str(refused.value)
    assert not (tmp_path / "mould.obj").exists()


def test_without_the_package_the_message_says_which_and_what_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_file, "find_spec", lambda name: None if name == "cascadio" else object())
    with pytest.raises(CellError, match=r"needs cascadio: pip install 'irec_calibration\[step\]'; or export STL"):
        mesh_of_step(tmp_path / "mould.step", tmp_path / "mould.obj")


def test_a_cell_file_that_names_a_step_file_is_told_how_a_mesh_is_made(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="STEP is no mesh; irec init-cell --surface makes one of it; or export STL"):
        read_mesh(tmp_path / "mould.step")
