# SPDX-License-Identifier: Apache-2.0
"""What the page for the cell says: traffic light, how far a run is, calibrations to go back to, "Do this now". No ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import IrecError
from ..recertification.advice import NOW, apart, asks_to_resume
from ..recertification.journal import Entry
from ..recertification.readings import MANNED
from ..recertification.verdict import Kind, kind_of

GREEN, AMBER, RED, GREY = "green", "amber", "red", "grey"
MEANING = {GREEN: "GOOD", AMBER: "LOOK AT IT", RED: "NOT GOOD", GREY: "UNKNOWN"}
CONFIRM = {
    "area": "Nobody is in the area of the robot.",
    "disc": "The disc is whole, clean and tight, and the surface too.",
    "tool": "This is the tool that the calibration is for, and it is tight.",
}  # as in recertification.readings: what only a person can see
GO_ON = "Go on with the run that was stopped."
FULL = "Measure everything anew, even if the robot is as it was (takes longer)."
SHOWN = 6


@dataclass(frozen=True)
class Light:
    """A traffic light with its word and what to do now."""

    colour: str
    sentence: str
    now: str = ""

    @property
    def word(self) -> str:
        return MEANING[self.colour]


def light_of(result: Mapping[str, Any]) -> Light:
    """The answer of a recertification (fields of the action's result) as a traffic light."""
    kind, text = kind_of(str(result.get("verdict") or "")), str(result.get("text") or "")
    sentence, now = _now_apart(text or "No answer.")
    if not result.get("success"):
        return Light(GREY, sentence, now or "Do this now: mend what it says, then try again.")
    if kind is Kind.PASS:
        return Light(GREEN, sentence, now or "Do this now: nothing. Go on working.")
    if kind is Kind.RECALIBRATED:
        colour = GREEN if result.get("activated") else AMBER
        return Light(colour, sentence, now or "Do this now: check one part at reduced speed.")
    if kind is Kind.INVESTIGATE:
        return Light(AMBER, sentence, now or "Do this now: show this page to the person in charge.")
    if not result.get("session_path"):  # refused before anything was measured: that says nothing of the robot
        return Light(GREY, sentence, now or "Do this now: mend what it says, then try again.")
    return Light(RED, sentence, now or "Do this now: show this page to the person in charge.")


def _now_apart(text: str) -> tuple[str, str]:
    """A text that ends in what to do now, in two parts."""
    found, now = apart(text)
    if asks_to_resume(now):  # what to call is for programs
        now = f"mend what it says, if anything. Then press Recalibrate and tick {GO_ON!r}"
    return found or text, f"{NOW} {now}" if now else ""


def how_far(progress: Mapping[str, Any] | None) -> tuple[float, str]:
    """Share done (0..1) and a sentence: pose n of N, time left, what it waits for.

    Args:
        progress: `message`, `pose`, `poses`, `remaining_s`, `paused` of the run, as far as known.
    """
    if not progress:
        return 0.0, ""
    message = str(progress.get("message") or "")
    pose, poses = int(progress.get("pose") or 0), int(progress.get("poses") or 0)
    if not poses:
        return 0.0, message
    left = float(progress.get("remaining_s") or 0.0)
    minutes = f", about {math.ceil(left / 60.0)} min left" if left >= 90.0 else f", {left:.0f} s left" if left > 0.0 else ""
    message = "" if message == f"pose {pose} of {poses}" else message  # said already
    paused = "Paused. " if progress.get("paused") else ""
    return min(max(pose - 1, 0) / poses, 1.0), f"{paused}Pose {pose} of {poses}{minutes}. {message}".strip()


@dataclass(frozen=True)
class Past:
    """A calibration that was in force at some time."""

    calibration: str
    at: str
    by: str
    verdict: str
    current: bool


def calibrations(entries: Sequence[Entry], in_force: str) -> list[Past]:
    """Calibrations that were in force, the latest first, each once.

    Args:
        entries: of the store, oldest first; in_force: number of the one in force, or empty.
    """
    out: list[Past] = []
    for e in reversed(entries):
        if e.event in ("put_in_force", "rolled_back") and all(p.calibration != e.calibration for p in out):
            out.append(Past(e.calibration, e.at[:16].replace("T", " "), e.by, e.verdict, e.calibration == in_force))
    return out[:SHOWN]


def may_start(name: str, ticked: Mapping[str, bool]) -> list[str]:
    """What the operator has confirmed; refuses to move before everything is. Raises IrecError saying what is missing."""
    if not name.strip():
        raise IrecError("Enter your name first: somebody has to answer for it.")
    for key in MANNED:
        if not ticked.get(key):
            raise IrecError(f"Confirm first: {CONFIRM.get(key, key)}")
    return list(MANNED)
