# SPDX-License-Identifier: Apache-2.0
"""Link-side angles are compared with the motor-side ones of the same moment, and with a drive without process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from chain import ROBOT
from irec_calibration.commands.links import write_table
from irec_calibration.sensors.dry_drive import DryDriveTable
from irec_correction.errors import SettingsError
from irec_correction.link_angles import DryDrive, LinkAngles, read_dry_drive
from irec_correction.watchdog import Fault, Finding

NAMES = ("a", "b")
WINDUP = np.array([4e-4, -3e-4])
SPEED = np.array([1.0, -0.5])  # rad/s


def motor(t: float) -> np.ndarray:
    return np.array([0.2, 0.7]) + SPEED * t


def test_a_moving_arm_is_told_apart_from_its_windup_whatever_the_rates_and_the_order_of_messages() -> None:
    angles, told = LinkAngles(2, 0.5), []
    times = sorted([(0.008 * k, "motor") for k in range(50)] + [(0.003 + 0.005 * k, "link") for k in range(70)])
    for t, kind in times:
        if kind == "motor":
            told.append(angles.take_motor(t, motor(t)))
        else:
            told.append(angles.take_link(t, t, motor(t) + WINDUP))
    windups = [answer for answer in told if answer is not None]
    assert len(windups) > 40  # one for each motor-side sample at least
    for stamp, windup in windups:
        assert abs((stamp - 0.003) / 0.005 - round((stamp - 0.003) / 0.005)) < 1e-9  # of link-side stamps
        np.testing.assert_allclose(windup, WINDUP, atol=1e-9)


def test_angles_that_come_after_both_neighbours_are_answered_at_once() -> None:
    angles = LinkAngles(2, 0.5)
    for t in (1.0, 1.004, 1.008):
        assert angles.take_motor(t, motor(t)) is None
    stamp, windup = angles.take_link(1.006, 1.01, motor(1.006) + WINDUP)  # type: ignore[misc]
    assert stamp == 1.006
    np.testing.assert_allclose(windup, WINDUP, atol=1e-9)


@pytest.mark.parametrize(
    ("stamp", "link", "fault"),
    [
        (1.004, np.zeros(3), Fault.JOINTS_NAMES),
        (1.004, np.array([np.nan, 0.0]), Fault.JOINTS_NOT_FINITE),
        (1.7, np.zeros(2), Fault.JOINTS_CLOCK),
        (float("nan"), np.zeros(2), Fault.JOINTS_CLOCK),
        (0.9, np.zeros(2), Fault.JOINTS_CLOCK),  # before all motor-side angles
        (1.05, np.zeros(2), Fault.JOINTS_CLOCK),  # in a gap of them
    ],
)
def test_what_can_not_be_paired_is_refused_with_a_reason(stamp: float, link: np.ndarray, fault: Fault) -> None:
    angles = LinkAngles(2, 0.5)
    for t in (1.0, 1.004, 1.008, 1.1):
        angles.take_motor(t, motor(t))
    answer = angles.take_link(stamp, 1.1, link)
    assert answer is not None and isinstance(answer[1], Finding)
    assert answer[1].fault is fault and len(answer[1].text) > 20


def test_a_stamp_that_does_not_go_on_is_refused_and_the_next_one_taken() -> None:
    angles = LinkAngles(2, 0.5)
    for t in (1.0, 1.004, 1.008):
        angles.take_motor(t, motor(t))
    answers = [angles.take_link(t, 1.008, motor(t) + WINDUP) for t in (1.006, 1.006, 1.007)]
    assert [isinstance(a[1], Finding) for a in answers if a] == [False, True, False]


def test_gravity_and_eccentricity_are_taken_off_where_the_robot_is_on_the_way(tmp_path: Path) -> None:
    def dry(q: np.ndarray) -> np.ndarray:
        return np.stack([1e-3 * np.cos(q[..., 0]), 2e-4 * np.sin(7.0 * q[..., 1])], axis=-1)

    q = np.array([motor(t) for t in np.linspace(0.0, 1.0, 2001)])
    write_table(tmp_path / "links.csv", DryDriveTable(NAMES, q, q + dry(q), len(q)))
    angles = LinkAngles(2, 0.5, read_dry_drive(tmp_path / "links.csv", NAMES))
    for t in (0.1, 0.5, 0.502, 0.95, 0.2):  # jumps along the way too
        angles.take_motor(t if t != 0.2 else 2.0, motor(t))
        stamp = t if t != 0.2 else 2.0
        answer = angles.take_link(stamp, stamp, motor(t) + dry(motor(t)) + WINDUP)
        assert answer is not None
        np.testing.assert_allclose(answer[1], WINDUP, atol=2e-6)
    away = motor(0.5) + [0.0, 0.3]
    angles.take_motor(3.0, away)
    _, finding = angles.take_link(3.0, 3.0, away + WINDUP)  # type: ignore[misc]
    assert isinstance(finding, Finding)
    assert finding.outside and "0.200 rad" in finding.text


@pytest.mark.parametrize(
    ("text", "word"),
    [("", "empty"), ("a,b,link_a\n0,0,0\n", "link_b"), ("a,b,link_a,link_b\n0,0,x,0\n", "finite"), ("# x\n", "missing")],
)
def test_a_table_that_is_no_dry_drive_is_refused(text: str, word: str, tmp_path: Path) -> None:
    (tmp_path / "links.csv").write_text(text)
    with pytest.raises(SettingsError, match=word):
        read_dry_drive(tmp_path / "links.csv", NAMES)


def test_a_dry_drive_of_another_robot_is_refused() -> None:
    with pytest.raises(SettingsError, match="2 joints, the robot has 6"):
        LinkAngles(6, 0.5, DryDrive(np.zeros((3, 2)), np.zeros((3, 2))))


@pytest.mark.parametrize(("given", "word"), [("links.file", "without links.topic"), ("links.topic", "motor-side")])
def test_parameters_of_the_node_that_do_not_go_together_are_refused(given: str, word: str) -> None:
    parameters = pytest.importorskip("irec_correction.nodes.parameters")
    table = {p.name: p.default for p in (*parameters.CORRECTION, *parameters.LINKS)}
    assert parameters.links(table, ROBOT) is None
    with pytest.raises(SettingsError, match=word):
        parameters.links(table | {given: "joint_states"}, ROBOT)
