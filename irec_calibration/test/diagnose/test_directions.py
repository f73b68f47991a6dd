# SPDX-License-Identifier: Apache-2.0
"""Variables and directions of structures: of what a session has, and of nothing that only rounding leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose.directions import bearing, shaped, varying
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.study import Study, prepare
from irec_calibration.identification.identify import default_terms


@pytest.fixture(scope="module")
def pushed_along_axis_6() -> Study:
    """A session whose forces are all along the last axis, which so bears none of them."""
    made = synthetic.session(12, seed=4, lateral=0.0)
    made = replace(made, force_in_tool=made.force_in_tool * np.array([0.0, 0.0, 1.0]))
    return prepare(made, default_terms(made))


def test_the_torque_of_an_axis_that_bears_none_is_no_variable(pushed_along_axis_6: Study) -> None:
    assert np.ptp(pushed_along_axis_6.ready.load_torque()[:, 5]) > 0.0  # by rounding
    assert bearing(pushed_along_axis_6) == [0, 1, 2, 3, 4]
    assert {f"tau_{k}" for k in range(1, 7)} & {*varying(pushed_along_axis_6)} == {f"tau_{k}" for k in range(1, 6)}


def test_no_structure_follows_it(pushed_along_axis_6: Study) -> None:
    structures = family_of(pushed_along_axis_6).structures
    assert any("tau_5" in s.variables for s in structures)
    shown = [s for s in structures if "tau_6" in s.variables]
    assert all(s.law_of is None and s.axis != 5 for s in shown), [s.words for s in shown]


@pytest.mark.parametrize("words", ["along the elastic deflection", "as compliance of axis 2"])
def test_what_all_load_cases_have_in_common_is_left_to_the_springs(pushed_along_axis_6: Study, words: str) -> None:
    (by_load_case,) = (d for d in shaped(pushed_along_axis_6) if d.words == words and d.variables[0] == "load_case")
    assert np.abs(by_load_case.columns).max() > 0.0
    assert np.abs(by_load_case.columns.sum(axis=2)).max() < 1e-12 * np.abs(by_load_case.columns).max()
