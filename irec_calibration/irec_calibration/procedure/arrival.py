# SPDX-License-Identifier: Apache-2.0
"""Whether a move that was answered with success has led where it was to lead, and whether the tool has left the contact.

An answer is a claim. Where the robot stands is read from joint_states and tcp_pose, whether it presses from the wrench; after a
move out of the contact what can be read has to say so, and at least one of the two has to be readable.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ..typing import Array
from .commands import MoveJoint, MoveLinear
from .marker_way import free_way_problem
from .plausible import newtons
from .settings import LEAST_UNLOADED_N, UNLOADED_SHARE
from .standstill import LOOK_BACK, second_largest

if TYPE_CHECKING:
    from .machine import Procedure

ARRIVED = 0.01  # rad and m between where a joint move was to end and where it has ended
TURNED = 0.02  # rad, of the tool after a straight move
SHORT_SHARE, LEAST_ARRIVAL = 0.5, 5e-4  # of a way that is so short that who does not move would have arrived; m
NEWER = 3  # joint states and TCP poses that have to come after the answer
STAND_WAIT = 3.0  # s after which angles that are too noisy to be told from slow motion are taken as they are
UNKNOWN_S = 3.0  # s after which a silent stream is not waited for any more
AIR_WINDOW = 0.1  # s over which the force is averaged once the robot stands
TOUCH_WINDOW = 0.04  # s, likewise where it is to be known at once
TOUCH_N, TOUCH_SHARE = 20.0, 0.15  # N and share of the normal force: more out of contact is no noise
SEEN_TO_MOVE = 1e-4  # m, of the TCP
WAY_OUT = 0.5  # share of the force that has to act along the tool for the way out to be known
SPEED_WINDOW, SPEED_SHARE, SPEED_MARGIN = 0.1, 1.5, 0.02  # s; share of the speed asked for, and m/s on top, that a move may have
LEASE_GRACE = 0.3  # s after an answer in which robot/state may still be of before


def touch_limit(p: Procedure) -> float:
    """More than this, N, is contact, or a bias or weight that was not removed."""
    return max(TOUCH_N, TOUCH_SHARE * abs(float(p.forces[0][2])))


def unloaded_limit(p: Procedure) -> float:
    """Largest change of the unloaded force over one pose, N, with which its load cases can be believed."""
    s = p.settings
    return s.checks.unloaded_n or max(2.0 * s.settling.force_n, UNLOADED_SHARE * abs(float(p.forces[0][2])), LEAST_UNLOADED_N)


def force_beside_unloaded(p: Procedure, begin: float, length_s: float) -> Array | None:
    """Mean force over the newest length_s, less what was read unloaded at this pose, (3,), N; None while it is not known."""
    mean = p.streams.mean_force(begin, length_s)
    return None if mean is None or not np.isfinite(mean).all() else mean - p.force_unloaded


def joint_problem(q: Array, asked: Array, rail: float, rail_asked: float | None) -> str:
    """What is wrong with the end of a joint move. q, asked: (k,), rad. rail, rail_asked: m; None where it was not moved."""
    off = q - asked
    worst = int(np.abs(off).argmax())
    if abs(off[worst]) > ARRIVED:
        return (
            f"the move to {asked[worst]:.4f} rad of axis {worst + 1} was answered with success, joint_states says"
            f" {q[worst]:.4f} rad (limit {ARRIVED:g} rad apart): does the driver move by the names and units of the goal, and"
            " answer when the robot has arrived?"
        )
    if rail_asked is not None and abs(rail - rail_asked) > ARRIVED:
        return f"the move of the rail to {rail_asked:.4f} m was answered with success, joint_states says {rail:.4f} m"
    return ""


def tcp_problem(p_tcp: Array, quat: Array, asked: MoveLinear, limit: float) -> str:
    """What is wrong with the end of a straight move. p_tcp: (3,), m. quat: of tool0, (4,), in base_link. limit: m."""
    off = float(np.linalg.norm(p_tcp - asked.p_in_base))
    turn = float((Rotation.from_quat(quat).inv() * Rotation.from_matrix(np.array(asked.R_in_base))).magnitude())
    if off > limit:
        return (
            f"the straight move to {_mm(asked.p_in_base)} mm was answered with success, tcp_pose says {_mm(p_tcp)} mm:"
            f" {1e3 * off:.1f} mm apart, limit {1e3 * limit:g} mm (procedure.checks.arrival_m); does the driver answer when the"
            " robot has arrived?"
        )
    if turn > TURNED:
        return (
            f"the straight move was answered with success, and tcp_pose is turned by {np.degrees(turn):.1f} deg against its end,"
            f" limit {np.degrees(TURNED):.1f} deg"
        )
    return ""


def place_problem(p: Procedure) -> str | None:
    """Empty: the robot stands at the end of the move under way; a sentence: it does not; None: not known yet."""
    if not p.moved or p.goal is None:
        return None
    waited = p.time.elapsed - p.answered_at
    if any(p.streams.counts[name] < p.counts_at_answer[name] + NEWER for name in ("joints", "TCP")):
        p.message = "the move was answered; waits for joint_states and tcp_pose"
        return None
    problem = _end_problem(p)
    if not p.streams.stands and (problem or waited <= STAND_WAIT):
        p.message = f"the move was answered, and the robot does not stand yet{': ' if problem else ''}{problem}"
        return None
    return problem


def _end_problem(p: Procedure) -> str:
    joints, tcp, goal = p.streams.newest_joints, p.streams.newest_tcp, p.goal
    if joints is None or tcp is None or goal is None:
        raise RuntimeError("the end of a move was asked for without readings")
    if isinstance(goal, MoveJoint):
        k = len(p.home)
        return joint_problem(joints[:k], goal.q, float(joints[k]) if len(joints) > k else 0.0, goal.rail)
    way = 0.0 if p.moved_from is None else float(np.linalg.norm(goal.p_in_base - p.moved_from))
    return tcp_problem(tcp[0], tcp[1], goal, min(p.settings.checks.arrival_m, max(SHORT_SHARE * way, LEAST_ARRIVAL)))


def arrived(p: Procedure) -> bool:
    """The robot stands where the move was to lead; it is stopped where it stands elsewhere."""
    problem = place_problem(p)
    if problem:
        p.stop(problem)
    return problem == ""


def out_of_contact(p: Procedure) -> bool:
    """The robot stands where the way out was to lead, and the force is that of before contact."""
    if not p.moved:
        return False
    place, waited = place_problem(p), p.time.elapsed - p.answered_at
    silent = place is None and p.watch.silent_for("joints") > UNKNOWN_S and waited > UNKNOWN_S
    if place:
        p.fail(f"the robot has not left the contact: {place}")
        return False
    if place is None and not silent:
        return False
    if np.isnan(p.stood_at):
        p.stood_at = p.now
    force = force_beside_unloaded(p, p.stood_at, AIR_WINDOW)
    if force is None:
        p.message = "the robot stands; waits for the force"
        if waited <= UNKNOWN_S:
            return False
        if silent:
            p.fail("neither joint_states nor wrench tell whether the robot has left the contact")
            return False
        p.stop("no force is read after the way out of the contact")
    else:
        _judge_unloaded(p, force, silent)
    p.is_out = True
    return True


def _judge_unloaded(p: Procedure, beside: Array, silent: bool) -> None:
    """The force out of contact against that of before contact. Where the robot is was checked.

    At the reference the tool may have touched the tooling a little, so that it is also that of free air, and after the retract
    that alone.

    Args:
        beside: force less what was read unloaded at this pose, (3,), N.
    """
    read = beside + p.force_unloaded
    known = [p.force_in_air] if p.state == "retract" else [p.force_unloaded, p.force_in_air]
    before = min(known, key=lambda force: float(np.linalg.norm(read - force)))
    off = read - before
    size = float(np.linalg.norm(off))
    if p.state == "withdraw":
        if size > touch_limit(p):
            p.stop(
                f"before contact the wrench reads {newtons(off)} N, limit {touch_limit(p):.0f} N, and did so before the tool was"
                " drawn back: is the sensor's bias set and the tool's weight removed, and does nothing touch the tool?"
            )
        return
    if p.state == "lift" and p.reference is None:
        return  # the tooling may stand nearer than so few millimetres
    problem = ""
    if size > unloaded_limit(p) and p.reference is not None:
        problem = (
            f"after the retract the wrench reads {newtons(read)} N, {newtons(before)} N before"
            f" contact: {size:.0f} N apart, limit {unloaded_limit(p):.0f} N (procedure.checks.unloaded_n): the sensor's bias"
            " has changed under load (set anew, drift, overload), and the load cases of this pose are not what was read"
        )
        p.discard(problem)
    if size > touch_limit(p):
        p.stop(
            problem
            or f"out of contact the wrench reads {newtons(read)} N, limit {touch_limit(p):.0f} N: has the sensor's bias changed,"
            " or does something touch the tool?"
        )
    if not silent and not problem and (problem := free_way_problem(p)):
        p.discard(problem)
        p.stop(problem)


def _forces_on_the_way(p: Procedure) -> Array:
    """The newest LOOK_BACK forces since the move under way was asked for, (n, 3), N."""
    return p.streams.last_forces(max(0, min(LOOK_BACK, p.streams.counts["force"] - p.forces_at_move)))


def force_rises(p: Procedure) -> str:
    """Why the move out of the contact under way is to be cancelled: the force rises where it is to fall. Empty: it does not."""
    read = _forces_on_the_way(p)
    if not p.moving or len(read) < 2 or not np.isfinite(p.force_at_move).all():
        return ""
    margin = touch_limit(p) if p.state == "retract" else unloaded_limit(p)  # nothing swings while it moves slowly
    began, largest = p.force_at_move, p.settings.force_abort_n
    pressing, limit = second_largest(-read[:, 2]), max(0.0, -float(began[2])) + margin
    sizes = np.linalg.norm(read, axis=1)
    size, limit_of_all = second_largest(sizes), max(largest, float(np.linalg.norm(began)) + margin)
    if not (pressing > limit or size > limit_of_all):
        return ""
    return (
        f"the robot presses harder on its way out of the contact: {newtons(read[int(sizes.argmax())])} N, {newtons(began)} N when"
        f" it began, limit {limit:.0f} N along the tool and {limit_of_all:.0f} N in all: {_into_the_surface(p)}; the move was"
        " cancelled"
    )


def _into_the_surface(p: Procedure) -> str:
    """What a force that rises on the way out of the contact means, by the way of the TCP."""
    tcp, target = p.streams.newest_tcp, p.target
    out = 0.0
    if tcp is not None and p.moved_from is not None and target is not None:
        out = -float((tcp[0] - p.moved_from) @ target.R_tool_in_base[:, 2])  # the tool's z axis points into the surface
    if out < -SEEN_TO_MOVE:
        return f"the move leads into the surface ({-1e3 * out:.1f} mm by tcp_pose)"
    if out < SEEN_TO_MOVE:
        return "the move leads into the surface, or the wrench reads wrongly"
    return (
        f"by tcp_pose the TCP has moved {1e3 * out:.1f} mm out of the surface, so the wrench reads wrongly (has its bias changed,"
        " is it at the end of its range?), or tcp_pose is not where the robot goes, or something else is in its way"
    )


def touches_on_the_way(p: Procedure) -> str:
    """Why the advance to the reference is to be cancelled: the tool touches something. Empty: it does not."""
    read = _forces_on_the_way(p)
    if not p.moving or len(read) < 2:
        return ""
    sizes = np.linalg.norm(read - p.force_unloaded, axis=1)
    if not second_largest(sizes) > touch_limit(p):
        return ""
    return (
        f"the tool touches the tooling before the reference: the wrench reads {newtons(read[int(sizes.argmax())])} N, limit"
        f" {touch_limit(p):.0f} N, and {newtons(p.force_unloaded)} N in free air; the tooling stands nearer than the"
        " cell file says"
    )


def too_fast(p: Procedure) -> str:
    """Why the straight move under way is to be cancelled: it is driven far faster than was asked for. Empty: it is not."""
    if not p.moving or not isinstance(p.goal, MoveLinear):
        return ""
    speed, limit = p.streams.tcp_speed(SPEED_WINDOW), SPEED_SHARE * p.goal.speed + SPEED_MARGIN
    if speed <= limit:
        return ""
    return (
        f"the robot is driven at {1e3 * speed:.0f} mm/s by tcp_pose on a straight move for which {1e3 * p.goal.speed:g} mm/s was"
        f" asked, limit {1e3 * limit:.0f} mm/s: does the driver take the speed of the goal, in m/s?"
    )


def presses_still(p: Procedure) -> bool:
    """The run is to end, and the tool may be in contact."""
    if p.is_out or not p.stopped_because:
        return False
    off = force_beside_unloaded(p, -np.inf, TOUCH_WINDOW)
    return off is not None and float(np.linalg.norm(off)) > touch_limit(p)


def is_free(p: Procedure) -> bool:
    """The robot has left the contact by itself: position control, it stands, and the force is that of before contact."""
    off = force_beside_unloaded(p, p.since, AIR_WINDOW)
    size = np.inf if off is None else float(np.linalg.norm(off))
    if size > touch_limit(p):
        p.message = "the force is not known" if off is None else f"{size:.0f} N is still read: the robot may press"
        return False
    if p.watch.robot_presses or p.in_state_s <= LEASE_GRACE:
        p.message = "the robot is leaving the contact by itself"
        return False
    p.is_out = bool(p.streams.stands or p.watch.silent_for("joints") > UNKNOWN_S)
    return p.is_out


def is_relieved(p: Procedure) -> bool:
    """Without a dead man's switch: no force is left in force control, so that position control freezes none."""
    if not p.switched or p.lease_s > 0.0 or p.time.elapsed - p.switched_at <= LEASE_GRACE:
        return False
    off = force_beside_unloaded(p, p.since, AIR_WINDOW)
    return off is not None and float(np.linalg.norm(off)) <= unloaded_limit(p)


def way_out_is_known(p: Procedure) -> bool:
    """The force acts from the surface along the tool, against the way of pressing."""
    off = force_beside_unloaded(p, -np.inf, TOUCH_WINDOW)
    return off is not None and -float(off[2]) >= WAY_OUT * float(np.linalg.norm(off)) > 0.0


def found_in_contact(p: Procedure) -> tuple[bool, str]:
    """Whether the tool is pressed by a robot in position control before a run, and why it can't be led out of that."""
    off = force_beside_unloaded(p, -np.inf, AIR_WINDOW)
    if off is None or float(np.linalg.norm(off)) <= touch_limit(p):
        return False, ""
    if way_out_is_known(p):
        return True, ""
    return False, (
        f"before the run the wrench reads {newtons(off)} N, limit {touch_limit(p):.0f} N, and not along the tool, so that nobody"
        " knows the way out: drive the robot free by hand, or set the sensor's bias and remove the tool's weight"
    )


def _mm(p: Array) -> str:
    return f"({', '.join(f'{1e3 * v:.1f}' for v in p)})"
