# SPDX-License-Identifier: Apache-2.0
"""Versions that were kept: back and forth between them, and found again after the server was killed."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.errors import IrecError
from irec_calibration.workbench.free_names import free_path
from irec_calibration.workbench.plain import Version
from irec_calibration.workbench.room import fingerprint
from irec_calibration.workbench.versions import Versions, new_folder, past_work


def version(folder: Path, name: str) -> Version:
    (folder / f"{name}.yaml").write_text(name)
    none, path = np.zeros((0, 3)), str(folder / f"{name}.yaml")
    return Version(name, path, (), (), np.zeros(0, int), none, none, none, none[:, 0], none, 0, 0, 0, 0, 0)


@pytest.fixture
def versions(tmp_path):
    made = Versions("/data/session", new_folder(tmp_path, "/data/session"))
    for name in ("a", "b", "c"):
        made.keep(version(made.folder, name))
    return made


def test_undo_and_redo_go_back_and_forth(versions):
    versions.undo()
    versions.undo()
    assert versions.current.name == "a" and not versions.can_undo
    versions.redo()
    assert versions.current.name == "b"


def test_going_to_an_earlier_version_can_be_undone(versions):
    versions.go_to(0)
    versions.undo()
    assert versions.current.name == "c"


def test_a_version_kept_after_an_undo_ends_the_way_forth_but_loses_no_version(versions):
    versions.undo()
    versions.keep(version(versions.folder, "d"))
    assert not versions.can_redo and [v.name for v in versions.all] == ["a", "b", "c", "d"]


def test_a_version_that_is_not_there_is_refused(versions):
    with pytest.raises(IrecError, match="no version 9"):
        versions.go_to(8)


def test_versions_show_the_noise_that_a_diagnosis_has_inferred_those_that_come_later_too(versions):
    claimed = replace(version(versions.folder, "d"), sigma=np.array([2e-5, 4e-5]), noise_m=3e-5)
    versions.keep(claimed)
    versions.learn_noise(6e-5)
    versions.keep(replace(claimed, name="e"))
    for shown in versions.all[-2:]:
        assert shown.noise_m == 6e-5 and np.allclose(shown.sigma, [4e-5, 8e-5])


def test_earlier_work_is_found_again(versions, tmp_path):
    versions.go_to(1)
    (past,) = past_work(tmp_path)
    assert [n for n, _ in past.versions] == ["a", "b", "c"] and past.current == 1 and past.session == "/data/session"


def test_earlier_work_whose_files_are_gone_is_passed_over(versions, tmp_path):
    os.remove(versions.all[1].model)
    assert past_work(tmp_path) == []


def test_two_people_never_share_a_folder(tmp_path):
    assert new_folder(tmp_path, "s") != new_folder(tmp_path, "s")


def test_a_file_that_exists_is_never_written_to(tmp_path):
    first = free_path(tmp_path, "model", ".yaml")
    first.write_text("mine")
    assert free_path(tmp_path, "model", ".yaml") != first and first.read_text() == "mine"


def test_a_model_whose_aliases_explode_is_refused_where_diagnoses_are_looked_up(tmp_path):
    model = tmp_path / "model.yaml"
    lines = [f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
    model.write_text("\n".join(["a: &a [x, x, x, x, x, x, x, x, x, x]", *lines]))
    with pytest.raises(IrecError, match=r"model.yaml:\d+: more than .* values"):
        fingerprint("/data/session", str(model))
