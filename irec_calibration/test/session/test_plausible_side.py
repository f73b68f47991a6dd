# SPDX-License-Identifier: Apache-2.0
"""The force across the tool is judged by differences between load cases; what is odd about rows and weights is noted."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.cli import main
from irec_calibration.robot import Payload, Robot
from irec_calibration.session import Session, Station, write_table
from irec_calibration.session.plausible import judged

LOADED = synthetic.session(20)
LOADED_BARE = replace(LOADED, load_cases={})


def forces(session: Session, change) -> Session:
    return replace(session, force_in_tool=change(session.force_in_tool.copy()))


def times(*signs):
    return lambda f: f * np.array(signs, dtype=float)


def half_turned(f):
    f[len(f) // 2 :, :2] *= -1.0
    return f


def one_late(f):
    for begin in range(0, len(f), 6):
        f[begin + 1 : begin + 6] = np.roll(f[begin + 1 : begin + 6], 1, axis=0)
    return f


def column(k, value):
    def change(f):
        f[:, k] = value
        return f

    return change


REFUSED = {
    "sensor turned by 180 deg": (forces(LOADED_BARE, times(-1, -1, 1)), "turned by 180 deg about z"),
    "force_x of the other sign": (forces(LOADED_BARE, times(-1, 1, 1)), "it would fit (0.", "force_x of the other sign"),
    "force_y of the other sign": (forces(LOADED_BARE, times(1, -1, 1)), "force_y of the other sign"),
    "x and y exchanged": (forces(LOADED_BARE, lambda f: f[:, [1, 0, 2]]), "force_x and force_y exchanged"),
    "sensor turned by 90 deg": (forces(LOADED_BARE, lambda f: f[:, [1, 0, 2]] * [1, -1, 1]), "90 deg about z"),
    "one row late within the pose": (forces(LOADED_BARE, one_late), "next load case of the pose"),
    "the other half of the signs": (forces(LOADED_BARE, half_turned), "it is turned in 10 of 20 poses, first in pose 11"),
    "a dead channel": (forces(LOADED, column(0, 0.0)), "force_x is exactly 0 N", "the channel is dead"),
    "a channel that stands still": (forces(LOADED, column(1, 17.3)), "force_y is exactly 17.3 N"),
    "forces in base_link": (
        forces(LOADED, lambda f: np.einsum("nij,nj->ni", LOADED.robot.kinematics(LOADED.q).R_tool, f)), "force_* in base_link"
    ),
    "load case and reference exchanged": (
        replace(LOADED, load_case=np.where(LOADED.load_case < 2, 1 - LOADED.load_case, LOADED.load_case)), "are 1 and 0 exchanged"
    ),
    "references alone": (LOADED.select(LOADED.load_case == 0), "no loaded row"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_force_that_did_not_deflect_the_robot_is_refused_with_what_would_fit(name):
    session, *words = REFUSED[name]
    doubts = "; ".join(judged(session)[0])
    assert all(word in doubts for word in words), doubts


@pytest.mark.parametrize(
    "session",
    [
        LOADED, LOADED_BARE, forces(LOADED, lambda f: np.round(f)), forces(LOADED, times(0.7, 0.7, 0.7)),
        forces(LOADED_BARE, lambda f: f * 1.3), synthetic.session(12, seed=3, weight=False),
    ],
)  # fmt: skip
def test_a_force_that_is_what_it_says_raises_neither_doubt_nor_note(session):
    assert judged(session) == ((), ())


def test_settling_that_hides_the_force_across_the_tool_is_no_doubt():
    def settling(scene):
        by_chance = np.random.default_rng(4).normal(0.0, 5e-4, scene.q.shape)
        return np.einsum("nik,nk->ni", scene.J, by_chance)

    assert judged(synthetic.session(20, extra=settling))[0] == ()


def test_two_poses_with_exchanged_load_cases_are_left_to_the_diagnosis():
    force = LOADED.force_in_tool.copy()
    force[:12, :2] *= -1.0
    assert judged(replace(LOADED, force_in_tool=force))[0] == ()


def test_load_cases_that_are_named_otherwise_are_noted_where_the_force_is_right():
    exchanged = {1: 1, 2: 3, 3: 2, 4: 5, 5: 4}
    named = {exchanged[c]: f for c, f in LOADED.load_cases.items()}
    doubts, (note,) = judged(replace(LOADED, load_cases=named))
    assert doubts == () and "the robot gives way as force_* says" in note


def test_forces_against_load_cases_are_noted_where_no_marker_tells_which_is_right():
    unseen = replace(LOADED, p_marker_in_station=np.full((len(LOADED), 3), np.nan))
    doubts, notes = judged(forces(unseen, times(-1, -1, 1)))
    assert doubts == () and any("signs or axes of force_*" in n for n in notes)
    assert judged(unseen) == ((), ())


def last_joint_turned(session: Session) -> Session:
    """As it would be with the last joint of the other sign, which moves no TCP on its axis."""
    text = session.robot.urdf_text.replace("0.4 0 0.05", "0.4 0 0")
    robot = Robot(text)
    made = synthetic_on(robot)
    q = made.q.copy()
    q[:, 5] *= -1.0
    return replace(made, q=q)


def synthetic_on(robot: Robot) -> Session:
    q = LOADED.q
    kin = robot.kinematics(q)
    force = np.einsum("nij,nj->ni", kin.R_tool, LOADED.force_in_tool)
    marker = np.array([0.0, 0.0, -0.03])
    p = kin.p_tcp + np.einsum("nij,j->ni", kin.R_tool, marker)
    J = kin.jacobian(kin.p_tcp)
    p = p + np.einsum("nik,nk->ni", J, synthetic.COMPLIANCE * np.einsum("nik,ni->nk", J, force)) + 1e-8 * force
    station = Station("A", known=True)
    markers = (replace(LOADED.markers[0], xyz=tuple(marker)),)
    return replace(LOADED, robot=robot, p_tcp_in_base=kin.p_tcp, p_marker_in_station=p, stations=(station,), markers=markers)


def test_a_last_joint_of_the_other_sign_is_told():
    doubts, notes = judged(last_joint_turned(LOADED))
    assert "joint_6 of the other sign" in " ".join((*doubts, *notes)), (doubts, notes)


def held(session: Session, joint: int, since: int) -> Session:
    q = session.q.copy()
    q[since:, joint] = q[since, joint]
    return replace(session, q=q, p_tcp_in_base=session.robot.kinematics(q).p_tcp)


NOTED = {
    "a joint with one value": (replace(LOADED, q=LOADED.q * [1, 1, 1, 1, 1, 0]), "joint_6 has the same value in every row"),
    "a reference under load": (
        forces(LOADED, lambda f: f - np.outer(LOADED.load_case == 0, [0, 0, 200.0])), "the reference (load_case 0) reads 200"
    ),
    "a bias of loaded rows": (
        forces(LOADED, lambda f: f + np.outer(LOADED.load_case > 0, [100.0, 0, 0])), "off load_cases in all load cases alike"
    ),
    "saturation": (forces(LOADED, lambda f: np.clip(f, [-200, -1e4, -1e4], [200, 1e4, 1e4])), "does it saturate?"),
    "air in degF": (replace(LOADED, temperature={"ambient": np.full(len(LOADED), 72.0)}), "F for degC?"),
}  # fmt: skip


@pytest.mark.parametrize("name", NOTED)
def test_what_is_odd_and_may_be_so_is_noted(name):
    session, words = NOTED[name]
    assert any(words in note for note in judged(session)[1]), judged(session)


def test_a_joint_that_stands_still_from_one_pose_on_is_noted():
    _, notes = judged(held(LOADED, 5, 60))
    assert any("joint_6 is" in n and "in 10 of 20 poses, from pose 11 on" in n for n in notes), notes


def test_poses_at_round_angles_are_no_reading_that_stands_still():
    q = LOADED.q.copy()
    q[:, 5] = np.round(q[:, 5])
    session = replace(LOADED, q=q, p_tcp_in_base=LOADED.robot.kinematics(q).p_tcp)
    assert not any("joint_6 is" in n for n in judged(session)[1])


@pytest.mark.parametrize(("rows", "refused"), [(1, False), (50, True)])
def test_rows_with_a_tcp_of_another_tool_are_counted_and_many_are_refused(rows, refused):
    p = LOADED.p_tcp_in_base.copy()
    p[-rows:, 2] += 0.05
    doubts, notes = judged(replace(LOADED, p_tcp_in_base=p))
    said = [*doubts, *notes] if refused else notes
    assert bool(doubts) == refused and any(f"in {rows} of 120 rows" in s for s in said), (doubts, notes)


def test_a_tcp_that_is_everywhere_about_at_the_limit_is_no_doubt():
    away = np.random.default_rng(0).normal(size=(len(LOADED), 3))
    size = np.random.default_rng(1).uniform(0.008, 0.0115, len(LOADED))
    away *= (size / np.linalg.norm(away, axis=1))[:, None]
    p = LOADED.robot.kinematics(LOADED.q).p_tcp
    assert not any("tcp_*" in d for d in judged(replace(LOADED, p_tcp_in_base=p + away))[0])


@pytest.mark.parametrize(
    ("payload", "refused", "words"),
    [
        (Payload(2400.0, (0.0, 0.0, 0.1)), True, "g for kg?"), (Payload(3.0, (0.0, 0.0, 40.0)), True, "mm for m?"),
        (Payload(100.0, (0.0, 0.0, 0.1)), False, "robots carry less"), (Payload(8.0, (0.0, 0.0, 0.1)), False, ""),
    ],
)  # fmt: skip
def test_a_payload_is_held_against_the_arm_that_carries_it(payload, refused, words):
    session = absolute_sessions.session(poses=40)
    doubts, notes = judged(replace(session, payload=payload))
    about = [s for s in (*doubts, *notes) if s.startswith("payload")]
    assert bool(doubts) == refused and (any(words in s for s in about) if words else not about), (doubts, notes)


@pytest.mark.parametrize(("times_", "refused"), [(1.0, False), (10.0, False), (1000.0, True)])
def test_links_of_a_mass_that_no_arm_has_are_refused(times_, refused):
    text = synthetic.urdf()
    for mass in synthetic.MASSES:
        text = text.replace(f'value="{mass}"', f'value="{mass * times_}"')
    doubts = judged(replace(LOADED, robot=Robot(text)))[0]
    assert any("g for kg?" in d for d in doubts) == refused, doubts


def under_gravity(direction) -> Session:
    """An absolute session of a robot whose joints give way to its weight, gravity stated downward."""
    made = absolute_sessions.session(poses=60)
    kin = made.robot.kinematics(made.q)
    torque = made.robot.gravity_torque(made.q, tuple(direction))
    R = np.stack([s.R_in_base for s in made.stations])[made.station]
    xyz = np.array([m.xyz for m in made.markers])[made.marker]
    J = kin.jacobian(kin.p_tcp + np.einsum("nij,nj->ni", kin.R_tool, xyz))
    sag = np.einsum("nik,nk->ni", J, 5e-6 * torque)
    return replace(made, p_marker_in_station=made.p_marker_in_station + np.einsum("nji,nj->ni", R, sag))


@pytest.mark.parametrize(("direction", "noted"), [((0, 0, 9.81), "upward"), ((0, 0, -9.81), "")])
def test_a_robot_that_hangs_and_does_not_say_so_is_asked(direction, noted):
    doubts, notes = judged(under_gravity(direction))
    about = [n for n in notes if "gravity" in n]
    assert doubts == () and (len(about) == 1 and noted in about[0] and "does the robot hang" in about[0] if noted else not about)


def test_a_commanded_tcp_is_told_from_a_force_of_the_other_sign():
    p = np.repeat(LOADED.p_tcp_in_base[::6], 6, axis=0)
    q = np.repeat(LOADED.q[::6], 6, axis=0)
    force = forces(LOADED, times(-1, -1, -1)).force_in_tool
    session = replace(LOADED, p_tcp_in_base=p, q=q, force_in_tool=force, load_cases={})
    assert any("commanded, not measured" in d for d in judged(session)[0]), judged(session)[0]


def test_check_says_what_diagnose_would_refuse(tmp_path, capsys):
    folder = write_table(replace(LOADED, p_tcp_in_base=LOADED.p_tcp_in_base * 1000.0), tmp_path / "s")
    assert main(["check", str(folder)]) == 2
    assert "implausible: tcp_* is" in capsys.readouterr().out
    assert main(["check", str(write_table(LOADED, tmp_path / "sound"))]) == 0
