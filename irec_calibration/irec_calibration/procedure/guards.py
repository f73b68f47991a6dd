# SPDX-License-Identifier: Apache-2.0
"""When a state of the table is left."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .arrival import arrived, is_free, is_relieved, out_of_contact, presses_still
from .by_encoders import unsettled_by_encoders
from .plausible import what_is_read
from .standstill import too_few, unsettled

if TYPE_CHECKING:
    from .machine import Procedure

SILENT = 0.5  # s without a reading, for the message only
FOLLOW_S = 3.0  # s in which the force has to follow a new set point
FOLLOW_SHARE = 0.25  # of the change, at least
EXPLAIN_S = 1.0  # s after which a force that is not near is worth an explanation
NEVER_SEEN_S = 3.0  # s at the first reference without any reading of the tracker since the run began


def _force_is_near(p: Procedure) -> bool:
    """The force has come within twice the settling tolerance of the set point."""
    mean = p.streams.mean_force(p.window_from, 0.25 * p.settings.window_s)
    if mean is None:
        p.message = "waits for force readings"
        return False
    asked = p.setpoint
    off = float(np.abs(mean - asked).max())
    if off <= 2.0 * p.settings.settling.force_n:
        p.message = ""
        return True
    if p.in_state_s > EXPLAIN_S:
        p.message = f"force is {off:.0f} N off its set point: {what_is_read(asked, mean)}"
    before = p.force_before
    if before is not None and p.in_state_s > FOLLOW_S:
        change = asked - before
        size = float(np.linalg.norm(change))
        if size > 4.0 * p.settings.settling.force_n and (mean - before) @ change < FOLLOW_SHARE * size * size:
            stays = float(np.linalg.norm(mean - before)) < 0.1 * size
            read = f"it reads {np.round(before).tolist()} N as before" if stays else what_is_read(asked, mean)
            p.stop(
                f"the force does not follow robot/force_setpoint: {np.round(asked).tolist()} N was asked for {FOLLOW_S:g} s ago,"
                f" {read}; does the driver take set points?"
            )
    return False


def _stands_still(p: Procedure) -> bool:
    """One whole window since entry in which the force stands still, and the marker or, without a tracker, the joints."""
    window = p.streams.window(p.window_from, p.settings.window_s)
    if window is None:
        newest = p.streams.newest()
        silent = [n for n in p.streams.needed if newest.get(n, -1.0) < p.now - SILENT]
        p.message = f"no readings of {', '.join(silent)}" if silent else "fills the averaging window"
        p.message += " (tracker: line of sight?)" if "marker" in silent else ""
        never_seen = "marker" in p.streams.needed and p.streams.counts["marker"] == p.markers_before
        if never_seen and p.in_state_s > NEVER_SEEN_S:
            p.stop(
                "tracker/point has not sent a single point since the run began: is the tracker measuring, its driver running, and"
                " the topic in this namespace?"
            )
        return False
    target = None if p.state == "reference" else p.setpoint
    p.message = too_few(window, p.settings.checks)
    if p.message:
        return False
    if p.settings.without_tracker:
        lever, names = p.work[p.index][0].lever, p.streams.names
        p.message = unsettled_by_encoders(window, p.settings.settling, p.settings.min_samples, target, lever, names)
    else:
        p.message = unsettled(window, p.settings.settling, p.settings.min_samples, target)
    p.window = window
    return not p.message


def _same_place(p: Procedure) -> bool:
    """The robot stands at the approach pose of what comes next, back from a measurement there that was completed."""
    if p.outcome or not 0 < p.index < len(p.work):
        return False
    last, following = p.work[p.index - 1][0], p.work[p.index][0]
    return (
        last.rail == following.rail
        and np.array_equal(last.q_approach, following.q_approach)
        and np.array_equal(last.R_tool_in_base, following.R_tool_in_base)
        and np.array_equal(last.p_approach, following.p_approach)
        and np.array_equal(last.p_reference, following.p_reference)
    )


def _guards() -> dict[str, Callable[[Procedure], bool]]:
    return {
        "always": lambda p: True,
        "started": lambda p: p.started,
        # all poses are measured or refused, or the run was stopped before it began
        "nothing_to_do": lambda p: not p.found_pressing and (bool(p.stopped_because) or (p.started and not p.work)),
        "arrived": arrived,
        "out_of_contact": out_of_contact,
        "out_and_ending": lambda p: out_of_contact(p) and bool(p.stopped_because),
        "presses_still": presses_still,
        "is_free": is_free,
        "is_relieved": is_relieved,
        "switched": lambda p: p.switched,
        "switched_from_contact": lambda p: p.switched and p.found_pressing,
        "switched_and_ending": lambda p: p.switched and bool(p.stopped_because),
        "force_is_near": _force_is_near,
        "stands_still": _stands_still,
        "cases_left": lambda p: p.case <= len(p.forces),
        "ending": lambda p: bool(p.stopped_because),
        "pausing": lambda p: p.pause_wanted,
        "resumed": lambda p: not p.pause_wanted,
        "no_pose_left": lambda p: p.index >= len(p.work),
        "same_place": _same_place,
    }


GUARDS = _guards()
