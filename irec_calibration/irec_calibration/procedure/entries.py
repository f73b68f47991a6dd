# SPDX-License-Identifier: Apache-2.0
"""What each state of the table does once, on entry."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ..typing import Array
from .arrival import AIR_WINDOW, presses_still, touch_limit, way_out_is_known
from .by_encoders import commanded_problem
from .checks import contact_problem, contact_problem_by_encoders
from .commands import Event, MoveJoint, MoveLinear, Row
from .marker_way import contact_way_problem
from .nearer import met_the_tooling
from .plausible import Standing, newtons
from .standstill import Window

if TYPE_CHECKING:
    from .machine import Procedure

WITHDRAW = 0.05  # m along the tool, from a contact that a run finds
FIRST_POSE_LIMIT = 0.5  # share of the load cases of the first pose that may be rejected
SAME_TIME = 0.1  # s between readings that may be compared with each other
FRESH = 0.3  # s of the machine's clock: joint angles that came longer ago say nothing about where the robot is now


def nothing(p: Procedure) -> None:
    """Wait for the operator, or be done."""
    if p.state == "paused":
        p.event("paused", "")
    elif p.state == "finished":
        if presses_still(p):
            still = f"the wrench still reads a force{_newest_newtons(p)}"
            p.add_reason(f"{still}: where that is contact, drive the robot free by hand, nothing moves it any more")
        _judge_rejections(p, p.settings.skip_limit)
        _judge_scale(p)
        p.event("stopped" if p.stopped_because else "finished", p.stopped_because)


def _judge_scale(p: Procedure) -> None:
    """Who has pressed and does not know with what scale of the force says so."""
    if p.plausibility is None or not p.counts.cases:
        return
    told, p.scale_doubt = p.scale_doubt, p.plausibility.scale.doubt()
    if p.scale_doubt and not told:
        p.out.append(Event("unverified", 0, 0, 0, p.scale_doubt))


def switch_to_position(p: Procedure) -> None:
    """Line 24; also before a run, which then knows whether the driver has a dead man's switch."""
    p.switch(False, np.zeros(3))


def move_out(p: Procedure) -> None:
    """Back along the tool from where the robot was found pressing."""
    tcp = p.streams.newest_tcp
    if tcp is None:
        raise RuntimeError("a run was started without readings of tcp_pose")
    R = Rotation.from_quat(tcp[1]).as_matrix()
    p.move(MoveLinear(tcp[0] - WITHDRAW * R[:, 2], R, _slow(p)))


def begin_pose(p: Procedure) -> None:
    """Nothing is recorded of it yet. Draws the order of the load cases."""
    p.pose_since, p.recorded, p.case, p.outcome = p.since_elapsed, 0, 0, ""
    p.p_contact, p.p_touch, p.p_pressed, p.reference = None, None, [], None
    if p.seed is not None and p.target is not None:
        drawn = np.random.default_rng([p.seed, p.target.pose, p.repeat]).permutation(len(p.forces))
        p.order = tuple(int(j) + 1 for j in drawn)


def move_home(p: Procedure) -> None:
    """Line 4; the rail stays where it is, since the arm may still be close to the tooling."""
    begin_pose(p)
    if problem := _standing_problem(p):
        p.stop(problem)
        return
    p.move(MoveJoint(p.home, None, p.settings.home_speed))


def move_to_approach(p: Procedure) -> None:
    """Line 5."""
    target = p.work[p.index][0]
    if problem := _standing_problem(p):
        p.stop(problem)
        return
    p.move(MoveJoint(target.q_approach, target.rail, p.settings.home_speed))


def move_near(p: Procedure) -> None:
    """Lines 6 and 7, as far as the robot may go fast: `near_m` before the reference."""
    target = p.work[p.index][0]
    if problem := _standing_problem(p):
        p.stop(problem)
        return
    read = p.streams.mean_force(-np.inf, AIR_WINDOW)
    p.force_in_air = p.force_unloaded = np.zeros(3) if read is None else read
    z = target.R_tool_in_base[:, 2]
    if float((target.p_reference - target.p_approach) @ z) <= p.settings.checks.near_m:  # all of the way is the last stretch
        p.go("near")
        return
    p.move(MoveLinear(target.p_reference - p.settings.checks.near_m * z, target.R_tool_in_base, p.settings.linear_speed))


