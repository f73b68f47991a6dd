# SPDX-License-Identifier: Apache-2.0
"""A recertification that ends at any moment, as by a power cut: what is in force stays sound, and the run goes on."""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import synthetic
from irec_calibration.model.file import file_sha256, save_model
from irec_calibration.recertification import flow
from irec_calibration.recertification.flow import recertify
from irec_calibration.recertification.request import Request
from irec_calibration.recertification.run_state import interrupted
from irec_calibration.recertification.store import Store
from irec_calibration.session import write_table
from recertification_cell import FakeCell, place, pose_file

PLACE = place()
POSES = 14
fsync = os.fsync
FEWEST_CUTS = 25  # a run writes to the disk so often at the least


class PowerCut(BaseException):
    """Ends everything at once: no `except Exception` sees it."""


class Supply:
    """Cuts the power before the n-th time that something is brought to the disk."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.left = -1
        for owner, name in ((os, "fsync"), (os, "replace"), (Path, "rename"), (shutil, "copyfile"), (flow, "save_model")):
            monkeypatch.setattr(owner, name, self._watched(getattr(owner, name)))

    def _watched(self, write: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(write)
        def watched(*args: Any, **kwargs: Any) -> Any:
            self.left -= 1
            if self.left == 0:
                raise PowerCut
            # what fsync does is not seen by a process that goes on, and a thousand of them take minutes on a busy disk
            return None if write is fsync else write(*args, **kwargs)

        return watched


@pytest.fixture(scope="module")
def commissioned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("commissioned")
    poses = pose_file(folder / "poses.yaml", POSES)
    outcome = recertify(PLACE, Store(folder, "S-1"), Request("M", str(poses)), FakeCell())
    assert outcome.activated, outcome.text
    return folder


@pytest.mark.slow
def test_power_cut_at_any_write_leaves_a_calibration_in_force_and_the_run_goes_on(
    commissioned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # measuring and solving are the same each time: done once
    softer = synthetic.COMPLIANCE * [1.0, 1.2, 1.0, 1.0, 1.0, 1.0]
    session = FakeCell(seed=200, compliance=softer).measured(commissioned / "poses.yaml")

    def run(self: FakeCell, poses: Path, path: Path, resume: bool, enough: Any) -> str:
        write_table(session, path)
        return ""

    monkeypatch.setattr(FakeCell, "run", run)
    first, judged, judge = Store(commissioned, "S-1").entries()[0], [], flow.judge

    def once(session: Any, in_force: Any, *rest: Any) -> Any:
        assert file_sha256(save_model(in_force, tmp_path / "against.yaml")) == first.model_sha256, "judged against another one"
        if not judged:
            judged.append(judge(session, in_force, *rest))
        return judged[0]

    monkeypatch.setattr(flow, "judge", once)
    supply = Supply(monkeypatch)
    number, ended = 0, False
    while not ended:
        number += 1
        shutil.copytree(commissioned, tmp_path / str(number))
        store, poses = Store(tmp_path / str(number), "S-1"), str(tmp_path / str(number) / "poses.yaml")
        supply.left = number
        try:
            recertify(PLACE, store, Request("M", poses, full=True), FakeCell())
            ended = True
        except PowerCut:
            pass
        supply.left = -1

        now = store.in_force()
        assert now is not None and now[0].calibration in ("0001", "0002")
        side = FakeCell()
        if ended or (now[0].calibration == "0002" and not interrupted(store)):
            assert now[0].calibration == "0002"
        else:
            outcome = recertify(PLACE, store, Request("M", poses, full=True, resume=bool(interrupted(store))), side)
            assert outcome.verdict == "recalibrated" and outcome.activated, outcome.text
        assert [e.event for e in store.entries()] == ["added", "put_in_force"] * 2, f"cut at write {number}"
        assert store.in_force_entry().calibration == "0002"  # type: ignore[union-attr]
        assert not interrupted(store) and not list(store.folder.glob(".*.part"))
    assert number > FEWEST_CUTS
