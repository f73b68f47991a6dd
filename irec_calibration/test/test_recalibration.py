# SPDX-License-Identifier: Apache-2.0
"""When a new calibration is put in force."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from irec_calibration.errors import ModelError
from irec_calibration.identify import identify
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model_file import save_model
from irec_calibration.procedure.settings import Acceptance
from irec_calibration.provenance import model_of
from irec_calibration.recalibration import Register, held_out_poses, judge

ACCEPTANCE = Acceptance(min_poses=12, held_out_share=0.3, held_out_rms_m=1e-4, max_ratio_to_old=1.05, max_noise_floors=6.0)


def failed(judgement: object) -> list[str]:
    return [c.name for c in judgement.criteria if not c.holds]  # type: ignore[attr-defined]


def test_a_first_calibration_of_a_healthy_robot_is_accepted() -> None:
    judgement = judge(synthetic.session(20), None, ACCEPTANCE)
    assert judgement.accepted
    assert np.isnan(judgement.rms_old)
    assert f"{1e6 * judgement.rms_new:.1f} um" in judgement.text


def test_held_out_poses_take_no_part_in_the_judged_fit_and_are_whole_poses() -> None:
    session = synthetic.session(20)
    held = held_out_poses(session, 0.3)
    assert len(held) == 6 and len(set(held.tolist())) == 6
    assert set(held) <= set(session.poses)


def test_a_calibration_worse_than_the_one_in_force_is_refused() -> None:
    good = model_of(identify(synthetic.session(31, seed=1), blank_model(EIGHTEEN_DOF)))
    disturbed = synthetic.session(20, seed=2)
    rng = np.random.default_rng(0)
    marker = disturbed.p_marker_in_station + 4e-5 * rng.normal(size=(len(disturbed.poses), 1, 3)).repeat(6, axis=1).reshape(-1, 3)
    marker[disturbed.load_case != 0] += 5e-5 * rng.normal(size=(int((disturbed.load_case != 0).sum()), 3))

    judgement = judge(replace(disturbed, p_marker_in_station=marker), good, ACCEPTANCE)
    assert "max_ratio_to_old" in failed(judgement) or "held_out_rms_m" in failed(judgement)
    assert "FAILED" in judgement.text and not judgement.accepted


def test_a_softer_robot_makes_the_new_calibration_better_than_the_old() -> None:
    old = model_of(identify(synthetic.session(31, seed=1), blank_model(EIGHTEEN_DOF)))
    softer = synthetic.session(20, seed=2, compliance=synthetic.COMPLIANCE * np.array([1, 1.3, 1, 1, 1, 1]))
    judgement = judge(softer, old, ACCEPTANCE)
    assert judgement.accepted
    assert judgement.rms_old > 2 * judgement.rms_new


def test_too_few_poses_are_refused() -> None:
    assert "min_poses" in failed(judge(synthetic.session(8), None, ACCEPTANCE))


def test_the_register_keeps_every_model_that_was_in_force(tmp_path: Path) -> None:
    register = Register(tmp_path / "calibrations")
    assert register.current("KR-1") is None
    model = model_of(identify(synthetic.session(12), blank_model(EIGHTEEN_DOF)))
    for name in ("a.yaml", "b.yaml"):
        register.put_in_force("KR-1", save_model(model, tmp_path / name), "s.mcap", "M. Muster")
    path, _ = register.current("KR-1")  # type: ignore[misc]
    assert path.name == "b.yaml"
    assert [Path(e["model"]).name for e in register.entries("KR-1")] == ["a.yaml", "b.yaml"]
    assert register.current("KR-2") is None


def test_a_model_changed_after_it_was_put_in_force_is_not_trusted(tmp_path: Path) -> None:
    register = Register(tmp_path)
    model = save_model(model_of(identify(synthetic.session(12), blank_model(EIGHTEEN_DOF))), tmp_path / "a.yaml")
    register.put_in_force("KR-1", model, "s.mcap", "M. Muster")
    model.write_text(model.read_text() + "\n")
    with pytest.raises(ModelError, match="changed since"):
        register.current("KR-1")
