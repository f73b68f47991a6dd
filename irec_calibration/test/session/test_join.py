# SPDX-License-Identifier: Apache-2.0
"""Sessions of one robot that were measured one after the other, read as one."""

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
from irec_calibration.cli import main as irec
from irec_calibration.errors import SessionError
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.session import Marker, Station, read_session, write_table
from irec_calibration.session.join import joined
from synthetic import COMPLIANCE, session


def more(**changes):
    return replace(session(4, seed=1), **changes)


def test_poses_and_stamps_of_the_later_session_go_on_after_those_of_the_first() -> None:
    first, second = session(3), more()
    both = joined([first, second], gap=100.0)
    assert len(both) == len(first) + len(second)
    assert both.poses.tolist() == [1, 2, 3, 101, 102, 103, 104]
    begin = both.stamp[len(first)]
    assert begin == pytest.approx(first.stamp.max() + 100.0)
    assert np.diff(both.stamp[len(first) :]) == pytest.approx(np.diff(second.stamp))


def test_a_third_session_is_counted_on_from_the_second() -> None:
    both = joined([session(3), more(), session(2, seed=2)])
    assert both.poses.tolist() == [1, 2, 3, 101, 102, 103, 104, 201, 202]
    assert (np.diff(both.stamp) > 0.0).all()


def test_what_is_joined_and_written_reads_as_it_was(tmp_path) -> None:
    both = joined([session(3), more(temperature={"ambient": np.full(24, 21.0)})])
    again = read_session(write_table(both, tmp_path / "both"))
    assert again.pose.tolist() == both.pose.tolist() and again.stations == both.stations and again.markers == both.markers
    assert np.array_equal(again.p_marker_in_station, both.p_marker_in_station)
    assert np.isnan(again.temperature["ambient"][:18]).all() and (again.temperature["ambient"][18:] == 21.0).all()


def test_springs_of_two_short_sessions_are_known_as_well_as_of_one_long_one() -> None:
    def error(s) -> float:
        found = identify(s, default_terms(s)).terms[0].estimates
        return float(np.abs([found[f"c_{k + 1}"].value / COMPLIANCE[k] - 1.0 for k in range(6)]).max())

    whole = session(30)
    parts = [whole.select_poses(list(range(1, 16))), whole.select_poses(list(range(16, 31)))]
    assert error(joined(parts)) == pytest.approx(error(whole), rel=0.02)


def test_a_station_with_another_pose_is_another_one() -> None:
    turned = Station("A", (4.0, -2.0, 1.1), (0.0, 0.0, 0.5**0.5, 0.5**0.5), known=True)
    both = joined([session(3), more(stations=(turned,))])
    assert [s.name for s in both.stations] == ["A", "A (2)"]
    assert set(both.station[:18]) == {0} and set(both.station[18:]) == {1}


def test_a_station_that_stood_still_is_one() -> None:
    assert len(joined([session(3), more()]).stations) == 1


def test_a_station_of_unknown_pose_is_another_one_each_time() -> None:
    first, second = absolute_sessions.session(poses=20), absolute_sessions.session(poses=10, seed=1)
    free = [replace(s, stations=(replace(s.stations[0], known=False),)) for s in (first, second)]
    both = joined(free)
    assert [s.name for s in both.stations] == ["T", "T (2)"] and len(both.markers) == 1


def test_a_marker_at_another_place_is_another_one(tmp_path) -> None:
    both = joined([session(3), more(markers=(Marker("marker", "tool0", (0.0, 0.0, -0.05)),))])
    assert [m.name for m in both.markers] == ["marker", "marker (2)"]
    again = read_session(write_table(both, tmp_path / "both"))
    assert again.markers[1].xyz == (0.0, 0.0, -0.05) and set(again.marker[18:]) == {1}


def test_a_load_case_of_other_force_has_a_number_of_its_own() -> None:
    second = more(load_cases={**session(1).load_cases, 3: (-140.0, 0.0, -550.0)})
    both = joined([session(3), second])
    assert sorted(set(both.load_case.tolist())) == [0, 1, 2, 3, 4, 5, 6]
    assert both.load_cases[6] == (-140.0, 0.0, -550.0) and both.load_cases[3] == (-280, 0, -1100)
    assert (both.load_case[18:] == 6).sum() == 4 and not (both.load_case[18:] == 3).any()


def test_a_load_case_that_a_later_session_numbers_otherwise_is_the_one_of_its_force(tmp_path) -> None:
    first = session(3)
    swapped = {1: 1, 2: 3, 3: 2, 4: 4, 5: 5}
    cases = {new: first.load_cases[old] for old, new in swapped.items()}
    second = more()
    other = replace(second, load_cases=cases, load_case=np.array([swapped.get(j, 0) for j in second.load_case.tolist()]))
    both = joined([first, other])
    assert both.load_cases == first.load_cases and both.load_case[18:].tolist() == second.load_case.tolist()
    assert len(read_session(write_table(both, tmp_path / "both"))) == len(both)


def test_a_third_session_has_the_load_cases_that_the_second_brought() -> None:
    half = {**session(1).load_cases, 3: (-140.0, 0.0, -550.0)}
    both = joined([session(3), more(load_cases=half), more(load_cases=half, stamp=more().stamp + 1.0)])
    assert sorted(set(both.load_case.tolist())) == [0, 1, 2, 3, 4, 5, 6]


def test_noise_that_is_stated_otherwise_is_the_mean_of_squares_and_is_said() -> None:
    second = more()
    both = joined([session(4), replace(second, noise=replace(second.noise, force_n=7.0))])
    assert both.noise.force_n == pytest.approx(5.0)
    assert any("force_n: 1, 7" in n for n in both.notes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"serial": "S-2"}, "serial of the robot is S-2, of synthetic S-1"),
        ({"gravity_in_base": (0.0, 0.0, 9.81)}, "gravity is"),
        ({"ext": {"rail": np.zeros(24)}}, "external axes"),
        ({"kind": "absolute"}, "kind is absolute"),
    ],
)
def test_what_one_session_can_not_hold_is_refused(changes, words) -> None:
    with pytest.raises(SessionError, match=words):
        joined([session(3), more(**changes)])


def test_what_one_session_states_as_the_other_takes_it_to_be_is_shared() -> None:
    second = more()
    both = joined([session(3), replace(second, meta={**second.meta, "sensor_axis_in_tool": [0, 0, 1]})])
    assert len(both.poses) == 7


def test_a_session_joined_with_itself_is_refused() -> None:
    with pytest.raises(SessionError, match="same rows"):
        joined([session(3), session(3)])


def test_one_session_alone_is_refused() -> None:
    with pytest.raises(SessionError, match="at least two"):
        joined([session(3)])


def test_the_command_writes_a_session_and_leaves_what_is_there(tmp_path, capsys) -> None:
    paths = [str(write_table(s, tmp_path / n)) for s, n in ((session(3), "a"), (more(name="later"), "b"))]
    out = tmp_path / "both"
    assert irec(["join", *paths, "-o", str(out)]) == 0
    assert "7 poses, 42 rows" in capsys.readouterr().out and read_session(out).name == "synthetic + later"
    assert irec(["join", *paths, "-o", str(out)]) == 2
    assert "exists and is not empty" in capsys.readouterr().err