def move_to_reference(p: Procedure) -> None:
    """Lines 6 and 7, so slowly that a cancel ends a touch of the tooling before the force is dangerous."""
    target = p.work[p.index][0]
    p.move(MoveLinear(target.p_reference, target.R_tool_in_base, p.settings.near_speed))


def _standing_problem(p: Procedure) -> str:
    """What of the newest readings of the standing robot does not agree."""
    joints, tcp, marker = p.streams.newest_joints, p.streams.newest_tcp, p.streams.newest_marker
    if p.plausibility is None or joints is None or tcp is None or not p.streams.stands:
        return ""
    newest = p.streams.newest()
    if abs(newest["joints"] - newest["TCP"]) > SAME_TIME or p.watch.silent_for("joints") > FRESH:
        return ""  # one of them has stopped: the watch over silence says which
    seen = marker is not None and marker[0] > max(p.streams.newest().values()) - SAME_TIME
    place = marker[1:] if marker is not None and seen else (None, "")
    standing = _standing(p, joints, tcp[0], tcp[1], *place)
    return p.plausibility.problem(standing) or p.plausibility.weight_problem(standing.R_tool)


def _standing(p: Procedure, joints: Array, p_tcp: Array, quat: Array, p_marker: Array | None, station: str) -> Standing:
    k = len(p.home)
    rail = float(joints[k]) if len(joints) > k else 0.0
    return Standing(joints[:k], rail, p_tcp, Rotation.from_quat(quat).as_matrix(), station, p_marker)


def begin_window(p: Procedure) -> None:
    """Only readings from now on may count; those of a load case, once it has been held."""
    p.window_from = p.since + (p.settings.settling.hold_s if p.state == "settle" else 0.0)


def record_and_switch(p: Procedure) -> None:
    """Lines 8 to 11: the window that stood still is the reference."""
    window = _window(p)
    if p.plausibility is not None and window.quat_tcp is not None:
        marker = window.p_marker_in_station.mean(axis=0) if window.station else None
        quat = window.quat_tcp[-1]
        s = _standing(p, window.q.mean(axis=0), window.p_tcp_in_base.mean(axis=0), quat, marker, window.station)
        if problem := p.plausibility.problem(s):
            p.stop(problem)
            return
    read = window.force_in_tool.mean(axis=0)
    limit = touch_limit(p)
    if float(np.linalg.norm(read)) > limit:
        _refuse_reference(p, read, limit)
        return
    p.reference, p.force_unloaded = window, read
    _record(p, 0)
    p.case = 1
    p.switch(True, _normal(p))


def _refuse_reference(p: Procedure, read: Array, limit: float) -> None:
    """A force at the reference is contact made too early, or bias or weight that was not removed: that reads in free air too."""
    in_air = p.force_in_air
    if float(np.linalg.norm(in_air)) <= limit:
        met_the_tooling(
            p,
            f"the tool touches the tooling at the reference already: the wrench reads {np.round(read).tolist()} N, limit"
            f" {limit:.0f} N, and {np.round(in_air).tolist()} N in free air; the tooling stands nearer than the cell file says",
        )
        return
    p.stop(
        f"before contact the wrench reads {np.round(read).tolist()} N, limit {limit:.0f} N: is the sensor's bias set and the"
        " tool's weight removed, and does nothing touch the tool?"
    )


def _normal(p: Procedure) -> Array:
    """The part of the first load case along the tool: contact is made without lateral force, which would slide it."""
    return np.array([0.0, 0.0, p.forces[p.load_case - 1][2]])


def ask_for_contact(p: Procedure) -> None:
    """Line 12: press with the normal force alone until the contact holds."""
    p.window_from, p.force_before = p.since, None
    p.set_force(_normal(p))


def ask_for_force(p: Procedure) -> None:
    """Line 13."""
    p.window_from = p.since
    p.force_before = p.streams.newest_force
    if p.p_contact is None and p.streams.newest_tcp is not None:
        p.p_contact = p.streams.newest_tcp[0]  # under the normal force alone, whatever the first load case is
    p.counts.cases += 1
    p.set_force(p.forces[p.load_case - 1])


def record_row(p: Procedure) -> None:
    """Lines 14 to 21, unless the contact slips."""
    window, reference = _window(p), p.reference
    if reference is None:
        raise RuntimeError("record was entered without a reference")
    if problem := _contact_problem(p, window, reference):
        p.reject(problem)
        return
    _record(p, p.load_case)
    p.recorded += 1
    p.p_pressed.append(window.p_tcp_in_base.mean(axis=0))


