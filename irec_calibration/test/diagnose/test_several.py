# SPDX-License-Identifier: Apache-2.0
"""Effects that stand together where structure is left that explains the session as well as any one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from irec_calibration.diagnose import build as building
from irec_calibration.diagnose import several as module
from irec_calibration.diagnose.candidates import options
from irec_calibration.diagnose.explanation import Explanation
from irec_calibration.diagnose.family import Family, family_of
from irec_calibration.diagnose.remainder import grow
from irec_calibration.diagnose.settings import SETTINGS, Settings
from irec_calibration.diagnose.several import Several, several_together
from irec_calibration.effects.scene import Scene
from numpy.typing import NDArray
from test_again import play_and_a_drift
from test_building_blocks import play_of_axis_4, study

Array = NDArray[np.float64]
pytestmark = pytest.mark.slow


@cache
def alone(hidden: Callable[[Scene], Array]) -> tuple[Explanation, Family]:
    asked = study(hidden)
    family = family_of(asked)
    return Explanation((), asked, 0.0, grow(asked.bench, family, asked.base)), family


def together(hidden: Callable[[Scene], Array], settings: Settings = SETTINGS) -> Several:
    start, family = alone(hidden)
    return several_together(start, start, options(start.study)[0], (), family, lambda: None, settings)


def test_effects_that_explain_a_session_together_are_taken_in_by_evidence_of_their_own_and_named() -> None:
    start, found = alone(play_and_a_drift)[0], together(play_and_a_drift)
    assert found.model is not None
    assert set(found.model.ids) == {"joint_backlash", "thermal_drift"} == set(found.evidence)
    assert found.model.log_evidence > start.log_evidence + SETTINGS.nats_to_separate
    assert found.model.remainder.structures == ()


def test_what_can_not_come_in_one_by_one_is_part_of_the_model_that_is_built_with_its_evidence(monkeypatch) -> None:
    monkeypatch.setattr(building, "refused", lambda *_: ("a structure explains as much", 0.0))
    monkeypatch.setattr(building, "two_together", lambda *_: None)
    built = building.build(study(play_and_a_drift))
    assert set(built.final.ids) == {"joint_backlash", "thermal_drift"} == set(built.evidence)
    assert (built.closest, built.reason) == (None, "")


def test_one_effect_by_itself_is_left_to_be_weighed_by_itself() -> None:
    assert together(play_of_axis_4).model is None


def test_what_was_fitted_on_the_way_is_kept_for_those_who_ask_next() -> None:
    found = together(play_and_a_drift)
    assert found.tried[()] and all(t.ids[:-1] == () for t in found.tried[()])


def test_names_that_do_not_stand_together_are_not_given(monkeypatch) -> None:
    monkeypatch.setattr(module, "standing", lambda start, one, family, settings: (start, {}))
    assert together(play_and_a_drift).model is None


def test_a_model_that_explains_no_more_than_what_has_no_name_is_not_taken() -> None:
    start, found = alone(play_and_a_drift)[0], together(play_and_a_drift)
    assert found.model is not None
    gained = found.model.log_evidence - start.log_evidence
    assert together(play_and_a_drift, replace(SETTINGS, nats_to_separate=gained + 1.0)).model is None
