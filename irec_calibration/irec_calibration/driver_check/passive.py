# SPDX-License-Identifier: Apache-2.0
"""Level `passive`: nothing is commanded. Topics, frames, names, rates, stamps, units, and kinematics against tcp_pose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from ..cell import Cell
from ..joint_states import contradiction, named_twice
from ..procedure.axes import Axes
from ..robot import Robot
from ..typing import Array
from .observed import Item, Observation, Stream

LEVEL = "passive"
RATES = {"joint_states": 50.0, "tcp_pose": 50.0, "wrench": 200.0, "wrench_raw": 200.0, "tracker/point": 20.0, "robot/state": 9.0}
FRAMES = {"tcp_pose": "base_link", "wrench": "tool0"}
GAP = 0.2  # s without a message, of what comes at 50 Hz and more
LAG = 0.1  # s between stamp and arrival, median
SIMULATED_LAG = 0.5  # s, where time is simulated: a simulator may be ahead of those who listen
TCP = 1e-4  # m between forward kinematics and tcp_pose
TURN = 2e-4  # rad, likewise
FREE_FORCE = 30.0  # N in free air
PLACE = 0.5  # m between where the tracker sees the marker and where station and TCP say it is
LEAST_TO_TELL = 50  # readings of a wrench, of which a live sensor has two that differ
SAME_ROBOT = 1e-5  # m between the two descriptions
REACH = 50.0  # m


def judge_passive(seen: Observation, cell: Cell, axes: Axes, simulated: bool = False) -> list[Item]:
    """All items of the level, from a few seconds of a standing robot in free air. simulated: so is its clock."""
    return [
        *_streams(seen, cell, SIMULATED_LAG if simulated else LAG),
        *_joints(seen, axes),
        *_kinematics(seen, cell, axes),
        *_forces(seen),
        *_tracker(seen, cell, axes),
        *_description(seen, cell),
        *_state(seen),
    ]


def _item(name: str, passed: bool, figure: str, limit: str, advice: str) -> Item:
    return Item(LEVEL, name, bool(passed), figure, limit, advice)


def _streams(seen: Observation, cell: Cell, lag_limit: float) -> Iterator[Item]:
    for topic, rate in RATES.items():
        if topic == "tracker/point" and cell.without_tracker:
            continue
        s = seen.streams.get(topic)
        if s is None or not len(s.stamp):
            yield _item(
                f"{topic} is there",
                False,
                "no message",
                "",
                f"publish {topic}, in the namespace of the cell, with this type and QoS",
            )
            continue
        yield from _stamps(topic, s, lag_limit)
        span = float(s.stamp[-1] - s.stamp[0])
        measured = (len(s.stamp) - 1) / span if span > 0 else 0.0
        yield _item(
            f"rate of {topic}", measured >= rate, f"{measured:.1f} Hz", f"at least {rate:g} Hz", "raise the rate of the driver"
        )
        gap = float(np.diff(s.stamp).max()) if len(s.stamp) > 1 else np.inf
        if rate >= 50.0:
            yield _item(
                f"gaps of {topic}", gap <= GAP, f"{gap:.3f} s", f"{GAP:g} s", "something holds the driver up, or loses messages"
            )
        yield _item(
            f"numbers of {topic}",
            bool(np.isfinite(s.value).all()),
            "all finite" if np.isfinite(s.value).all() else "NaN or Inf",
            "finite",
            "send nothing where nothing was measured",
        )
        yield _item(
            f"QoS of {topic}",
            s.reliable,
            "reliable" if s.reliable else "best effort",
            "reliable",
            "offer reliable: both kinds of subscribers match",
        )
        wanted = {st.name for st in cell.stations} if topic == "tracker/point" else {FRAMES.get(topic, "")}
        if topic in FRAMES or topic == "tracker/point":
            wrong = sorted(set(s.frame) - wanted)
            yield _item(
                f"frame of {topic}",
                not wrong,
                f"'{wrong[0]}'" if wrong else f"'{s.frame[0]}'",
                " or ".join(sorted(wanted)),
                "set header.frame_id, and transform the values where they are given in another frame",
            )


def _stamps(topic: str, s: Stream, lag_limit: float) -> Iterator[Item]:
    zero = int((s.stamp == 0.0).sum())
    if zero:
        yield _item(
            f"stamps of {topic}",
            False,
            f"{zero} of {len(s.stamp)} are 0",
            "none",
            "stamp each reading with the time at which it was taken",
        )
        return
    backwards = int((np.diff(s.stamp) <= 0.0).sum())
    yield _item(
        f"order of the stamps of {topic}",
        backwards == 0,
        f"{backwards} not newer than the one before",
        "0",
        "do not resend a reading, and do not publish from a timer when no new one came",
    )
    lag = float(np.median(s.arrival - s.stamp))
    yield _item(
        f"stamps of {topic} against the clock",
        abs(lag) <= lag_limit,
        f"{1e3 * lag:.0f} ms",
        f"{1e3 * lag_limit:.0f} ms",
        "bring the instrument's clock to the ROS clock (use_sim_time, time synchronisation)",
    )


def positions(seen: Observation, axes: Axes) -> tuple[Array, Stream] | None:
    """Joints and rail in the order of `axes`, (n, k), and their stream; None where a name is missing."""
    s = seen.streams.get("joint_states")
    if s is None or not len(s.value) or any(name not in s.names for name in axes.driver):
        return None
    return s.value[:, [s.names.index(name) for name in axes.driver]], s


def _joints(seen: Observation, axes: Axes) -> Iterator[Item]:
    s = seen.streams.get("joint_states")
    if s is None or not len(s.value):
        return
    missing = [name for name in axes.driver if name not in s.names]
    yield _item(
        "joint names",
        not missing,
        f"{', '.join(s.names)}",
        ", ".join(axes.driver),
        "name the joints as the description does, or state the driver's names in the cell file (robot.joint_names)",
    )
    found = positions(seen, axes)
    if found is None:
        return
    twice = named_twice(s.names, axes.driver)
    why = next(filter(None, (contradiction(twice, position) for position in s.value)), "") if twice else ""
    yield _item("each joint once", not why, why or "yes", "one position each", "let one node alone send the robot's joints")
    q, over = found[0], ""
    for k, name in enumerate(axes.driver):
        worst = float(q[:, k][np.abs(q[:, k]).argmax()])
        if not axes.lower[k] - 0.01 <= worst <= axes.upper[k] + 0.01:
            over = over or f"{name} at {worst:.4g}"
    yield _item(
        "joints within their limits",
        not over,
        over or "all",
        "limits of the description",
        "radians and metres are needed; are these degrees or mm?",
    )


def _kinematics(seen: Observation, cell: Cell, axes: Axes) -> Iterator[Item]:
    found, tcp = positions(seen, axes), seen.streams.get("tcp_pose")
    if found is None or tcp is None or not len(tcp.value):
        return
    n, q = cell.robot.n_joints, np.median(found[0], axis=0)
    read = np.median(tcp.value, axis=0)
    at = cell.robot.kinematics(q[None, :n])
    off = float(np.linalg.norm(at.p_tcp[0] - read[:3]))
    turn = (
        np.inf
        if np.linalg.norm(read[3:]) < 0.5
        else float(Rotation.from_matrix(at.R_tool[0].T @ Rotation.from_quat(read[3:]).as_matrix()).magnitude())
    )
    advice = "is tcp_pose tool0 in base_link, and the description that of this robot and tool?"
    if np.linalg.norm(cell.robot.kinematics(np.radians(q[None, :n])).p_tcp[0] - read[:3]) < 0.01:
        advice = "joint_states are in degrees, radians are needed"
    elif np.linalg.norm(at.p_tcp[0] - 1e-3 * read[:3]) < 0.01:
        advice = "tcp_pose is in mm, m is needed"
    yield _item("tcp_pose against the joint angles", off <= TCP, f"{1e3 * off:.3f} mm", f"{1e3 * TCP:g} mm", advice)
    yield _item(
        "orientation of tcp_pose against the joint angles",
        turn <= TURN,
        f"{np.degrees(turn):.3f} deg",
        f"{np.degrees(TURN):.3f} deg",
        "quaternion x y z w of tool0 in base_link, tool0 z out of the tool",
    )


def _forces(seen: Observation) -> Iterator[Item]:
    mean = seen.mean("wrench")
    if mean is None:
        return
    size = float(np.abs(mean[:3]).max())
    yield _item(
        "force in free air",
        size <= FREE_FORCE,
        f"{size:.1f} N",
        f"{FREE_FORCE:g} N",
        "remove tool weight and bias from wrench, in N",
    )
    for topic in ("wrench", "wrench_raw"):
        s = seen.streams.get(topic)
        if s is not None and len(s.value) > LEAST_TO_TELL:
            # not the standard deviation: its mean is rounded, so that of equal numbers need not be 0
            alive = float(np.ptp(s.value[:, :3], axis=0).max())
            yield _item(
                f"{topic} is alive",
                alive > 0.0,
                "all the same" if alive == 0.0 else f"the force spreads by {alive:.3g} N",
                "more than 0",
                "a sensor that reads the same to the last bit is not being read",
            )


def _tracker(seen: Observation, cell: Cell, axes: Axes) -> Iterator[Item]:
    s, found, tcp = seen.streams.get("tracker/point"), positions(seen, axes), seen.mean("tcp_pose")
    if s is None or not len(s.value) or cell.without_tracker:
        return
    held = float(np.ptp(s.value, axis=0).max()) if len(s.value) > 20 else np.inf
    yield _item(
        "tracker points are measured",
        held > 0.0,
        "all the same" if held == 0.0 else f"they spread by {1e6 * held:.0f} um",
        "more than 0",
        "send nothing while the line of sight is broken: no repeated, held or zero points",
    )
    station = next((st for st in cell.stations if s.frame and st.name == s.frame[-1]), None)
    if station is None or tcp is None or found is None or np.linalg.norm(tcp[3:]) < 0.5:
        return
    rail = found[0][-1, cell.robot.n_joints] if cell.rail is not None else 0.0
    by_tcp = tcp[:3] + Rotation.from_quat(tcp[3:]).as_matrix() @ cell.marker_in_tool + cell.base_in_cell(np.array([rail]))[0]
    point = np.median(s.value, axis=0)
    off = float(np.linalg.norm(station.p_in_cell + station.R_in_cell @ point - by_tcp))
    in_mm = np.linalg.norm(station.p_in_cell + station.R_in_cell @ (1e-3 * point) - by_tcp) < PLACE
    yield _item(
        "marker against tcp_pose",
        off <= PLACE,
        f"{off:.3f} m",
        f"{PLACE:g} m",
        "tracker/point is in mm, m is needed"
        if in_mm
        else "give points in the frame of the station; is the station where the cell file says?",
    )


def _description(seen: Observation, cell: Cell) -> Iterator[Item]:
    advice = "publish the URDF on robot_description, reliable and transient local"
    if not seen.description:
        yield _item("robot_description", False, "none", "", advice)
        return
    try:
        other = Robot(seen.description, "robot_description")
        off = float(np.linalg.norm(other.kinematics(cell.home[None]).p_tcp[0] - cell.robot.kinematics(cell.home[None]).p_tcp[0]))
        yield _item(
            "robot_description against the cell file",
            off <= SAME_ROBOT,
            f"{1e3 * off:.3f} mm at HOME",
            f"{1e3 * SAME_ROBOT:g} mm",
            "the description of the driver and that of the cell file are not of one robot and tool",
        )
    except Exception as error:  # whatever a foreign description makes of the reader
        yield _item("robot_description against the cell file", False, str(error).splitlines()[0], "", advice)
    yield _item(
        "robot_description comes late too",
        seen.description_latched,
        "latched" if seen.description_latched else "volatile",
        "transient local",
        advice,
    )


def _state(seen: Observation) -> Iterator[Item]:
    s = seen.streams.get("robot/state")
    if s is None or not len(s.value):
        return
    mode = int(s.value[-1, 0])
    names = {0: "position control", 1: "force control", 2: "fault"}
    yield _item(
        "mode of the standing robot",
        mode == 0,
        names.get(mode, str(mode)),
        "position control",
        "clear the fault, leave force control",
    )
    yield _item(
        "a standing robot is not in motion",
        not s.value[:, 1].any(),
        "in_motion" if s.value[:, 1].any() else "stands",
        "stands",
        "in_motion is true only while a Move is carried out",
    )
