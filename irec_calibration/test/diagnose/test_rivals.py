# SPDX-License-Identifier: Apache-2.0
"""How far apart two effects in each other's place have to be before one is named."""

from __future__ import annotations

import pytest
from irec_calibration.diagnose.rivals import as_they_count
from irec_calibration.diagnose.settings import SETTINGS


@pytest.mark.parametrize("own", [10.0, 100.0])
def test_two_laws_of_torque_need_more_to_be_told_apart_the_stronger_they_show(own: float) -> None:
    least = SETTINGS.nats_over_rival + SETTINGS.share_between_laws * own
    short, enough = (as_they_count(least + more, own, SETTINGS.share_between_laws) for more in (-0.1, 0.1))
    assert short < SETTINGS.nats_over_rival < enough


def test_odds_over_an_effect_of_another_kind_count_as_they_are() -> None:
    assert as_they_count(2.4, 100.0, 0.0) == 2.4


@pytest.mark.parametrize("odds", [-1.0, 0.005, 3.0])
def test_the_likelier_of_two_laws_is_named_first(odds: float) -> None:
    assert (as_they_count(odds, 100.0, SETTINGS.share_between_laws) > 0.0) == (odds > 0.0)
