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


def answer(monkeypatch: pytest.MonkeyPatch, odds: float, better_by: float) -> str:
    """What a name is refused for whose evidence is `odds`, that lowers the held-out error by so many standard errors."""
    monkeypatch.setattr(naming, "odds_of", lambda *_: odds)
    monkeypatch.setattr(naming, "needed", lambda *_: SETTINGS.nats_to_name)
    monkeypatch.setattr(naming, "implausible", lambda *_: "")
    monkeypatch.setattr(naming, "in_one_pose", lambda *_: False)
    monkeypatch.setattr(naming, "held_out", lambda *_: None)
    monkeypatch.setattr(naming, "only_good_poses", lambda *_: None)
    monkeypatch.setattr(naming, "gain", lambda *_: (better_by, 1.0, 0))
    study = SimpleNamespace(bench=SimpleNamespace(poses=range(SETTINGS.fewest_poses)))
    bare: Any = SimpleNamespace(study=study, remainder=SimpleNamespace(structures=()))
    one: Any = SimpleNamespace(ids=("joint_backlash",), study=study, remainder=None)
    family: Any = None
    return naming.refused(bare, bare, one, family, SETTINGS)[0]


def test_evidence_makes_up_for_held_out_poses_that_show_little(monkeypatch: pytest.MonkeyPatch) -> None:
    enough, clearly = SETTINGS.nats_to_name, SETTINGS.held_out_sigmas
    assert answer(monkeypatch, 1.01 * enough, clearly) == ""
    assert answer(monkeypatch, 1.49 * enough, clearly / 2) == "it does not help on held-out poses"
    assert answer(monkeypatch, 1.51 * enough, clearly / 2) == ""


@pytest.mark.parametrize("better_by", [0.0, -1.0, float("nan")])
def test_no_evidence_makes_up_for_held_out_poses_that_get_no_better(monkeypatch: pytest.MonkeyPatch, better_by: float) -> None:
    assert answer(monkeypatch, 1e6, better_by) == "it does not help on held-out poses"
