# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 as one table, to be read beside the 27 lines of the paper.

`lines` are the lines of Procedure 1; `enter` is the method of `Procedure` that runs once on entry; `leave` lists (guard, next
state), the first guard that holds wins; `otherwise` is what a timeout or a failed command leads to:

    stop          end the run; the robot is taken out of contact first
    skip_pose     give this pose up: position control, retract, next pose
    next_pose     give this pose up while still away from the surface
    next_case     give this load case up, its rows are not recorded, and go on with the next one
    failed        the robot does not obey: end the run and say so
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class State:
    """One row of the table; `otherwise` is empty for states that are left at once or by the operator only."""

    name: str
    lines: str
    enter: str
    otherwise: str
    leave: tuple[tuple[str, str], ...]


STATES = {
    state.name: state
    for state in (
        # fmt: off
        #     state             lines     on entry               else            left when -> for
        State("idle",           "1-2",    "nothing",             "",             (("nothing_to_do", "finished"),
                                                                                  ("started", "home"))),
        State("home",           "3-4",    "move_home",           "stop",         (("moved", "approach"),)),
        State("approach",       "5",      "move_to_approach",    "next_pose",    (("moved", "advance"),)),
        State("advance",        "6-7",    "move_to_reference",   "skip_pose",    (("moved", "reference"),)),
        State("reference",      "8-9",    "begin_window",        "skip_pose",    (("stands_still", "force_mode"),)),
        State("force_mode",     "10-11",  "record_and_switch",   "skip_pose",    (("switched", "establish"),)),
        State("establish",      "12-13",  "ask_for_force",       "next_case",    (("force_is_near", "settle"),)),
        State("settle",         "13",     "begin_window",        "next_case",    (("stands_still", "record"),)),
        State("record",         "14-21",  "record_row",          "",             (("always", "next_case"),)),
        State("next_case",      "22-23",  "count_case",          "",             (("cases_left", "establish"),
                                                                                  ("always", "position_mode"))),
        State("position_mode",  "24",     "switch_to_position",  "failed",       (("switched", "retract"),)),
        State("retract",        "25",     "move_to_retract",     "failed",       (("moved", "next_pose"),)),
        State("next_pose",      "26-27",  "count_pose",          "",             (("ending", "finished"),
                                                                                  ("no_pose_left", "finished"),
                                                                                  ("pausing", "paused"), ("always", "home"))),
        State("paused",         "-",      "nothing",             "",             (("ending", "finished"), ("resumed", "home"))),
        State("failed",         "-",      "give_up",             "",             (("always", "finished"),)),
        State("finished",       "27",     "nothing",             "",             ()),
        # fmt: on
    )
}
NEAR_CONTACT = ("advance", "reference", "force_mode", "establish", "settle", "record", "next_case", "position_mode", "retract")
