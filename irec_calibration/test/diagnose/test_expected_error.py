# SPDX-License-Identifier: Apache-2.0
"""The error that a model's predictions of the TCP are to be expected to have, against the error that they have."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from absolute_sessions import session as absolute_session
from irec_calibration.diagnose import improve, solved, validated, with_error
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import default_terms
from irec_calibration.lengths import length
from irec_calibration.model import EIGHTEEN_DOF, Model, blank_model
from irec_calibration.robot.kinematics import Kinematics
from irec_calibration.session import Marker, Session
from irec_calibration.typing import Array

TERMS = blank_model(EIGHTEEN_DOF)
SOFT_TOOL = synthetic.TRANSVERSE * np.where(np.arange(12) < 10, 1.0, 40.0)  # what holds the tool turns by some mrad


def moved_tcp(session: Session) -> Array:
    """Deflection of the TCP by the springs of the synthetic robot, (n, 3), m."""
    kin, scene = session.robot.kinematics(session.q), scene_of(session)
    u = np.zeros((len(session), 3))
    for axis, c, origin in springs(kin, synthetic.TRANSVERSE):
        lever = kin.p_tcp - origin
        u += c * np.einsum("ni,ni->n", axis, np.cross(lever, scene.force))[:, None] * np.cross(axis, lever)
    return u


def springs(kin: Kinematics, transverse: Array) -> Iterator[tuple[Array, float, Array]]:
    """Axis, compliance and origin of each spring."""
    for k in range(6):
        yield kin.axis[:, k], synthetic.COMPLIANCE[k], kin.origin[:, k]
        for v in (0, 1):
            yield kin.virtual_axis[:, k, v], transverse[2 * k + v], kin.origin[:, k]


def error_at_tcp(model: Model, truth: Session) -> float:
    """RMS over loaded rows, m."""
    predicted = model.predict(scene_of(truth, observe="tcp"))
    loaded = truth.load_case > 0
    return float(np.sqrt(((predicted - moved_tcp(truth))[loaded] ** 2).sum(axis=1).mean()))


def upright(seed: int, z: float, name: str = "marker") -> Session:
    """A session with a soft tool that points down at every pose, as on a table, and a reflector at (0, 0, z) in tool0."""
    rng = np.random.default_rng(7)
    q = np.zeros((20, 6))
    q[:, 0], q[:, 1], q[:, 2] = rng.uniform(-0.7, 0.7, 20), rng.uniform(0.2, 0.8, 20), rng.uniform(-0.3, 0.4, 20)
    q[:, 4] = -q[:, 1] - q[:, 2]
    made = synthetic.session(20, seed, q_of_poses=q, transverse=SOFT_TOOL)
    kin, scene = made.robot.kinematics(made.q), scene_of(made)
    shift = np.einsum("nij,j->ni", kin.R_tool, np.array([0.0, 0.0, z]) - np.array(made.markers[0].xyz))
    moved = shift.copy()  # what turns the tool turns the way from the one place to the other
    for axis, c, origin in springs(kin, SOFT_TOOL):
        angle = c * np.einsum("ni,ni->n", axis, np.cross(kin.p_tcp - origin, scene.force))
        moved += np.cross(angle[:, None] * axis, shift)
    seen = made.p_marker_in_station + moved @ made.stations[0].R_in_base
    return replace(made, p_marker_in_station=seen, markers=(Marker(name, "tool0", (0.0, 0.0, z)),))


def both(one: Session, other: Session) -> Session:
    """Rows of one reflector, then of another one, of the same poses."""
    n = len(one)
    rows = {
        name: np.concatenate([getattr(one, name), getattr(other, name)])
        for name in ("pose", "load_case", "repeat", "q", "p_tcp_in_base", "p_marker_in_station", "station", "force_in_tool",
                     "torque_in_tool")
    }  # fmt: skip
    stamp = np.concatenate([one.stamp, other.stamp + 1.0])
    marker = np.repeat([0, 1], n)
    return replace(one, **rows, stamp=stamp, marker=marker, markers=(*one.markers, *other.markers))


@pytest.mark.parametrize("poses", [12, pytest.param(31, marks=pytest.mark.long)])
def test_over_many_sessions_the_error_at_other_poses_is_what_is_expected_of_ideal_gears(poses: int) -> None:
    ratios = []
    for seed in range(8):
        made = validated(synthetic.session(poses, seed), TERMS)
        truth = synthetic.session(40, 100 + seed)
        expected = replace(made.expected_error, gears_m=0.0)
        ratios.append(error_at_tcp(Model(made.study.terms), truth) / expected.at_tcp_m)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.5, ratios


def test_no_error_smaller_than_what_gears_of_every_robot_leave_is_promised() -> None:
    made = synthetic.session(60)
    deflection = float(np.sqrt((moved_tcp(made)[made.load_case > 0] ** 2).sum(axis=1).mean()))
    assert validated(made, TERMS).expected_error.at_tcp_m > 0.008 * deflection  # of the reflector it is, which moves less


def test_more_poses_tell_more_of_the_parameters() -> None:
    few, many = (validated(synthetic.session(n), TERMS).expected_error.tcp_m for n in (8, 60))
    assert many < 0.6 * few


def test_a_tool_that_points_the_same_way_at_every_pose_leaves_its_turning_open() -> None:
    error = validated(upright(3, -0.14), TERMS).expected_error
    assert error.turning_unknown and "140.00 mm from it: one place does not show how the tool turns" in error.caution


def test_a_reflector_at_the_tcp_leaves_nothing_open() -> None:
    error = validated(upright(3, 0.0), TERMS).expected_error
    assert error.at_tcp_m == pytest.approx(error.at_reflector_m, rel=1e-2) and error.caution == ""


def test_a_second_reflector_shows_how_the_tool_turns() -> None:
    one = upright(3, -0.14)
    alone, together = (validated(s, TERMS).expected_error for s in (one, both(one, upright(4, 0.05, "second"))))
    assert together.tcp_m < 0.3 * alone.tcp_m and not together.turning_unknown


def test_a_row_with_the_joint_angles_of_another_pose_does_not_count() -> None:
    whole = synthetic.session(20, 3)
    row = int(np.flatnonzero((whole.pose == 5) & (whole.load_case == 2))[0])
    q = whole.q.copy()
    q[row] = whole.q[np.flatnonzero(whole.pose == 12)[0]]
    usual, with_it = (validated(s, TERMS).expected_error for s in (whole, replace(whole, q=q)))
    assert usual is not None and with_it is not None
    assert with_it.tcp_m < 1.2 * usual.tcp_m


def test_a_bump_of_the_station_in_one_pose_says_nothing_of_other_poses() -> None:
    made = synthetic.session(31, 2)
    bumped = made.p_marker_in_station + np.where((made.pose == 9) & (made.load_case > 2), 1e-3, 0.0)[:, None]
    quiet, shaken = (validated(s, TERMS) for s in (made, replace(made, p_marker_in_station=bumped)))
    assert shaken.expected_error.at_tcp_m < 1.5 * quiet.expected_error.at_tcp_m


@pytest.mark.parametrize(("poses", "counts"), [((9,), False), ((9, 10), True)])
def test_poses_that_deviate_in_every_load_case_count_where_several_do(poses: tuple[int, ...], counts: bool) -> None:
    def soft_there(scene: Scene) -> Array:
        lateral = scene.force_in_tool[:, :1] + scene.force_in_tool[:, 1:2]  # no reference is off by that
        return np.where(np.isin(made.pose, poses)[:, None], 1e-6 * lateral * np.ones(3), 0.0)

    made = synthetic.session(31, 2)
    missing = soft_there(scene_of(made))
    shaken = validated(synthetic.session(31, 2, extra=soft_there), TERMS)
    assert (shaken.expected_error.at_tcp_m > 0.7 * np.sqrt((missing**2).sum(axis=1).mean())) == counts


def test_structure_that_a_model_lacks_is_part_of_it() -> None:
    def law(scene: Scene) -> Array:
        return 1e-4 * np.sin(3.0 * scene.q[:, :1]) * (scene.load_case > 0)[:, None] * np.array([1.0, 0.0, 0.0])

    error = validated(synthetic.session(31, 2, extra=law), TERMS).expected_error
    assert 2e-5 < error.beyond_m < 1e-4


def test_an_absolute_session_says_nothing_of_deflections_by_process_forces() -> None:
    session = absolute_session()
    assert validated(session, default_terms(session)).expected_error is None


def test_the_files_of_models_have_it() -> None:
    session = upright(3, -0.14)
    model, _ = solved(session, TERMS)
    error = validated(session, TERMS).expected_error
    assert model.figures["expected_error_m"] == error.at_tcp_m
    assert model.figures["expected_error_reflector_m"] == error.at_reflector_m
    assert error.caution in model.made["caution"]


def test_a_model_without_it_is_left_as_it_is() -> None:
    model = Model(tuple(TERMS))
    assert with_error(model, None) is model


def test_a_diagnosis_says_it_of_the_improved_model() -> None:
    ladder = improve(upright(3, -0.14))
    error = ladder.before.expected_error
    assert ladder.model.figures["expected_error_m"] == error.at_tcp_m == ladder.before.to_json()["improved"]["expected_error_m"]
    assert f"the TCP is expected to be predicted to {length(error.at_tcp_m)}" in ladder.before.verdict.text
