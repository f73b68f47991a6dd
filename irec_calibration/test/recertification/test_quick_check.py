# SPDX-License-Identifier: Apache-2.0
"""The quick check keeps its error rates, whatever was said about the noise, and finds the station anew."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.identification.identify import identify
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.recertification.quick_check import (
    FEWEST_POSES,
    MOST_VISITS,
    NOTABLE,
    QuickResult,
    Reference,
    check,
    reference_of,
    signal_to_noise,
)
from irec_calibration.recertification.quick_plan import MATTERS, MOST, PLACES, ROUNDS, SEEN_WELL, QuickPlan, _Power, plan
from irec_calibration.recertification.station import with_stations_found
from irec_calibration.session import Noise, Session
from scipy.spatial.transform import Rotation

TOLERANCE = 3e-4


def station_moved(session: Session, seed: int) -> Session:
    """As measured by a tracker that was put up anew, a few mrad and centimetres off, with the old pose still in the file."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.normal(0.0, 4e-3, 3)).as_matrix()
    return replace(session, p_marker_in_station=session.p_marker_in_station @ R.T + rng.normal(0.0, 0.02, 3))


@functools.cache
def reference(noise_stated: float = 1.0, seed: int = 5) -> tuple[Reference, np.ndarray]:
    session = synthetic.session(25, seed)
    q = session.q[:: len(session.q) // 25].copy()
    n = session.noise
    told = replace(n, tracker_m=n.tracker_m * noise_stated, tracker_m_per_m=n.tracker_m_per_m * noise_stated)
    session = replace(session, noise=told)
    fit = identify(with_stations_found(session), blank_model(EIGHTEEN_DOF))
    return reference_of(fit.terms, session, TOLERANCE), q


PLANS: dict[int, QuickPlan] = {}


def plan_of(ref: Reference) -> QuickPlan:
    if id(ref) not in PLANS:
        PLANS[id(ref)] = plan(ref)
    return PLANS[id(ref)]


def visited(ref: Reference, q: np.ndarray, seed: int, stated: float = 1.0, **robot: object) -> QuickResult:
    """The check as it goes on pose by pose, at a station that was put up anew."""
    chosen = plan_of(ref)
    visits = q[[p - 1 for p in chosen.poses]]
    session = station_moved(synthetic.session(len(visits), seed, q_of_poses=visits, **robot), seed)  # type: ignore[arg-type]
    n = session.noise
    session = replace(session, noise=replace(n, tracker_m=n.tracker_m * stated, tracker_m_per_m=n.tracker_m_per_m * stated))
    for k in chosen.looks:
        result = check(ref, session.select_poses(list(range(1, k + 1))), chosen.sizes, last=k == MOST_VISITS)
        if result.decision != "undecided":
            return result
    return result


def softer(axis: int, factor: float) -> np.ndarray:
    return synthetic.COMPLIANCE * np.where(np.arange(6) == axis - 1, factor, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [0.5, *(pytest.param(s, marks=pytest.mark.long) for s in (1.0, 2.0))])
def test_an_unchanged_robot_raises_no_alarm_whatever_the_stated_noise(stated: float) -> None:
    ref, q = reference(stated)
    found = [visited(ref, q, 1000 + i, stated).decision for i in range(6)]
    assert "changed" not in found
    assert found.count("pass") >= 4


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_an_axis_that_is_a_tenth_softer_is_found(axis: int) -> None:
    ref, q = reference()
    for i in range(3):
        result = visited(ref, q, 2000 + i, compliance=softer(axis, 1.1))
        assert result.decision == "changed", result.text
        assert result.poses >= 3


def test_the_change_is_named_where_the_data_single_it_out() -> None:
    ref, q = reference()
    result = visited(ref, q, 77, compliance=softer(2, 1.5))
    assert any("axis 2" in name for name in result.like), result.like
    assert "Do this now" in result.text


def test_a_change_by_micrometres_is_none_that_staff_are_told_of() -> None:
    """To a tracker almost without noise everything is a change."""
    quiet = Noise(tracker_m=2e-7, tracker_m_per_m=0.0, force_n=0.01, settling_m=1e-7)
    session = synthetic.session(25, 5, noise=quiet)
    ref = reference_of(identify(session, blank_model(EIGHTEEN_DOF)).terms, session, TOLERANCE)
    visits = session.q[::6][:12]

    def checked(factor: float) -> QuickResult:
        now = synthetic.session(12, 6, noise=quiet, compliance=softer(2, factor), q_of_poses=visits)
        return check(ref, now, last=True)

    moved = {c.name: float(np.linalg.norm(c.displacement, axis=1).max()) for c in ref.changes}
    name = "axis 2: 10 % softer"
    small = checked(1.0 + 0.1 * 0.5 * NOTABLE * TOLERANCE / moved[name])
    assert small.decision == "changed" and small.like == (), small.text
    assert "By micrometres only" in small.text and "axis" not in small.text
    large = checked(1.1)
    assert large.decision == "changed" and large.like == (name,), large.text


def test_a_robot_passes_only_after_enough_poses() -> None:
    ref, q = reference()
    result = visited(ref, q, 3)
    assert result.decision == "pass" and result.poses >= FEWEST_POSES
    assert f"({result.visits} visits to {result.poses} poses)" in result.text


def test_the_plan_tells_at_which_size_each_change_is_found() -> None:
    ref, _ = reference()
    chosen = plan_of(ref)
    assert len(chosen.poses) == MOST_VISITS and len(set(chosen.poses)) == PLACES
    assert chosen.looks == (*range(2, 17, 2), *range(20, 49, 4)), "each pose twice in the first round, four times in the second"
    for name, size in chosen.sizes.items():
        assert size >= 1.0
        assert size == 1.0 or chosen.moved[name] <= MATTERS * TOLERANCE, "what matters is found at its size"
        assert size == 1.0 or size * chosen.moved[name] <= MOST * TOLERANCE * (1 + 1e-9)
        assert size == 1.0 or size * chosen.power[name] <= SEEN_WELL * (1 + 1e-9), "no larger than these poses need"
    assert len(chosen.seen) == len(chosen.sizes)


def test_larger_forces_across_the_tool_show_more() -> None:
    ref, _ = reference()
    usual, harder = _Power(ref), _Power(ref, 1.25)
    times = np.bincount(np.searchsorted(ref.observation.poses, plan_of(ref).poses), minlength=usual.poses)
    more = dict(zip([c.name for c in ref.changes], np.sqrt(harder.of(times) / usual.of(times)).tolist(), strict=True))
    assert all(m < 1.26 for m in more.values()), more
    assert all(more[f"axis {k}: 10 % softer"] > 1.02 for k in (1, 4, 5)), more
    assert harder.worth(times) > usual.worth(times)
    chosen = plan(ref, 1.25)
    assert chosen.lateral == 1.25 and chosen.moved == plan_of(ref).moved, "what a change matters in production is the same"


def test_visits_are_chosen_for_the_way_in_which_they_show_least_of_a_change() -> None:
    """Play that is taken up over much torque shows a little at many poses, play that is taken up at once only at some."""
    ref, _ = reference()
    power = _Power(ref)
    times = np.bincount(np.searchsorted(ref.observation.poses, plan_of(ref).poses), minlength=power.poses)
    each = []
    for way in range(len(power._A)):
        single = _Power(ref)
        single._A = power._A[way : way + 1]
        each.append(single.of(times))
    assert len(each) == 3, "of play; a softer axis has one"
    np.testing.assert_allclose(power.of(times), np.min(each, axis=0))
    spread = dict(zip([c.name for c in ref.changes], np.max(each, axis=0) / np.min(each, axis=0), strict=True))
    assert all(s == pytest.approx(1.0) for name, s in spread.items() if "softer" in name)
    assert max(s for name, s in spread.items() if "play" in name) > 1.05


def test_visits_are_chosen_better_than_at_random() -> None:
    ref, _ = reference()
    power = _Power(ref)
    chosen = np.bincount(np.searchsorted(ref.observation.poses, plan_of(ref).poses), minlength=power.poses)
    rng = np.random.default_rng(1)
    worth = [
        power.worth(sum(ROUNDS) * np.bincount(rng.choice(power.poses, PLACES, replace=False), minlength=power.poses))
        for _ in range(50)
    ]
    assert power.worth(chosen) > max(worth)


@pytest.mark.parametrize("axis", [4, 5])
def test_an_axis_that_moves_the_tool_little_is_found_at_the_size_that_the_plan_tells(axis: int) -> None:
    ref, q = reference()
    chosen = plan_of(ref)
    size = chosen.sizes[f"axis {axis}: 10 % softer"]
    for i in range(4):
        found = visited(ref, q, 4000 + i, compliance=softer(axis, 1.0 + 0.1 * size))
        assert found.decision != "pass", found.text


def test_a_station_that_was_put_up_anew_is_found_and_told() -> None:
    session = station_moved(synthetic.session(12, 4), 9)
    found = with_stations_found(session)
    believed = session.p_marker_in_station @ found.stations[0].R_in_base.T + np.array(found.stations[0].xyz)
    true = synthetic.session(12, 4)
    expected = true.p_marker_in_station @ true.stations[0].R_in_base.T + np.array(true.stations[0].xyz)
    np.testing.assert_allclose(believed, expected, atol=1e-3)
    assert any("was found anew" in note for note in found.notes)


def test_a_station_that_sees_one_pose_only_keeps_its_stated_pose() -> None:
    session = synthetic.session(12, 4).select_poses([1])
    assert with_stations_found(session).stations == session.stations


@pytest.mark.parametrize("axis", [2, 3])
def test_what_the_best_test_sees_of_a_change_is_what_the_plan_reckons_with(axis: int) -> None:
    ref, q = reference()
    chosen = plan_of(ref)
    visits = q[[p - 1 for p in chosen.poses]]
    session, softened = (synthetic.session(len(visits), 7, q_of_poses=visits, compliance=softer(axis, f)) for f in (1.0, 1.1))
    moved = (softened.p_marker_in_station - session.p_marker_in_station) @ session.stations[0].R_in_base.T
    rows = moved[session.load_case != 0]
    seen = signal_to_noise(ref, session, rows)
    assert seen == pytest.approx(chosen.power[f"axis {axis}: 10 % softer"], rel=0.25)
    assert signal_to_noise(ref, session, rows, repeats=4.0) > seen
    assert signal_to_noise(ref, session, 2.0 * rows) == pytest.approx(2.0 * seen)
