# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 as one table, to be read beside the 27 lines of the paper.

`lines` are the lines of Procedure 1; `enter` is the function of entries.py that runs once on entry; `leave` lists (guard of
guards.py, next state), the first guard that holds wins; `otherwise` is what a timeout or a failed command leads to:

    stop          end the run; the robot is taken out of contact first
    skip_pose     give this pose up: position control, retract, next pose
    next_pose     give this pose up while still away from the surface
    next_case     give this load case up, its rows are not recorded, and go on with the next one
    failed        the robot does not obey: end the run and say so
    stand_off     the way out of the contact was not driven: see below
    let_go        likewise, where the robot has not left the contact by itself

The first millimetres out of the contact are driven slowly (`lift`), so that a move that leads the wrong way is stopped in time,
and so are the last ones to the reference (`near`): tooling that stands nearer than the cell file says is touched, not hit.
A way out of the contact counts where the robot stands at its end and the force is that of before contact. Where it does not,
the move is cancelled and no other is asked for: `stand_off` waits for the driver to draw the tool back, which the contract asks
of it; `let_go` switches to force control with no force and does not renew that, so that the lease leads out; a driver without
lease is switched to position control when no force is left. A run is `finished` out of contact, or says that it is not.

Where the next pose or repeat is at the same place, the robot advances again from its approach pose without the way home.

A run takes the robot as it finds it: `position_first` and `withdraw` leave a contact before anything else is asked.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class State:
    """One row of the table; `otherwise` is empty for states that are left at once or by the operator only.

    `timeout` names the state whose time-out of the cell file goes for this one; empty: its own.
    """

    name: str
    lines: str
    enter: str
    otherwise: str
    leave: tuple[tuple[str, str], ...]
    timeout: str = ""


STATES = {
    state.name: state
    for state in (
        # fmt: off
        #     state             lines     on entry               else            left when -> for
        State("idle",           "1-2",    "nothing",             "",             (("nothing_to_do", "finished"),
                                                                                  ("started", "position_first"))),
        State("position_first", "-",      "switch_to_position",  "failed",       (("switched_from_contact", "withdraw"),
                                                                                  ("switched_and_ending", "finished"),
                                                                                  ("switched", "home")), "position_mode"),
        State("withdraw",       "-",      "move_out",            "stand_off",       (("out_and_ending", "finished"),
                                                                                  ("out_of_contact", "home")), "retract"),
        State("home",           "3-4",    "move_home",           "stop",         (("arrived", "approach"),)),
        State("approach",       "5",      "move_to_approach",    "next_pose",    (("arrived", "advance"),)),
        State("advance",        "6-7",    "move_near",           "skip_pose",    (("arrived", "near"),)),
        State("near",           "6-7",    "move_to_reference",   "skip_pose",    (("arrived", "reference"),), "advance"),
        State("reference",      "8-9",    "begin_window",        "skip_pose",    (("stands_still", "force_mode"),)),
        State("force_mode",     "10-11",  "record_and_switch",   "skip_pose",    (("switched", "contact"),)),
        State("contact",        "12",     "ask_for_contact",     "skip_pose",    (("force_is_near", "establish"),), "establish"),
        State("establish",      "12-13",  "ask_for_force",       "next_case",    (("force_is_near", "settle"),)),
        State("settle",         "13",     "begin_window",        "next_case",    (("stands_still", "record"),)),
        State("record",         "14-21",  "record_row",          "",             (("always", "next_case"),)),
        State("next_case",      "22-23",  "count_case",          "",             (("cases_left", "establish"),
                                                                                  ("always", "position_mode"))),
        State("position_mode",  "24",     "switch_to_position",  "failed",       (("switched", "lift"),)),
        State("lift",           "25",     "move_off",            "stand_off",    (("out_of_contact", "retract"),), "retract"),
        State("retract",        "25",     "move_to_retract",     "stand_off",    (("out_of_contact", "next_pose"),)),
        State("next_pose",      "26-27",  "count_pose",          "",             (("presses_still", "stand_off"),
                                                                                  ("ending", "finished"),
                                                                                  ("no_pose_left", "finished"),
                                                                                  ("pausing", "paused"), ("same_place", "again"),
                                                                                  ("always", "home"))),
        State("again",          "26-27",  "begin_pose",          "",             (("always", "advance"),)),
        State("paused",         "-",      "nothing",             "",             (("ending", "finished"), ("resumed", "home"))),
        State("stand_off",      "-",      "stand_off",           "let_go",       (("is_free", "finished"),), "position_mode"),
        State("let_go",         "-",      "let_go",              "failed",       (("is_free", "finished"),
                                                                                  ("is_relieved", "position_last")),
                                                                                 "position_mode"),
        State("position_last",  "-",      "switch_to_position",  "failed",       (("switched", "finished"),), "position_mode"),
        State("failed",         "-",      "give_up",             "",             (("always", "finished"),)),
        State("finished",       "27",     "nothing",             "",             ()),
        # fmt: on
    )
}
NEAR_CONTACT = ("advance", "near", "reference", "force_mode", "contact", "establish", "settle", "record", "next_case",
                "position_mode", "lift", "retract")  # fmt: skip
WAY_IN = ("advance", "near")  # moves towards the tooling
WAY_OUT = ("withdraw", "lift", "retract")  # moves out of the contact
PRESSING = ("contact", "establish", "settle", "record", "next_case")  # a force set point is renewed
