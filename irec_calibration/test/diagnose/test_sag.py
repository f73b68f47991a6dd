# SPDX-License-Identifier: Apache-2.0
"""What the arm sags on its way to the contact is known by the masses of its description only: the session has to show it."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic
from irec_calibration.diagnose import Diagnosis, compare, diagnose, solved, start_terms
from irec_calibration.model.file import load_model, save_model
from irec_calibration.session import Noise, Session
from test_diagnose import play_of_axis_4

PRECISE = Noise(tracker_m=4e-6, force_n=0.5)


def cell(sags: float, **changed: object) -> Session:
    return synthetic.session(24, seed=3, noise=PRECISE, sags=sags, approach=2e-3, **changed)


def notes_on_sag(found: Diagnosis) -> list[str]:
    return [n for n in found.notes if n.startswith("what the arm sags")]


@pytest.mark.parametrize("sags", [0.0, 0.4])
def test_a_controller_that_corrects_for_the_sag_of_its_arm_has_no_geometry_error(sags: float) -> None:
    found = diagnose(cell(sags))
    assert (found.verdict.status, found.verdict.effects) == ("adequate", ())
    (note,) = notes_on_sag(found)
    assert abs(float(note.split("shows by ")[1].split(" %")[0]) / 100.0 - sags) < 0.15


def test_an_arm_that_sags_as_its_masses_say_needs_no_word() -> None:
    assert notes_on_sag(diagnose(cell(1.0))) == []


def test_what_is_missing_is_named_beside_a_sag_that_is_corrected_for() -> None:
    found = diagnose(cell(0.0, extra=play_of_axis_4))
    assert found.verdict.effects == ("joint_backlash",)
    assert len(notes_on_sag(found)) == 1


def test_a_model_keeps_how_much_of_the_sag_its_sessions_show(tmp_path: Path) -> None:
    session = cell(0.0)
    save_model(solved(session, start_terms(session))[0], tmp_path / "model.yaml")
    model = load_model(tmp_path / "model.yaml")
    assert model.sag_share < 0.15
    left = compare(session, model.terms, model.sag_share).rms_m
    assert left == pytest.approx(model.figures["fit_rms_m"], rel=1e-6)
    assert left < 0.9 * compare(session, model.terms).rms_m
