# SPDX-License-Identifier: Apache-2.0
"""A stored model is put in force only if what it predicts over its envelope can be true."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from irec_calibration.cell import read_cell
from irec_calibration.effects import find_effect
from irec_calibration.errors import ModelError
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.model.file import load_model, save_model
from irec_calibration.model.largest import _poses, worst_directions
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


def test_a_model_whose_prediction_is_too_large_under_an_oblique_load_only_is_refused_with_figure_and_load(tmp_path: Path) -> None:
    path = save_model(model(), tmp_path / "model.yaml")
    alone = [
        np.linalg.norm(_predicted(path, q, force * axis, torque * axis))
        for q in _poses(model().envelope, CELL.robot) for axis in np.eye(3) for force, torque in ((1200.0, 0.0), (0.0, 50.0))
    ]  # fmt: skip
    limit = 1.05 * max(alone)
    text = rf"mm at .* 1200 N along \[.*\] and 50 N m about \[.*; {limit * 1e3:g} mm is the limit"
    with pytest.raises(ModelError, match=text) as e:
        check_before_force(path, CELL, limit)
    assert limit < float(re.search(r"deflection of (\S+) mm", str(e.value))[1]) * 1e-3 < np.sqrt(3.0) * 2.0 * limit


def _predicted(path: Path, q: np.ndarray, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
    from irec_correction.deflection import Deflection

    return Deflection(load_model(path), CELL.robot, payload=CELL.payload)(q, force, torque, 0.1)[0]


def test_the_worst_directions_are_the_worst_of_all() -> None:
    """For springs the figure is the maximum itself: no load drawn from all directions displaces more, some nearly as much."""
    rng = np.random.default_rng(0)
    by_force, by_torque = rng.normal(size=(40, 3, 3)), 0.4 * rng.normal(size=(40, 3, 3))
    by_torque[0] = 0.0
    n, m = worst_directions(by_force, by_torque)
    u = np.einsum("pi,pij->pj", n, by_force) + np.einsum("pi,pij->pj", m, by_torque)
    f, t = (w / np.linalg.norm(w, axis=1)[:, None] for w in rng.normal(size=(2, 40000, 3)))
    drawn = np.linalg.norm(np.einsum("ki,pij->pkj", f, by_force) + np.einsum("ki,pij->pkj", t, by_torque), axis=2).max(axis=1)
    assert np.all(np.linalg.norm(u, axis=1) >= drawn) and np.all(np.linalg.norm(u, axis=1) < 1.1 * drawn)


def test_a_model_of_another_robot_or_tool_or_without_an_envelope_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="other"):
        check_before_force(save_model(model(serial="other"), tmp_path / "other.yaml"), CELL)
    roller = replace(CELL, raw={**CELL.raw, "tool": {**CELL.raw["tool"], "name": "roller"}})
    for tool in ("", "spindle"):
        with pytest.raises(ModelError, match="'roller' is mounted"):
            check_before_force(save_model(replace(model(), tool=tool), tmp_path / "tool.yaml"), roller)
    assert check_before_force(save_model(replace(model(), tool="roller"), tmp_path / "tool.yaml"), roller).largest_offset > 0.0
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
