# SPDX-License-Identifier: Apache-2.0
"""When readings that stand out follow one effect of impossible size."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from irec_calibration.diagnose import naming
from irec_calibration.diagnose.settings import SETTINGS


def asked(monkeypatch: pytest.MonkeyPatch, odds: float, rows: int, beyond: str = "b_2 = 1 rad", one_pose: bool = False) -> bool:
    monkeypatch.setattr(naming, "odds_of", lambda *_: odds)
    monkeypatch.setattr(naming, "implausible", lambda *_: beyond)
    monkeypatch.setattr(naming, "in_one_pose", lambda *_: one_pose)
    monkeypatch.setattr(naming, "needed", lambda *_: SETTINGS.nats_to_name)
    bare: Any = SimpleNamespace(remainder=SimpleNamespace(bad_rows=(None,) * rows))
    one: Any = SimpleNamespace(ids=("joint_backlash",))
    family: Any = None
    return naming.one_cause_of_bad_rows(bare, one, family, SETTINGS)


def test_each_reading_that_stands_out_asks_for_more_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked(monkeypatch, odds=9.6, rows=3)
    assert not asked(monkeypatch, odds=9.4, rows=3)


def test_without_such_readings_or_within_what_can_be_there_is_nothing_to_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not asked(monkeypatch, odds=99.0, rows=0)
    assert not asked(monkeypatch, odds=99.0, rows=3, beyond="")


def test_a_step_in_one_pose_is_a_bad_reading_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not asked(monkeypatch, odds=99.0, rows=3, one_pose=True)