def _contact_problem(p: Procedure, window: Window, reference: Window) -> str:
    R_tool = p.work[p.index][0].R_tool_in_base
    if p.settings.without_tracker:
        if p.p_contact is None:
            raise RuntimeError("record was entered without a contact")
        return contact_problem_by_encoders(window, reference, p.p_contact, R_tool, p.settings)
    station = p.station_rotation.get(reference.station)
    if station is None:
        return f"the tracker reports as '{reference.station}', which the cell file does not name"
    problem = contact_problem(window, reference, station.T @ R_tool, p.settings)
    return problem or contact_way_problem(window, reference, p.p_touch, station, R_tool, p.settings.checks.marker_m)


def _window(p: Procedure) -> Window:
    if p.window is None:
        raise RuntimeError("nothing stood still that could be recorded")
    return p.window


def _record(p: Procedure, load_case: int) -> None:
    pose = p.work[p.index][0].pose
    p.out.append(Row(pose, load_case, p.repeat, _window(p), p.streams.names, dict(p.streams.temperature)))


def count_case(p: Procedure) -> None:
    """Line 22."""
    p.case += 1


def move_off(p: Procedure) -> None:
    """Line 25: off the surface along the tool, to the place of the reference or as far from where the robot is."""
    target, tcp = p.work[p.index][0], p.streams.newest_tcp
    if tcp is None:
        raise RuntimeError("the robot is to leave the contact without readings of tcp_pose")
    z = target.R_tool_in_base[:, 2]
    way = max(float((tcp[0] - target.p_reference) @ z), p.settings.reference_distance)
    p.move(MoveLinear(tcp[0] - way * z, target.R_tool_in_base, _slow(p)))


def _slow(p: Procedure) -> float:
    return min(p.settings.checks.lift_speed, p.settings.linear_speed)


def move_to_retract(p: Procedure) -> None:
    """Line 25."""
    target = p.work[p.index][0]
    p.move(MoveLinear(target.p_approach, target.R_tool_in_base, p.settings.linear_speed))


def count_pose(p: Procedure) -> None:
    """Line 26; a pose that was broken off is not counted, it is measured again."""
    if p.outcome == "broken off":
        return
    if not p.outcome:
        if p.recorded:
            p.event("complete", f"{p.recorded} of {len(p.forces)} load cases")
            p.counts.complete += 1
            p.counts.seconds.append(p.since_elapsed - p.pose_since)
            if p.settings.without_tracker and not p.stopped_because:
                p.stopped_because = commanded_problem(p.p_pressed)
        else:
            p.skip(f"no load case could be recorded; the last because: {p.last_rejection}")
    p.index += 1
    if p.counts.complete + p.counts.skipped - len(p.refused) == 1:
        _judge_rejections(p, FIRST_POSE_LIMIT)  # what is wrong with a driver is wrong at each pose


def _judge_rejections(p: Procedure, limit: float) -> None:
    """A run of which too much was rejected is no success."""
    if p.counts.rejected > limit * p.counts.cases and not p.stopped_because:
        p.stopped_because = (
            f"{p.counts.rejected} of {p.counts.cases} load cases were rejected, limit {limit:.0%};"
            f" the last because: {p.last_rejection}"
        )


def give_up(p: Procedure) -> None:
    """The robot does not obey: stop asking."""
    p.cancel_move()


def stand_off(p: Procedure) -> None:
    """The robot may press in position control. No move is asked for: the driver's own way out of the contact begins then."""
    p.outcome = "broken off"
    p.cancel_move()


def let_go(p: Procedure) -> None:
    """The driver has not drawn the tool back: take the force down, where it is known to act from the surface on the tool."""
    if not way_out_is_known(p):
        p.fail(f"the robot may press, and the force{_newest_newtons(p)} does not tell the way out")
        return
    p.switch(True, np.zeros(3))


def _newest_newtons(p: Procedure) -> str:
    force = p.streams.newest_force
    return "" if force is None else f" ({newtons(force)} N)"


_ALL = (
    nothing, switch_to_position, move_out, begin_pose, move_home, move_to_approach, move_near, move_to_reference, begin_window,
    record_and_switch, ask_for_contact, ask_for_force, record_row, count_case, move_off, move_to_retract, count_pose, give_up,
    stand_off, let_go,
)  # fmt: skip
ENTRIES: dict[str, Callable[[Procedure], None]] = {function.__name__: function for function in _ALL}
