# SPDX-License-Identifier: Apache-2.0
"""A reading that is an accident for certain has noise of its own before causes are weighed; a step that lasts has not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose, start_terms
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects.scene import Scene
from irec_calibration.session import Session
from numpy.typing import NDArray

POSE, FAR = 9, np.array([6e-4, -5e-4, 4e-4])
ROW = {"load case of one pose": 3, "last load case of one pose": 5, "reference of one pose": 0}


def soft_tool(scene: Scene) -> NDArray[np.float64]:
    """So that the model that is asked about lacks something beside the accident."""
    return np.einsum("nij,nj->ni", scene.kin.R_tool, np.array([5e-7, 3e-7, 8e-7]) * scene.force_in_tool)


def measured(load_case: int | None = None, later: bool = False, by: float = 1.0) -> Session:
    """A session in which a reading is off, or all that come later too."""
    session = synthetic.session(poses=22, seed=3, extra=soft_tool)
    if load_case is None:
        return session
    at = (session.pose == POSE) & (session.load_case == load_case)
    if later:
        at |= session.stamp > session.stamp[at].max()
    return replace(session, p_marker_in_station=session.p_marker_in_station + by * at[:, None] * FAR)


def set_apart(session: Session) -> list[int]:
    """Load cases of the rows that have noise of their own where alternatives are weighed."""
    study = prepare(session, start_terms(session)).to_weigh
    return sorted({int(session.load_case[r]) for p in study.apart for r in p.structure.rows})


def test_nothing_is_an_accident_where_only_a_cause_is_missing() -> None:
    assert set_apart(measured()) == []


@pytest.mark.parametrize("where", ROW)
def test_one_reading_that_is_far_off_is_an_accident(where: str) -> None:
    found = set_apart(measured(ROW[where], by=0.4))
    assert found == ([1, 2, 3, 4, 5] if "reference" in where else [ROW[where]])


def test_a_step_that_later_readings_have_too_is_none() -> None:
    assert set_apart(measured(5, later=True, by=0.4)) == []


def test_one_reading_that_is_little_off_is_weighed_with_the_causes() -> None:
    assert set_apart(measured(3, by=0.1)) == []


@pytest.mark.long
def test_beside_an_accident_a_cause_is_named_and_a_bumped_station_is_no_rival_of_it() -> None:
    session = measured(5, by=0.4)
    verdict = diagnose(session).verdict
    assert "tool_compliance" in verdict.effects
    assert not any("station_shift" in several for several in verdict.one_of)
    assert f"pose {POSE}" in verdict.text


@pytest.mark.long
def test_a_plainly_wrong_last_reading_is_kept_where_the_readings_of_later_poses_have_the_step_too() -> None:
    once, lasting = (prepare(s, start_terms(s)) for s in (measured(5), measured(5, later=True)))
    row = int(np.flatnonzero((once.session.pose == POSE) & (once.session.load_case == 5))[0])
    assert row not in once.observation.rows and any("left out" in str(b) for b in once.observation.bad)
    assert row in lasting.observation.rows
    assert "station_shift" in diagnose(measured(5, later=True)).verdict.effects


def by_two_reflectors(session: Session) -> Session:
    """Each reading again by a second reflector at the same place."""
    twice = session.select(np.repeat(np.arange(len(session)), 2))
    noise = np.random.default_rng(5).normal(0.0, 8e-6, (len(twice), 3)) * np.tile([0.0, 1.0], len(session))[:, None]
    markers = (*session.markers, replace(session.markers[0], name="B"))
    return replace(
        twice, marker=np.tile([0, 1], len(session)), markers=markers, p_marker_in_station=twice.p_marker_in_station + noise
    )


def test_a_step_that_several_reflectors_show_lasts_as_one_reflectors_does() -> None:
    """Left out as plainly wrong, row by row of each reflector, it would be no cause."""
    once, lasting = (by_two_reflectors(measured(5, later=later)) for later in (False, True))
    rows = np.flatnonzero((lasting.pose == POSE) & (lasting.load_case == 5))
    assert not set(rows) & set(prepare(once, start_terms(once)).observation.rows)
    assert set(rows) <= set(prepare(lasting, start_terms(lasting)).observation.rows)


@pytest.mark.long
def test_a_station_that_is_bumped_between_a_reference_and_its_load_cases_is_named_wherever_it_stands() -> None:
    quiet = measured()
    reference = quiet.stamp[(quiet.pose == POSE) & (quiet.load_case == 0)].max()
    bumped = quiet.p_marker_in_station + (quiet.stamp > reference)[:, None] * FAR + [0.03, -0.02, 0.01]
    verdict = diagnose(replace(quiet, p_marker_in_station=bumped)).verdict
    assert "station_shift" in verdict.effects
    assert f"Station shift breaks pose {POSE}, which no other pose predicts" in verdict.text
    assert "without that pose" in verdict.text
    assert not any("station_shift" in several for several in verdict.one_of)
