# SPDX-License-Identifier: Apache-2.0
"""A stored model is put in force only if what it predicts over its envelope can be true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import synthetic
from irec_calibration.cell import read_cell
from irec_calibration.effects import find_effect
from irec_calibration.errors import ModelError
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.model.file import save_model
from irec_calibration.recertification.plausible import check_before_force

CELL = read_cell(Path(synthetic.__file__).parents[2] / "config" / "cells" / "afp.yaml")
COMPLIANCE = (2.5e-7, 2.0e-7, 3.0e-7, 1.0e-6, 1.2e-6, 1.8e-6)  # rad/(N m)


def model(scale: float = 1.0, serial: str = CELL.serial) -> Model:
    torsion = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(scale * c) for k, c in enumerate(COMPLIANCE, 1)})
    home = CELL.home
    envelope = Envelope(tuple((home - 0.3).tolist()), tuple((home + 0.3).tolist()), 1200.0, 50.0)
    return Model((torsion,), serial, urdf_sha256=CELL.robot.sha256, envelope=envelope)


def test_a_sound_model_passes_and_tells_what_it_predicts_at_most(tmp_path: Path) -> None:
    found = check_before_force(save_model(model(), tmp_path / "model.yaml"), CELL)
    assert 5e-4 < found.largest_offset < 5e-3


def test_a_model_that_predicts_more_than_the_limit_is_refused_with_figure_and_file(tmp_path: Path) -> None:
    path = save_model(model(), tmp_path / "model.yaml")
    with pytest.raises(ModelError, match=r"model\.yaml: the model predicts a deflection of .* mm .*; 0\.1 mm is the limit"):
        check_before_force(path, CELL, 1e-4)


def test_a_model_of_another_robot_or_without_an_envelope_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="other"):
        check_before_force(save_model(model(serial="other"), tmp_path / "other.yaml"), CELL)
    with pytest.raises(ModelError, match="envelope"):
        check_before_force(save_model(replace(model(), envelope=None), tmp_path / "none.yaml"), CELL)


def test_the_prediction_is_that_of_the_correction(tmp_path: Path) -> None:
    from irec_correction.deflection import Deflection
    from irec_correction.nodes.model_checks import Mounted, read_checked

    path = save_model(model(), tmp_path / "model.yaml")
    mounted = Mounted(CELL.robot, CELL.serial, "", (0.0, 0.0, -9.81), CELL.payload, 0.1)
    theirs = read_checked(path, mounted)
    assert isinstance(theirs.deflection, Deflection)
    assert check_before_force(path, CELL).largest_offset == pytest.approx(theirs.largest_offset, rel=1e-6)
