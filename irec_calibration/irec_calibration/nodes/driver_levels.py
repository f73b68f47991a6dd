# SPDX-License-Identifier: Apache-2.0
"""What check_driver does at each level with a live driver, to be judged by driver_check."""

from __future__ import annotations

import numpy as np

from irec_msgs.srv import SetControlMode

from ..cell import Cell
from ..driver_check.moving import Moves, judge_moves
from ..driver_check.observed import Answer, Item, Observation
from ..driver_check.offset import SENT_WITHIN, Offsets, judge_offset
from ..driver_check.passive import judge_passive
from ..driver_check.pressing import LEAVE, Pressing, judge_pressing
from ..poses.checker import Checker
from ..procedure.arrival import TOUCH_N, TOUCH_SHARE
from ..procedure.axes import Axes
from ..procedure.commands import LONGEST_LEASE
from ..procedure.settings import Settings
from ..procedure.standstill import LOOK_BACK, second_largest
from ..typing import Array
from .driver_client import DriverClient

LISTEN = 3.0  # s of the cell's clock
SETTLE = 1.0  # s for all topics to be found
STAND = 0.5
TURNS = ((0.0, 0.0), (0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25), (0.2, 0.2))  # rad of the last two axes
LINE = 0.08  # m
SPEED = 0.05  # m/s
PUSH = 200.0  # N, and ACROSS of it sideways: what every force sensor and surface bears
ACROSS = 0.15
FREE_READINGS = 50  # of the wrench before contact, averaged
FARTHEST = 0.02  # m from where the tool was a few millimetres above the surface
OFFSET = 1e-3  # m
FAR = 0.1  # m
TRIES = 8  # of offsets that this computer sends in time; on one that is shared something often comes between


def passive(client: DriverClient, cell: Cell, axes: Axes) -> list[Item]:
    """Listen."""
    advice = "start it, in the namespace of the cell"
    items = [Item("passive", f"{name} is there", False, "not found", "", advice) for name in client.discover()]
    client.wait(lambda: client.now > 0.0, "time on /clock (is use_sim_time set for a robot that is not simulated?)", 15.0)
    client.pause(SETTLE)
    return items + judge_passive(client.seen(*client.pause(LISTEN)), cell, axes, client.simulated)


def moves(client: DriverClient, cell: Cell, axes: Axes, settings: Settings) -> list[Item]:
    """Turn the wrist, go a short way straight, cancel it, ask for what has to be refused. From where the robot stands."""
    names, n = axes.driver[: cell.robot.n_joints], cell.robot.n_joints
    q0, (p0, R0) = client.joints(names), client.tcp()
    standing: list[Observation] = []
    answers: list[Answer] = []
    arrived: list[tuple[Array, Array]] = []
    for a, b in TURNS:
        q = q0.copy()
        q[n - 2] += a
        q[n - 1] += b
        q = np.clip(q, np.array(axes.lower[:n]) + 0.02, np.array(axes.upper[:n]) - 0.02)
        answers.append(client.move_joints(names, q, 0.2 * settings.home_speed))
        standing.append(client.seen(*client.pause(STAND)))
        if answers[-1].success:
            arrived.append((cell.robot.kinematics(q[None]).p_tcp[0], client.tcp()[0]))
    answers.append(client.move_joints(names, q0, 0.2 * settings.home_speed))
    back = -R0[:, 2]  # away from the tooling
    for direction in (back, R0[:, 0]):
        answers.append(client.move_line(p0 + LINE * direction, R0, SPEED))
        standing.append(client.seen(*client.pause(STAND)))
        arrived.append((p0 + LINE * direction, client.tcp()[0]))
        answers.append(client.move_line(p0, R0, SPEED))
    begin = client.now
    answers.append(client.move_line(p0 + LINE * back, R0, SPEED))
    way = client.seen(begin, client.now)
    answers.append(client.move_line(p0, R0, SPEED))
    cancelled = client.move_line(p0 + LINE * back, R0, SPEED, cancel_after=0.8)
    p_cancelled = client.tcp()[0]
    at_cancel = p_cancelled if client.cancelled_at is None else client.cancelled_at
    answers.append(client.move_line(p0, R0, SPEED))
    here = client.tcp()[0]
    beyond = q0.copy()
    beyond[0] = axes.upper[0] + 0.5
    refused = {
        "a joint beyond its limit": client.move_joints(names, beyond, 0.1),
        "a joint that the robot does not have": client.move_joints(("joint_of_another_robot",), np.zeros(1), 0.1),
        "a pose out of reach": client.move_line(p0 + [0.0, 0.0, 50.0], R0, SPEED),
        "a pose that is no number": client.move_line(np.full(3, np.nan), R0, SPEED),
        "a speed of 0": client.move_joints(names, q0, 0.0),
    }
    moved = float(np.linalg.norm(client.tcp()[0] - here))
    line = np.array([p0, p0 + LINE * back])
    seen = Moves(standing, way, line, arrived, answers, cancelled, p_cancelled, at_cancel, SPEED, refused, moved)
    return judge_moves(seen, cell, axes)


