# SPDX-License-Identifier: Apache-2.0
"""A session that can't be what it says is refused before anything is identified from it, with the reason."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.cli import main
from irec_calibration.errors import ImplausibleSession
from irec_calibration.robot import Payload
from irec_calibration.session import Marker, Noise, Session, write_table
from irec_calibration.session.plausible import check_plausible, judged
from scipy.spatial.transform import Rotation

LOADED = synthetic.session(seed=1)
ABSOLUTE = absolute_sessions.session(noise=Noise(tracker_m=1e-5), poses=60)


def doubts(session: Session) -> tuple[str, ...]:
    return judged(session)[0]


def columns(array: np.ndarray, order: list[int]) -> np.ndarray:
    return array[:, order]


def of(session: Session, **arrays: object) -> Session:
    return replace(session, **{k: v(getattr(session, k)) for k, v in arrays.items()})  # type: ignore[operator]


def station(session: Session, **changed: object) -> Session:
    return replace(session, stations=(replace(session.stations[0], **changed),))


def off_by(joint: int, angle: float):
    return lambda q: q + angle * np.eye(q.shape[1])[joint]


def turned(joint: int):
    return lambda q: q * np.where(np.arange(q.shape[1]) == joint, -1.0, 1.0)


ALTERED = {
    "forces in kN": (lambda s: of(s, force_in_tool=lambda f: f / 1000), "kN for N"),
    "forces in mN": (lambda s: of(s, force_in_tool=lambda f: f * 1000), "N for kN"),
    "forces in kN, none nominal": (lambda s: replace(of(s, force_in_tool=lambda f: f / 1000), load_cases={}), "force_n is 1 N"),
    "the sign of the forces turned": (lambda s: of(s, force_in_tool=lambda f: -f), "sign is turned"),
    "the sign turned, none nominal": (lambda s: replace(of(s, force_in_tool=lambda f: -f), load_cases={}), "along the force"),
    "force_x and force_z exchanged": (lambda s: of(s, force_in_tool=lambda f: columns(f, [2, 1, 0])), "does not point"),
    "no force at all": (lambda s: of(s, force_in_tool=lambda f: 0 * f), "force is 0"),
    "torques in N mm": (
        lambda s: replace(s, has_torque=True, torque_in_tool=np.cross([0, 0, 0.1], s.force_in_tool) * 1000), "N mm"
    ),
    "TCP at 1e9 m": (lambda s: of(s, p_tcp_in_base=lambda p: p + 1e9), "forward kinematics"),
    "TCP in mm": (lambda s: of(s, p_tcp_in_base=lambda p: p * 1000), "tcp_* in mm"),
    "TCP x and y exchanged": (lambda s: of(s, p_tcp_in_base=lambda p: columns(p, [1, 0, 2])), "forward kinematics"),
    "joints 2 and 3 exchanged": (
        lambda s: of(s, q=lambda q: columns(q, [0, 2, 1, 3, 4, 5])), "joint_2 and joint_3 exchanged"
    ),
    "joints in degrees": (lambda s: of(s, q=np.rad2deg), "joint_* in degrees"),
    "the sign of joint 5 turned": (lambda s: of(s, q=turned(4)), "joint_5 of the other sign"),
    "joint 2 off by 90 degrees": (lambda s: of(s, q=off_by(1, np.pi / 2)), "joint_2 off by +90 deg"),
    "joint 3 frozen": (lambda s: of(s, q=lambda q: np.where(np.arange(6) == 2, q[0, 2], q)), "forward kinematics"),
    "markers in mm": (lambda s: of(s, p_marker_in_station=lambda p: p * 1000), "mm for m"),
    "marker x and y exchanged": (
        lambda s: of(s, p_marker_in_station=lambda p: columns(p, [1, 0, 2])), "marker_x and marker_y exchanged"
    ),
    "markers of a mirrored axis": (lambda s: of(s, p_marker_in_station=lambda p: p * [1, 1, -1]), "where the controller has it"),
    "the tracker frozen": (lambda s: of(s, p_marker_in_station=lambda p: 0 * p + p[0]), "did not change"),
    "the station's pose the other way round": (
        lambda s: station(s, quat_xyzw=tuple(np.array(s.stations[0].quat_xyzw) * [-1, -1, -1, 1])), "other way round"
    ),
    "a quaternion with w first": (lambda s: station(s, quat_xyzw=(0.5**0.5, 0.0, 0.0, 0.5**0.5)), "where the controller has it"),
    "the station's place in mm": (lambda s: station(s, xyz=tuple(1000 * x for x in s.stations[0].xyz)), "controller has it"),
    "marker_in_tool0 in mm": (lambda s: replace(s, markers=(replace(s.markers[0], xyz=(20.0, 0.0, -30.0)),)), "marker_in_tool0"),
    "noise in um": (lambda s: replace(s, noise=Noise(7.5)), "um for m"),
    "noise per metre in um": (lambda s: replace(s, noise=Noise(7.5e-6, 3.0)), "um/m"),
    "force noise in mN": (lambda s: replace(s, noise=Noise(7.5e-6, force_n=1000.0)), "force_n is 1000"),
    "gravity in mm": (lambda s: replace(s, gravity_in_base=(0.0, 0.0, -9810.0)), "gravity"),
    "a payload in g": (lambda s: replace(s, payload=Payload(20000.0)), "g for kg"),
    "temperatures in K": (lambda s: replace(s, temperature={"ambient": np.full(len(s), 295.0)}), "K or F"),
    "a rail in mm": (lambda s: replace(s, ext={"rail": np.full(len(s), 2500.0)}), "mm or degrees"),
    "rows of poses mixed up": (
        lambda s: of(s, q=lambda q: np.roll(q, 3, axis=0), p_tcp_in_base=lambda p: np.roll(p, 3, axis=0)), "belong together"
    ),
    "forces in an order of their own": (
        lambda s: replace(of(s, force_in_tool=lambda f: np.random.default_rng(0).permutation(f)), load_cases={}), "springs"
    ),
}  # fmt: skip


def test_a_clean_session_raises_no_doubt():
    assert doubts(LOADED) == () and doubts(ABSOLUTE) == ()


@pytest.mark.parametrize("near", [1.0, 0.1])
def test_a_tool_that_is_aligned_at_contact_raises_no_doubt_however_near_the_poses_are(near):
    low, high = (tuple(near * np.array(ends)) for ends in synthetic.JOINTS)
    assert doubts(synthetic.session(seed=1, aligned=0.18, joints=(low, high))) == ()


def test_a_reference_well_above_the_contact_raises_no_doubt():
    assert doubts(synthetic.session(seed=1, aligned=0.3, axis_aligned=1)) == ()


@pytest.mark.parametrize("name", ALTERED)
def test_a_gross_alteration_is_refused_with_its_reason(name):
    alter, reason = ALTERED[name]
    with pytest.raises(ImplausibleSession, match=".*") as refused:
        check_plausible(alter(LOADED))
    assert reason in str(refused.value), str(refused.value)


ABSOLUTE_ALTERED = {
    "joints in degrees": (lambda s: of(s, q=np.rad2deg), "joint_* in degrees"),
    "joints 2 and 3 exchanged": (lambda s: of(s, q=lambda q: columns(q, [0, 2, 1, 3, 4, 5])), "joint_2 and joint_3 exchanged"),
    "the sign of joint 3 turned": (lambda s: of(s, q=turned(2)), "joint_3 of the other sign"),
    "markers in mm": (lambda s: of(s, p_marker_in_station=lambda p: p * 1000), "mm for m"),
    "rows mixed up": (
        lambda s: of(s, p_marker_in_station=lambda p: np.random.default_rng(1).permutation(p)), "wherever stations and markers"
    ),
}  # fmt: skip
LAST = ("markers in mm", "rows mixed up", "the sign of joint 3 turned")  # what a search of all placements has to be made for


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) if n in LAST else n for n in ABSOLUTE_ALTERED])
def test_a_gross_alteration_of_an_absolute_session_is_refused_with_its_reason(name):
    alter, reason = ABSOLUTE_ALTERED[name]
    session = alter(ABSOLUTE)
    session = replace(session, p_tcp_in_base=session.robot.kinematics(session.q).p_tcp)
    assert any(reason in d for d in doubts(session)), doubts(session)


def test_markers_on_the_base_that_most_readings_are_of_are_no_doubt():
    on_base = (Marker(name, "base_link", (0.3, 0.1, 0.0)) for name in ("B", "C"))
    session = absolute_sessions.session(noise=Noise(tracker_m=1e-5), poses=60, markers=(*on_base, ABSOLUTE.markers[0]))
    assert doubts(replace(session, p_tcp_in_base=session.robot.kinematics(session.q).p_tcp)) == ()


@pytest.mark.parametrize("count", [1, 3])
def test_markers_on_the_base_of_a_loaded_session_are_no_doubt(count):
    rows = np.repeat(np.arange(len(LOADED)), 1 + count)
    marker = np.tile(np.arange(1 + count), len(LOADED))
    on_base = tuple(Marker(f"B{k}", "base_link", (0.3, 0.1 * k, 0.2)) for k in range(count))
    session = replace(LOADED.select(rows), marker=marker, markers=(*LOADED.markers, *on_base))
    at = session.stations[0]
    seen = (np.array([m.xyz for m in session.markers])[marker] - at.xyz) @ at.R_in_base
    seen += np.random.default_rng(1).normal(0.0, 1e-5, seen.shape)
    assert doubts(replace(session, p_marker_in_station=np.where(marker[:, None] > 0, seen, session.p_marker_in_station))) == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_missing_effect_or_bad_rows_are_no_doubt(seed):
    def counterforce(scene):
        return scene.J[:, :, 1] * (2e-4 * np.sign(scene.tau[:, 1] + scene.tau_gravity[:, 1]))[:, None]

    session = synthetic.session(seed=seed, extra=counterforce)
    p = session.p_marker_in_station.copy()
    p[::20] += 1e-3
    assert doubts(replace(session, p_marker_in_station=p)) == ()


def test_a_robot_that_settles_by_more_than_it_gives_way_is_no_doubt():
    def settling(scene):
        by_chance = np.random.default_rng(4).normal(0.0, 5e-4, scene.q.shape)
        return np.einsum("nik,nk->ni", scene.J, by_chance)

    session = synthetic.session(extra=settling)
    assert doubts(session) == ()


def test_axes_that_stop_short_of_the_way_between_poses_are_no_doubt():
    def short_of_its_way(scene):
        before = np.vstack([scene.q[:1], scene.q[:-1]])
        return np.einsum("nik,nk->ni", scene.J, 4e-3 * (scene.q - before))

    session = synthetic.session(extra=short_of_its_way)
    share = np.median(np.linalg.norm(session.p_marker_in_station - LOADED.p_marker_in_station, axis=1))
    assert share > 2e-3, "far more than the force moves it"
    assert doubts(session) == ()


def placed(turn: float, aside: float) -> Session:
    """A session as it would be with its station turned by turn, rad, about base_link, its reflector aside, m, on the tool."""
    R, R_tool = Rotation.from_rotvec([turn, 0.0, 0.0]), LOADED.robot.kinematics(LOADED.q).R_tool
    s = LOADED.stations[0]
    believed = LOADED.p_marker_in_station @ s.R_in_base.T + np.array(s.xyz) + aside * R_tool[:, :, 0]
    return replace(LOADED, p_marker_in_station=(R.apply(believed) - np.array(s.xyz)) @ s.R_in_base)


def test_stations_and_reflectors_a_little_elsewhere_than_stated_are_told_and_left_to_the_diagnosis():
    session = placed(0.06, 0.3)
    (note,) = check_plausible(session).notes
    assert "stations turned by 0.06 rad and markers 0.3 m from where they are stated" in note
    assert check_plausible(placed(0.01, 0.02)).notes == LOADED.notes, "such are usual"


@pytest.mark.parametrize(("turn", "aside"), [(0.2, 0.3), (0.06, 1.2)])
def test_stations_and_reflectors_far_from_where_they_are_stated_are_refused(turn, aside):
    with pytest.raises(ImplausibleSession, match="from where the controller has it"):
        check_plausible(placed(turn, aside))


def test_readings_beside_the_controllers_that_no_place_of_the_station_mends_are_refused():
    p = LOADED.p_marker_in_station
    scattered = p + 0.4 * np.random.default_rng(2).choice([-1.0, 1.0], p.shape) / np.sqrt(3.0)
    with pytest.raises(ImplausibleSession, match="from where the controller has it"):
        check_plausible(replace(LOADED, p_marker_in_station=scattered))


@pytest.mark.parametrize("command", ["solve", "diagnose"])
def test_the_commands_end_with_2_and_the_reason(command, tmp_path, capsys):
    folder = write_table(ALTERED["forces in kN"][0](LOADED), tmp_path / "session")
    out = tmp_path / "out.yaml"
    assert main([command, str(folder), "-o", str(out)]) == 2
    assert "kN for N" in capsys.readouterr().err
    assert not out.exists()


def test_who_knows_better_goes_on_by_force(tmp_path, capsys):
    mars = replace(LOADED, gravity_in_base=(0.0, 0.0, -3.7), meta={**LOADED.meta, "gravity": [0, 0, -3.7]})
    folder = write_table(mars, tmp_path / "s")
    assert main(["solve", str(folder), "-o", str(tmp_path / "m.yaml")]) == 2
    assert main(["solve", str(folder), "-o", str(tmp_path / "m.yaml"), "--accept-implausible"]) == 0
    assert "went on by --accept-implausible although gravity is 3.7" in capsys.readouterr().out
