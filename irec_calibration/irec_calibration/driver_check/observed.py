# SPDX-License-Identifier: Apache-2.0
"""What was observed of a driver, and what is said about it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..typing import Array


@dataclass(frozen=True)
class Item:
    """One line of the report: `figure` and `limit` with their units; `advice` says what to change where it failed, or was not
    `checked`, since something was not known. What was not checked has not passed, and has not failed."""

    level: str
    name: str
    passed: bool
    figure: str
    limit: str
    advice: str = ""
    checked: bool = True

    @property
    def failed(self) -> bool:
        return self.checked and not self.passed


@dataclass
class Stream:
    """One topic over some time; n messages.

    Attributes:
        stamp: (n,), s. arrival: (n,), s of the same clock, when it came. value: (n, m), SI units.
        frame: header.frame_id of each. names: joint names, for joint_states. reliable, latched: as offered by the publisher.
    """

    stamp: Array
    arrival: Array
    value: Array
    frame: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    reliable: bool = True
    latched: bool = False


@dataclass
class Observation:
    """Some seconds of a driver. Streams by topic:

    joint_states (positions in the order of `names`), tcp_pose (x y z qx qy qz qw), wrench and wrench_raw (force, torque),
    tracker/point (x y z), robot/state (mode, in_motion, offset x y z, retreating, expired_leases).
    """

    streams: dict[str, Stream] = field(default_factory=dict)
    description: str = ""  # URDF on robot_description
    description_latched: bool = True
    messages: tuple[str, ...] = ()  # of robot/state, each once

    def between(self, begin: float, end: float) -> Observation:
        """The part with begin < stamp <= end, s."""
        part = Observation({}, self.description, self.description_latched, self.messages)
        for name, s in self.streams.items():
            keep = (s.stamp > begin) & (s.stamp <= end)
            frames = tuple(f for f, k in zip(s.frame, keep, strict=True) if k) if s.frame else ()
            part.streams[name] = Stream(s.stamp[keep], s.arrival[keep], s.value[keep], frames, s.names, s.reliable, s.latched)
        return part

    def mean(self, topic: str) -> Array | None:
        """Mean of a stream's values; None where there are none."""
        s = self.streams.get(topic)
        return s.value.mean(axis=0) if s is not None and len(s.value) else None


@dataclass(frozen=True)
class Answer:
    """What came of one request: whether it succeeded, was cancelled, the message, and how long it took, s."""

    success: bool
    message: str
    took: float
    cancelled: bool = False


def at(stream: Stream, times: Array) -> Array:
    """Values at these times by linear interpolation, (len(times), m)."""
    columns = [np.interp(times, stream.stamp, stream.value[:, k]) for k in range(stream.value.shape[1])]
    return np.stack(columns, axis=1)


def report(items: list[Item]) -> str:
    """The report as text, worst first within each level."""
    lines = []
    for level in dict.fromkeys(item.level for item in items):
        own = sorted((i for i in items if i.level == level), key=lambda i: (i.passed, i.checked))
        lines.append(f"{level}: {_counts(own)}")
        for i in own:
            word = "ok    " if i.passed else "FAILED" if i.checked else "not checked"
            lines.append(f"  {word} {i.name}: {i.figure}{f' (limit {i.limit})' if i.limit else ''}")
            if not i.passed and i.advice:
                lines.append(f"         -> {i.advice}")
    return "\n".join(lines)


def _counts(items: list[Item]) -> str:
    unknown = sum(not i.checked for i in items)
    return f"{sum(i.passed for i in items)} of {len(items)} passed{f', {unknown} not checked' if unknown else ''}"


def conclusion(items: list[Item]) -> str:
    """The closing sentence: that the driver keeps the contract only where nothing has failed and all was checked."""
    failed, unknown = sum(i.failed for i in items), [i.name for i in items if not i.checked]
    if failed:
        return f"{_counts(items)}, {failed} failed"
    if unknown:
        but = f"but for what nobody has checked: {', '.join(unknown)}"
        return f"{_counts(items)}, none failed: the driver keeps the contract {but}"
    return f"{_counts(items)}: the driver keeps the contract"
