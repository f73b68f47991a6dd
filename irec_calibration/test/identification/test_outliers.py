# SPDX-License-Identifier: Apache-2.0
"""Rows that are plainly wrong are found and named; what a missing effect bends stays in."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.codec import pose_data
from irec_calibration.diagnose.comparison import compare
from irec_calibration.diagnose.study import prepare
from irec_calibration.identification.gross_errors import mended, wrong_joints
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.identification.observe import observe
from irec_calibration.identification.outliers import find, treated
from irec_calibration.session import Marker, Noise, Session
from scipy.spatial.transform import Rotation

ROW = 20  # pose 4, load case 2 of a loaded session of five load cases
MARKERS = (
    *(Marker(f"M{i}", "tool0", (0.03 * i - 0.1, (-1) ** i * 0.05, 0.05 + 0.02 * i), known=False) for i in range(5)),
    Marker("B", "base_link", (0.5, 0.4, 0.1), known=False),
)


def changed(session: Session, name: str, rows: object, value: object) -> Session:
    """A session with some rows of one array replaced."""
    array = getattr(session, name).copy()
    array[rows] = value
    return replace(session, **{name: array})


def moved(session: Session, rows: object, by: tuple[float, float, float]) -> Session:
    return changed(session, "p_marker_in_station", rows, session.p_marker_in_station[rows] + np.array(by))


@pytest.fixture(scope="module")
def loaded() -> Session:
    return replace(synthetic.session(seed=1), load_case_names={1: "normal", 2: "N", 3: "S", 4: "E", 5: "W"})


def only(session: Session):
    found = find(observe(session), default_terms(session))
    assert len(found) == 1, [str(b) for b in found]
    return found[0]


def test_nothing_is_wrong_in_a_clean_session(loaded):
    assert treated(observe(loaded), default_terms(loaded)).bad == ()


@pytest.mark.parametrize("size", [1e-3, 2e-4])
def test_a_jump_in_one_row_is_named_with_its_size(loaded, size):
    bad = only(moved(loaded, ROW, (0.6 * size, 0.0, -0.8 * size)))
    assert bad.kind == "jump" and bad.rows == (ROW,)
    assert bad.size_m == pytest.approx(size, rel=0.15)
    assert str(bad).startswith("pose 4, load case N: moved by") and "against its neighbours" in str(bad)


@pytest.mark.parametrize("what", ["p_marker_in_station", "force_in_tool"])
def test_two_load_cases_that_were_exchanged_look_swapped(loaded, what):
    bad = only(changed(loaded, what, [ROW, ROW + 1], getattr(loaded, what)[[ROW + 1, ROW]]))
    assert bad.kind == "swapped" and set(bad.rows) == {ROW, ROW + 1}
    assert "load cases N and S of pose 4 look swapped" in bad.sentence


def test_the_joint_angles_of_another_pose_are_recognised(loaded):
    bad = only(changed(loaded, "q", ROW, loaded.q[50]))
    assert bad.kind == "joints" and bad.rows == (ROW,) and "those of pose 9" in bad.sentence


def test_what_comes_after_a_wrong_row_has_what_was_there_as_its_history(loaded):
    clean = observe(loaded).scene
    for name, value in (("q", loaded.q[50]), ("force_in_tool", loaded.force_in_tool[ROW] * 1000.0)):
        spoilt = changed(loaded, name, ROW, value)
        scene = observe(spoilt).scene
        assert scene.previous[ROW + 1] == ROW
        np.testing.assert_allclose(scene.load_torque()[ROW], clean.load_torque()[ROW], atol=60.0)
        assert np.abs(scene.step[ROW + 1]).max() < 0.02
        assert only(spoilt).rows == (ROW,), "and it counts for nothing by itself"


def test_angles_and_position_in_place_of_wrong_ones_are_those_of_one_row(loaded):
    kept = mended(changed(loaded, "q", ROW, loaded.q[50]))
    twins = [r for r in range(18, 24) if r != ROW and np.array_equal(kept.q[ROW], loaded.q[r])]
    assert len(twins) == 1
    np.testing.assert_array_equal(kept.p_tcp_in_base[ROW], loaded.p_tcp_in_base[twins[0]])


def test_a_reference_with_the_joint_angles_of_another_pose_spoils_its_load_cases(loaded):
    bad = only(changed(loaded, "q", 18, loaded.q[50]))
    assert bad.kind == "joints" and bad.rows == tuple(range(19, 24))


@pytest.mark.parametrize("by", ["tcp_*", "the marker"])
def test_a_pose_all_of_whose_joint_angles_are_those_of_another_pose_is_left_out(loaded, by):
    mine = np.flatnonzero(loaded.pose == loaded.pose[ROW])
    spoilt = changed(loaded, "q", mine, loaded.q[loaded.pose == 9])
    if by == "the marker":  # the controller works its TCP out of the same angles
        spoilt = replace(spoilt, p_tcp_in_base=spoilt.robot.kinematics(spoilt.q).p_tcp)
    bad = only(spoilt)
    assert bad.kind == "joints" and bad.rows == tuple(mine[1:])
    assert f"joint angles that put {by}" in bad.sentence and "look like those of pose 9" in bad.sentence


def test_a_session_most_of_whose_poses_have_the_tcp_elsewhere_loses_none_of_them(loaded):
    off = changed(loaded, "p_tcp_in_base", slice(None, len(loaded) // 2), loaded.p_tcp_in_base[: len(loaded) // 2] + 0.5)
    assert wrong_joints(off) == []


@pytest.fixture(scope="module")
def aligned() -> Session:
    return synthetic.session(seed=1, aligned=0.18)


def test_a_tool_that_is_aligned_at_contact_stands_otherwise_in_all_references_and_nothing_is_wrong(aligned):
    assert find(observe(aligned), default_terms(aligned)) == ()


def test_beside_a_tool_that_is_aligned_at_contact_the_joint_angles_of_another_pose_are_recognised(aligned):
    bad = only(changed(aligned, "q", 18, aligned.q[50]))
    assert bad.kind == "joints" and bad.rows == tuple(range(19, 24))


def test_a_bumped_reference_is_told_from_a_jump_in_a_load_case(loaded):
    bad = only(moved(loaded, 18, (1e-4, -1e-4, 1.4e-4)))
    assert bad.kind == "moved" and bad.rows == tuple(range(19, 24)) and "reference" in bad.sentence
    assert bad.size_m == pytest.approx(2e-4, rel=0.2)


def test_a_reflector_reseated_within_a_pose_spoils_the_rows_from_there_on(loaded):
    bad = only(moved(loaded, slice(21, None), (0.0, -2e-4, 0.0)))
    assert bad.kind == "moved" and bad.rows == (21, 22, 23) and "from load case S on" in bad.sentence


def test_kilonewtons_in_one_row_are_named(loaded):
    bad = only(changed(loaded, "force_in_tool", ROW, loaded.force_in_tool[ROW] / 1000))
    assert bad.kind == "force" and "kN for N" in bad.sentence


def twice(session: Session) -> Session:
    """Each pose measured twice, with its own reference each time."""
    n = len(session)
    both = session.select(np.tile(np.arange(n), 2))
    later = np.arange(2 * n) >= n
    noise = np.random.default_rng(3).normal(0.0, 5e-6, (2 * n, 3))
    return replace(
        both, repeat=later.astype(np.int64), stamp=both.stamp + later * (np.ptp(session.stamp) + 60.0),
        p_marker_in_station=both.p_marker_in_station + noise,
    )  # fmt: skip


def left_out(session: Session) -> set[int]:
    return {r for b in treated(observe(session), default_terms(session)).bad if b.is_left_out for r in b.rows}


def test_what_a_repeat_of_the_load_case_shows_again_is_no_accident(loaded):
    n, session = len(loaded), twice(loaded)
    once = moved(session, ROW, (1.2e-3, 0.0, -1.6e-3))
    assert left_out(once) == {ROW}
    again = moved(once, ROW + n, (1.0e-3, 0.2e-3, -1.5e-3))
    seen = treated(observe(again), default_terms(again))
    assert left_out(again) == set()
    assert [str(b).partition("; kept: ")[2] for b in seen.bad] == 2 * [
        "another measurement of the same pose and load case shows it again, so that it is no accident"
    ]


def test_two_accidents_in_one_load_case_that_have_nothing_in_common_are_left_out(loaded):
    n = len(loaded)
    session = moved(moved(twice(loaded), ROW, (1.2e-3, 0.0, -1.6e-3)), ROW + n, (-1.2e-3, 0.0, 1.6e-3))
    assert left_out(session) == {ROW, ROW + n}


def test_heavy_tails_of_a_loaded_session_are_neither_wrong_nor_weighted():
    session = synthetic.session(seed=1)
    rng = np.random.default_rng(0)
    tails = rng.standard_t(3, session.p_marker_in_station.shape) * 1.5e-5
    seen = treated(observe(replace(session, p_marker_in_station=session.p_marker_in_station + tails)), default_terms(session))
    assert len(seen.rows) == 155 and (seen.weight == 1.0).all()


@pytest.mark.parametrize(("size", "rows"), [(1e-3, 154), (2e-4, 155)])
def test_a_row_is_left_out_only_where_no_missing_effect_could_do_it(loaded, size, rows):
    seen = treated(observe(moved(loaded, ROW, (0.6 * size, 0.0, -0.8 * size))), default_terms(loaded))
    assert len(seen.rows) == rows and (seen.weight == 1.0).all()
    assert seen.bad[0].is_left_out == (rows < 155) and any("moved by" in n for n in seen.session.notes)


def test_every_part_of_the_tool_rests_on_the_same_rows(loaded):
    spoilt = moved(moved(loaded, ROW, (1e-3, 0.0, 0.0)), 40, (0.0, 2e-4, 0.0))
    terms = default_terms(spoilt)
    rows = identify(spoilt, terms).observation.rows
    assert len(rows) == 154
    np.testing.assert_array_equal(prepare(spoilt, terms).observation.rows, rows)
    np.testing.assert_array_equal(compare(spoilt, identify(spoilt, terms).terms).rows, rows)
    assert pose_data(spoilt, terms).seen.sum() == 154


def test_down_weighted_rows_count_less_and_the_others_as_before(loaded):
    seen = observe(loaded)
    weight = np.ones(len(seen.rows))
    weight[3] = 0.25
    less = seen.weighted(weight)
    assert less.whiten.sigma[3] == pytest.approx(2.0 * seen.whiten.sigma[3])
    np.testing.assert_array_equal(np.delete(less.whiten.sigma, 3), np.delete(seen.whiten.sigma, 3))
    np.testing.assert_allclose(less.weighted(np.ones(len(weight))).whiten.sigma, seen.whiten.sigma)


def stiffens(k):
    def extra(scene):
        t = scene.tau[:, k]
        return scene.J[:, :, k] * (0.6 * synthetic.COMPLIANCE[k] * t * np.abs(t) / np.abs(t).max())[:, None]

    return extra


def plays(k):
    return lambda scene: scene.J[:, :, k] * (1e-4 * np.sign(scene.tau[:, k] + scene.tau_gravity[:, k]))[:, None]


@pytest.mark.parametrize("effect", [stiffens, plays])
@pytest.mark.parametrize("axis", range(6))
def test_a_missing_effect_in_one_axis_leaves_all_rows_in(effect, axis):
    session = synthetic.session(seed=2, extra=effect(axis))
    assert len(treated(observe(session), default_terms(session)).rows) == 155


def test_what_a_wrong_row_did_to_the_compliances_is_gone(loaded):
    clean = identify(loaded, default_terms(loaded))
    fixed = identify(moved(loaded, ROW, (1e-3, 0.0, 0.0)), default_terms(loaded))
    assert fixed.rms == pytest.approx(clean.rms, rel=0.02)


def six_markers(poses: int = 40) -> Session:
    def bent(session, p):
        on_tool = np.array([m.link == "tool0" for m in session.markers])[session.marker]
        return absolute_sessions.torsion(np.full(6, 4e-6))(session, p) * on_tool[:, None]

    return absolute_sessions.session(noise=Noise(tracker_m=1e-5), markers=MARKERS, poses=poses, moved=bent)


@pytest.fixture(scope="module")
def absolute() -> Session:
    return six_markers()


def test_gravity_that_bends_every_pose_of_an_absolute_session_is_no_outlier(absolute):
    assert len(treated(observe(absolute), default_terms(absolute)).rows) == len(absolute)


def test_readings_of_another_nest_are_left_out_and_do_not_bend_the_fit(absolute):
    rows = [7, 80, 200]
    found = find(observe(bad := moved(absolute, rows, (0.2, 0.1, -0.2))), default_terms(absolute))
    assert {r for b in found for r in b.rows} == set(rows) and {b.kind for b in found} == {"nest"}
    assert all(b.size_m == pytest.approx(0.3, rel=0.01) for b in found)
    plain, fixed = identify(absolute, default_terms(absolute)), identify(bad, default_terms(bad))
    assert fixed.rms == pytest.approx(plain.rms, rel=0.05)


def test_a_marker_measured_for_another_is_named(absolute):
    mine = np.flatnonzero(absolute.pose == 12)
    bad = only(changed(absolute, "p_marker_in_station", mine[1], absolute.p_marker_in_station[mine[3]]))
    assert bad.kind == "nest" and "marker M3 measured for M1" in bad.sentence


def test_the_joint_angles_of_another_pose_are_recognised_in_an_absolute_session(absolute):
    q = absolute.q.copy()
    q[absolute.pose == 10] = absolute.q[absolute.pose == 20]
    bad = only(replace(absolute, q=q, p_tcp_in_base=absolute.robot.kinematics(q).p_tcp))
    assert bad.kind == "joints" and "joint angles of pose 20" in bad.sentence
    assert {int(absolute.pose[r]) for r in bad.rows} == {10}


def test_what_comes_after_the_joint_angles_of_another_pose_is_left_out_as_its_step_is_not_known(absolute):
    q = absolute.q.copy()
    q[absolute.pose == 10] = absolute.q[absolute.pose == 20]
    spoilt = replace(absolute, q=q, p_tcp_in_base=absolute.robot.kinematics(q).p_tcp)
    left = treated(observe(spoilt), default_terms(spoilt))
    gone = np.setdiff1d(np.unique(absolute.pose), np.unique(absolute.pose[left.rows[absolute.marker[left.rows] < 5]]))
    assert gone.tolist() == [10, 11]
    assert any("pose 11: comes after joint angles that are not those of their pose" in str(b) for b in left.bad)


def test_joint_angles_far_from_the_commanded_ones_are_left_out_and_the_next_step_begins_where_the_robot_was(absolute):
    rows = np.flatnonzero(absolute.pose == 10)
    commanded = replace(absolute, q_target=absolute.q + 1e-5)
    spoilt = changed(commanded, "q", rows, absolute.q[absolute.pose == 20])
    spoilt = replace(spoilt, p_tcp_in_base=absolute.robot.kinematics(spoilt.q).p_tcp)
    found = find(observe(spoilt), default_terms(spoilt))
    assert {r for b in found for r in b.rows} == set(rows.tolist()) and {b.kind for b in found} == {"joints"}
    assert "from the commanded ones; look like those of pose 20" in found[0].sentence
    after = np.flatnonzero(absolute.pose == 11)
    np.testing.assert_allclose(observe(spoilt).scene.step[after], observe(absolute).scene.step[after], atol=1e-4)


def test_a_reading_that_is_off_by_a_millimetre_is_found_beside_missing_torsion(absolute):
    bad = only(moved(absolute, 100, Rotation.from_euler("x", 0.3).apply((1e-3, 0.0, 0.0))))
    assert bad.kind == "jump" and bad.rows == (100,)