def pressing(client: DriverClient, settings: Settings) -> list[Item]:
    """From a few millimetres above a surface that somebody has confirmed; each driver goes there at its own speed."""
    none = np.zeros(3)

    def in_contact(seconds: float) -> float:
        """Until the tool presses, either way, and some seconds more, of the cell's clock; no longer than a load case has, and no
        further than a surface can be. Returns how far the tool has gone, m."""
        begin, longest = client.now, settings.timeouts["settle"]

        def gone() -> float:
            return float(np.linalg.norm(client.tcp()[0] - p0))

        def ends() -> bool:
            return abs(client.last("wrench")[2]) > 0.5 * PUSH or client.now > begin + longest or gone() > FARTHEST

        client.wait(ends, "contact", 10.0 * longest)
        client.pause(seconds)
        return gone()

    _, lease, retract = client.switch(SetControlMode.Request.POSITION, none)
    down = np.array([0.0, 0.0, -PUSH])
    p0, R0 = client.tcp()
    free = client.newest("wrench", FREE_READINGS)[:, 3:].mean(axis=0)
    client.pressing = down
    to_force, lease, retract = client.switch(SetControlMode.Request.FORCE, down)
    begin = client.now
    client.wait(lambda: client.last("robot/state")[0] == 1.0 or client.now - begin > 2.0, "robot/state")
    state_late = client.now - begin
    held, torques = [], []
    way = in_contact(0.0)
    if way > FARTHEST:
        client.pressing = None
        client.switch(SetControlMode.Request.POSITION, none)
        client.move_line(p0, R0, SPEED)
        advice = "is the sign of the set point that of the wrench? is the surface where the first pose has it?"
        figure, limit = f"none within {1e3 * way:.0f} mm", f"{1e3 * FARTHEST:g} mm"
        return [Item("pressing", "the tool comes into contact", False, figure, limit, advice)]
    for force in (down, down + [ACROSS * PUSH, 0.0, 0.0], down + [0.0, -ACROSS * PUSH, 0.0]):
        client.pressing = force
        client.pause(3.0)
        read = client.seen(*client.pause(STAND)).mean("wrench")
        held.append((force, none if read is None else read[:3]))
        torques.append(none if read is None else read[3:])
        if float(held[-1][1][2]) > 0.1 * PUSH:  # the sign is wrong: nothing more of this
            break
    refused = client.move_line(p0, R0, SPEED)
    before = client.seen(*client.pause(0.2)).mean("tcp_pose")
    client.pressing = None
    to_position, _, _ = client.switch(SetControlMode.Request.POSITION, none)
    after_switch = client.seen(*client.pause(0.2)).mean("tcp_pose")
    jump = np.inf if before is None or after_switch is None else float(np.linalg.norm(after_switch[:3] - before[:3]))
    client.pressing = down
    client.switch(SetControlMode.Request.FORCE, down)
    in_contact(2.0)
    client.pressing, last = None, client.now
    client.pause((lease if 0.0 <= lease <= LONGEST_LEASE else LONGEST_LEASE) + 3.0)  # not for the time of a lease that fails
    after = client.seen(last, client.now)
    if client.last("robot/state")[0] == 1.0:  # no dead man's switch
        client.switch(SetControlMode.Request.POSITION, none)
    client.move_line(p0, R0, SPEED)
    client.pressing = down
    client.switch(SetControlMode.Request.FORCE, down)
    in_contact(3.0)
    client.pressing, left_at = None, client.now
    client.switch(SetControlMode.Request.POSITION, none)
    client.pause(LEAVE + 3.0)
    left = client.seen(left_at, client.now)
    client.move_line(p0, R0, SPEED)
    seen = Pressing(
        to_force, to_position, state_late, lease, retract, held, jump, refused, after, R0, last, left, left_at,
        torques, free, settings.pad_radius,
    )  # fmt: skip
    return judge_pressing(seen)


