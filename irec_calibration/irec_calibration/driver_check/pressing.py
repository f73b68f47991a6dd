# SPDX-License-Identifier: Apache-2.0
"""Level `pressing`: on a surface that somebody has confirmed. Sign and axes of the force, mode switches, the lease."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..procedure.checks import torque_limit, torque_problem
from ..procedure.commands import LONGEST_LEASE
from ..procedure.plausible import what_is_read
from ..typing import Array
from .observed import Answer, Item, Observation, Stream

LEVEL = "pressing"
OFF = 0.1  # share of the set point by which the mean force may be off
SWITCH = 5.0  # s for a mode switch
STATE = 0.5  # s until robot/state says so
JUMP = 2e-4  # m of tcp_pose when position control freezes the robot
LEASE_SLACK = 1.0  # s beyond the lease in which the force has to be gone: the ramp
LEFT = 20.0  # N, no contact
LEAVE = 2.0  # s in which a move has to begin after force control, by the contract
LEAVE_SLACK = 1.0  # s beyond it in which the force has to be gone
RETRACT_SHARE = 0.8  # of the way back that the driver states


@dataclass(frozen=True)
class Pressing:
    """What was done and seen.

    Attributes:
        to_force, to_position: answers to the switches; state_late: s until robot/state said force control.
        lease: s as the driver says; retract: m, likewise.
        held: (set point (3,), mean force (3,)) once it should be settled, N.
        torques: mean torque (3,) with each of them, N m. free: before contact, (3,), N m. pad_radius: m, 0: not known.
        jump: m, of tcp_pose at the switch to position control.
        move: answer to a move in force control.
        after: from the last set point on; R_tool: rotation of tool0 in base_link then; last_sent: s.
        left: from a switch to position control in contact on, without a move; left_at: s.
    """

    to_force: Answer
    to_position: Answer
    state_late: float
    lease: float
    retract: float
    held: list[tuple[Array, Array]]
    jump: float
    move: Answer
    after: Observation
    R_tool: Array
    last_sent: float
    left: Observation
    left_at: float
    torques: list[Array] = field(default_factory=list)
    free: Array = field(default_factory=lambda: np.zeros(3))
    pad_radius: float = 0.0


def judge_pressing(p: Pressing) -> list[Item]:
    """All items of the level."""
    return [*_switches(p), *_forces(p), *_lease(p), *_left_alone(p)]


def _item(name: str, passed: bool, figure: str, limit: str, advice: str) -> Item:
    return Item(LEVEL, name, bool(passed), figure, limit, advice)


def _switches(p: Pressing) -> Iterator[Item]:
    for name, answer in (("force", p.to_force), ("position", p.to_position)):
        good = answer.success and answer.took <= SWITCH
        yield _item(
            f"switch to {name} control",
            good,
            f"{answer.took:.2f} s {answer.message}".strip(),
            f"{SWITCH:g} s",
            "answer when the mode is active",
        )
    yield _item(
        "robot/state follows the switch",
        p.state_late <= STATE,
        f"{p.state_late:.2f} s",
        f"{STATE:g} s",
        "publish robot/state on every change",
    )
    yield _item(
        "position control freezes the robot",
        p.jump <= JUMP,
        f"{1e3 * p.jump:.3f} mm",
        f"{1e3 * JUMP:g} mm",
        "keep the position where it is: no jump, no move back",
    )
    yield _item(
        "moves are refused in force control",
        not p.move.success and bool(p.move.message),
        p.move.message or "accepted",
        "",
        "abort with the reason",
    )


def _forces(p: Pressing) -> Iterator[Item]:
    for asked, read in p.held:
        size = float(np.linalg.norm(asked))
        off = float(np.abs(read - asked).max())
        against = float(read[2] * asked[2]) < 0.0 and abs(read[2]) > 0.1 * abs(asked[2])
        advice = (
            "the sign is turned: what the environment exerts on the robot, in tool0; pressing reads a negative z"
            if against
            else (f"{what_is_read(asked, read)}; is it the force at the TCP in tool0, as the set point is?")
        )
        yield _item(
            f"set point ({', '.join(f'{v:.0f}' for v in asked)}) N is held",
            off <= OFF * size,
            f"{off:.1f} N off",
            f"{OFF * size:.1f} N",
            advice,
        )


    if p.pad_radius <= 0.0 or not p.torques:
        return
    pairs = [(torque - p.free, read) for torque, (_, read) in zip(p.torques, p.held, strict=True)]
    torque, read = max(pairs, key=lambda pair: float(np.linalg.norm(pair[0])))
    size, limit = float(np.linalg.norm(torque)), torque_limit(read, p.pad_radius)
    yield _item(
        "torque that the pad can carry",
        size <= limit,
        f"{size:.1f} N m",
        f"{limit:.1f} N m",
        torque_problem(torque, read, p.pad_radius),
    )


def _lease(p: Pressing) -> Iterator[Item]:
    advice = "take the force down and draw the tool back when no set point comes for force_lease; see the contract"
    yield _item(
        "force_lease",
        0.0 < p.lease <= LONGEST_LEASE,
        f"{p.lease:g} s",
        f"above 0, {LONGEST_LEASE:g} s at most",
        "give the driver a dead man's switch and say its time in SetControlMode",
    )
    force, state = p.after.streams.get("wrench"), p.after.streams.get("robot/state")
    if p.lease <= 0.0 or force is None or not len(force.stamp):
        return
    late = _gone_after(force, p.last_sent)
    yield _item(
        "the force goes when no set point comes",
        late <= p.lease + LEASE_SLACK,
        f"{late:.2f} s",
        f"{p.lease + LEASE_SLACK:g} s",
        advice,
    )
    early = force.stamp[(np.abs(force.value[:, 2]) < 0.5 * np.abs(force.value[:5, 2]).mean())]
    held = float(early[0] - p.last_sent) if len(early) else np.inf
    yield _item(
        "the force holds for the lease",
        held >= 0.8 * p.lease,
        f"{held:.2f} s",
        f"{0.8 * p.lease:g} s",
        "a set point holds for force_lease",
    )
    tcp = p.after.streams.get("tcp_pose")
    if tcp is not None and len(tcp.value):
        back = float(-(tcp.value[-1, :3] - tcp.value[0, :3]) @ p.R_tool[:, 2])
        yield _item(
            "the tool is drawn back",
            back >= RETRACT_SHARE * p.retract and p.retract > 0.0,
            f"{1e3 * back:.1f} mm",
            f"{1e3 * p.retract:g} mm as stated",
            advice,
        )
    if state is not None and len(state.value):
        reported = state.value[-1, 6] > state.value[0, 6] and int(state.value[-1, 0]) == 0
        yield _item(
            "robot/state says so",
            reported,
            "expired_leases counted, position control" if reported else "it does not",
            "",
            "count expired_leases, say retreating, go to position control",
        )


def _gone_after(force: Stream, since: float) -> float:
    """Time from then to where the force has gone, s; inf: it has not."""
    gone = force.stamp[np.abs(force.value[:, 2]) < LEFT]
    return float(gone[0] - since) if len(gone) else np.inf


def _left_alone(p: Pressing) -> Iterator[Item]:
    force = p.left.streams.get("wrench")
    if p.lease <= 0.0 or force is None or not len(force.stamp):
        return
    late = _gone_after(force, p.left_at)
    yield _item(
        "the force goes when no move comes after force control",
        0.5 * LEAVE <= late <= LEAVE + LEAVE_SLACK,
        f"{late:.2f} s",
        f"{0.5 * LEAVE:g} to {LEAVE + LEAVE_SLACK:g} s",
        f"draw the tool back by itself where it stands in contact and no move came for {LEAVE:g} s after force control",
    )
