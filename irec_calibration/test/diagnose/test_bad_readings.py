# SPDX-License-Identifier: Apache-2.0
"""A bad reading is told once, as it is treated where the verdict is reached, though several models of a session were fitted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.diagnose.bad_readings import SET_ASIDE, one_note_each, put_aside, rows_json, too_many_aside
from irec_calibration.diagnose.settings import SETTINGS
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.bad_rows import BadRow
from irec_calibration.identification.outliers import KEPT
from numpy.typing import NDArray

ROW = 40


def part(*rows: int, words: str = "pose 5") -> SimpleNamespace:
    return SimpleNamespace(structure=SimpleNamespace(rows=rows, words=words))


def test_a_row_that_one_model_keeps_and_another_leaves_out_has_one_note() -> None:
    kept, left_out = (
        BadRow("jump", (3,), 1e-3, "row 3: moved by 1 mm", KEPT),
        BadRow("jump", (3,), 9e-4, "row 3: moved by 0.9 mm"),
    )
    notes = ("other", str(kept), "other", str(left_out))
    assert one_note_each(notes, [kept], [], [left_out]) == ("other", str(kept))
    assert one_note_each(notes, [kept], [part(3)], [left_out]) == ("other", f"row 3: moved by 1 mm; {SET_ASIDE}")


def test_what_is_found_beside_what_was_added_only_is_told_so() -> None:
    found = BadRow("jump", (3,), 1e-3, "row 3: moved by 1 mm")
    assert one_note_each((str(found),), [], [], [found]) == ("row 3: moved by 1 mm; left out, beside what was added",)


def test_of_rows_that_are_put_aside_in_part_it_is_said_which() -> None:
    kept = BadRow("moved", (3, 4), 1e-3, "from row 3 on", KEPT)
    (note,) = one_note_each((str(kept),), [kept], [part(4, words="row 4")], [kept])
    assert note == f"from row 3 on; kept, but for this, which {SET_ASIDE}: row 4"


def test_markers_are_listed_once() -> None:
    notes = tuple(f"residual by marker, um per coordinate: M1 {n}" for n in (22, 22, 21))
    assert one_note_each(notes, [], [], []) == notes[:1]


def test_a_result_has_one_entry_for_each_row() -> None:
    session = synthetic.session(poses=6)
    kept = BadRow("jump", (ROW - 20,), 1e-3, "moved by 1 mm", KEPT)
    one, other = rows_json(session, [kept], [part(ROW - 20), part(ROW - 10)])
    assert (one["kind"], one["action"], other["kind"]) == ("jump", SET_ASIDE, "stands out")


@pytest.mark.long
def test_a_bad_reading_beside_a_missing_effect_is_told_once() -> None:
    def play(scene: Scene) -> NDArray[np.float64]:
        angle = 2e-4 * np.clip((scene.tau[:, 3] + scene.tau_gravity[:, 3]) / 5.0, -1.0, 1.0)
        return scene.kin.jacobian(scene.p_observed)[:, :, 3] * angle[:, None]

    clean = synthetic.session(poses=20, seed=5, extra=play)
    marker = clean.p_marker_in_station.copy()
    marker[ROW] += [3e-4, -2.5e-4, 0.0]
    found = diagnose(replace(clean, p_marker_in_station=marker))
    assert found.verdict.effects == ("joint_backlash",), found.verdict.text
    assert sum(f"pose {clean.pose[ROW]}," in note for note in found.notes) == 1, found.notes
    assert [b["pose"] for b in found.bad_rows] == [clean.pose[ROW]], found.bad_rows


def test_of_a_pose_that_is_put_aside_only_the_readings_that_stand_out_count() -> None:
    rows = np.arange(20)
    residual = np.full((20, 3), 1e-5)
    residual[[4, 6]] = 3e-4  # two of the five load cases of one pose
    study = SimpleNamespace(
        observation=SimpleNamespace(rows=rows),
        fit=SimpleNamespace(residual=residual),
        ready=SimpleNamespace(reference=np.repeat([0, 5, 10, 15], 5)),
    )

    def part(rows: tuple[int, ...]) -> SimpleNamespace:
        return SimpleNamespace(structure=SimpleNamespace(rows=rows, columns=slice(0, 3 * len(rows))))

    reference = SimpleNamespace(structure=SimpleNamespace(rows=tuple(range(5, 10)), columns=slice(0, 3)))
    assert put_aside(study, [part((4, 5, 6, 7, 8))], 4e-5) == 2 / 24
    assert put_aside(study, [part((1,)), reference], 4e-5) == 2 / 24


def _poses_put_aside(kind: str, poses: int, columns: int) -> tuple[SimpleNamespace, list[SimpleNamespace]]:
    study = SimpleNamespace(
        observation=SimpleNamespace(rows=np.arange(100), poses=np.arange(20)),
        fit=SimpleNamespace(residual=np.full((100, 3), 1e-5)),
        ready=SimpleNamespace(reference=np.repeat(np.arange(0, 100, 5), 5), kind=kind),
    )
    rows = [tuple(range(5 * i, 5 * i + 5)) for i in range(poses)]
    return study, [SimpleNamespace(structure=SimpleNamespace(rows=r, columns=slice(0, columns))) for r in rows]


@pytest.mark.parametrize(("kind", "poses", "is_too_many"), [("loaded", 3, False), ("loaded", 4, True), ("absolute", 2, False)])
def test_too_many_poses_put_aside_by_their_references_are_no_bad_luck(kind: str, poses: int, is_too_many: bool) -> None:
    study, aside = _poses_put_aside(kind, poses, columns=3)
    assert too_many_aside(study, aside, 4e-5, SETTINGS) == is_too_many


@pytest.mark.parametrize(("kind", "poses", "is_too_many"), [("loaded", 1, False), ("loaded", 2, True), ("absolute", 4, False)])
def test_two_poses_that_stand_out_in_each_load_case_by_itself_are_no_bad_luck_though_few_of_their_readings_do(
    kind: str, poses: int, is_too_many: bool
) -> None:
    study, aside = _poses_put_aside(kind, poses, columns=15)
    assert put_aside(study, aside, 4e-5) == 0.0
    assert too_many_aside(study, aside, 4e-5, SETTINGS) == is_too_many


def test_how_far_two_poses_are_off_is_no_size_of_the_noise() -> None:
    def off(scene: Scene) -> NDArray[np.float64]:
        angle = np.where(np.isin(scene.pose, (9, 10)), 6e-7 * scene.tau[:, 1], 0.0)
        return scene.kin.jacobian(scene.p_observed)[:, :, 1] * angle[:, None]

    quiet, shaken = (diagnose(synthetic.session(31, 2, extra=extra)) for extra in (None, off))
    assert shaken.verdict.evidence == ("readings_that_stand_out",), shaken.verdict.text
    assert shaken.verdict.depends_on
    assert shaken.noise.inferred_m < 1.3 * quiet.noise.inferred_m