def offset(client: DriverClient) -> list[Item]:
    """In free air: a millimetre for a second, then far too much."""
    small = OFFSET * np.array([0.6, 0.0, 0.8])
    for _ in range(TRIES):
        start, _ = client.pause(STAND)
        client.correcting = small
        begin, end = client.pause(2.0)
        client.correcting = None
        seen = client.seen(start, client.pause(1.5)[1])
        without = client.longest_without_offset(begin, end)
        if without <= SENT_WITHIN:
            break
    client.correcting = np.array([0.0, 0.0, FAR])
    large_begin, _ = client.pause(1.0)
    client.correcting = None
    large_seen = client.seen(large_begin, client.pause(1.5)[1])
    return judge_offset(Offsets(small, begin, end, seen, np.array([0.0, 0.0, FAR]), large_seen, without))


def above_surface(
    client: DriverClient, cell: Cell, axes: Axes, settings: Settings, q: Array, rail: float, distance: float
) -> Answer:
    """To the first pose of the cell: over HOME and its approach pose to `distance` m before contact; close to the surface
    the last stretch is slow, and the tool is taken back where it touches something."""
    at = cell.robot.kinematics(q[None])
    p, R = at.p_tcp[0], at.R_tool[0]
    q_approach, _ = Checker(cell).approach(q[None], at.p_tcp, at.R_tool)
    for target in (cell.home, q_approach[0]):
        position = np.r_[target, rail] if cell.rail is not None and target is not cell.home else target
        answer = client.move_joints(axes.driver[: len(position)], position, settings.home_speed)
        if not answer.success:
            return answer
    near = distance + (settings.checks.near_m if distance < FAR else 0.0)
    answer = client.move_line(p - near * R[:, 2], R, settings.linear_speed)
    if not answer.success or near == distance:
        return answer
    limit = max(TOUCH_N, TOUCH_SHARE * PUSH)
    free = client.last("wrench")[:3]

    def touches() -> bool:
        return second_largest(np.linalg.norm(client.newest("wrench", LOOK_BACK)[:, :3] - free, axis=1)) > limit

    answer = client.move_line(p - distance * R[:, 2], R, settings.near_speed, cancel_when=touches)
    if client.cancelled_at is None:
        return answer
    read = np.round(client.last("wrench")[:3]).tolist()
    client.move_line(client.tcp()[0] - FAR * R[:, 2], R, settings.near_speed)
    return Answer(
        False,
        f"the tool touches something before the reference: the wrench reads {read} N, limit {limit:.0f} N;"
        " does the tooling stand nearer than the cell file says?",
        answer.took,
        answer.cancelled,
    )
