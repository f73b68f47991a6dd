# SPDX-License-Identifier: Apache-2.0
"""A driver that keeps the contract passes; each of many wrong ones fails, with the sentence that says what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import Cell, read_cell
from irec_calibration.driver_check.moving import Moves, judge_moves
from irec_calibration.driver_check.observed import Answer, Item, Observation, Stream, conclusion, report
from irec_calibration.driver_check.offset import Offsets, judge_offset
from irec_calibration.driver_check.passive import judge_passive
from irec_calibration.driver_check.pressing import Pressing, judge_pressing
from irec_calibration.procedure.axes import read_axes
from irec_calibration.procedure.weighing import mass_verdict, sensor_in_tool, stated_mass, weigh
from irec_calibration.robot import Payload, Robot
from scipy.spatial.transform import Rotation

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
AXES = read_axes(CELL)
STATION = CELL.stations[0]
SENSOR = sensor_in_tool(CELL.robot, "ft_sensor")
MASS, BIAS = 120.0, np.array([18.0, -11.0, 25.0])


def stream(t: np.ndarray, value: np.ndarray, frame: str = "", names: tuple[str, ...] = ()) -> Stream:
    return Stream(t, t + 0.002, value, (frame,) * len(t), names)


def observe(q_of: Callable[[np.ndarray], np.ndarray], begin: float, seconds: float, rail: float = 0.1) -> Observation:
    """Readings of a true driver whose robot follows q_of (n,) -> (n, 6)."""
    rng = np.random.default_rng(3)
    slow, fast, state = (begin + np.arange(1, int(seconds * rate) + 1) / rate for rate in (100.0, 250.0, 10.0))
    q = q_of(slow)
    at = CELL.robot.kinematics(q)
    ride = CELL.base_in_cell(np.array([rail]))[0]
    marker = at.p_tcp + at.R_tool @ CELL.marker_in_tool + ride
    point = (marker - STATION.p_in_cell) @ STATION.R_in_cell + rng.normal(0.0, 1e-5, marker.shape)
    R = CELL.robot.kinematics(q_of(fast)).R_tool
    weight = np.einsum("nji,j->ni", R @ SENSOR, [0.0, 0.0, -9.81 * MASS])
    noise = rng.normal(0.0, 1.0, (len(fast), 6))
    moving = float(np.abs(q_of(slow[-1:]) - q_of(slow[:1])).max() > 1e-4)
    return Observation(
        {
            "joint_states": stream(slow, np.c_[q, np.full(len(slow), rail)], "", AXES.driver),
            "tcp_pose": stream(slow, np.c_[at.p_tcp, Rotation.from_matrix(np.array(at.R_tool)).as_quat()], "base_link"),
            "wrench": stream(fast, noise, "tool0"),
            "wrench_raw": stream(fast, noise + np.c_[weight + BIAS, np.zeros((len(fast), 3))], "ft_sensor"),
            "tracker/point": stream(slow, point, STATION.name),
            "robot/state": stream(state, np.tile([0.0, moving, 0, 0, 0, 0, 0], (len(state), 1)), "base_link"),
        },
        CELL.robot.urdf_text,
    )


def standing() -> Observation:
    return observe(lambda t: np.tile(CELL.home, (len(t), 1)), 10.0, 2.0)


def failures(items: list[Item]) -> str:
    return report([item for item in items if not item.passed])


def test_a_true_driver_passes_the_passive_level() -> None:
    items = judge_passive(standing(), CELL, AXES)
    assert not failures(items) and len(items) > 40


def test_no_tracker_is_asked_for_where_the_cell_file_states_that_there_is_none() -> None:
    blind = replace(CELL, raw={**CELL.raw, "procedure": {**CELL.raw["procedure"], "without_tracker": True}})
    seen = standing()
    del seen.streams["tracker/point"]
    assert "tracker/point is there" in failures(judge_passive(seen, CELL, AXES))
    assert not failures(judge_passive(seen, blind, AXES))


def change(topic: str, **changed: object) -> Callable[[Observation], None]:
    """A fault of one stream; a callable is applied to what is there."""

    def apply(o: Observation) -> None:
        s = o.streams[topic]
        o.streams[topic] = replace(s, **{k: v(getattr(s, k)) if callable(v) else v for k, v in changed.items()})  # type: ignore[arg-type]

    return apply


def framed(frame: str) -> Callable[[tuple[str, ...]], tuple[str, ...]]:
    return lambda frames: (frame,) * len(frames)


def in_degrees(value: np.ndarray) -> np.ndarray:
    return np.c_[np.degrees(value[:, :6]), value[:, 6:]]


def frozen_as_the_sum_rounds(value: np.ndarray) -> np.ndarray:
    """One reading for ever, whose standard deviation is not 0 as it is computed."""
    held = np.tile([0.1, -3.3, 1177.2001, 0.0, 0.0, 0.0], (len(value), 1))
    assert held[:, :3].std(axis=0).max() > 0.0
    return held


def nowhere(o: Observation) -> None:
    o.description = ""


PASSIVE: dict[str, tuple[Callable[[Observation], None], str]] = {
    "wrench in base_link": (change("wrench", frame=framed("base_link")), "frame of wrench: 'base_link' (limit tool0)"),
    "tcp_pose in world": (change("tcp_pose", frame=framed("world")), "frame of tcp_pose: 'world' (limit base_link)"),
    "joint angles in degrees": (change("joint_states", value=in_degrees), "joint_states are in degrees, radians are needed"),
    "joints of other names": (change("joint_states", names=tuple("abcdefg")),
        "state the driver's names in the cell file (robot.joint_names)"),
    "a joint at two places": (change("joint_states", names=lambda n: (*n, n[1]), value=lambda v: np.c_[v, v[:, 1] + 0.5]),
        "is named 2 times, at"),
    "robot/state silent": (lambda o: o.streams.pop("robot/state") and None, "robot/state is there: no message"),
    "tracker silent": (lambda o: o.streams.pop("tracker/point") and None, "tracker/point is there: no message"),
    "tcp_pose missing": (lambda o: o.streams.pop("tcp_pose") and None, "tcp_pose is there: no message"),
    "stamps of 0": (change("joint_states", stamp=lambda t: 0.0 * t), "stamps of joint_states: 200 of 200 are 0"),
    "stamps of another clock": (change("tracker/point", stamp=lambda t: t - 37.0),
        "stamps of tracker/point against the clock: 37002 ms"),
    "readings sent twice": (change("wrench", stamp=lambda t: np.floor(t * 100.0) / 100.0), "do not resend a reading"),
    "tcp_pose in mm": (change("tcp_pose", value=lambda v: np.c_[1e3 * v[:, :3], v[:, 3:]]), "tcp_pose is in mm, m is needed"),
    "tcp_pose of the flange": (change("tcp_pose", value=lambda v: v + [0, 0, 0.2, 0, 0, 0, 0]),
        "tcp_pose against the joint angles: 200.000 mm"),
    "marker in mm": (change("tracker/point", value=lambda v: 1e3 * v), "tracker/point is in mm, m is needed"),
    "held points": (change("tracker/point", value=lambda v: np.tile(v[0], (len(v), 1))), "no repeated, held or zero points"),
    "another station": (change("tracker/point", frame=framed("leica")), "frame of tracker/point: 'leica' (limit A)"),
    "weight in wrench": (change("wrench", value=lambda v: v + [0, 0, -118.0, 0, 0, 0]),
        "remove tool weight and bias from wrench"),
    "no numbers": (change("wrench", value=lambda v: np.where(np.arange(len(v))[:, None] == 7, np.nan, v)),
        "numbers of wrench: NaN or Inf"),
    "too slow": (change("wrench", stamp=lambda t: t[0] + 5.0 * (t - t[0]), arrival=lambda t: t[0] + 5.0 * (t - t[0])),
        "rate of wrench: 50.0 Hz"),
    "best effort": (change("tcp_pose", reliable=False), "QoS of tcp_pose: best effort"),
    "no description": (nowhere, "publish the URDF on robot_description"),
    "wrench frozen": (change("wrench", value=lambda v: np.tile(v[0], (len(v), 1))), "wrench is alive: all the same"),
    "wrench_raw frozen": (change("wrench_raw", value=frozen_as_the_sum_rounds), "wrench_raw is alive: all the same"),
    "in fault": (change("robot/state", value=lambda v: v + [2, 0, 0, 0, 0, 0, 0]), "mode of the standing robot: fault"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", PASSIVE)
def test_a_wrong_driver_fails_the_passive_level_with_the_right_sentence(wrong: str) -> None:
    o = standing()
    fault, sentence = PASSIVE[wrong]
    fault(o)
    assert sentence in failures(judge_passive(o, CELL, AXES))


# --- moves --------------------------------------------------------------------------------------------------------------

TURNS = np.array([[0, 0], [0.25, 0], [-0.25, 0], [0, 0.25], [0, -0.25], [0.2, 0.2]])


def moves() -> Moves:
    stood = []
    for k, (a, b) in enumerate(TURNS):
        q = CELL.home + [0.02 * k, -0.02 * k, 0.0, 0.0, a, b]
        stood.append(observe(lambda t, q=q: np.tile(q, (len(t), 1)), 20.0 + k, 0.5))  # type: ignore[misc]
    way = observe(lambda t: CELL.home + np.outer(t - 30.0, [0.1, 0.05, 0.0, 0.0, 0.0, 0.0]), 30.0, 1.0)
    tcp = way.streams["tcp_pose"].value
    line = np.array([tcp[0, :3], tcp[-1, :3]])
    refused = {"a pose out of reach": Answer(False, "out of reach", 0.1)}
    ok = Answer(True, "", 1.0)
    stopped = line.mean(axis=0)
    return Moves(
        stood, way, line, [(line[1], line[1] + 1e-5)], [ok], Answer(False, "", 0.4, True), stopped, stopped, 0.05, refused, 0.0
    )  # fmt: skip


def test_a_true_driver_passes_the_moves() -> None:
    items = judge_moves(moves(), CELL, AXES)
    assert not failures(items) and len(items) >= 12


def everywhere(topic: str, **changed: object) -> Callable[[Moves], Moves]:
    def apply(m: Moves) -> Moves:
        m = deepcopy(m)
        for o in (*m.standing, m.way):
            change(topic, **changed)(o)
        return m

    return apply


MOVES: dict[str, tuple[Callable[[Moves], Moves], str]] = {
    "tracker with a clock of its own": (everywhere("tracker/point", stamp=lambda t: t + 0.1),
        "stamps of tracker/point against tcp_pose: 1"),
    "commanded angles": (everywhere("joint_states", stamp=lambda t: t - 0.1), "tcp_pose against the joint angles while moving"),
    "held marker": (everywhere("tracker/point", value=lambda v: np.tile([3.0, 0.0, 0.0], (len(v), 1))),
        "does the tracker hold a point"),
    "turned station": (everywhere("tracker/point", value=lambda v: v[:, [1, 2, 0]]),
        "station of the tracker against the cell file: 120.00 deg"),
    "weight in wrench": (everywhere("wrench", value=lambda v: v + 60.0), "remove the tool's weight from wrench"),
    "raw sensor with the sign turned": (everywhere("wrench_raw", value=lambda v: -v), "a tool that hangs pulls down"),
    "cancel ignored": (lambda m: replace(m, cancelled=Answer(True, "", 1.2)), "a cancelled move answers canceled: not canceled"),
    "cancel answered and ignored": (lambda m: replace(m, p_cancelled=m.line[1]),
        "a cancelled move stops before its end: 0.0 mm before the end of a line of"),
    "slow to stop": (lambda m: replace(m, at_cancel=m.p_cancelled - [0.0, 0.0, 0.03]),
        "a cancelled move goes no further: 30.0 mm after the cancel at 50 mm/s (limit 25.0 mm, 0.5 s of the speed)"),
    "raw sensor in pounds": (everywhere("wrench_raw", value=lambda v: 0.2248 * v),
        "mass of the tool on wrench_raw: 27.0 kg are weighed, 120 kg are stated"),
    "advice for pounds": (everywhere("wrench_raw", value=lambda v: 0.2248 * v), "it seems to be in pounds (lbf), N is needed"),
    "raw sensor in kilograms": (everywhere("wrench_raw", value=lambda v: v / 9.807), "kilograms (kgf), N is needed"),
    "raw sensor in kN": (everywhere("wrench_raw", value=lambda v: 1e-3 * v), "it seems to be in kN, N is needed"),
    "raw sensor of half the gain": (everywhere("wrench_raw", value=lambda v: 0.5 * v),
        "the sensor's gain seems to be 0.5 of what it should be; with such a scale the robot presses with 2 times"),
    "cancel leaves the path": (lambda m: replace(m, p_cancelled=m.p_cancelled + [0, 0, 0.01]),
        "a cancelled move stays on its path"),
    "refuses nothing": (lambda m: replace(m, refused={"a pose out of reach": Answer(True, "", 2.0)}),
        "refused: a pose out of reach: accepted"),
    "arrives elsewhere": (lambda m: replace(m, arrived=[(m.line[1], m.line[1] + 0.002)]), "moves arrive where asked: 3.464 mm"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", MOVES)
def test_a_wrong_driver_fails_the_moves_with_the_right_sentence(wrong: str) -> None:
    fault, sentence = MOVES[wrong]
    assert sentence in failures(judge_moves(fault(moves()), CELL, AXES))


def with_payload(mass: float, frame: str = "ft_sensor") -> Cell:
    """The cell whose description has a tool of no mass, with a payload."""
    bare = Robot(CELL.robot.urdf_text.replace('<mass value="120"/>', '<mass value="0"/>'))
    raw = {**CELL.raw, "force_sensor": {**CELL.raw["force_sensor"], "frame": frame}}
    return replace(CELL, robot=bare, payload=Payload(mass), raw=raw)


def weighed(cell: Cell) -> Item:
    return next(i for i in judge_moves(moves(), cell, AXES) if i.name == "mass of the tool on wrench_raw")


def test_where_nobody_states_what_the_sensor_carries_the_report_says_that_nothing_was_compared() -> None:
    item = weighed(with_payload(0.0))
    assert not item.passed and not item.checked and not item.failed
    assert "120.0 kg are weighed, and beyond ft_sensor" in item.figure and "state no mass" in item.figure
    text = report(judge_moves(moves(), with_payload(0.0), AXES))
    assert "not checked mass of the tool on wrench_raw" in text and "1 not checked" in text
    assert "-> state tool.payload.mass" in text


def test_a_driver_is_not_said_to_keep_the_contract_without_naming_what_nobody_has_checked() -> None:
    passed, failed = Item("moves", "a", True, "", ""), Item("moves", "b", False, "", "")
    unknown = Item("moves", "c", False, "", "", checked=False)
    assert conclusion([passed]) == "1 of 1 passed: the driver keeps the contract"
    assert conclusion([passed, unknown]) == (
        "1 of 2 passed, 1 not checked, none failed: the driver keeps the contract but for what nobody has checked: c"
    )
    assert conclusion([passed, failed, unknown]) == "1 of 3 passed, 1 not checked, 1 failed"


def test_a_tool_that_stood_too_seldom_to_be_weighed_is_not_checked() -> None:
    m = moves()
    few = judge_moves(replace(m, standing=m.standing[:2]), CELL, AXES)
    item = next(i for i in few if i.name == "mass of the tool on wrench_raw")
    assert not item.passed and not item.checked and "2 standing places" in item.figure


def test_the_payload_of_the_cell_file_is_what_the_sensor_carries() -> None:
    assert weighed(with_payload(120.0)).passed and weighed(with_payload(100.0)).passed
    assert "120.0 kg are weighed, 30 kg are stated" in weighed(with_payload(30.0)).figure
    assert not weighed(with_payload(30.0)).passed


def test_a_sensor_that_the_description_does_not_have_between_arm_and_tool_is_not_compared() -> None:
    assert stated_mass(with_payload(30.0, "tool0")) == (0.0, 0.0)
    item = weighed(with_payload(30.0, "tool0"))
    assert not item.passed and not item.checked and "no such link before tool0" in item.figure


def test_a_light_tool_that_is_weighed_badly_is_not_told_from_its_mass() -> None:
    """2 kg with 20 N of noise in each orientation."""
    R = CELL.robot.kinematics(CELL.home + np.pad(TURNS, ((0, 0), (4, 0)))).R_tool
    rng = np.random.default_rng(5)
    force = np.einsum("nji,j->ni", R, [0.0, 0.0, -9.81 * 2.0]) + rng.normal(0.0, 20.0, (len(R), 3))
    w = weigh(np.array(R), force)
    passed, _, _, advice = mass_verdict(w, with_payload(2.0))
    assert w.error > 1.0 and passed is None and "hang a known weight" in advice


# --- pressing -----------------------------------------------------------------------------------------------------------


def after_lease(lease: float = 0.5) -> Observation:
    """From the last set point at 50 s on: held, ramp of 0.3 s, drawn back by 20 mm."""
    t, slow = 50.0 + np.arange(1, 900) / 250.0, 50.0 + np.arange(1, 360) / 100.0
    share = np.clip(1.0 - (t - 50.0 - lease) / 0.3, 0.0, 1.0)
    back = 0.02 * np.clip((slow - 50.8 - lease) / 0.5, 0.0, 1.0)
    expired = (slow > 50.0 + lease).astype(float)
    state = np.c_[(slow < 50.3 + lease).astype(float), np.zeros((len(slow), 5)), expired]
    tcp = np.c_[np.zeros((len(slow), 2)), -back, np.zeros((len(slow), 3)), np.ones(len(slow))]
    wrench = np.c_[np.zeros((len(t), 2)), -200.0 * share, np.zeros((len(t), 3))]
    return Observation({"wrench": stream(t, wrench, "tool0"), "tcp_pose": stream(slow, tcp), "robot/state": stream(slow, state)})


def left_alone(leave: float = 2.0) -> Observation:
    """From the switch to position control at 60 s on."""
    t = 60.0 + np.arange(1, 1250) / 250.0
    force = np.c_[np.zeros((len(t), 2)), -200.0 * (t < 60.0 + leave), np.zeros((len(t), 3))]
    return Observation({"wrench": stream(t, force, "tool0")})


def pressing() -> Pressing:
    held = [(f, f + 1.0) for f in np.array([[0, 0, -200.0], [30.0, 0, -200.0], [0, -30.0, -200.0]])]
    ok, no = Answer(True, "", 0.1), Answer(False, "moves are refused in force control", 0.1)
    torques, free = [np.array([0.7, -1.5, 0.2]) + t for t in ([0, 0, 0], [0, 0.4, 0], [0.4, 0, 0])], np.array([0.7, -1.5, 0.2])
    return Pressing(
        ok, ok, 0.05, 0.5, 0.02, held, 1e-6, no, after_lease(), np.eye(3), 50.0, left_alone(), 60.0, torques, free, 0.03
    )  # fmt: skip


def test_a_true_driver_passes_the_pressing() -> None:
    items = judge_pressing(pressing())
    assert not failures(items) and len(items) >= 13


PRESSING: dict[str, tuple[Callable[[Pressing], Pressing], str]] = {
    "sign of the force turned": (lambda p: replace(p, held=[(a, -b) for a, b in p.held]),
        "the sign is turned: what the environment exerts on the robot"),
    "x and y exchanged": (lambda p: replace(p, held=[(a, a[[1, 0, 2]]) for a, _ in p.held]),
        "axes or signs are exchanged (x is y, y is x)"),
    "kilonewtons": (lambda p: replace(p, held=[(a, 1e-3 * b) for a, b in p.held]), "it is in kN, N is needed"),
    "set point ignored": (lambda p: replace(p, held=[(a, p.held[0][1]) for a, _ in p.held]),
        "set point (30, 0, -200) N is held: 29.0 N off"),
    "jump at the switch": (lambda p: replace(p, jump=2e-3), "position control freezes the robot: 2.000 mm"),
    "moves in force control": (lambda p: replace(p, move=Answer(True, "", 1.0)), "moves are refused in force control: accepted"),
    "answers before the mode is active": (lambda p: replace(p, state_late=2.0), "robot/state follows the switch: 2.00 s"),
    "no dead man's switch": (lambda p: replace(p, lease=0.0), "give the driver a dead man's switch"),
    "a lease of half a minute": (lambda p: replace(p, lease=30.0), "force_lease: 30 s"),
    "a lease that is no number": (lambda p: replace(p, lease=float("nan")), "force_lease: nan s"),
    "presses on": (lambda p: replace(p, after=after_lease(10.0)), "the force goes when no set point comes: inf s"),
    "lets go too early": (lambda p: replace(p, after=after_lease(0.0)), "the force holds for the lease"),
    "stays after force control": (lambda p: replace(p, left=left_alone(10.0)),
        "the force goes when no move comes after force control: inf s"),
    "leaves before a move can come": (lambda p: replace(p, left=left_alone(0.1)),
        "the force goes when no move comes after force control: 0.10 s"),
    "torque about the sensor": (lambda p: replace(p, torques=[p.free + np.cross([0, 0, 0.3], force) for force, _ in p.held]),
        "is the torque taken about the sensor in place of the TCP"),
    "stays in contact": (lambda p: replace(p, retract=0.2), "the tool is drawn back: 20.0 mm"),
}  # fmt: skip


def test_where_the_cell_file_states_no_pad_no_torque_is_too_much() -> None:
    items = judge_pressing(replace(pressing(), torques=[np.full(3, 50.0)] * 3, pad_radius=0.0))
    assert not failures(items) and not any("torque" in i.name for i in items)


@pytest.mark.parametrize("wrong", PRESSING)
def test_a_wrong_driver_fails_the_pressing_with_the_right_sentence(wrong: str) -> None:
    fault, sentence = PRESSING[wrong]
    assert sentence in failures(judge_pressing(fault(pressing())))


# --- offset -------------------------------------------------------------------------------------------------------------

SMALL = np.array([6e-4, 0.0, 8e-4])


def offsets(share: Callable[[np.ndarray], np.ndarray] | None = None, largest: float = 0.005, reported: float = 1.0) -> Offsets:
    """Sent from 60 to 62 s; share of it that is applied at a time."""

    def true(t: np.ndarray) -> np.ndarray:
        return np.clip(np.minimum((t - 60.0) / 0.4, 1.0 - (t - 62.1) / 0.4), 0.0, 1.0)

    share = share or true
    state, slow = 59.5 + np.arange(1, 41) / 10.0, 59.5 + np.arange(1, 401) / 100.0

    def seen(offset: np.ndarray) -> Observation:
        told = np.c_[np.zeros((40, 2)), reported * share(state)[:, None] * offset, np.zeros((40, 2))]
        went = np.c_[share(slow)[:, None] * offset, np.zeros((400, 3)), np.ones(400)]
        return Observation({"robot/state": stream(state, told), "tcp_pose": stream(slow, went)})

    return Offsets(SMALL, 60.0, 62.0, seen(SMALL), np.array([0, 0, 0.1]), seen(np.array([0, 0, largest])), without=0.004)


def test_a_true_driver_passes_the_offset() -> None:
    items = judge_offset(offsets())
    assert not failures(items) and len(items) >= 7


OFFSET: dict[str, tuple[Callable[[], Offsets], str]] = {
    "offset ignored": (lambda: offsets(lambda t: 0.0 * t), "an offset is applied and reported: 0.800 mm off"),
    "offset with the sign turned": (lambda: offsets(lambda t: -1.0 * ((t > 60.0) & (t < 62.4))),
        "the TCP moves by it: moved by (-0.6"),
    "no fade": (lambda: offsets(lambda t: 1.0 * (t > 60.0)), "it fades when none comes: inf s"),
    "steps": (lambda: offsets(lambda t: 1.0 * ((t > 60.0) & (t < 62.5))), "nothing jumps: 1.000 mm"),
    "no limit": (lambda: offsets(largest=0.1), "an offset beyond all limits is cut: 100.00 mm of 100 mm"),
    "reports the wrong thing": (lambda: offsets(reported=0.0), "report it in robot/state"),
}  # fmt: skip


def test_offsets_that_this_computer_sends_late_tell_nothing_of_the_driver() -> None:
    late = replace(offsets(lambda t: 0.0 * t), without=0.12)
    assert [i.name for i in judge_offset(late) if not i.checked] == ["offsets are sent in time"]
    assert not any(i.failed for i in judge_offset(late))
    assert "0.12 s without one" in failures(judge_offset(late)) and "nothing of the driver" in failures(judge_offset(late))


@pytest.mark.parametrize("wrong", OFFSET)
def test_a_wrong_driver_fails_the_offset_with_the_right_sentence(wrong: str) -> None:
    fault, sentence = OFFSET[wrong]
    assert sentence in failures(judge_offset(fault()))
